"""Sampled time: order, held inputs, substeps, the control loop, and the shipped record."""

import importlib.resources
import io
import subprocess
import sys

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from motion import PrescribedPMSM

import aslo_jax as aslo
from aslo_jax.filters import second_order

MOTOR = PrescribedPMSM()


def prescribed_log(dt, t1=1.0):
    """A log of the prescribed motion whose held voltage gives the true change of flux to
    third order, so that what is measured is the observer's own order."""
    t = np.arange(round(t1 / dt) + 1) * dt
    return t, *_signals(t, t + dt)


@jax.jit
@jax.vmap
def _signals(t, end):
    return MOTOR.mean_voltage(t, end), MOTOR.current(t), MOTOR.flux(t)


def held_log(dt, t1=1.0):
    """A log of a double integrator under a held input, exact in closed form."""
    t = np.arange(round(t1 / dt) + 1) * dt
    u = np.cos(3 * t) + 0.5
    x2 = -0.4 + np.concatenate([[0], np.cumsum(u[:-1])]) * dt
    x1 = 0.7 + np.concatenate([[0], np.cumsum((x2[:-1] + 0.5 * u[:-1] * dt) * dt)])
    return t, jnp.asarray(u), jnp.asarray(x1), jnp.asarray(x2)


def order(errors):
    return np.log2(np.array(errors[:-1]) / np.array(errors[1:]))


@pytest.mark.parametrize(
    "completion", [aslo.LeastSquares(), aslo.Repeat()], ids=["least squares", "repeat"]
)
@pytest.mark.parametrize("filter", [aslo.LowPass(20.0), second_order(30.0)])
@pytest.mark.parametrize("dt", [1e-3, 2e-2])
def test_a_known_change_of_x_leaves_no_error_of_sampling(completion, filter, dt):
    """The Swapping Lemma holds for sequences: samples may lie far apart, and the filter may
    forget within a few of them."""
    if isinstance(completion, aslo.LeastSquares):
        completion = aslo.LeastSquares(aslo.LowPass(20.0))
    observer = aslo.AlgebraicObserver(MOTOR.relation(), filter, completion)
    t, u, y, flux = prescribed_log(dt, 1000 * dt)
    found = aslo.replay(observer, t, u, y)
    error = jnp.linalg.norm(found.value - flux, axis=1)[t > 0.5]
    assert error.max() < 1e-11
    assert not found.coasting[t > 0.5].any()


def test_order_two_of_a_voltage_that_was_measured():
    """The mean of a voltage holds the mean of the current's square, not that of a line."""
    observer = aslo.AlgebraicObserver(MOTOR.relation(), aslo.LowPass(20.0))
    errors = []
    for dt in (4e-3, 2e-3, 1e-3):
        t, u, y, flux = prescribed_log(dt, 1000 * dt)
        middle = jax.vmap(MOTOR.current)(t + 0.5 * dt)
        line = 0.5 * (y + jax.vmap(MOTOR.current)(t + dt))
        u = u + MOTOR.resistance * (2.0 / 3.0) * (middle - line)  # by Simpson's rule
        error = jnp.linalg.norm(aslo.replay(observer, t, u, y).value - flux, axis=1)
        errors.append(float(jnp.sqrt(jnp.mean(error[(t > 0.5) & (t <= 1.0)] ** 2))))
    assert ((order(errors) > 1.9) & (order(errors) < 2.1)).all(), errors


@pytest.mark.parametrize("filter", [aslo.LowPass(8.0), second_order(6.0)])
@pytest.mark.parametrize("dt", [5e-3, 0.5])
def test_no_error_with_a_held_input_and_a_general_filter(filter, dt):
    relation = aslo.plants.IntegratorChain(2).relation()
    observer = aslo.AlgebraicObserver(relation, filter, aslo.Repeat())
    t, u, y, x2 = held_log(dt, 400 * dt)
    error = np.asarray(aslo.replay(observer, t, u, y).value[:, 0] - x2)[t > 0.3]
    assert np.abs(error).max() < 1e-9 * np.abs(x2).max()


