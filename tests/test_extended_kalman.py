"""The extended Kalman filter against a NumPy loop, the linear theory, SciPy and chance."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.integrate
import scipy.linalg
import scipy.stats
from motion import PrescribedPMSM, observe
from test_sampled import order, prescribed_log, record as record

import aslo_jax as aslo
from aslo_jax.observers import AbstractModel, Belief, PMSMModel

MOTOR = PrescribedPMSM()
FLUX = MOTOR.relation()
R, L, M = MOTOR.resistance, MOTOR.inductance, MOTOR.magnet_flux
GAINS = {"voltage": 1e-5, "acceleration": 300.0, "current": 1e-7}
FILTER = aslo.ExtendedKalman.of_pmsm(FLUX, **GAINS)


class Linear(AbstractModel):
    """An oscillator with two unequal modes and a sensor that mixes them."""

    A: jax.Array
    B: jax.Array
    C: jax.Array

    def drift(self, x, u):
        return self.A @ x + self.B @ jnp.atleast_1d(u)

    def output(self, x):
        return self.C @ x

    def select(self, x):
        return x


A = np.array([[0.0, 1.0, 0.2], [-4.0, -0.3, 0.5], [0.0, 0.1, -0.7]])
B = np.array([[0.0], [1.0], [0.4]])
C = np.array([[1.0, 0.0, 0.3]])
W, V = 0.2, 1e-3
LINEAR = aslo.ExtendedKalman(
    Linear(*map(jnp.asarray, (A, B, C))), B @ B.T * W, [[V]], np.zeros(3), 0.1 * np.eye(3)
)
STEADY = aslo.SteadyStateKalman.design(A, B, C, W, V)


class Covariance(aslo.AbstractObserver):
    """The whole belief of a filter, as one vector: the mean, then the covariance."""

    filter: aslo.ExtendedKalman

    def equations(self, F, u, y):
        mean, covariance = self.filter.belief(F, u, y)
        value = jnp.concatenate([mean, covariance.ravel()])
        return aslo.Estimate(value, jnp.ones(()), jnp.asarray(False))


def loop(u, y, h):
    """One sample at a time, the Jacobians by hand."""
    Q = np.diag([GAINS["voltage"], GAINS["voltage"], GAINS["acceleration"], 0.0])
    V = GAINS["current"] / h * np.eye(2)
    x, P = np.array([M, 0, 0, 0.0]), np.diag([M, M, 100.0, np.pi]) ** 2
    found = [x[:2]]

    def rate(x, u):
        i = (x[:2] - M * np.array([np.cos(x[3]), np.sin(x[3])])) / L
        return np.array([*(u - R * i), 0.0, x[2]])

    def slope(x):
        s, c = M * np.sin(x[3]), M * np.cos(x[3])
        return np.array(
            [
                [-R / L, 0, 0, -R / L * s],
                [0, -R / L, 0, R / L * c],
                [0, 0, 0, 0],
                [0, 0, 1, 0],
            ]
        )

    for k in range(1, len(y)):
        k1 = rate(x, u[k - 1])
        k2 = rate(x + h / 2 * k1, u[k - 1])
        k3 = rate(x + h / 2 * k2, u[k - 1])
        k4 = rate(x + h * k3, u[k - 1])
        # The Jacobian of each stage, by the chain rule.
        J1 = slope(x)
        J2 = slope(x + h / 2 * k1) @ (np.eye(4) + h / 2 * J1)
        J3 = slope(x + h / 2 * k2) @ (np.eye(4) + h / 2 * J2)
        J4 = slope(x + h * k3) @ (np.eye(4) + h * J3)
        G = np.eye(4) + h / 6 * (J1 + 2 * J2 + 2 * J3 + J4)
        x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        P = G @ P @ G.T + h / 2 * (G @ Q @ G.T + Q)
        s, c = np.sin(x[3]), np.cos(x[3])
        H = np.array([[1, 0, 0, M * s], [0, 1, 0, -M * c]]) / L
        K = P @ H.T @ np.linalg.inv(H @ P @ H.T + V)
        x = x + K @ (y[k] - (x[:2] - M * np.array([c, s])) / L)
        P = (np.eye(4) - K @ H) @ P @ (np.eye(4) - K @ H).T + K @ V @ K.T
        found.append(x[:2])
    return np.array(found)


def test_replay_is_the_loop():
    t, u, y, _ = prescribed_log(1e-3, 0.6)
    value = aslo.replay(FILTER, t, u, y).value
    expected = loop(np.asarray(u), np.asarray(y), t[-1] / (t.size - 1))
    np.testing.assert_allclose(value, expected, atol=1e-12)


def test_continuous_filter_is_the_printed_one():
    """Kalman and Bucy's equations of the PMSM by SciPy, from t = 0."""
    signals = jax.jit(lambda t: (MOTOR.voltage(t), MOTOR.current(t)))
    Q = np.diag([1e-3, 1e-3, 300.0, 0.0])
    V = 1e-5
    start = np.array([*MOTOR.flux(jnp.zeros(())), 5.0, 0.5])
    P0 = np.diag([0.01, 0.02, 30.0, 0.3])

    def rate(t, s):
        u, i = (np.asarray(v) for v in signals(t))
        x, P = s[:4], s[4:].reshape(4, 4)
        s, c = M * np.sin(x[3]), M * np.cos(x[3])
        h = (x[:2] - [c, s]) / L
        H = np.array([[1, 0, 0, s], [0, 1, 0, -c]]) / L
        f = np.array([*(u - R * h), 0, x[2]])
        J = np.zeros((4, 4))
        J[:2], J[3, 2] = -R * H, 1
        K = P @ H.T / V
        dP = J @ P + P @ J.T + Q - K @ H @ P
        return np.concatenate([f + K @ (i - h), dP.ravel()])

    ts = np.array([0.01, 0.1, 0.3])
    solution = scipy.integrate.solve_ivp(
        rate, (0, 0.3), np.r_[start, P0.ravel()], "DOP853", ts, rtol=1e-12, atol=1e-14
    )
    filter = aslo.ExtendedKalman(PMSMModel(FLUX), Q, V * np.eye(2), start, P0)
    found = observe(Covariance(filter), MOTOR.voltage, MOTOR.current, jnp.asarray(ts))
    np.testing.assert_allclose(found.value, solution.y.T, rtol=1e-9, atol=1e-10)


