"""The lifted Kalman filter against a plain NumPy loop, closed forms, Riccati and chance."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg
from motion import PrescribedBearing, PrescribedPMSM

import aslo_jax as aslo

MOTOR = PrescribedPMSM()
FLUX = MOTOR.relation()
R, L, M = MOTOR.resistance, MOTOR.inductance, MOTOR.magnet_flux
H = 1e-3
T = H * np.arange(1200)


@jax.jit
@jax.vmap
def signals(t):
    return MOTOR.mean_voltage(t, t + H), MOTOR.current(t), MOTOR.flux(t)


U, Y, PHI = map(np.asarray, signals(jnp.asarray(T)))


def noisy(seed, current, voltage):
    """The log with white noise on its samples (A, V)."""
    rng = np.random.default_rng(seed)
    u = U + np.asarray(voltage) * rng.standard_normal(U.shape)
    return u, Y + np.asarray(current) * rng.standard_normal(Y.shape)


def plain(u, y, h, current, voltage, deviation):
    """A Kalman filter in covariances, with all of it by hand: the state is `(sigma, flux)`,
    `sigma = |flux|^2/(2 L)`, and beside it is the noise of the currents at the sample."""
    si, su = np.diag(current), np.diag(voltage)
    x, P = np.zeros(3), np.zeros((3, 3))
    P[1:, 1:] = deviation**2 * np.eye(2)
    c = y[0]  # sigma = c'x + d, the magnet flux in d
    J = -L * y[0] @ si
    noise = J @ J + np.trace(si @ P[1:, 1:] @ si)
    P[0, 0] = c @ P[1:, 1:] @ c + noise
    P[0, 1:] = P[1:, 0] = P[1:, 1:] @ c
    x[0] = 0.5 * (M * M - L * L * (y[0] @ y[0])) / L
    gathered, found = 0.0, [(x[1:].copy(), P[1:, 1:].copy())]
    for k in range(1, len(u)):
        step = h * (u[k - 1] - 0.5 * R * (y[k - 1] + y[k]))
        W = h * h * (su @ su + R * R * si @ si)
        F = np.eye(3)
        F[0, 1:] = step / L
        blurred = np.trace(W @ P[1:, 1:]) / L**2
        sigma = x[0] + x[1:] @ step / L + 0.5 * (step @ step + np.trace(W)) / L
        x = np.array([sigma, *(x[1:] + step)])
        G = np.vstack([x[1:] / L, np.eye(2)])
        P = F @ P @ F.T + G @ W @ G.T
        P[0, 0] += blurred
        gathered += 1.0

        row = np.array([-1.0, *y[k]])
        magnet = x[1:] - L * y[k]  # the noise of a current n enters by -magnet'n
        V = magnet @ si @ si @ magnet + np.trace(si @ P[1:, 1:] @ si)
        # A row that is not significantly away from where it has been is left out.
        away = y[k] - np.linalg.solve(P[1:, 1:], P[1:, 0])
        loose = np.trace(si @ P[1:, 1:] @ si) + gathered * np.trace(W @ P[1:, 1:]) / L**2
        if away @ P[1:, 1:] @ away <= 64.0 * loose:
            found.append((x[1:].copy(), P[1:, 1:].copy()))
            continue
        # The same noise has entered the flux: h R n over the interval.
        entered = G @ (h * R * si) @ (-si @ magnet)
        seen = P @ row + entered
        S = row @ P @ row + 2 * row @ entered + V
        K = seen / S
        innovation = 0.5 * (L * L * (y[k] @ y[k]) - M * M) / L - row @ x
        given = P[0, 0] - P[0, 1:] @ np.linalg.solve(P[1:, 1:], P[1:, 0])
        share = given * (row + np.linalg.solve(P, entered))[0] ** 2 / S
        gathered *= (1.0 - share) ** 2
        x = x + K * innovation
        P = P - np.outer(K, K) * S
        # Row and value have the noise n in common, which takes the mean of their product.
        x = x + P[:, 1:] @ si @ si @ magnet / V
        found.append((x[1:].copy(), P[1:, 1:].copy()))
    x, P = zip(*found, strict=True)
    return np.array(x), np.array(P)


def test_it_equals_a_plain_kalman_filter():
    current, voltage = np.array([2e-3, 3e-3]), np.array([0.05, 0.02])
    u, y = noisy(1, current, voltage)
    observer = aslo.Lifted(FLUX, current, voltage, prior=0.3, guard=None)
    found = aslo.replay(observer, T, u, y)
    x, P = plain(u, y, H, current, voltage, 0.3)
    np.testing.assert_allclose(found.value, x, rtol=0, atol=1e-10 * M)
    np.testing.assert_allclose(found.covariance[-1], P[-1], rtol=1e-8)
    grown = np.diff(np.trace(P, axis1=1, axis2=2)) > 0
    assert 5 < grown.sum() < 600  # some rows are left out, at the start above all
    fused = aslo.replay(observer, T, u, y, engine="fused")
    np.testing.assert_allclose(fused.value, found.value, rtol=0, atol=1e-9 * M)
    np.testing.assert_allclose(fused.covariance, found.covariance, rtol=1e-6, atol=1e-14)


def test_without_noise_it_is_exact_once_the_samples_tell():
    observer = aslo.Lifted(FLUX, 1e-9, 1e-9)
    found = aslo.replay(observer, T[:60], U[:60], Y[:60])
    first = int(np.argmin(found.coasting))
    assert 2 <= first <= 8  # three unknowns, one row a sample
    error = np.linalg.norm(found.value - PHI[:60], axis=1)
    # Three rows a few milliseconds apart differ by the square of the angle in between.
    assert error[first:].max() < 2e-6 * M and error[20:].max() < 1e-12 * M
    assert found.coasting[:first].all() and not found.coasting[first:].any()


@pytest.mark.slow
def test_an_indefinite_quadratic_form():
    motion = PrescribedBearing(aslo.plants.MagneticBearing.laboratory())
    t = 2e-5 * np.arange(500)
    log = jax.vmap(lambda t: (motion.mean_voltage(t, t + 2e-5), motion.current(t)))
    u, y = log(jnp.asarray(t))
    flux = jax.vmap(motion.flux)(jnp.asarray(t))
    observer = aslo.Lifted(motion.bearing.flux_relation(), [1e-6, 2e-6], [1e-5, 2e-5])
    found = aslo.replay(observer, t, u, y)
    assert not found.coasting[-1]
    assert jnp.abs(found.value - flux)[-1].max() < 1e-4 * jnp.abs(flux).max()


def chain(order, start, h, count):
    """An exact log of a chain of integrators, u held."""
    A, b = np.eye(order, k=1), np.eye(order)[-1]
    whole = np.zeros((order + 1, order + 1))
    whole[:order, :order], whole[:order, -1] = A, b
    step = scipy.linalg.expm(whole * h)
    u = np.cos(3.0 * h * np.arange(count)) + 0.3
    x = [np.asarray(start, float)]
    for k in range(count - 1):
        x.append(step[:order, :order] @ x[-1] + step[:order, -1] * u[k])
    return h * np.arange(count), u, np.array(x)


def test_a_chain_with_dynamics_is_exact():
    t, u, x = chain(4, [0.2, -0.4, 0.7, 0.3], 0.01, 200)
    observer = aslo.Lifted(aslo.plants.IntegratorChain(4).relation(), 1e-9, 1e-9)
    found = aslo.replay(observer, t, u, x[:, 0])
    assert not found.coasting[4:].any()
    np.testing.assert_allclose(found.value[50:], x[50:, 1:], atol=1e-6)


SY, SU = 0.02, 0.7


def test_it_settles_at_the_solution_of_riccatis_equation():
    h = 0.01
    t, u, x = chain(2, [0.2, -0.4], h, 1500)
    observer = aslo.Lifted(aslo.plants.IntegratorChain(2).relation(), SY, SU)
    found = aslo.replay(observer, t, u, x[:, 0])
    A, B = np.array([[1.0, h], [0.0, 1.0]]), np.array([[h * h / 2], [h]]) * SU
    C = np.array([[1.0, 0.0]])
    P = scipy.linalg.solve_discrete_are(A.T, C.T, B @ B.T, [[SY**2]])
    P = P - P @ C.T @ C @ P / (P[0, 0] + SY**2)
    np.testing.assert_allclose(found.covariance[-1, 0, 0], P[1, 1], rtol=1e-9)


class TwoRows(eqx.Module):
    """x1, and a mixture of x and a second sensor, which share the noise of the first."""

    def __call__(self, u, y):
        zero = jnp.zeros_like(u)
        z = jnp.stack([zero, u])
        A = jnp.asarray([[0.0, 1.0], [0.0, 0.0]])
        c = jnp.stack([zero + 1.0, zero])
        rate = aslo.Rate(c=c, s=y[0], z=z, A=A)
        return rate, aslo.Linear(
            c=jnp.stack([zero + 0.4, zero + 2.0]), d=y[1] - 0.3 * y[0], z=z, A=A
        )


def two_rows(count, h, seed):
    t, u, x = chain(3, [0.2, -0.4, 0.7], h, count)
    rng = np.random.default_rng(seed)
    d = 0.4 * x[:, 1] + 2.0 * x[:, 2] + 0.3 * x[:, 0]
    y = np.stack([x[:, 0], d], 1) + np.array([0.02, 0.05]) * rng.standard_normal((count, 2))
    return t, u + SU * rng.standard_normal(count), y, x


def test_several_rows_share_their_noise():
    h, count = 0.02, 80
    t, u, y, _ = two_rows(count, h, 3)
    observer = aslo.Lifted(TwoRows(), [0.02, 0.05], SU, prior=[2.0, 3.0], guard=None)
    found = aslo.replay(observer, t, u, y)
    # The whole state measured by y0 = x1, y1 = 0.4 x2 + 2 x3 + 0.3 x1, independent noise.
    A = scipy.linalg.expm(np.eye(3, k=1) * h)
    b = np.array([h**3 / 6, h * h / 2, h])
    C = np.array([[1.0, 0, 0], [0.3, 0.4, 2.0]])
    V = np.diag([0.02, 0.05]) ** 2
    x, P = np.zeros(3), np.diag([1e6, 4.0, 9.0])
    for k in range(count):
        if k:
            x, P = A @ x + b * u[k - 1], A @ P @ A.T + SU**2 * np.outer(b, b)
        K = P @ C.T @ np.linalg.inv(C @ P @ C.T + V)
        x, P = x + K @ (y[k] - C @ x), P - K @ C @ P
    np.testing.assert_allclose(found.value[-1], x[1:], atol=1e-3)
    np.testing.assert_allclose(found.covariance[-1], P[1:, 1:], rtol=2e-3)


@pytest.fixture(scope="module")
def many():
    """Errors and covariances of 24 logs with noise, filtered and smoothed, from nothing."""
    logs = [noisy(seed, 0.01, 0.1) for seed in range(24)]
    u, y = (jnp.stack(s) for s in zip(*logs, strict=True))
    observer = aslo.Lifted(FLUX, 0.01, 0.1)
    each = lambda run: jax.jit(jax.vmap(lambda u, y: run(observer, T, u, y)))(u, y)
    return each(aslo.replay), each(aslo.smooth)


def calibration(estimate, of):
    """The squared error in units of the covariance, over the size of x."""
    e, P = (estimate.value - PHI)[:, of], estimate.covariance[:, of]
    return float(jnp.mean(jnp.sum(e * jnp.linalg.solve(P, e[..., None])[..., 0], -1)) / 2)


def test_the_covariance_is_that_of_the_error(many):
    filtered, smoothed = many
    assert not filtered.coasting[:, 800:].any()
    assert 0.7 < calibration(filtered, slice(800, None)) < 1.4
    assert 0.7 < calibration(smoothed, slice(100, None)) < 1.4


def test_smoothing_is_better_than_filtering(many):
    filtered, smoothed = many
    inside = slice(800, 1100)
    rms = [float(jnp.sqrt(jnp.mean((e.value - PHI)[:, inside] ** 2))) for e in many]
    assert rms[1] < rms[0] / 1.2
    start = jnp.linalg.norm((smoothed.value - PHI)[:, 0], axis=-1)
    assert jnp.all(start < 0.05 * M) and filtered.coasting[:, 0].all()


def test_at_rest_nothing_is_learnt():
    t = 1e-3 * np.arange(4000)
    rng = np.random.default_rng(8)
    y = np.array([1.2, -0.7]) + 0.01 * rng.standard_normal((4000, 2))
    u = R * np.array([1.2, -0.7]) + 0.1 * rng.standard_normal((4000, 2))
    for prior in (None, 0.5):
        observer = aslo.Lifted(FLUX, 0.01, 0.1, prior=prior)
        found = aslo.replay(observer, t, u, y)
        assert found.coasting.all()
        kept = jnp.trace(found.covariance, axis1=1, axis2=2)
        # One direction is that of the row itself, whose level sigma takes up.
        assert kept[-1] > 0.45 * kept[0]
        assert jnp.linalg.norm(found.value[-1]) < 0.05  # the guess, and noise integrated


def test_pieces_are_the_whole_and_an_experiment_runs_it():
    u, y = noisy(2, 1e-3, 1e-2)
    observer = aslo.Lifted(FLUX, 1e-3, 1e-2)
    whole = aslo.replay(observer, T, u, y)
    _, state = aslo.replay(observer, T[:500], u[:500], y[:500], return_state=True)
    rest = aslo.replay(observer, T[499:], u[499:], y[499:], state=state)
    np.testing.assert_allclose(rest.value[1:], whole.value[500:], atol=1e-12)


def whole(belief):
    """Mean and covariance of a belief."""
    n = belief.mean.shape[0]
    U = jnp.eye(n).at[jnp.triu_indices(n, 1)].set(belief.factors.upper)
    return belief.mean, U @ jnp.diag(belief.factors.pivots) @ U.T


@pytest.mark.parametrize("kind", [pytest.param("flux", marks=pytest.mark.slow), "chain"])
def test_continuous_time_is_the_limit_of_short_intervals(kind):
    if kind == "flux":
        relation, (u, y) = FLUX, noisy(4, 1e-6, 1e-5)
    else:
        _, u, x = chain(3, [0.2, -0.4, 0.7], H, T.size)
        relation, y = aslo.plants.IntegratorChain(3).relation(), x[:, 0]
    settings = {"prior": 0.3, "guard": None, "interval": H}
    current, voltage = 1e-6, 1e-5
    observer = aslo.Lifted(relation, current, voltage, **settings)
    _, state = aslo.replay(observer, T, u, y, return_state=True)
    belief = state.states["belief"]
    u, y = jnp.asarray(u[-1]), jnp.asarray(y[-1])
    field = eqx.filter_jit(lambda o, s: o.vector_field(jnp.zeros(()), s, u, y))
    flow = field(observer, state).states["belief"]
    rates = jax.jvp(whole, (belief,), (flow,))[1]
    # Shorter intervals, with noise of the same intensity.
    h = 1e-7
    more = (H / h) ** 0.5
    finer = aslo.Lifted(relation, more * current, more * voltage, **settings)
    step = eqx.filter_jit(lambda o, s: o.step(s, u, y, h)[0])
    after = step(finer, state).states["belief"]
    for a, b, rate in zip(whole(after), whole(belief), rates, strict=True):
        scale = jnp.abs(rate).max()
        np.testing.assert_allclose((a - b) / h, rate, atol=2e-3 * float(scale))


def test_what_it_refuses():
    for name in ("output_deviation", "input_deviation"):
        settings = {"output_deviation": 1e-3, "input_deviation": 1e-2} | {name: 0.0}
        with pytest.raises(ValueError, match=f"Argument `{name}` must be positive"):
            aslo.Lifted(FLUX, **settings)
    with pytest.raises(
        ValueError, match=r"`output_deviation` must be a number or have the"
    ):
        aslo.replay(aslo.Lifted(FLUX, [1e-3] * 3, 1e-2), T, U, Y)
    observer = aslo.Lifted(FLUX, 1e-3, 1e-2)
    u, y = jnp.asarray(U[0]), jnp.asarray(Y[0])
    state = observer.init(y)
    with pytest.raises(ValueError, match="Argument `interval` must be given in continuous"):
        observer.vector_field(jnp.zeros(()), state, u, y)
    with pytest.raises(ValueError, match="must be a `Lifted` or an `Adaptive`, but got"):
        aslo.smooth(aslo.FO2(FLUX, 1.0), T, U, Y)