@pytest.mark.parametrize(
    "completion", [aslo.LeastSquares(), aslo.Repeat()], ids=["least squares", "repeat"]
)
def test_a_chain_has_the_error_of_the_derivative_only(completion):
    """Its rows turn by A: a filter that forgets within a sample costs nothing more, where
    Heun's method was wrong by 50 times x."""
    h = 1e-2
    t = h * np.arange(2001)
    u, x = np.cos(2.0 * t), np.zeros((t.size, 3))
    for k in range(t.size - 1):
        a, b, c = x[k]
        x[k + 1, 0] = a + h * b + h**2 / 2 * c + h**3 / 6 * u[k]
        x[k + 1, 1:] = b + h * c + h**2 / 2 * u[k], c + h * u[k]
    relation = aslo.plants.IntegratorChain(3).relation()
    errors = []
    for rate in (5.0, 5000.0):
        observer = aslo.AlgebraicObserver(relation, aslo.LowPass(rate), completion)
        found = aslo.replay(observer, t, u, x[:, 0]).value
        errors.append(np.abs(np.asarray(found) - x[:, 1:])[500:].max(axis=0))
    # The mean slope of y over an interval is not that of its ends, by the curvature of the
    # slope: u, and u' for the derivative of the slope, up to 2.
    assert np.max(errors) < 1.05 * h**2 / 12 * 2.0


def test_the_asymptotic_observer_has_no_error_of_sampling():
    inner = aslo.AlgebraicObserver(MOTOR.relation(), aslo.LowPass(20.0))
    t, u, y, flux = prescribed_log(1e-2, 10.0)
    value = aslo.replay(aslo.Asymptotic(inner, 15.0), t, u, y).value
    assert jnp.linalg.norm((value - flux)[t > 2.0], axis=1).max() < 1e-11


def test_voltage_as_a_point_costs_an_order():
    """What the two-sided sampling is for: the held voltage taken as a point loses 5 to 40
    times."""
    t, u, y, flux = prescribed_log(1e-3)
    observer = aslo.AlgebraicObserver(MOTOR.relation(), aslo.LowPass(20.0))
    held = aslo.replay(observer, t, u, y).value
    shifted = aslo.replay(observer, t, jnp.concatenate([u[1:], u[-1:]]), y).value
    error = [jnp.linalg.norm((v - flux)[t > 0.5], axis=1).max() for v in (held, shifted)]
    assert error[1] > 5 * error[0]


@pytest.fixture(scope="module")
def record():
    text = importlib.resources.files("aslo_jax.data").joinpath("pmsm_log.csv").read_text()
    log = np.genfromtxt(io.StringIO(text), delimiter=",", names=True)
    pair = [
        np.stack([log[f"{name}_alpha"], log[f"{name}_beta"]], 1)
        for name in ("u", "i", "flux")
    ]
    return log["t"], *pair


RECORD_OBSERVER = aslo.AlgebraicObserver(
    aslo.plants.FluxRelation(8.875, 40.03e-3), aslo.LowPass(150.0)
)


@pytest.mark.parametrize("substeps", [1, 4])
def test_the_shipped_record(record, substeps):
    t, u, y, flux = record
    estimate = aslo.replay(RECORD_OBSERVER, t, u, y, substeps=substeps)
    error = np.linalg.norm(estimate.value - flux, axis=1) / np.linalg.norm(flux, axis=1)
    assert np.median(error[t > 0.15]) < 5e-5
    assert error[t >= 0.02].max() < 2e-3
    assert not estimate.coasting[t >= 0.02].any()