def test_continuous_linear_filter_settles_at_the_steady_one():
    P = scipy.linalg.solve_continuous_are(A.T, C.T, B @ B.T * W, [[V]])
    ts = jnp.array([40.0])
    found = observe(Covariance(LINEAR), jnp.cos, lambda t: jnp.sin(t)[None], ts).value[0]
    np.testing.assert_allclose(found[3:].reshape(3, 3), P, rtol=1e-9, atol=1e-12)
    steady = observe(STEADY, jnp.cos, lambda t: jnp.sin(t)[None], ts).value[0]
    np.testing.assert_allclose(found[:3], steady, atol=1e-9)


def test_sampled_linear_filter_settles_at_the_discrete_riccati_equation():
    h = 0.05
    t = np.arange(1200) * h
    y = np.sin(t)[:, None]
    found = aslo.replay(Covariance(LINEAR), t, np.cos(t), y).value[-1, 3:].reshape(3, 3)
    series = [np.linalg.matrix_power(A * h, k) for k in range(5)]
    G = sum(term / f for term, f in zip(series, (1, 1, 2, 6, 24), strict=True))
    Q = h / 2 * (G @ (B @ B.T * W) @ G.T + B @ B.T * W)
    P = scipy.linalg.solve_discrete_are(G.T, C.T, Q, [[V / h]])  # before the update
    P = P - P @ C.T @ np.linalg.solve(C @ P @ C.T + V / h, C @ P)
    np.testing.assert_allclose(found, P, rtol=1e-9, atol=1e-13)


