"""FO1, FO2, FO3 and the open-loop integrator: the printed equations, integrated by SciPy,
closed forms, and what becomes of stiff gains in sampled time."""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.integrate
from motion import PrescribedPMSM, observe
from test_sampled import order, prescribed_log, record as record

import aslo_jax as aslo
from aslo_jax.observers._fo3 import _cramer
from aslo_jax.observers._relaxation import relaxation

MOTOR = PrescribedPMSM()
FLUX = MOTOR.relation()
R, L, M = MOTOR.resistance, MOTOR.inductance, MOTOR.magnet_flux
FLUX0 = MOTOR.flux(jnp.zeros(()))
LAM, GUESS = 6.0, [0.05, -0.12]
SLOW = aslo.LowPass(LAM)
compiled = jax.jit(lambda t: (MOTOR.voltage(t), MOTOR.current(t)))


@functools.lru_cache(maxsize=1)
def signals(t):
    return tuple(np.asarray(x) for x in compiled(t))


def printed_fo1(t, s, gain):
    """`s = (q, F[-|mu|^2], F[2 mu], eta)`, as the paper prints it but for its stray c."""
    u, i = signals(t)
    q, f5, f67, eta = s[:2], s[2], s[3:5], s[5:7]
    mu = q - L * i
    Y = -LAM * (mu @ mu + f5)
    omega = LAM * (2 * mu - f67)
    return np.concatenate(
        [
            u - R * i,
            [-LAM * (f5 + mu @ mu)],
            -LAM * (f67 - 2 * mu),
            gain * omega * (Y - omega @ eta),
        ]
    )


def printed_fo2(t, s, gain, one_sided):
    u, i = signals(t)
    x = s - L * i
    h = x @ x - M**2
    return u - R * i - gain * x * (max(0.0, h) if one_sided else h)


def printed_fo3(t, s, gain):
    """`s = (w1, w2 and w3, w4 ... )`: the rows of Prop. 2 with the exact start, and phi."""
    u, i = signals(t)
    one, k, f, r2, b2, phi = s[0], s[1:3], s[3], s[4:6], s[6], s[7:9]
    z, d = u - R * i, M**2 / (2 * L) - L / 2 * (i @ i)
    # k = F[i] + F[rho z]/(lam L), f = F[k'z]/lam - F[d], by their own filters.
    r1, b1 = k - one * i, one * d + f
    D = r1[0] * r2[1] - r1[1] * r2[0]
    N = np.array([b1 * r2[1] - r1[1] * b2, r1[0] * b2 - b1 * r2[0]])
    return np.concatenate(
        [
            [LAM * (1 - one)],
            LAM * (i - k) + one * z / L,
            [LAM * (-d - f) + k @ z],
            LAM * (r1 - r2),
            [LAM * (b1 - b2) + r2 @ z],
            z + gain * D * (N - D * phi),
        ]
    )


def reference(rate, start, *args, t1=1.0):
    """At t = 0.1, 0.2 ... t1."""
    solution = scipy.integrate.solve_ivp(
        rate,
        (0, t1),
        start,
        "DOP853",
        np.arange(1, 11) * t1 / 10,
        args=args,
        rtol=1e-12,
        atol=1e-14,
    )
    return solution.y.T


def ours(observer, t1=1.0):
    ts = jnp.arange(1, 11) * t1 / 10
    return observe(observer, MOTOR.voltage, MOTOR.current, ts).value


@pytest.mark.parametrize("start", ["exact", "paper"])
def test_fo1_is_the_printed_one(start):
    mu = -L * np.asarray(MOTOR.current(jnp.zeros(())))
    filters = [-mu @ mu, *(2 * mu)] if start == "exact" else [0.0, 0.0, 0.0]
    s = reference(printed_fo1, np.r_[0, 0, filters, GUESS], 0.7)
    value = ours(aslo.FO1(FLUX, SLOW, 0.7, start, GUESS))
    np.testing.assert_allclose(value, s[:, :2] + s[:, 5:], atol=1e-11)


@pytest.mark.parametrize("one_sided", [True, False])
def test_fo2_is_the_printed_one(one_sided):
    s = reference(printed_fo2, np.array([0.4, -0.3]), 50.0, one_sided)
    value = ours(aslo.FO2(FLUX, 50.0, one_sided, [0.4, -0.3]))
    # The clamp is a corner in the derivative, which costs both integrators digits.
    np.testing.assert_allclose(value, s, atol=1e-9 if one_sided else 1e-11)


