"""The Kalman filters of all velocities against a plain NumPy loop and closed forms."""

import dataclasses
import re

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import aslo_jax as aslo
from aslo_jax.plants import CartOnArm, Drive

MASS, INERTIA, GRAVITY, DAMPING = 0.7, 0.3, 9.81, np.array([0.4, 0.05])
CART = CartOnArm(MASS, INERTIA, GRAVITY, DAMPING)
H, COUNT = 2e-3, 700
SY, SU, SF = np.array([2e-4, 5e-4]), np.array([0.03, 0.01]), np.array([0.02, 0.004])


def acceleration(q, v, u, mass=MASS, damping=DAMPING, push=0.0):
    """That of a cart on an arm, by hand."""
    (r, angle), (f1, f2) = q, u + push - damping * v
    along = r * v[1] ** 2 - GRAVITY * np.sin(angle) + f1 / mass
    turning = f2 - 2.0 * mass * r * v[0] * v[1] - mass * GRAVITY * r * np.cos(angle)
    return np.array([along, turning / (INERTIA + mass * r**2)])


def motion(x, u, *parameters):
    return np.concatenate([x[2:4], acceleration(x[:2], x[2:4], u, *parameters)])


def runge_kutta(x, u, h, *parameters):
    a = motion(x, u, *parameters)
    b = motion(x + 0.5 * h * a, u, *parameters)
    c = motion(x + 0.5 * h * b, u, *parameters)
    d = motion(x + h * c, u, *parameters)
    return x + h / 6.0 * (a + 2.0 * b + 2.0 * c + d)


def moving(start, seed=1, count=COUNT, mass=MASS, push=0.0):
    """A log of the cart: u, y with noise, and the velocities."""
    rng = np.random.default_rng(seed)
    t = H * np.arange(count)
    level = MASS * GRAVITY * np.stack([np.sin(0.3 * np.sin(3 * t)), 0.5 + 0 * t], 1)
    u = level + np.stack([0.5 * np.sin(4 * t), 0.4 * np.cos(2.5 * t)], 1)
    x = [np.asarray(start, float)]
    for k in range(count - 1):
        true = u[k] + SU * rng.standard_normal(2) + SF * rng.standard_normal(2)
        x.append(runge_kutta(x[-1], true, H, mass, DAMPING, push))
    x = np.array(x)
    return t, u, x[:, :2] + SY * rng.standard_normal((count, 2)), x[:, 2:]


def plain(u, y, h, first, names=(), nominal=(), deviations=(), drift=()):
    """The filter in covariances, its slopes by steps along the imaginary axis: velocities
    from zero, known to `first`; the parameters named one after the other."""

    def given(theta):
        found = dict(mass=MASS, damping=DAMPING, push=0.0)
        for k, name in enumerate(names):
            found[name] = theta[k : k + 2] if name == "push" else theta[k]
        return found["mass"], found["damping"], found["push"]

    def slope(function, *at):
        """By the first of what it is taken at."""
        x, rest = np.asarray(at[0], complex), at[1:]
        steps = 1e-30j * np.eye(len(x))
        return np.array([np.imag(function(x + e, *rest)) / 1e-30 for e in steps]).T

    def whole(z, v):
        return np.concatenate([motion(z[:4], v, *given(z[4:])), np.zeros(k)])

    swapped = lambda v, z: whole(z, v)
    k = len(nominal)
    x = np.concatenate([y[0], np.zeros(2), nominal])
    P = np.diag(np.concatenate([SY, [first] * 2, deviations]) ** 2)
    found, misfit = [(x.copy(), P.copy())], 0.0
    for i in range(1, len(u)):
        v, seen = u[i - 1], (y[i] - y[i - 1]) / h
        wide = h * h * np.diag(P)[2:4] > 2.0 * SY**2
        about = x.copy()
        about[2:4] = np.where(wide, seen, x[2:4])
        middle = about + 0.5 * h * whole(about, v)
        A, B = slope(whole, middle, v), slope(swapped, v, middle)
        F = np.eye(4 + k) + h * A + 0.5 * h * h * A @ A
        # Noise that is held over the interval moves the velocities first.
        G = h * B + 0.5 * h * h * A @ B
        ahead = about.copy()
        ahead[:4] = runge_kutta(about[:4], v, h, *given(about[4:]))
        x = ahead + F @ (x - about)
        P = F @ P @ F.T + G @ np.diag(SU**2 + SF**2) @ G.T
        P[4:, 4:] += h * np.diag(np.asarray(drift) ** 2) if len(drift) else 0.0
        S = P[:2, :2] + np.diag(SY**2)
        K, error = P[:, :2] @ np.linalg.inv(S), y[i] - x[:2]
        misfit += (error @ np.linalg.solve(S, error) / 2 - misfit) / 100
        x = x + K @ error
        P = P - K @ S @ K.T
        found.append((x.copy(), P.copy()))
    x, P = zip(*found, strict=True)
    return np.array(x), np.array(P), misfit


