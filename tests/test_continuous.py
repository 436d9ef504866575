"""Continuous co-simulation by the fused engine: against SciPy, closed forms and diffrax."""

import itertools
import warnings

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.integrate
from jax.flatten_util import ravel_pytree

import aslo_jax as aslo
from aslo_jax._interconnection import Interconnection
from aslo_jax.control._base import controlled
from aslo_jax.disturbances import ParasiticLag, SampledNoise
from aslo_jax.export._traced import precision

pytest.importorskip("llvmlite")
PLANT = aslo.plants.IntegratorChain(2)
X0 = jnp.array([0.3, 0.1])
TS = np.linspace(0, 2, 21)


def u(t):
    return jnp.cos(2.0 * t)


def printed(rate=3.0):
    return aslo.AlgebraicObserver(
        PLANT.relation(),
        aslo.LowPass(rate),
        completion=aslo.Repeat(),
        guard=None,
        start="paper",
    )


def run(observers, **settings):
    settings = dict(t1=2.0, initial=X0, ts=TS, engine="fused") | settings
    return aslo.simulate(PLANT, u, observers, **settings)


# -- a motor ------------------------------------------------------------------------------

MOTOR = aslo.plants.PMSM.bmp0701f(load=lambda t: 0.5)
OBSERVER = aslo.AlgebraicObserver(MOTOR.flux_relation(), aslo.LowPass(200.0), guard=None)
INSTANTS = np.linspace(0.0, 0.05, 11)


def voltage(t):
    return 40.0 * jnp.stack([jnp.cos(100.0 * t), jnp.sin(100.0 * t)])


def turned(motor=MOTOR, **settings):
    settings = dict(t1=0.05, ts=INSTANTS, engine="fused") | settings
    return aslo.simulate(motor, voltage, {"ASLO": OBSERVER}, **settings)


@pytest.fixture(scope="module")
def accurate():
    """The motor's states by SciPy, from the vector field of the library."""
    parts = (None, None, None, None, None)
    loop = Interconnection(MOTOR, controlled(voltage), {"ASLO": OBSERVER}, *parts)
    start, tree = ravel_pytree(loop.init(jnp.asarray(0.0), MOTOR.initial()))
    rate = jax.jit(lambda t, x: ravel_pytree(loop.vector_field(t, tree(x), None))[0])
    found = scipy.integrate.solve_ivp(
        lambda t, x: np.asarray(rate(t, x)),
        (0.0, 0.05),
        np.asarray(start),
        "DOP853",
        INSTANTS,
        rtol=1e-12,
        atol=1e-14,
    )
    return jax.vmap(tree)(jnp.asarray(found.y.T))


@pytest.fixture(scope="module")
def tolerances(accurate):
    """The largest error of flux and speed over their sizes, by tolerance."""
    found = {}
    for rtol in (1e-4, 1e-6, 1e-8, 1e-10):
        x = turned(rtol=rtol, atol=1e-2 * rtol).x
        exact = accurate["plant"]
        pairs = [(x.flux, exact.flux), (x.speed, exact.speed)]
        found[rtol] = max(float(jnp.abs(a - b).max() / jnp.abs(b).max()) for a, b in pairs)
    return found


def test_a_motor_against_scipy(accurate):
    solution = turned(rtol=1e-11, atol=1e-13)
    states = {"plant": solution.x, "observers": {"ASLO": solution.states["ASLO"]}}
    expected = {key: accurate[key] for key in states}
    for ours, theirs in zip(*map(jax.tree.leaves, (states, expected)), strict=True):
        np.testing.assert_allclose(
            ours, theirs, atol=1e-9 * (1 + float(np.abs(theirs).max()))
        )
    assert not solution.result.any()


@pytest.mark.slow
def test_errors_fall_with_the_tolerance(tolerances):
    """To ten times the tolerance at most, at the instants that are interpolated too."""
    errors = list(tolerances.values())
    assert all(error <= 10 * rtol for rtol, error in tolerances.items()), tolerances
    assert all(b < 0.1 * a for a, b in itertools.pairwise(errors)), tolerances