def test_the_clamp_tells_the_two_sides_apart():
    inside = FLUX0 - 0.5 * (FLUX0 - L * MOTOR.current(jnp.zeros(())))
    t, u, y, _ = prescribed_log(1e-3, 0.2)
    values = {
        one_sided: aslo.replay(aslo.FO2(FLUX, 1e3, one_sided, inside), t, u, y).value
        for one_sided in (True, False)
    }
    radius = {k: jnp.linalg.norm(v - L * y, axis=1) for k, v in values.items()}
    # Inside of the circle the one-sided observer integrates, and no more than that.
    free = aslo.replay(aslo.OpenLoopIntegrator(FLUX, inside), t, u, y).value
    assert (radius[True][:20] < M).all()
    np.testing.assert_allclose(values[True][:20], free[:20], atol=1e-15)
    assert abs(radius[False][-1] - M) < 0.02 * M < abs(radius[False][0] - M)


@pytest.fixture(scope="module")
def fo3():
    """The printed equations, and the integral of the squared determinant."""
    return reference(
        lambda t, s, gain: np.r_[
            printed_fo3(t, s[:-1], gain),
            _determinant(t, s) ** 2,
        ],
        np.r_[np.zeros(7), GUESS, 0.0],
        40.0,
    )


def test_fo3_is_the_printed_one(fo3):
    value = ours(aslo.FO3(FLUX, SLOW, 40.0, initial=GUESS))
    np.testing.assert_allclose(value, fo3[:, 7:9], atol=1e-10)


def test_fo3_contracts_each_entry_by_the_integral_of_the_squared_determinant(fo3):
    """`e(t) = e(0) exp(-gain int D^2)`: the same for each entry, from t = 0."""
    ts = jnp.arange(1, 11) / 10
    error = ours(aslo.FO3(FLUX, SLOW, 40.0, initial=GUESS)) - jax.vmap(MOTOR.flux)(ts)
    expected = np.exp(-40.0 * fo3[:, -1:]) * (np.array(GUESS) - FLUX0)
    np.testing.assert_allclose(error, expected, atol=1e-9)
    assert np.abs(expected[-1]).max() < 0.1 * np.abs(expected[0]).max()


def _determinant(t, s):
    i = signals(t)[1]
    r1 = s[1:3] - s[0] * i
    return r1[0] * s[5] - r1[1] * s[4]


@pytest.mark.parametrize("n", [1, 2, 3, 4])
def test_the_numerators_are_the_adjugate_solution(n):
    rng = np.random.default_rng(n)
    R, b = rng.normal(size=(n, n)), rng.normal(size=n)
    D, N = _cramer(jnp.asarray(R), jnp.asarray(b))
    np.testing.assert_allclose(D, np.linalg.det(R), rtol=1e-11)
    np.testing.assert_allclose(N, D * np.linalg.solve(R, b), rtol=1e-10)
    D, N = _cramer(jnp.asarray(np.outer(b, b)), jnp.asarray(b))  # not of full rank
    assert jnp.isfinite(N).all() and (n == 1 or abs(D) < 1e-12)


def test_fo3_of_a_chain_follows_the_true_states():
    """Three integrators, two of them hidden, `x' = A x + z` with A not zero."""
    t = np.arange(4001) * 1e-3
    x = [np.sin(t), np.cos(t), -np.sin(t)]
    u = -np.sinc(5e-4 / np.pi) * np.cos(t + 5e-4)  # the mean over the interval
    relation = aslo.plants.IntegratorChain(3).relation()
    observer = aslo.FO3(relation, aslo.LowPass(4.0), 100.0)
    error = aslo.replay(observer, t, u, x[0]).value - np.stack(x[1:], 1)
    assert jnp.abs(error[0]).max() == 1
    assert jnp.abs(error[t > 3.5]).max() < 1e-4