@pytest.mark.parametrize("substeps", [1, 3])
def test_stepping_equals_replaying(record, substeps):
    t, u, y, _ = (a[:400] for a in record)
    observer = aslo.Asymptotic(RECORD_OBSERVER, 30.0)
    whole = aslo.replay(observer, t, u, y, substeps=substeps)
    step = eqx.filter_jit(lambda s, u, y: observer.step(s, u, y, 2e-4, substeps=substeps))
    state, values = observer.init(y[0], u[0]), []
    for k in range(1, len(t)):
        state, estimate = step(state, u[k - 1], y[k])
        values.append(estimate)
    stepped = jax.tree.map(lambda *x: jnp.stack(x), *values)
    np.testing.assert_allclose(stepped.value, whole.value[1:], atol=1e-13)
    np.testing.assert_array_equal(stepped.coasting, whole.coasting[1:])


def test_a_replay_in_pieces_has_the_same_bits(record):
    # An interval of a power of two, so that each piece computes it to the same bit.
    t = np.arange(1000) * 2.0**-12
    _, u, y, _ = (a[:1000] for a in record)
    observer, cut = aslo.Asymptotic(RECORD_OBSERVER, 30.0), 437
    whole = aslo.replay(observer, t, u, y)
    first, rest = slice(0, cut + 1), slice(cut, None)
    head, state = aslo.replay(observer, t[first], u[first], y[first], return_state=True)
    tail = aslo.replay(observer, t[rest], u[rest], y[rest], state=state)
    for a, b, c in zip(*map(jax.tree.leaves, (whole, head, tail)), strict=True):
        np.testing.assert_array_equal(a[first], b)
        np.testing.assert_array_equal(a[rest], c)


def test_a_step_loop_restored_mid_run_has_the_same_bits(record, tmp_path):
    _, u, y, _ = (a[:60] for a in record)
    observer = aslo.Asymptotic(RECORD_OBSERVER, 30.0)
    step = eqx.filter_jit(lambda s, u, y: observer.step(s, u, y, 2e-4))

    def run(state, first, last):
        values = []
        for k in range(first, last):
            state, estimate = step(state, u[k - 1], y[k])
            values.append(np.asarray(estimate.value))
        return state, values

    start = observer.init(y[0], u[0])
    _, whole = run(start, 1, 60)
    state, head = run(start, 1, 25)
    eqx.tree_serialise_leaves(tmp_path / "state.eqx", state)
    state = eqx.tree_deserialise_leaves(tmp_path / "state.eqx", start)
    _, tail = run(state, 25, 60)
    np.testing.assert_array_equal(np.stack(whole), np.stack(head + tail))


def test_uneven_intervals_are_taken_as_they_are():
    """Samples left out of a log of a held input: each interval has its own length."""
    relation = aslo.plants.IntegratorChain(2).relation()
    observer = aslo.AlgebraicObserver(relation, aslo.LowPass(8.0), aslo.Repeat())
    rng = np.random.default_rng(3)
    dt = rng.uniform(0.5e-3, 2e-3, size=800)
    t = np.concatenate([[0], np.cumsum(dt)])
    u = np.sin(9 * t)
    x2 = -0.4 + np.concatenate([[0], np.cumsum(u[:-1] * dt)])
    x1 = 0.7 + np.concatenate([[0], np.cumsum(x2[:-1] * dt + 0.5 * u[:-1] * dt**2)])
    uneven = aslo.replay(observer, t, u, x1).value[:, 0]
    assert np.abs(uneven - x2)[t > 0.1].max() < 1e-5
    even = aslo.replay(observer, np.linspace(t[0], t[-1], t.size), u, x1).value[:, 0]
    assert np.abs(even - x2)[t > 0.1].max() > 1e-2


def test_the_first_estimate_is_the_initial_guess():
    t, u, y, _ = prescribed_log(1e-3, 0.1)
    guess = jnp.array([0.11, -0.07])
    observer = eqx.tree_at(
        lambda o: o.initial, RECORD_OBSERVER, guess, is_leaf=lambda x: x is None
    )
    estimate = aslo.replay(observer, t, u, y)
    np.testing.assert_array_equal(estimate.value[0], guess)
    assert estimate.coasting[0] and not estimate.coasting[-1]