def test_sampled_linear_filter_approaches_the_steady_one():
    """For a given noise intensity, order one in the interval: samples are not a signal."""
    errors = []
    for h in (4e-3, 2e-3, 1e-3):
        t = np.arange(24_001) * h  # 24 s or more, of one length: compiled once
        u = np.cos(t + h / 2)
        values = [aslo.replay(o, t, u, np.sin(t)[:, None]).value for o in (LINEAR, STEADY)]
        errors.append(float(jnp.abs(values[0] - values[1])[t > 20].max()))
    assert ((order(errors) > 0.9) & (order(errors) < 1.1)).all(), errors
    assert errors[-1] < 0.02


def consistency(runs, model, process, measurement, start, spread, samples, h, u):
    """The mean of `e'P^-1 e` over the runs, at each sample; noise as the filter has it."""
    n, p = len(start), len(measurement)
    rng = np.random.default_rng(5)
    x0 = start + rng.normal(size=(runs, n)) * spread
    noise = rng.normal(size=(runs, samples, n)) * np.sqrt(np.diag(process) * h)
    sensor = rng.normal(size=(runs, samples, p)) * np.sqrt(np.diag(measurement) / h)
    t = np.arange(samples) * h
    filter = aslo.ExtendedKalman(model, process, measurement, start, np.diag(spread**2))

    def run(x0, noise, sensor):
        def advance(x, k):
            rate = lambda x: model.drift(x, u[k])
            k1 = rate(x)
            k2 = rate(x + h / 2 * k1)
            x = x + h * rate(x + h / 2 * (0 * k1 + k2)) + noise[k]
            return x, x

        _, x = jax.lax.scan(advance, x0, jnp.arange(samples - 1))
        x = jnp.concatenate([x0[None], x])
        y = jax.vmap(model.output)(x) + sensor
        found = aslo.replay(Covariance(filter), t, u, y).value
        error, P = found[:, :n] - x, found[:, n:].reshape(samples, n, n)
        return jnp.einsum("ki,ki->k", error, jnp.linalg.solve(P, error[..., None])[..., 0])

    return np.asarray(jax.jit(jax.vmap(run))(x0, noise, sensor)).mean(0)


@pytest.mark.slow
def test_pmsm_filter_is_consistent():
    """The normalised estimation error squared of 1000 runs has the mean 4 of its
    chi-squared law, within what chance allows once in a million: it knows its error."""
    h, samples, runs = 2e-4, 1500, 1000
    theta = 30.0 * np.arange(samples) * h + 0.3
    u = 9.0 * np.stack([-np.sin(theta), np.cos(theta)], 1)
    nees = consistency(
        runs, PMSMModel(FLUX), np.diag([1e-6, 1e-6, 50.0, 1e-12]), 5e-8 * np.eye(2),
        np.array([0.2, 0.06, 30.0, 0.3]), np.array([5e-3, 5e-3, 1.0, 0.02]), samples, h,
        jnp.asarray(u),
    )  # fmt: skip
    low, high = scipy.stats.chi2.ppf([5e-7, 1 - 5e-7], 4 * runs) / runs
    inside = (nees > low) & (nees < high)
    assert inside[1:].mean() > 0.99
    assert abs(nees[1:].mean() - 4) < 0.25


@pytest.mark.parametrize(("substeps", "bound"), [(1, 5e-4), (4, 5e-4)])
def test_the_shipped_record(record, substeps, bound):
    t, u, y, flux = record
    filter = aslo.ExtendedKalman.of_pmsm(FLUX, 1e-6, 1e6, 1e-9, 400.0)
    estimate = aslo.replay(filter, t, u, y, substeps=substeps)
    error = np.linalg.norm(estimate.value - flux, axis=1) / np.linalg.norm(flux, axis=1)
    assert error[t > 0.8].max() < bound < error[0]
    assert estimate.certificate[-1] > 0.99