class Residual(aslo.AbstractObserver):
    """`Y - omega'eta` of FO1, eta being the true one."""

    observer: aslo.FO1
    eta: jax.Array

    def equations(self, F, u, y):
        _, omega, Y = self.observer.regression(F, u, y)
        value = (Y - omega @ self.eta)[None]
        return aslo.Estimate(value, jnp.ones(()), jnp.asarray(False))


def test_fo1_holds_from_the_start_and_the_papers_start_leaves_a_transient():
    ts = jnp.array([1e-6, 1e-3, 0.03, 0.2, 1.0])
    residual = {}
    for start in ("exact", "paper"):
        observer = Residual(aslo.FO1(FLUX, SLOW, 1.0, start), FLUX0)
        residual[start] = observe(observer, MOTOR.voltage, MOTOR.current, ts).value[:, 0]
    np.testing.assert_allclose(residual["exact"], 0.0, atol=1e-12)
    transient = LAM * (FLUX0 @ FLUX0 - M**2) * jnp.exp(-LAM * ts)
    np.testing.assert_allclose(residual["paper"], transient, atol=1e-12)
    assert jnp.abs(transient[:3]).min() > 1e-3


@pytest.mark.parametrize(
    "observer",
    [
        aslo.FO1(FLUX, aslo.LowPass(30.0), 1.0),
        aslo.FO2(FLUX, 200.0, initial=[0.3, 0.3]),
        aslo.FO2(FLUX, 200.0, one_sided=False),
        aslo.FO3(FLUX, aslo.LowPass(30.0), 30.0),
    ],
    ids=["FO1", "FO2", "FO2, both sides", "FO3"],
)
def test_order_two_in_the_interval(observer):
    ts = jnp.array([0.1, 0.2, 0.3])
    exact = observe(observer, MOTOR.voltage, MOTOR.current, ts).value
    errors = []
    for dt in (2e-3, 1e-3, 5e-4):
        t, u, y, _ = prescribed_log(dt, 600 * dt)  # of one length: compiled once
        value = aslo.replay(observer, t, u, y).value[round(0.1 / dt) * np.arange(1, 4)]
        errors.append(float(jnp.abs(value - exact).max()))
    assert ((order(errors) > 1.8) & (order(errors) < 2.4)).all(), errors


@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
def test_fo1_is_stable_at_any_gain(dtype):
    """The distance of eta never grows: each step is a contraction, at the identity."""
    t, u, y, flux = (jnp.asarray(s, dtype) for s in prescribed_log(2e-4, 0.4))
    cast = lambda tree: jax.tree.map(
        lambda x: x.astype(dtype) if eqx.is_inexact_array(x) else x, tree
    )

    def largest(gain):
        observer = cast(aslo.FO1(FLUX, aslo.LowPass(20.0), 1.0))
        observer = eqx.tree_at(lambda o: o.gain, observer, gain)
        value = aslo.replay(observer, np.arange(t.size) * 2e-4, u, y).value
        return jnp.linalg.norm(value - flux, axis=1)

    error = jax.vmap(largest)(10.0 ** jnp.arange(-2, 9, dtype=dtype))
    assert error.dtype == dtype
    rounding = 1e-3 if dtype == jnp.float32 else 1e-5
    assert (jnp.diff(error, axis=1) < rounding).all()
    assert (error[:, -1] < error[:, 0]).all()


@pytest.mark.parametrize("gain", [1e3, 1e6, 1e9])
@pytest.mark.parametrize("one_sided", [True, False])
def test_fo2_is_stable_at_5_kilohertz(one_sided, gain):
    t, u, y, flux = prescribed_log(2e-4, 4.0)
    observer = aslo.FO2(FLUX, gain, one_sided, [1.5, -2.0])
    error = jnp.linalg.norm(aslo.replay(observer, t, u, y).value - flux, axis=1)
    assert error.max() < 2.5
    # Far above its best gain it converges slowly, and has no ripple of its own.
    assert error[-1] < (0.01 if gain == 1e3 else 0.05) * M
    assert jnp.abs(jnp.diff(error[-50:])).max() < 1e-5


