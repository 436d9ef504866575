"""What must hold for any motor, rate and signal, with inputs that hypothesis makes: other
units, a turned frame, a shifted clock, offsets, the swapping identity, samples against the
flow, saving and restoring."""

import io

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from hypothesis import given, settings, strategies as st
from motion import observe_by_scipy

import aslo_jax as aslo

ROWS = 60
STEP = 2e-3  # s
unit = st.floats(-1.0, 1.0)
factor = st.floats(0.01, 100.0)
rate = st.floats(0.5, 200.0)
several = settings(max_examples=30)


def motor(resistance=0.7, inductance=3e-3, flux=0.09):
    return aslo.plants.FluxRelation(resistance, inductance, flux)


@st.composite
def records(draw):
    """Voltages and currents of a motor that turns unevenly, none of them special."""
    speed, phase, d, q = (draw(unit) for _ in range(4))
    angle = (90 + 60 * speed) * STEP * np.arange(ROWS) + 3 * phase
    angle += 0.5 * np.sin(25 * STEP * np.arange(ROWS) + phase)
    turn = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    across = np.stack([-turn[:, 1], turn[:, 0]], axis=1)
    y = (1.5 + d) * turn + (2.5 + q) * across
    flux = 0.09 * turn + 3e-3 * y
    u = np.zeros_like(y)
    u[:-1] = 0.7 * (y[1:] + y[:-1]) / 2 + np.diff(flux, axis=0) / STEP
    return STEP * np.arange(ROWS), u, y


def estimated(relation, cutoff, t, u, y, gain=None):
    """Numbers as arrays, so that one program serves them all."""
    return _estimated(*jax.tree.map(jnp.asarray, (relation, cutoff, t, u, y, gain)))


@eqx.filter_jit
def _estimated(relation, cutoff, t, u, y, gain):
    observer = aslo.AlgebraicObserver(
        relation, aslo.LowPass(cutoff), aslo.LeastSquares(), guard=aslo.Guard(1e-4)
    )
    if gain is not None:
        observer = aslo.Asymptotic(observer, gain)
    found = aslo.replay(observer, t, u, y)
    return found.value, found.certificate, found.coasting


def near(one, other, tolerance=1e-9):
    scale = np.abs(other).max()
    np.testing.assert_allclose(one, other, rtol=0, atol=tolerance * scale)


@several
@given(records(), rate, factor, factor, factor)
def test_units_change_nothing(record, cutoff, amperes, volts, seconds):
    """Currents in other amperes, voltages in other volts, time in other seconds: the
    flux in other webers, the certificate the same number."""
    t, u, y = record
    value, certificate, _ = estimated(motor(), cutoff, t, u, y, 40.0)
    webers = volts * seconds
    other = motor(0.7 * volts / amperes, 3e-3 * webers / amperes, 0.09 * webers)
    found, same, _ = estimated(
        other, cutoff / seconds, t * seconds, u * volts, y * amperes, 40.0 / seconds
    )
    near(found / webers, value)
    near(same, certificate)


@several
@given(records(), rate, st.floats(-np.pi, np.pi))
def test_a_turned_frame_turns_the_flux(record, cutoff, angle):
    t, u, y = record
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    value, _, coasting = estimated(motor(), cutoff, t, u, y)
    found, _, other = estimated(motor(), cutoff, t, u @ turn, y @ turn)
    # The certificate is that of the scaled matrix, which is another one in another frame.
    known = ~(coasting | other)
    assert known[10:].any()
    near(found[known], (value @ turn)[known], 1e-9)


@several
@given(records(), rate, st.floats(-1e3, 1e6))
def test_the_clock_may_start_anywhere(record, cutoff, shift):
    """To the digits that instants have, 1e-10 s after 1e6 s."""
    t, u, y = record
    value, _, _ = estimated(motor(), cutoff, t, u, y)
    found, _, _ = estimated(motor(), cutoff, t + shift, u, y)
    near(found, value, 1e-4 if abs(shift) > 1e3 else 1e-7)


def speed(cutoff, u, y, gain):
    return _speed(*map(jnp.asarray, (cutoff, u, y, gain)))


@eqx.filter_jit
def _speed(cutoff, u, y, gain):
    """The double integrator by the first-order filter, algebraic and asymptotic."""
    relation = aslo.plants.IntegratorChain(2).relation()
    observer = aslo.AlgebraicObserver(relation, aslo.LowPass(cutoff), aslo.Repeat())
    t = STEP * jnp.arange(len(u))
    both = [observer, aslo.Asymptotic(observer, gain)]
    return tuple(aslo.replay(each, t, u, y).value[..., -1] for each in both)