START = [0.5, 0.2, 0.4, -1.5]
LOG = moving(START)
PUSH = np.array([0.15, -0.1])
FORCED = moving(START, 2, mass=0.8, push=PUSH)
KNOWN = aslo.LiftedVelocities(CART, SY, SU, SF, prior=4.0)
UNKNOWN = aslo.AdaptiveVelocities(
    CART, SY, SU, ("mass", "push"), (0.1, [0.2, 0.3]), (0.01, 0.02), SF, prior=4.0
)
GIVEN = [MASS, 0, 0], [0.1, 0.2, 0.3]  # its parameters, and their deviations


@pytest.fixture(scope="module")
def known():
    return aslo.replay(KNOWN, *LOG[:3], return_state=True)


@pytest.fixture(scope="module")
def unknown():
    return aslo.replay(UNKNOWN, *FORCED[:3], return_state=True)


def test_it_equals_a_plain_kalman_filter(known):
    _, u, y, velocity = LOG
    x, P, misfit = plain(u, y, H, 4.0)
    found, state = known
    np.testing.assert_allclose(found.value, x[:, 2:], rtol=0, atol=1e-10)
    np.testing.assert_allclose(found.covariance, P[:, 2:, 2:], rtol=1e-7, atol=1e-15)
    np.testing.assert_allclose(
        found.certificate, 1 / (1 + np.max(np.diagonal(P, 0, 1, 2)[:, 2:], 1) / 16)
    )
    np.testing.assert_allclose(state.states["belief"].misfit, misfit, rtol=1e-8)
    assert found.coasting[0] and not found.coasting[3:].any()
    assert np.abs(x[100:, 2:] - velocity[100:]).max() < 0.05


def test_parameters_that_do_not_drift_keep_their_factors():
    t, u, y, _ = FORCED
    still = dataclasses.replace(UNKNOWN, drift=None)
    found = aslo.replay(still, t[:200], u[:200], y[:200])
    x, P, _ = plain(u[:200], y[:200], H, 4.0, ("mass", "push"), *GIVEN)
    np.testing.assert_allclose(found.parameters, x[:, 4:], rtol=0, atol=1e-9)
    np.testing.assert_allclose(
        found.parameter_covariance, P[:, 4:, 4:], rtol=1e-6, atol=1e-12
    )


def test_with_unknown_parameters_it_equals_a_plain_kalman_filter(unknown):
    _, u, y, velocity = FORCED
    drift = [0.01, 0.02, 0.02]
    x, P, _ = plain(u, y, H, 4.0, ("mass", "push"), *GIVEN, drift)
    found = unknown[0]
    np.testing.assert_allclose(found.value, x[:, 2:4], rtol=0, atol=1e-9)
    np.testing.assert_allclose(found.parameters, x[:, 4:], rtol=0, atol=1e-9)
    np.testing.assert_allclose(
        found.parameter_covariance, P[:, 4:, 4:], rtol=1e-6, atol=1e-12
    )
    # They are found, and the deviations are those of what has been found.
    off = found.parameters[-1] - np.array([0.8, *PUSH])
    assert (np.abs(off) < 3.5 * np.sqrt(np.diag(found.parameter_covariance[-1]))).all()
    assert np.abs(off[0]) < 0.02 < 0.1 and not found.held[-1] and found.held[2]
    assert np.abs(found.value - velocity)[100:].max() < 0.05


BOTH = (
    pytest.param(KNOWN, id="lifted"),
    pytest.param(UNKNOWN, id="adaptive", marks=pytest.mark.slow),
)


@pytest.mark.parametrize("observer", BOTH)
def test_steps_and_the_fused_engine_give_the_same(observer, known, unknown):
    (t, u, y, _), (whole, _) = (LOG, known) if observer is KNOWN else (FORCED, unknown)
    fused = aslo.replay(observer, t, u, y, engine="fused")
    for a, b in zip(*map(jax.tree.leaves, (fused, whole)), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-6, atol=1e-9)
    # Saved after 300 rows and restored, then step by step.
    begin = slice(0, 300)
    _, state = aslo.replay(observer, t[begin], u[begin], y[begin], return_state=True)
    state = jax.tree.map(lambda x: jnp.asarray(np.asarray(x)), state)
    step = jax.jit(lambda *signals: observer.step(*signals, H))
    for k in range(300, 330):
        state, estimate = step(state, u[k - 1], y[k])
        np.testing.assert_allclose(estimate.value, whole.value[k], rtol=1e-9, atol=1e-11)