def test_standstill_is_reported_from_a_narrow_first_belief():
    """At rest nothing tells where the magnet points: the variance of the flux along the
    circle stays as it was, and grows with the noise of the voltage. Once the motor turns
    the same filter knows better."""
    P0 = np.diag([5e-3, 5e-3, 1.0, 0.1]) ** 2
    Q = np.diag([1e-6, 1e-6, 1e-3, 0.0])
    filter = lambda x0: aslo.ExtendedKalman(PMSMModel(FLUX), Q, 1e-7 * np.eye(2), x0, P0)
    t = np.arange(2001) * 1e-3
    y = jnp.ones((t.size, 1)) * jnp.array([0.7, -0.4])
    start = jnp.array([L * y[0, 0] + M, L * y[0, 1], 0.0, 0.0])
    rest = aslo.replay(filter(start), t, R * y, y)
    # Of the flux and of m times the angle only the difference is measured.
    assert rest.certificate.max() < 1.1 * 5e-3**2 / (5e-3**2 + (0.1 * M) ** 2)
    np.testing.assert_allclose(rest.value[-1], start[:2], atol=1e-6)
    t, u, y, flux = prescribed_log(1e-3, 2.0)
    start = jnp.array([*flux[0], 10.0, MOTOR.angle(0.0)])
    assert aslo.replay(filter(start), t, u, y).certificate[-1] > 0.5


def test_a_wide_first_belief_makes_it_certain_of_nothing():
    """The price of linearising, which the certificate does not know: at rest, and wrong."""
    t, theta = np.arange(2001) * 1e-3, 0.9
    y = jnp.ones((t.size, 1)) * jnp.array([0.7, -0.4])
    rest = aslo.replay(FILTER, t, R * y, y)
    truth = L * y[0] + M * jnp.array([jnp.cos(theta), jnp.sin(theta)])
    assert rest.certificate[-1] > 0.99
    assert jnp.abs(rest.value[-1] - truth).max() > 0.5 * M


def test_the_covariance_stays_symmetric_and_definite():
    t, u, y, _ = prescribed_log(1e-3)
    for scale in (1.0, 1e-9):  # a sensor that is almost perfect
        filter = aslo.ExtendedKalman.of_pmsm(FLUX, 1e-5, 300.0, scale * 1e-7)
        P = aslo.replay(Covariance(filter), t, u, y).value[:, 4:].reshape(-1, 4, 4)
        size = jnp.sqrt(jnp.einsum("kii->ki", P))
        unit = P / (size[:, :, None] * size[:, None, :])
        np.testing.assert_allclose(unit, jnp.swapaxes(unit, 1, 2), atol=1e-9)
        assert jnp.linalg.eigvalsh(unit).min() > -1e-9


def test_a_belief_starts_as_given():
    belief = FILTER.init(jnp.zeros(2), jnp.zeros(2)).states["belief"]
    assert isinstance(belief, Belief)
    np.testing.assert_allclose(belief.mean, [M, 0, 0, 0])
    np.testing.assert_allclose(jnp.diag(belief.covariance), [M**2, M**2, 1e4, np.pi**2])


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("measurement", [[0.0]], "positive definite"),
        ("process", np.diag([1.0, -1.0, 1.0]), "positive semidefinite"),
        ("covariance", np.eye(3)[[1, 0, 2]], "positive semidefinite"),
    ],
)
def test_covariances_are_checked(name, value, message):
    settings = {
        "process": np.eye(3), "measurement": [[1.0]], "covariance": np.eye(3), name: value
    }  # fmt: skip
    with pytest.raises(ValueError, match=f"Argument `{name}` must be .*{message}"):
        aslo.ExtendedKalman(LINEAR.model, initial=np.zeros(3), **settings)


def test_a_gain_is_refused_where_it_is_not_positive():
    with pytest.raises(ValueError, match="`acceleration` must be positive"):
        aslo.ExtendedKalman.of_pmsm(FLUX, 1.0, -1.0, 1.0)


def test_the_noise_has_a_gradient():
    """How the mean error follows the speed's intensity, by differences."""
    t, u, y, flux = prescribed_log(1e-3, 0.3)

    @jax.jit
    def loss(log_intensity):
        gains = {**GAINS, "acceleration": jnp.exp(log_intensity)}
        filter = aslo.ExtendedKalman.of_pmsm(FLUX, **gains)
        return jnp.mean((aslo.replay(filter, t, u, y).value - flux) ** 2)

    x, d = jnp.log(300.0), 1e-4
    difference = (loss(x + d) - loss(x - d)) / (2 * d)
    np.testing.assert_allclose(eqx.filter_jacfwd(loss)(x), difference, rtol=1e-5)