def test_a_relaxation_lasts_as_long_as_the_exponential():
    v = jnp.array([0.0, 1e-300, 1e-9, 0.9e-4, 1.1e-4, 0.3, 50.0, 1e30])
    found = jax.vmap(relaxation)(v / 0.1, 0.1 + 0 * v)
    expected = 0.1 * np.r_[1.0, 1.0, -np.expm1(-v[2:]) / v[2:]]
    np.testing.assert_allclose(found, expected, rtol=2e-13)
    slope = jax.vmap(jax.grad(relaxation))(v[:5] / 0.1, 0.1 + 0 * v[:5])
    np.testing.assert_allclose(slope, -(0.1**2) * (0.5 - v[:5] / 3), rtol=1e-8)


def test_the_open_loop_integrates_its_errors():
    """An error at the start stays; an offset of the voltage drifts without bound."""
    t, u, y, flux = prescribed_log(1e-3)
    observer = aslo.OpenLoopIntegrator(FLUX, FLUX0 + jnp.array([0.01, 0.0]))
    offset = jnp.array([0.0, 0.003])
    error = aslo.replay(observer, t, u + offset, y).value - flux
    np.testing.assert_allclose(error[:, 0], 0.01, atol=1e-12)
    np.testing.assert_allclose(error[:, 1], 0.003 * t, atol=1e-12)


def test_standstill_is_no_information():
    """A direct current at rest: the integral of u - R i is known, and the flux is not."""
    t = np.arange(3001) * 1e-3
    y = jnp.ones((t.size, 1)) * jnp.array([0.7, -0.4])
    u, theta = R * y, 0.9
    truth = L * y + M * jnp.array([jnp.cos(theta), jnp.sin(theta)])
    guess = truth[0] + jnp.array([0.03, 0.02])

    def run(observer):
        return aslo.replay(observer, t, u, y)

    for observer in (
        aslo.OpenLoopIntegrator(FLUX, guess),
        aslo.FO1(FLUX, SLOW, 1e6, initial=guess),
        aslo.FO3(FLUX, SLOW, 1e6, initial=guess),
    ):
        estimate = run(observer)
        expected = jnp.broadcast_to(guess, truth.shape)
        np.testing.assert_allclose(estimate.value, expected, atol=1e-12)
        certified = isinstance(observer, aslo.FO1)  # it does not know
        assert jnp.all(estimate.coasting != certified)
        assert jnp.all((estimate.certificate < 1e-12) != certified)
    # FO2 finds the distance and not the direction, in closed form along the ray.
    x = guess - L * y[0]
    value = run(aslo.FO2(FLUX, 1e3, False, guess)).value - L * y
    s0, a = x @ x, jnp.exp(-2e3 * M**2 * t)
    expected = x * jnp.sqrt(M**2 / (s0 * (1 - a) + M**2 * a))[:, None]
    np.testing.assert_allclose(value, expected, atol=1e-12)


@pytest.mark.parametrize(
    ("observer", "bound"),
    [
        (aslo.FO1(FLUX, aslo.LowPass(150.0), 0.02), 1e-4),
        (aslo.FO2(FLUX, 1000.0), 1e-4),
        (aslo.FO2(FLUX, 1000.0, one_sided=False), 1e-4),
        (aslo.FO3(FLUX, aslo.LowPass(150.0), 10.0), 1e-3),
    ],
    ids=["FO1", "FO2", "FO2, both sides", "FO3"],
)
def test_the_shipped_record(record, observer, bound):
    t, u, y, flux = record
    value = aslo.replay(observer, t, u, y).value
    error = np.linalg.norm(value - flux, axis=1) / np.linalg.norm(flux, axis=1)
    assert error[t > 0.8].max() < bound < error[0]


@pytest.mark.parametrize("make", [
    lambda **s: aslo.FO1(FLUX, SLOW, **s), lambda **s: aslo.FO3(FLUX, SLOW, **s),
    lambda **s: aslo.FO2(FLUX, **s),
], ids=["FO1", "FO3", "FO2"])  # fmt: skip
def test_arguments_are_checked(make):
    with pytest.raises(ValueError, match="Argument `gain` must be positive and finite"):
        make(gain=-1.0)
    if not isinstance(make(gain=1.0), aslo.FO2):
        with pytest.raises(ValueError, match="Argument `start` must be"):
            make(gain=1.0, start="late")


def test_fo2_needs_the_magnet_flux():
    with pytest.raises(ValueError, match=r"`relation\.magnet_flux` must be positive"):
        aslo.FO2(aslo.plants.FluxRelation(R, L), 1000.0)
