"""The Cramer-Rao bound against Kalman, Riccati, a plain loop, and observers that run."""

from fractions import Fraction

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg
import xarray as xr

import aslo_jax as aslo
from aslo_jax.control import FieldOriented, MotorFeedback
from aslo_jax.control._base import OpenLoop
from aslo_jax.disturbances import SampledNoise
from aslo_jax.metrics import RMSError
from aslo_jax.plants._base import AbstractPlant
from aslo_jax.plants._machine import MachineState
from aslo_jax.plants._mechanical import MechanicalState
from aslo_jax.study._bound import Bound, cramer_rao, with_bound

H = 0.02
KEYS = jax.vmap(aslo.random.key)(jnp.arange(3))


def integrator(sample, observers=None):
    """The double integrator with noise on what is measured and on what is applied."""
    key, deviation, force = sample
    return aslo.Experiment(
        aslo.plants.IntegratorChain(),
        OpenLoop(lambda t: jnp.sin(3.0 * t)),
        observers or {},
        H,
        sensor=SampledNoise(deviation, H, key),
        actuator=SampledNoise(force, H, key, stream=1),
    )


def noisy(count=1, deviation=0.1, force=0.8):
    """Samples for it."""
    keys = jax.vmap(aslo.random.key)(jnp.arange(count))
    return keys, jnp.full(count, deviation), jnp.full(count, force)


A = np.array([[1.0, H], [0.0, 1.0]])
B = np.array([[H**2 / 2], [H]])
Q = 0.8**2 * B @ B.T
C = np.array([[1.0, 0.0]])


def kalman(steps, P, R=0.01, Q=Q):
    """Joseph's form, measurement first: the variances of x2."""
    found = []
    for k in range(steps + 1):
        P = A @ P @ A.T + Q if k else P
        K = P @ C.T / (C @ P @ C.T + R)
        P = (np.eye(2) - K @ C) @ P @ (np.eye(2) - K @ C).T + R * K @ K.T
        found.append(P[1, 1])
    return np.array(found)


@pytest.mark.parametrize("average", ["bounds", "information"])
def test_a_linear_plant_has_the_kalman_filter_s_covariance(average):
    rate = jnp.array([0.05, 0.3])  # Q has full rank only with it
    extra = H * np.diag(np.square(rate))
    prior = jnp.array([2.0, 3.0])
    bound = cramer_rao(integrator, noisy(3), 60, prior=prior, process=rate, average=average)
    assert bound.variance.shape == ((1 if average == "information" else 3), 61, 1)
    expected = kalman(60, np.diag([4.0, 9.0]), Q=Q + extra)
    np.testing.assert_allclose(bound.norm**2, expected, rtol=1e-10)
    np.testing.assert_allclose(bound.t, H * np.arange(61), rtol=1e-14)


@pytest.fixture(scope="module")
def settled():
    return cramer_rao(integrator, noisy(), 400, prior=jnp.ones(2))


def test_it_settles_at_the_solution_of_riccati_s_equation(settled):
    P = scipy.linalg.solve_discrete_are(A.T, C.T, Q, np.array([[0.01]]))
    P = P - P @ C.T @ C @ P / (C @ P @ C.T + 0.01)
    np.testing.assert_allclose(settled.norm[-1] ** 2, P[1, 1], rtol=1e-9)


def test_no_noise_on_the_state_and_a_known_position():
    """Q = 0 and a singular prior: least squares for the velocity alone."""
    still = noisy(force=0.0)
    bound = cramer_rao(integrator, still, 400, prior=jnp.array([0.0, 2.0]))
    t = bound.t
    expected = 1.0 / (1.0 / 4.0 + np.cumsum(t**2) / 0.01)
    np.testing.assert_allclose(bound.norm**2, expected, rtol=1e-11)


def test_more_measurements_are_better(settled):
    """Two sensors are one with half the variance; and each further sample helps."""
    two = noisy(deviation=0.1 / np.sqrt(2.0))
    bound = cramer_rao(integrator, two, 400, prior=jnp.ones(2))
    assert (bound.norm[1:] < settled.norm[1:]).all()
    # A position tells no velocity.
    np.testing.assert_allclose([bound.norm[0], settled.norm[0]], 1.0, rtol=1e-14)
    assert (np.diff(settled.norm[1:50]) < 0).all()