@several
@given(
    st.lists(unit, min_size=6, max_size=6),
    st.floats(20.0, 100.0),
    st.floats(20.0, 80.0),
    unit,
)
def test_offsets_of_the_double_integrator(shape, cutoff, gain, offset):
    """Remark O4, corrected: an input bias is delta / lam in the estimate, delta (1 / lam +
    1 / gamma) in the asymptotic one; an output offset vanishes, whatever the signals."""
    t = STEP * np.arange(500)
    a, b, c, d, e, f = shape
    u = a * np.sin(9 * b * t + c)
    y = d + e * t + f * np.cos(7 * t)
    right = speed(cutoff, u, y, gain)
    lag = 0.5 * STEP / np.tanh(0.5 * cutoff * STEP)  # of a sampled filter: 1 / lam and more
    for of_input, of_output, expected in (
        (offset, 0.0, (offset * lag, offset * lag + offset / gain)),
        (0.0, offset, (0.0, 0.0)),
    ):
        found = speed(cutoff, u + of_input, y + of_output, gain)
        for one, other, bias in zip(found, right, expected, strict=True):
            np.testing.assert_allclose((one - other)[-1], bias, atol=1e-6)


class Position(eqx.Module):
    """A smooth motion, and as the second derivative of itself the input of a double
    integrator."""

    shape: jax.Array
    derivative: int = eqx.field(static=True, default=0)

    def __call__(self, t):
        a, b, c, d = self.shape
        path = lambda t: a + b * t + c * jnp.sin(2.3 * t + d) + d * jnp.cos(5.1 * t)
        for _ in range(self.derivative):
            path = jax.grad(path)
        return path(jnp.asarray(t, float))


poles = st.lists(st.floats(0.5, 12.0), min_size=2, max_size=2)
shapes = st.lists(unit, min_size=4, max_size=4)


@settings(max_examples=6)
@given(poles, st.lists(st.floats(0.2, 3.0), min_size=2, max_size=2), shapes)
def test_the_swapping_identity_holds_for_any_filter(poles, numerator, shape):
    """`pF` of the position and `F`'s own memory of the input give the velocity at once,
    whatever the poles and the zero are (MATH 2; the exact start)."""
    (p, q), shape = poles, jnp.array(shape)
    law = aslo.LinearFilter(
        A=jnp.array([[0.0, 1.0], [-p * q, -p - q]]), B=jnp.array([0.0, 1.0]), C=numerator
    )
    relation = aslo.plants.IntegratorChain(2).relation()
    observer = aslo.AlgebraicObserver(relation, law, aslo.Repeat())
    ts = jnp.array([0.05, 0.4, 2.0])
    found = observe_by_scipy(observer, Position(shape, 2), Position(shape), ts, atol=1e-14)
    speed = jax.vmap(Position(shape, 1))(ts)
    settled = ~found.coasting
    assert settled.any()
    error = jnp.abs(found.value[:, -1] - speed)[settled]
    assert error.max() < 1e-7 * (1 + jnp.abs(speed).max())


@several
@given(st.floats(1.0, 60.0), st.lists(st.floats(0.3, 1.0), min_size=4, max_size=4))
def test_samples_approach_the_flow_in_second_order(cutoff, shape):
    """Twice as many samples, a quarter of the error, against the true velocity."""
    position, velocity = (Position(jnp.array(shape), k) for k in (0, 1))
    errors = []
    for rows in (100, 200):
        t = jnp.linspace(0.0, 1.0, rows + 1)
        v = jax.vmap(velocity)(t)
        u = jnp.concatenate([jnp.diff(v) * rows, jnp.zeros(1)])
        value = sampled(jnp.asarray(cutoff), t, u, jax.vmap(position)(t))
        errors.append(np.abs(value[:, -1] - v)[rows // 2 :].max())
    assert 3.4 < errors[0] / errors[1] < 4.6


@eqx.filter_jit
def sampled(cutoff, t, u, y):
    relation = aslo.plants.IntegratorChain(2).relation()
    observer = aslo.AlgebraicObserver(relation, aslo.LowPass(cutoff), aslo.Repeat())
    return aslo.replay(observer, t, u, y).value


@eqx.filter_jit
def stepped(observer, state, dt, u, y):
    return observer.step(state, u, y, dt)


@settings(max_examples=10)
@given(records(), rate, st.integers(1, ROWS - 2))
def test_saved_anywhere_it_goes_on_with_the_same_bits(record, cutoff, k):
    t, u, y = record
    observer = aslo.AlgebraicObserver(
        motor(), aslo.LowPass(cutoff), aslo.LeastSquares(), guard=aslo.Guard(1e-4)
    )
    value, _, _ = estimated(motor(), cutoff, t, u, y)
    state = observer.init(y[0])
    for row in range(1, ROWS):
        if row == k:
            kept = io.BytesIO()
            eqx.tree_serialise_leaves(kept, state)
            kept.seek(0)
            restored = eqx.tree_deserialise_leaves(kept, observer.init(jnp.zeros(2)))
            assert eqx.tree_equal(restored, state)
            state = restored
        state, found = stepped(observer, state, t[row] - t[row - 1], u[row - 1], y[row])
        near(found.value, value[row])