def test_lanes_do_not_depend_on_their_neighbours():
    """Bit by bit, whether a run is alone, in a batch, or in another order."""
    one = lambda r: turned(aslo.plants.PMSM.bmp0701f(resistance=r), rtol=1e-6)
    given = jnp.linspace(7.0, 11.0, 19)
    batch, turnedround = jax.vmap(one)(given), jax.vmap(one)(given[::-1])
    for k in (0, 11, 18):
        alone = one(given[k])
        for a, b, c in zip(*map(jax.tree.leaves, (alone, batch, turnedround)), strict=True):
            np.testing.assert_array_equal(a, b[k])
            np.testing.assert_array_equal(a, c[18 - k])
    compiled = jax.jit(jax.vmap(one))(given)
    np.testing.assert_array_equal(compiled.x.flux, batch.x.flux)


# -- closed forms -------------------------------------------------------------------------


def test_a_chain_with_lag_in_closed_form():
    tau = 0.3
    solution = run({"ASLO": printed()}, actuator=ParasiticLag(tau), rtol=1e-11, atol=1e-13)
    c = 1.0 / (1.0 + 4.0 * tau**2)
    speed = 0.1 + c * (0.5 * np.sin(2 * TS) - tau * (np.cos(2 * TS) - 1.0))
    speed = speed + c * tau * (np.exp(-TS / tau) - 1.0)
    np.testing.assert_allclose(solution.x[:, 1], speed, atol=1e-10)
    # Seen by the observer is the command, of which the plant has the lagging part.
    np.testing.assert_allclose(solution.u, np.cos(2 * TS), atol=1e-15)


@pytest.mark.parametrize("t0", [0.0, pytest.param(0.35, marks=pytest.mark.slow)])
def test_held_noise_is_stepped_to(t0):
    """Against the exact recurrence of a filter whose input is piecewise constant."""
    ts = np.arange(round(t0 / 0.05), 41) * 0.05
    noise = SampledNoise(0.3, 0.05, aslo.random.key(4), 0)
    solution = aslo.simulate(
        PLANT,
        lambda t: 0.0 * t,
        {"A": printed()},
        t0=t0,
        t1=2.0,
        ts=ts,
        initial=X0,
        input_sensor=noise,
        rtol=1e-9,
        atol=1e-11,
        engine="fused",
    )
    w, expected, a = 0.0, [0.0], np.exp(-3.0 * 0.05)
    for k in range(round(t0 / 0.05), 40):
        v = 0.3 * float(aslo.random.normal(aslo.random.key(4), k, 0, ()))
        w = a * w + (1 - a) * v
        expected.append(w)
    transient = (3 * 0.3 - 0.1) * np.exp(-3.0 * (ts - t0))
    noisy = solution.error("A")[:, 0] - transient
    np.testing.assert_allclose(noisy, np.array(expected) / 3.0, atol=1e-9)


# -- runs that do not reach their end -----------------------------------------------------


class Explosive(aslo.plants.AbstractPlant):
    """x' = rate x^2, which is infinite at 1 / (rate x(0))."""

    rate: jax.Array

    def initial(self):
        return jnp.ones(1)

    def vector_field(self, t, x, u):
        return self.rate * x * x + 0.0 * u

    def output(self, x):
        return x

    def hidden(self, x):
        return x


class Nothing(aslo.AbstractObserver):
    """It estimates what is measured."""

    def equations(self, F, u, y):
        return aslo.Estimate(jnp.atleast_1d(y), jnp.ones(()), jnp.asarray(False))


def exploded(rate, **settings):
    settings = dict(t1=1.0, ts=np.linspace(0.0, 1.0, 5), engine="fused") | settings
    return aslo.simulate(
        Explosive(rate), lambda t: jnp.zeros(1), {"N": Nothing()}, **settings
    )


def test_runs_that_diverge_have_a_result_and_leave_the_others_alone():
    rates = jnp.array([0.5, 1.6, 0.9, 5.0])
    with pytest.warns(UserWarning, match="Of 4 runs 2 diverged"):
        solution = jax.vmap(exploded)(rates)
    exact = 1.0 / (1.0 - np.outer(rates, solution.t[0]))
    expected = np.where(exact > 0, exact, np.nan)
    np.testing.assert_allclose(solution.x[..., 0], expected, rtol=1e-6)
    np.testing.assert_array_equal(solution.result, np.where(exact > 0, 0, 2))
    assert np.isfinite(solution.t).all()