def test_noise_of_the_argument_and_of_the_input_sensor(settled):
    def make(key):
        blind = SampledNoise(0.8, H, key, stream=1)
        parts = integrator((key, 0.1, 0.8))
        return aslo.Experiment(parts.plant, parts.controller, {}, H, input_sensor=blind)

    bound = cramer_rao(make, KEYS[:1], 20, prior=jnp.ones(2), noise=0.1)
    np.testing.assert_allclose(bound.norm, settled.norm[:21], rtol=1e-12)
    with pytest.raises(ValueError, match="`noise` must be given where"):
        cramer_rao(make, KEYS[:1], 5, prior=jnp.ones(2))


class Growth(AbstractPlant):
    """`x' = sin(2 x) - x/2 + u`, of which `x + x^2/5` is measured."""

    def initial(self):
        return jnp.array([0.4])

    def vector_field(self, t, x, u):
        return jnp.sin(2.0 * x) - 0.5 * x + u

    def output(self, x):
        return x[0] + 0.2 * x[0] ** 2

    def hidden(self, x):
        return x


class Lopsided(AbstractPlant):
    """`x' = A x`, of which `C x` is measured, without any symmetry."""

    A = np.array([[-0.5, 2.0, 0.25], [-1.0, 0.125, 3.0], [0.75, -0.25, -1.5]])
    C = np.array([[1.0, -0.5, 0.0], [0.25, 1.0, 2.0]])

    def initial(self):
        return jnp.zeros(3)

    def vector_field(self, t, x, u):
        return jnp.asarray(self.A) @ x

    def output(self, x):
        return jnp.asarray(self.C) @ x

    def hidden(self, x):
        return x


def test_a_vague_prior_beside_a_good_sensor_against_fractions():
    """The recursion as it is printed, in rational numbers: a prior half a million times
    as wide as the sensors, of which double precision must not lose the square."""
    h, prior, sensor, rate, steps = 0.125, 64.0, np.array([2.0**-13, 2.0**-14]), 0.25, 6

    def make(sample):
        control = OpenLoop(lambda t: 0.0 * t)
        return aslo.Experiment(Lopsided(), control, {}, h, initial=sample)

    found = cramer_rao(
        make, np.zeros((2, 3)), steps, prior=prior, noise=sensor, process=jnp.full(3, rate)
    )
    exact = np.vectorize(Fraction, otypes=[object])
    one, A, C = exact(np.eye(3)), exact(Lopsided.A * h), exact(Lopsided.C)
    F = one + A @ (one + A @ (one + A @ (one + A / 4) / 3) / 2)  # Runge and Kutta's
    information = C.T @ np.diag(1 / exact(sensor) ** 2) @ C
    Q = exact(h * rate**2 * np.eye(3))

    def inverse(M):
        M = np.concatenate([M, one], axis=1)
        for i in range(3):  # definite: no pivot is zero
            M[i] = M[i] / M[i, i]
            for j in set(range(3)) - {i}:
                M[j] = M[j] - M[j, i] * M[i]
        return M[:, 3:]

    J = exact(np.eye(3) / prior**2) + information
    expected = [np.diag(inverse(J))]
    for _ in range(steps):
        J = inverse(F @ inverse(J) @ F.T + Q) + information
        expected.append(np.diag(inverse(J)))
    expected = np.broadcast_to(np.array(expected, float), (2, steps + 1, 3))
    np.testing.assert_allclose(found.variance, expected, rtol=1e-9)


STARTS = np.array([-0.9, 0.1, 0.3, 1.4])


def growth(start):
    control = OpenLoop(lambda t: 0.3 * jnp.cos(t))
    noise = SampledNoise(0.2, 0.1, aslo.random.key(0))
    first = jnp.reshape(start, (1,))
    return aslo.Experiment(Growth(), control, {}, 0.1, sensor=noise, initial=first)