def test_the_last_input_is_unused():
    t, u, y, _ = prescribed_log(1e-3, 0.1)
    changed = u.at[-1].set(1e6)
    a, b = (aslo.replay(RECORD_OBSERVER, t, v, y).value for v in (u, changed))
    np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
def test_vmap_over_initial_states_and_parameters(record, dtype):
    """In float32 with the threshold of float32: single members, and the true flux."""
    t, u, y, flux = (a[:500] for a in record)
    u, y = jnp.asarray(u, dtype), jnp.asarray(y, dtype)

    def run(initial, resistance, rate):
        relation = aslo.plants.FluxRelation(resistance, jnp.asarray(40.03e-3, dtype))
        relation = eqx.tree_at(lambda r: r.magnet_flux, relation, jnp.zeros((), dtype))
        guard = aslo.Guard(tracking=jnp.asarray(50.0, dtype))
        observer = aslo.AlgebraicObserver(
            relation, aslo.LowPass(rate), guard=guard, initial=initial
        )
        return aslo.replay(observer, t, u, y)

    initial = jnp.array([[0.0, 0.0], [0.2, -0.1], [0.1, 0.1]], dtype)
    resistance = jnp.array([8.875, 9.3, 8.875], dtype)
    rates = jnp.array([150.0, 150.0, 60.0], dtype)
    batch = jax.vmap(run)(initial, resistance, rates)
    assert batch.value.dtype == dtype
    single = 1e-4 if dtype == jnp.float32 else 1e-12
    for k in range(3):
        alone = run(initial[k], resistance[k], rates[k]).value
        np.testing.assert_allclose(batch.value[k], alone, atol=single)
        np.testing.assert_array_equal(batch.value[k, 0], initial[k])
    error = jnp.linalg.norm(batch.value - flux, axis=-1)[:, t > 0.03].max(axis=1)
    assert error[0] < 5e-4 and error[2] < 5e-4
    assert error[1] > 2e-3  # the wrong resistance shows


def test_single_precision_columns_and_integers_are_taken():
    t, u, y, _ = held_log(1e-2)
    observer = aslo.AlgebraicObserver(
        aslo.plants.IntegratorChain(2).relation(), aslo.LowPass(8.0)
    )
    single = aslo.replay(observer, t, u, np.asarray(y, np.float32)).value
    double = aslo.replay(observer, t, u, y).value
    np.testing.assert_allclose(single, double, atol=1e-3)
    counts = np.arange(101)
    pll = aslo.PhaseLockedLoop(40.0)
    np.testing.assert_array_equal(
        aslo.replay(pll, t, 0 * t, counts).value,
        aslo.replay(pll, t, 0 * t, counts.astype(float)).value,
    )


def test_without_double_precision_time_keeps_its_digits():
    """A fresh interpreter with JAX as it comes: a jittered log 5,000 s into a run, and the
    default tolerances of a simulation."""
    code = """
import numpy as np, jax.numpy as jnp, aslo_jax as aslo
rng = np.random.default_rng(0)
dt = rng.uniform(0.8e-3, 1.2e-3, 800)
t = np.concatenate([[0], np.cumsum(dt)])
u = np.sin(9 * t)
x2 = -0.4 + np.concatenate([[0], np.cumsum(u[:-1] * dt)])
x1 = 0.7 + np.concatenate([[0], np.cumsum(x2[:-1] * dt + u[:-1] * dt**2 / 2)])
plant = aslo.plants.IntegratorChain(2)
observer = aslo.AlgebraicObserver(plant.relation(), aslo.LowPass(8.0), aslo.Repeat())
near, far = (aslo.replay(observer, t + s, u, x1).value[:, 0] for s in (0.0, 5000.0))
assert near.dtype == jnp.float32
assert np.abs(near - x2)[t > 0.1].max() < 1e-4
assert np.abs(far - x2)[t > 0.1].max() < 1e-4
solution = aslo.simulate(plant, jnp.cos, {"ASLO": observer}, t1=2.0)
assert np.abs(solution.error("ASLO"))[10:].max() < 1e-3
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