def test_of_a_double_integrator_it_is_the_lifted_filter():
    rng = np.random.default_rng(3)
    t, u = H * np.arange(300), rng.standard_normal((300, 1))
    y = np.cumsum(0.01 * rng.standard_normal((300, 1)), axis=0)
    chain = aslo.Lifted(aslo.plants.IntegratorChain(2).relation(), 1e-3, 0.5, guard=None)
    expected = aslo.replay(chain, t, u[:, 0], y[:, 0])
    observer = aslo.LiftedVelocities(Drive(0.0, 1.0), 1e-3, 0.5)
    found = aslo.replay(observer, t, u, y)
    np.testing.assert_allclose(found.value, expected.value, atol=1e-7)
    np.testing.assert_allclose(found.covariance[3:], expected.covariance[3:], rtol=1e-7)


FAST = jnp.array([[0.5, 0.2, 0.0, 0.0], [0.5, 0.2, 2.0, 60.0], [0.7, -1.0, -3.0, -150.0]])


def test_nothing_has_to_be_known_of_the_start():
    """Fine encoders, no noise of the input: from any velocity it is exact at once, and has
    no rival solution to fall for."""
    h, count = 1e-4, 400
    u = np.zeros((count, 2))

    def log(x):
        each = [np.asarray(x)]
        for _ in range(count - 1):
            each.append(runge_kutta(each[-1], np.zeros(2), h))
        return np.array(each)

    x = np.stack([log(start) for start in FAST])
    step = 1e-7
    y = np.round(x[:, :, :2] / step) * step
    observer = aslo.LiftedVelocities(CART, step / 12**0.5, 1e-6)
    t = h * np.arange(count)
    found = jax.vmap(lambda y: aslo.replay(observer, t, u, y))(jnp.asarray(y))
    assert found.coasting[:, 0].all() and not found.coasting[:, 1:].any()
    error = np.abs(found.value - x[:, :, 2:])
    size = 1.0 + np.abs(x[:, :1, 2:])
    assert (error[:, 10:] < 1e-3 * size).all() and (error[:, 300:] < 1e-5 * size).all()


def test_wrapped_angles_are_unwrapped(known):
    t, u, y, _ = LOG
    turned = y[:200] + np.array([0.0, 3.2])
    wrapped = turned - np.array([0.0, 2 * np.pi]) * np.round(turned / (2 * np.pi))
    assert np.abs(np.diff(wrapped[:, 1])).max() > 6.0
    one, other = (aslo.replay(KNOWN, t[:200], u[:200], q) for q in (turned, wrapped))
    np.testing.assert_allclose(one.value, other.value, atol=1e-9)


def test_a_model_that_does_not_fit_is_told():
    """With a mass that is wrong and no forces that the model does not know, the covariance
    says that all is well; the innovations do not."""
    t, u, y, velocity = LOG
    wrong = CartOnArm(1.2 * MASS, INERTIA, GRAVITY, DAMPING)
    found = {
        name: aslo.replay(aslo.LiftedVelocities(system, SY, SU + SF, prior=4.0), t, u, y)
        for name, system in {"right": CART, "wrong": wrong}.items()
    }
    error = np.abs(found["wrong"].value - velocity)[300:]
    claimed = np.sqrt(np.diagonal(found["wrong"].covariance[300:], 0, 1, 2))
    assert (error / claimed).max() > 10.0
    assert found["wrong"].coasting[300:].all() and not found["right"].coasting[3:].any()


def test_over_missing_samples_it_is_carried_along_and_says_so(known):
    t, u, y, velocity = LOG
    hole = slice(300, 340)
    y = y.copy()
    y[hole] = np.nan
    found = aslo.replay(KNOWN, t, u, y, missing="coast")
    np.testing.assert_array_equal(found.value[:300], known[0].value[:300])
    assert found.coasting[hole].all() and not found.coasting[400:].any()
    variance = np.trace(found.covariance, axis1=1, axis2=2)
    assert (np.diff(variance[hole]) > 0).all() and variance[400] < 2 * variance[299]
    off = np.abs(found.value - velocity) / np.sqrt(
        np.diagonal(found.covariance, axis1=1, axis2=2)
    )
    assert off[hole].max() < 4.0 and off[340:].max() < 5.0
    u = u.copy()
    u[hole] = np.nan
    blind = aslo.replay(KNOWN, t, u, y, missing="coast")
    assert np.trace(blind.covariance[339]) > 100 * variance[339]
    assert not blind.coasting[-1]
    assert np.abs(blind.value - velocity)[-50:].max() < 0.05