def plain_loop(starts, steps):
    """Scalars, Runge-Kutta by hand, complex steps; the recursion as it is printed."""

    def flow(x, u):
        rate = lambda x: np.sin(2 * x) - 0.5 * x + u
        a = rate(x)
        b = rate(x + 0.05 * a)
        c = rate(x + 0.05 * b)
        d = rate(x + 0.1 * c)
        return x + 0.1 / 6.0 * (a + 2 * b + 2 * c + d)

    q, each, x = 0.1 * 0.5**2, [], starts
    information = lambda x: (1.0 + 0.4 * x) ** 2 / 0.04
    J, J_all = 1.0 + information(x), 1.0 + information(x).mean()
    alone, together = [np.mean(1.0 / J)], [1.0 / J_all]
    for k in range(steps):
        u = 0.3 * np.cos(0.1 * k)
        F = flow(x + 1e-30j, u).imag / 1e-30
        x = flow(x, u)
        J = 1.0 / (F * F / J + q) + information(x)
        D11, D12, D22 = np.mean(F * F) / q, -np.mean(F) / q, 1.0 / q
        J_all = D22 + information(x).mean() - D12**2 / (J_all + D11)
        alone.append(np.mean(1.0 / J))
        together.append(1.0 / J_all)
        each.append(F)
    assert np.ptp(each, axis=1).max() > 0.1  # the trajectories do differ
    return np.array(alone), np.array(together)


def test_a_nonlinear_plant_against_a_plain_loop():
    alone, together = plain_loop(STARTS, 30)
    settings = dict(prior=jnp.ones(1), process=jnp.array([0.5]))
    bound = cramer_rao(growth, STARTS, 30, **settings)
    np.testing.assert_allclose(bound.norm**2, alone, rtol=1e-9)
    posterior = cramer_rao(growth, STARTS, 30, average="information", **settings)
    np.testing.assert_allclose(posterior.norm**2, together, rtol=1e-9)
    assert (posterior.norm <= bound.norm).all()
    settings["process"] = jnp.zeros(1)
    with pytest.raises(ValueError, match='`average` must be "bounds" where some state'):
        cramer_rao(growth, STARTS, 30, average="information", **settings)


def test_an_observer_stays_above_it_and_the_kalman_filter_close():
    """The rms of the study's metric beside the bound of the same name."""
    continuous = [[0.0, 1.0], [0.0, 0.0]], [[0.0], [1.0]], [[1.0, 0.0]]
    noise = 0.8**2 * H, 0.1**2 * H  # intensities
    best = aslo.SteadyStateKalman.design(*continuous, *noise, select=[[0.0, 1.0]])
    plain = aslo.AlgebraicObserver(
        aslo.plants.IntegratorChain().relation(), aslo.LowPass(15.0)
    )
    observers = {"Kalman": best, "ASLO": plain}
    make = lambda sample: integrator(sample, observers)
    metrics = {name: RMSError(name, after=3.0) for name in observers}
    batch = aslo.run_batch(make, noisy(64), 400, metrics=metrics, engine="scan")
    bound = cramer_rao(integrator, noisy(), 400, prior=jnp.zeros(2)).rms(3.0)
    rms = {n: np.sqrt(np.mean(np.square(x))) for n, x in batch.metrics.items()}
    # 64 runs of some 5 s, correlated over a third of one: known to 2 %.
    assert 0.96 < rms["Kalman"] / bound.value < 1.10
    assert rms["ASLO"] > 1.5 * bound.value


def test_the_flux_of_a_motor():
    motor = aslo.plants.PMSM.bmp0701f(inertia=2e-3, friction=1e-3)
    first = MachineState(
        0.2086 * jnp.array([jnp.cos(1.0), jnp.sin(1.0)]), jnp.array(3.0), jnp.array(0.2)
    )

    def make(sample):
        return aslo.Experiment(
            motor,
            FieldOriented(motor, lambda t: 3.0 + 0.0 * t, current_limit=2.3),
            {},
            2e-4,
            feedback=lambda y, x, e: MotorFeedback(y, 5 * x.angle, x.speed),
            sensor=SampledNoise(0.02, 2e-4, sample),
            input_sensor=SampledNoise(0.5, 2e-4, sample, stream=1),
            initial=first,
        )

    spread = [0.05, 0.08, 2.0, 0.06]  # of the two fluxes, the speed and the angle
    prior = MachineState(*map(jnp.asarray, (spread[:2], spread[2], spread[3])))
    bound = cramer_rao(make, KEYS, 200, prior=prior)
    # At the first instant only a current is known: i = (phi - magnet(5 angle)) / L.
    turn = 5 * 0.2086 * np.array([[0, 0, 0, -np.sin(1.0)], [0, 0, 0, np.cos(1.0)]])
    jacobian = (np.eye(2, 4) - turn) / 40.03e-3
    P0 = np.diag(np.square(spread))
    P = np.linalg.inv(np.linalg.inv(P0) + jacobian.T @ jacobian / 0.02**2)
    np.testing.assert_allclose(bound.deviation[0] ** 2, np.diag(P)[:2], rtol=1e-9)
    assert 0.0 < bound.norm[-1] < 0.7 * bound.norm[0]