def test_steps_run_out():
    with pytest.warns(UserWarning, match="Of 1 runs 1 took all of their `max_steps`"):
        solution = exploded(jnp.asarray(0.9), max_steps=7)
    assert solution.result[0] == 0 and solution.result[-1] == 1
    assert np.isnan(solution.x[-1]).all()


class Relaxing(Explosive):
    """x' = rate (cos(t) - x)."""

    def vector_field(self, t, x, u):
        return self.rate * (jnp.cos(t) - x) + 0.0 * u


def test_stiffness_is_told_and_the_solution_right():
    rates = jnp.array([1.0, 3e4])
    one = lambda rate: aslo.simulate(
        Relaxing(rate),
        lambda t: jnp.zeros(1),
        {"N": Nothing()},
        t1=1.0,
        ts=np.array([1.0]),
        engine="fused",
    )
    with pytest.warns(UserWarning, match="Of 2 runs 1 took steps as short as stability"):
        solution = jax.vmap(one)(rates)
    r = np.asarray(rates)
    settled = r * (r * np.cos(1.0) + np.sin(1.0)) / (r**2 + 1.0)
    exact = settled + np.exp(-r) * (1.0 - r**2 / (r**2 + 1.0))
    np.testing.assert_allclose(solution.x[:, 0, 0], exact, atol=1e-7)


# -- the face -----------------------------------------------------------------------------


def test_single_precision():
    def single(x):
        return jax.tree.map(lambda x: x.astype(jnp.float32), x, is_leaf=eqx.is_array)

    with precision(np.float32):
        plant = aslo.plants.IntegratorChain(2)
        solution = aslo.simulate(
            plant, u, {"N": Nothing()}, t1=2.0, ts=TS, initial=single(X0), engine="fused"
        )
        assert solution.x.dtype == jnp.float32
    exact = 0.3 + 0.1 * TS + 0.25 * (1.0 - np.cos(2 * TS))
    np.testing.assert_allclose(solution.x[:, 0], exact, atol=1e-4)


def test_what_the_engine_does_not_take_is_refused():
    for argument, given in {
        "solver": diffrax.Tsit5(),
        "dt0": 0.1,
        "adjoint": diffrax.ForwardMode(),
        "stepsize_controller": diffrax.PIDController(1e-3, 1e-3),
    }.items():
        with pytest.raises(ValueError, match=f"Argument `{argument}` is of diffrax alone"):
            run({}, **{argument: given})
    with pytest.raises(ValueError, match=r"`rtol` must be positive"):
        run({}, rtol=-1.0)
    with pytest.raises(ValueError, match=r"`engine` must be \"auto\", \"diffrax\" or"):
        run({}, engine="scan")
    with pytest.raises(ValueError, match="must not be given with `stepsize_controller`"):
        run({}, engine="diffrax", atol=1.0, stepsize_controller=diffrax.ConstantStepSize())
    with pytest.raises(ValueError, match="make `ts` with NumPy"):
        jax.jit(lambda t: run({}, ts=t))(TS)


def lowest(t):
    return jnp.linalg.eigvalsh(jnp.diag(jnp.stack([t, 1.0 + t])))[0]


def test_what_cannot_be_compiled_is_refused_or_run_by_diffrax():
    solve = lambda engine: aslo.simulate(PLANT, lowest, {}, t1=0.1, engine=engine)
    with pytest.raises(aslo.NotFusible, match=r"eigvalsh.*engine=\"diffrax\""):
        solve("fused")
    with pytest.warns(UserWarning, match='Running with engine="diffrax"'):
        solution = solve("auto")
    assert solution.result is None


def test_auto_leaves_what_is_traced_and_asked_of_diffrax_to_it():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        end = lambda x: run({"N": Nothing()}, initial=x, engine="auto").x[-1, 0]
        np.testing.assert_allclose(jax.grad(end)(X0), [1.0, 2.0], rtol=1e-9)
        solution = run({"N": Nothing()}, engine="auto", solver=diffrax.Dopri8())
    assert solution.result is None
    assert run({"N": Nothing()}, engine="auto").result is not None
    with pytest.raises(NotImplementedError, match=r'forward derivatives only.*"diffrax"'):
        jax.grad(lambda x: run({"N": Nothing()}, initial=x).x[-1, 0])(X0)