def test_in_continuous_time_it_obeys_riccatis_equation():
    observer = aslo.AdaptiveVelocities(
        CART, SY, SU, ("mass",), (0.1,), (0.02,), prior=0.3, initial=[0.1, -0.4], interval=H
    )
    u, y = jnp.array([0.3, 0.6]), jnp.array([0.5, 0.2])
    state = observer.init(y, u)
    belief = state.states["belief"]
    # A belief with covariances between all of its entries.
    rng = np.random.default_rng(0)
    upper = 0.3 * rng.standard_normal(10)
    pivots = np.array([1e-6, 2e-6, 0.03, 0.05, 0.002])
    mean = belief.mean + jnp.array([1e-3, -2e-3, 0.0, 0.0, 0.05])
    belief = belief._replace(
        mean=mean, factors=type(belief.factors)(jnp.asarray(upper), jnp.asarray(pivots))
    )
    state = type(state)(state.states | {"belief": belief}, state.y, state.gap)
    field = eqx.filter_jit(lambda *signals: observer.vector_field(jnp.zeros(()), *signals))
    rate = field(state, u, y).states["belief"]

    def covariance(factors):
        U = jnp.eye(5).at[np.triu_indices(5, 1)].set(factors.upper)
        return (U * factors.pivots) @ U.T

    slopes = jax.jit(lambda x, v: jax.jvp(covariance, (x,), (v,)))
    P, slope = slopes(belief.factors, rate.factors)
    full = lambda x, u: np.concatenate([motion(x[:4], u, x[4]), [0.0]])
    numeric = lambda f, x: np.stack(
        [np.imag(f(np.asarray(x) + 1e-30j * e)) / 1e-30 for e in np.eye(len(x))], 1
    )
    A, B = numeric(lambda x: full(x, u), mean), numeric(lambda u: full(mean, u), u)
    W = H * B @ np.diag(SU**2) @ B.T
    W[4, 4] += 0.02**2
    K = np.asarray(P)[:, :2] @ np.diag(1 / (H * SY**2))
    riccati = A @ P + P @ A.T + W - K @ P[:2]
    np.testing.assert_allclose(slope, riccati, rtol=1e-9, atol=1e-12)
    expected = full(mean, u) + K @ (y - mean[:2])
    np.testing.assert_allclose(rate.mean, expected, rtol=1e-10)


REFUSED = {
    "`output_deviation` must be positive": dict(output_deviation=0.0),
    "`input_deviation` must be a number or have the shape (2,)": dict(
        input_deviation=[1.0, 2.0, 3.0]
    ),
    "`force_deviation` must be a number or have the shape (2,)": dict(
        force_deviation=[1.0, 2.0, 3.0]
    ),
    "`initial` must have the shape (2,)": dict(initial=[1.0]),
    "`interval` must be given in continuous time": dict(),
}


@pytest.mark.parametrize("message", REFUSED)
def test_refusals(message):
    settings = dict(system=CART, output_deviation=SY, input_deviation=SU)
    u, y = jnp.zeros(2), jnp.array([0.5, 0.2])

    def made():
        observer = aslo.LiftedVelocities(**(settings | REFUSED[message]))
        observer.vector_field(jnp.zeros(()), observer.init(y, u), u, y)

    with pytest.raises(ValueError, match=re.escape(message)):
        made()


UNFIT = {
    "`parameters` must name leaves of the system, each once": dict(parameters=()),
    '`parameters` must name arrays that the system has, or "push", but `mas`': dict(
        parameters=("mas",)
    ),
    "`deviations` must have one entry for each of ('mass', 'push')": dict(deviations=0.1),
    "`drift` must have one entry for each": dict(drift=(1.0, 2.0, 3.0)),
    "`deviations` must be a number or have the shape (2,)": dict(
        deviations=(0.1, [1.0, 2.0, 3.0])
    ),
}


@pytest.mark.parametrize("message", UNFIT)
def test_refusals_of_parameters(message):
    settings: dict = dict(parameters=("mass", "push"), deviations=(0.1, 0.2))

    def made():
        observer = aslo.AdaptiveVelocities(CART, SY, SU, **(settings | UNFIT[message]))
        observer.init(jnp.array([0.5, 0.2]), jnp.zeros(2))

    with pytest.raises(ValueError, match=re.escape(message)):
        made()