def leg(first):
    control = OpenLoop(lambda t: jnp.stack([jnp.cos(t), 4.0 * jnp.sin(2.0 * t)]))
    noise = SampledNoise([1e-3, 2e-3, 3e-3], 0.02, aslo.random.key(0))
    plant = aslo.plants.RoboticLeg(1.2, 0.7, [0.1, 0.2, 0.3])
    state = MechanicalState(first[:3], first[3:])
    return aslo.Experiment(plant, control, {}, 0.02, sensor=noise, initial=state)


def test_the_velocities_of_a_leg():
    """Against the information of the whole trajectory on its first state, from central
    differences: a form that is not recursive."""
    first, steps, nudge = np.array([0.8, 0.1, 0.2, 0.3, 2.0, -1.0]), 40, 1e-5
    spread = jnp.array([0.05, 0.06, 0.07, 0.5, 0.6, 0.7])
    prior = MechanicalState(spread[:3], spread[3:])
    bound = cramer_rao(leg, first[None], steps, prior=prior)
    np.testing.assert_allclose(bound.deviation[0], spread[3:], rtol=1e-12)
    nudged = jnp.concatenate([first + nudge * np.eye(6), first - nudge * np.eye(6)])
    x = jax.vmap(lambda first: leg(first).run(steps).x)(nudged)
    differ = lambda x: np.moveaxis(np.asarray(x[:6] - x[6:]), 0, -1) / (2.0 * nudge)
    H, velocity = (
        differ(x.position) / np.array([[1e-3], [2e-3], [3e-3]]),
        differ(x.velocity),
    )
    information = np.diag(1.0 / np.square(spread)) + np.einsum("tij,tik->jk", H, H)
    P = velocity[-1] @ np.linalg.inv(information) @ velocity[-1].T
    np.testing.assert_allclose(bound.deviation[-1] ** 2, np.diag(P), rtol=1e-6)


def test_rms_over_samples_and_time():
    variance = np.array([[[1.0, 3.0], [4.0, 5.0]], [[1.0, 1.0], [2.0, 5.0]]])
    bound = Bound(np.array([0.0, 1.0]), variance)
    np.testing.assert_allclose(bound.norm, np.sqrt([3.0, 8.0]))
    np.testing.assert_allclose(bound.deviation[1], np.sqrt([3.0, 5.0]))
    np.testing.assert_allclose(bound.rms().value, np.sqrt(5.5))
    np.testing.assert_allclose(bound.rms(0.5).value, np.sqrt(8.0))
    with pytest.raises(ValueError, match="`after` must not be past the last sample"):
        bound.rms(2.0)
    dataset = xr.Dataset(coords={"time": [0.1, 0.9, 1.0]})
    found = with_bound(dataset, bound, {"late": 0.5})
    np.testing.assert_allclose(found.cramer_rao, np.sqrt([3.0, 8.0, 8.0]))
    np.testing.assert_allclose(found.cramer_rao_late, np.sqrt(8.0))


def test_arguments_that_make_no_sense():
    with pytest.raises(ValueError, match='`average` must be "bounds" or "information"'):
        cramer_rao(integrator, noisy(), 5, prior=jnp.ones(2), average="mean")
    with pytest.raises(ValueError, match="must have the structure of what deviates"):
        cramer_rao(integrator, noisy(), 5, prior={"a": 1.0, "b": 1.0})
