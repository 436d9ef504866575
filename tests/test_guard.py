"""Coasting: what the estimate does while the state is not observable."""

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.integrate
from motion import observe

import aslo_jax as aslo
from aslo_jax._guard import Memory

R, L, m = 8.875, 40.03e-3, 0.2086


class Standstill:
    """A motor that turns, rests from 1 s to 3 s with a current that stays, turns again."""

    def speed(self, t):
        return 40.0 * (jnp.clip(1 - t, 0, 1) + jnp.clip(t - 3, 0, 1))

    def angle(self, t):
        down = t - t**2 / 2
        up = jnp.where(t > 3, (t - 3) ** 2 / 2, 0.0)
        return 40.0 * (jnp.where(t < 1, down, 0.5) + up) + 0.4

    def current(self, t):
        a = self.angle(t)
        return jnp.stack([-jnp.sin(a), jnp.cos(a)]) * 1.2

    def flux(self, t):
        a = self.angle(t)
        return L * self.current(t) + m * jnp.stack([jnp.cos(a), jnp.sin(a)])

    def voltage(self, t):
        _, rate = jax.jvp(self.flux, (t,), (jnp.ones_like(t),))
        return R * self.current(t) + rate


def relation(resistance=R):
    return aslo.plants.FluxRelation(resistance, L)


MOTION = Standstill()


def sampled(dt=1e-3, t1=4.0):
    t = np.arange(round(t1 / dt) + 1) * dt
    y, flux = (jax.vmap(f)(jnp.asarray(t)) for f in (MOTION.current, MOTION.flux))
    u = jnp.diff(flux, axis=0) / dt + R * 0.5 * (y[1:] + y[:-1])
    return t, jnp.concatenate([u, u[-1:]]), y, flux


# A low threshold lets more of the sampling error through before it closes.
@pytest.mark.parametrize(("threshold", "bound"), [(1e-6, 2e-2), (1e-3, 2e-3)])
def test_sampled_coasting_through_standstill(threshold, bound):
    t, u, y, flux = sampled()
    guard = aslo.Guard(threshold)
    observer = aslo.AlgebraicObserver(relation(), aslo.LowPass(20.0), guard=guard)
    estimate = aslo.replay(observer, t, u, y)
    resting = (t > 2.0) & (t < 3.0)
    assert estimate.coasting[resting].all()
    assert estimate.certificate[resting].max() < threshold
    running = ((t > 0.2) & (t < 0.8)) | (t > 3.5)
    assert not estimate.coasting[running].any()
    error = jnp.linalg.norm(estimate.value - flux, axis=1)
    assert error[t > 0.2].max() < bound


def test_coasting_is_the_known_derivative():
    """With a wrong resistance the coasting estimate must drift at exactly u - R y, and the
    printed one is gone altogether."""
    t, u, y, _ = sampled()
    wrong = relation(R * 1.02)
    observer = aslo.AlgebraicObserver(wrong, aslo.LowPass(20.0), guard=aslo.Guard(1e-3))
    estimate = aslo.replay(observer, t, u, y)
    z = u[:-1] - wrong.resistance * 0.5 * (y[1:] + y[:-1])
    coasting = np.asarray(estimate.coasting[1:] & estimate.coasting[:-1])
    assert coasting.sum() > 1000
    steps = jnp.diff(estimate.value, axis=0)
    np.testing.assert_allclose(steps[coasting], 1e-3 * z[coasting], atol=1e-14)
    printed = aslo.AlgebraicObserver(wrong, aslo.LowPass(20.0), aslo.Repeat(), guard=None)
    value = aslo.replay(printed, t, u, y).value
    assert jnp.abs(value[(t > 2) & (t < 3)]).max() > 10.0


def test_continuous_coasting_through_standstill():
    ts = jnp.linspace(0.05, 4.0, 80)
    guard = aslo.Guard(1e-4)
    observer = aslo.AlgebraicObserver(relation(), aslo.LowPass(20.0), guard=guard)
    signals = MOTION.voltage, MOTION.current, ts
    estimate = observe(observer, *signals, rtol=1e-9, atol=1e-16)
    resting = (ts > 2.0) & (ts < 3.0)
    assert estimate.coasting[resting].all()
    assert not estimate.coasting[(ts > 0.2) & (ts < 0.8)].any()
    error = jnp.linalg.norm(estimate.value - jax.vmap(MOTION.flux)(ts), axis=1)
    assert error.max() < 1e-5


@pytest.mark.parametrize("start", ["exact", "paper"])
def test_before_the_first_certified_instant_the_guess_is_propagated(start):
    """A motor at rest from the beginning: the guess coasts along its voltage."""
    t = np.arange(501) * 1e-3
    y = jnp.zeros((501, 2))
    u = jnp.stack([jnp.sin(9 * t), 0.5 + 0 * t], 1) * 1e-3
    still = aslo.plants.FluxRelation(R, 1e3)  # so large that no current flows
    guess = jnp.array([0.2, -0.1])
    observer = aslo.AlgebraicObserver(
        still, aslo.LowPass(5.0), guard=aslo.Guard(1e9), start=start, initial=guess
    )
    estimate = aslo.replay(observer, t, u, y)
    assert estimate.coasting.all()
    expected = guess + jnp.concatenate([jnp.zeros((1, 2)), jnp.cumsum(u[:-1], 0) * 1e-3])
    np.testing.assert_allclose(estimate.value, expected, atol=1e-15)


def test_the_asymptotic_observer_coasts_along():
    t, u, y, flux = sampled()
    inner = aslo.AlgebraicObserver(relation(), aslo.LowPass(20.0), guard=aslo.Guard(1e-3))
    estimate = aslo.replay(aslo.Asymptotic(inner, 10.0), t, u, y)
    resting = (t > 2.0) & (t < 3.0)
    assert estimate.coasting[resting].all()
    assert jnp.linalg.norm(estimate.value - flux, axis=1)[t > 0.2].max() < 2e-3


def test_least_squares_through_a_reversal_beats_repeating_a_hundredfold():
    """10 mA and 0.1 V of noise at 10 kHz, speed 2 sin t rad/s: the paper's determinant
    crosses zero at every reversal."""
    dt, t1 = 1e-4, 5.0
    t = jnp.arange(round(t1 / dt) + 1) * dt
    angle = 5 * 2 * (1 - jnp.cos(t)) + 0.4
    axis = jnp.stack([jnp.cos(angle), jnp.sin(angle)], 1)
    y = 1.2 * jnp.stack([-axis[:, 1], axis[:, 0]], 1)
    flux = L * y + m * axis
    u = jnp.diff(flux, axis=0) / dt + R * 0.5 * (y[1:] + y[:-1])
    key = aslo.random.key(7)
    noise = jax.vmap(lambda k: aslo.random.normal(key, k, 0, (4,)))(jnp.arange(t.size))
    u = jnp.concatenate([u, u[-1:]]) + 0.1 * noise[:, :2]
    y = y + 10e-3 * noise[:, 2:]
    peak = {}
    for completion in (aslo.LeastSquares(), aslo.Repeat()):
        observer = aslo.AlgebraicObserver(relation(), aslo.LowPass(10.0), completion)
        error = aslo.replay(observer, np.asarray(t), u, y).value - flux
        peak[type(completion).__name__] = jnp.linalg.norm(error[t > 1], axis=1).max()
    assert peak["LeastSquares"] < peak["Repeat"] / 100
    assert peak["LeastSquares"] < 0.2


@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
def test_the_default_threshold_follows_the_dtype(dtype):
    guard, eps = aslo.Guard(), float(jnp.finfo(dtype).eps)
    assert guard.certified(jnp.asarray(2 * eps**0.75, dtype))
    assert not guard.certified(jnp.asarray(0.5 * eps**0.75, dtype))


def test_arguments_are_refused():
    with pytest.raises(ValueError, match="`threshold` must be positive"):
        aslo.Guard(-1.0)
    with pytest.raises(ValueError, match="`tracking` must be positive"):
        aslo.Guard(tracking=0.0)


def test_a_guard_does_not_stall_the_adaptive_solver():
    plant = aslo.plants.IntegratorChain(4)
    counts = []
    for guard in (None, aslo.Guard()):
        observer = aslo.AlgebraicObserver(plant.relation(), aslo.LowPass(5.0), guard=guard)

        def rate(t, states, args, observer=observer):
            y = jnp.sin(t)
            state = aslo.ObserverState(states, y)
            return observer.vector_field(t, state, jnp.sin(t), y).states

        solution = diffrax.diffeqsolve(
            diffrax.ODETerm(rate),
            diffrax.Tsit5(),
            0.0,
            10.0,
            None,
            observer.init(jnp.zeros(()), jnp.zeros(())).states,
            stepsize_controller=diffrax.PIDController(rtol=1e-8, atol=1e-10),
            max_steps=20_000,
        )
        counts.append(int(solution.stats["num_steps"]))
    assert counts[1] < 6 * counts[0]


@pytest.mark.parametrize("threshold", [0.02, 0.1])
def test_trust_rises_over_one_threshold(threshold):
    guard = aslo.Guard(threshold)
    shares = jnp.array([0.5, 1.0, 1.25, 1.5, 2.0, 3.0])
    trust = [guard.trust(jnp.asarray(threshold * share)) for share in shares]
    np.testing.assert_allclose(trust, [0.0, 0.0, 0.25, 0.5, 1.0, 1.0], atol=1e-12)


@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
@pytest.mark.parametrize("widening", [1e3, 1e6])
def test_trust_rises_until_rounding_is_small(dtype, widening):
    """Without a threshold over a thousand of the default one, or as many as are asked for,
    but over 0.01 at most."""
    guard, default = aslo.Guard(), float(jnp.finfo(dtype).eps) ** 0.75
    width = min(widening * default, 0.01)
    shares = np.array([-1.0, 0.0, 0.3, 0.8, 1.0, 2.0])
    given = {} if widening == 1e3 else {"widening": widening}
    trust = [guard.trust(jnp.asarray(default + s * width, dtype), **given) for s in shares]
    np.testing.assert_allclose(trust, [0.0, 0.0, 0.3, 0.8, 1.0, 1.0], atol=1e-5)


def test_at_its_threshold_an_estimate_is_not_let_through():
    guard = aslo.Guard(0.03)
    assert not guard.certified(guard.threshold)
    assert guard.certified(guard.threshold * (1.0 + 1e-15))


def test_in_continuous_time_the_memory_follows_what_it_trusts():
    """Exponentially to a value, with the tracking rate times the trust; along the known
    derivative without trust."""
    memory = Memory(jnp.asarray(30.0))
    begun, value, rate = (
        jnp.array(each) for each in ([0.4, -2.0], [1.1, 0.3], [5.0, -7.0])
    )
    for trust in (0.0, 0.25, 1.0):
        drive = value, jnp.asarray(True), jnp.asarray(trust), rate
        slope = lambda t, c, drive=drive: memory.flow(jnp.asarray(c), drive)
        found = scipy.integrate.solve_ivp(slope, (0.0, 0.1), begun, rtol=1e-9, atol=1e-12)
        v = 30.0 * trust
        left = np.exp(-0.1 * v)
        along = rate * ((1.0 - left) / v if v else 0.1)
        expected = value + left * (begun - value) + along
        np.testing.assert_allclose(found.y[:, -1], expected, rtol=1e-7)
