"""Filters whose rate varies: every identity stays exact, also in samples, and a rate that
varies by nothing is the constant one."""

import io

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from motion import PrescribedBearing, PrescribedPMSM, observe_by_scipy

import aslo_jax as aslo
from aslo_jax.schedules import Certified, FastStart, PerSpeed, Schedule, Table

MOTOR = PrescribedPMSM(resistance=3.1, inductance=17e-3, magnet_flux=0.13, pole_pairs=4)
FLUX = MOTOR.relation()
CHAIN = aslo.plants.IntegratorChain(2).relation()


def kinked(t, u, y):
    """From 200 rad/s down to 1, with jumps and corners."""
    early, late = 5.0 + 195.0 * jnp.exp(-8 * t), 1.0 + 60.0 * jnp.abs(jnp.sin(3 * t))
    return jnp.where(t < 0.7, early, jnp.where(t < 1.2, 200.0, late))


KINKED = aslo.LowPass(kinked)
SLOW = aslo.LowPass(lambda t, u, y: 4.0 + 3.0 * jnp.sin(2 * t))
COMPLETIONS = {
    "repeat": aslo.Repeat(),
    "least squares": aslo.LeastSquares(),
    "two rates": aslo.LeastSquares(forgetting=SLOW),
    "bank": aslo.FilterBank([SLOW, aslo.LowPass(11.0)]),
}
SCHEDULES = {
    "function": KINKED.rate,
    "speed": PerSpeed(1.2, 3.0, 150.0, vector=lambda u, y, x: x - 17e-3 * y),
    "certificate": Certified(3.0, 40.0),
    "fast start": FastStart(4.0, 300.0),
    "table": Table(
        lambda u, y: jnp.sum(y * y),
        jnp.array([0.5, 1.0, 2.0]),
        jnp.array([5.0, 50.0, 20.0]),
    ),
}
TS = jnp.array([2e-3, 0.05, 0.5, 0.69, 0.9, 1.5, 2.5])


def flux_error(observer, rtol=1e-11, atol=1e-18):
    """At TS, relative."""
    found = observe_by_scipy(observer, MOTOR.voltage, MOTOR.current, TS, rtol, atol)
    error = jnp.linalg.norm(found.value - jax.vmap(MOTOR.flux)(TS), axis=1)
    return jnp.where(found.coasting, 0.0, error / MOTOR.magnet_flux), found


@pytest.mark.parametrize("completion", COMPLETIONS)
def test_every_completion_is_exact_at_once(completion):
    observer = aslo.AlgebraicObserver(FLUX, KINKED, COMPLETIONS[completion])
    error, found = flux_error(observer)
    assert not found.coasting[1:].any()
    assert error.max() < 1e-9


@pytest.mark.parametrize("name", SCHEDULES)
def test_every_schedule_is_exact_at_once(name):
    observer = aslo.AlgebraicObserver(FLUX, aslo.LowPass(SCHEDULES[name]))
    # A loop that pulls in jumps where its error wraps.
    error, found = flux_error(observer, 1e-10, 1e-13 if name == "speed" else 1e-18)
    assert not found.coasting[1:].any()
    assert error.max() < 1e-9


class Position(eqx.Module):
    """A motion and its derivatives."""

    derivative: int = eqx.field(static=True)

    def __call__(self, t):
        path = lambda t: 0.4 + 0.3 * t + jnp.sin(2.3 * t + 0.7) + 0.2 * jnp.cos(5.1 * t)
        for _ in range(self.derivative):
            path = jax.grad(path)
        return path(jnp.asarray(t, float))


@pytest.mark.parametrize("completion", COMPLETIONS)
def test_rate_relations_are_exact_at_once(completion):
    """Which filter the derivative of y, and of lam s first in no place."""
    observer = aslo.AlgebraicObserver(CHAIN, KINKED, COMPLETIONS[completion])
    found = observe_by_scipy(observer, Position(2), Position(0), TS, 1e-11, 1e-16)
    error = jnp.abs(found.value[:, -1] - jax.vmap(Position(1))(TS))
    assert not found.coasting[1:].any()
    assert error[~found.coasting].max() < 1e-9


def test_relations_with_a_matrix_are_exact_at_once():
    """A chain of three, whose position is measured and whose state has `x' = A x`."""
    relation = aslo.plants.IntegratorChain(3).relation()
    observer = aslo.AlgebraicObserver(relation, KINKED, aslo.LeastSquares())
    found = observe_by_scipy(observer, Position(3), Position(0), TS, 1e-12, 1e-18)
    truth = jnp.stack([jax.vmap(Position(k))(TS) for k in (1, 2)], axis=1)
    certain = ~found.coasting & (TS > 0.04)
    assert certain.sum() >= 5
    assert jnp.abs(found.value - truth)[certain].max() < 1e-7


def test_the_papers_start_has_a_transient_that_dies():
    for completion in COMPLETIONS.values():
        observer = aslo.AlgebraicObserver(
            FLUX, aslo.LowPass(lambda t, u, y: 12.0 + 5.0 * jnp.sin(9 * t)), completion
        )
        observer = eqx.tree_at(lambda o: o.guard, observer, None)
        printed = aslo.AlgebraicObserver(
            observer.relation, observer.filter, completion, None, "paper"
        )
        error, _ = flux_error(printed)
        assert error[1] > 1e-2
        assert error[-1] < 1e-4


def log(rows, T=1.0):
    t = jnp.linspace(0.0, T, rows + 1)
    u = jax.vmap(MOTOR.mean_voltage)(t[:-1], t[1:])
    y = jax.vmap(MOTOR.current)(t)
    return t, jnp.concatenate([u, u[-1:]]), y, jax.vmap(MOTOR.flux)(t)


@eqx.filter_jit
def replayed(observer, t, u, y):
    return aslo.replay(observer, t, u, y)


@pytest.mark.parametrize("name", SCHEDULES)
def test_sampled_no_rate_costs_anything(name):
    """The rate of the left end of an interval is as good as any other."""
    observer = aslo.AlgebraicObserver(FLUX, aslo.LowPass(SCHEDULES[name]))
    t, u, y, flux = log(1000)
    found = replayed(observer, t, u, y)
    late = (t > 0.3) & ~found.coasting
    assert late.sum() > 500
    assert jnp.linalg.norm(found.value - flux, axis=1)[late].max() < 1e-9


@pytest.mark.parametrize("start", ["exact", "paper"])
@pytest.mark.parametrize("completion", ["repeat", "least squares", "two rates"])
def test_a_schedule_that_stays_is_the_constant_rate(completion, start):
    t, u, y, _ = log(300)
    found = []
    for rate in (23.0, Schedule(lambda t, u, y: 23.0)):
        observer = aslo.AlgebraicObserver(
            FLUX, aslo.LowPass(rate), COMPLETIONS[completion], start=start
        )
        found.append(replayed(aslo.Asymptotic(observer, 9.0), t, u, y))
    np.testing.assert_allclose(found[0].value, found[1].value, rtol=0, atol=1e-9)
    np.testing.assert_allclose(
        found[0].certificate, found[1].certificate, rtol=1e-6, atol=1e-15
    )


@pytest.mark.parametrize("name", SCHEDULES)
def test_step_replay_and_the_fused_engine_agree(name):
    pytest.importorskip("llvmlite")
    observer = aslo.Asymptotic(
        aslo.AlgebraicObserver(FLUX, aslo.LowPass(SCHEDULES[name])), 15.0
    )
    t, u, y, _ = log(200, 0.4)
    found = replayed(observer, t, u, y)
    step = eqx.filter_jit(observer.step)
    state, now = observer.init(y[0], u[0]), None
    for k in range(1, 61):
        if k == 33:  # saved and restored
            kept = io.BytesIO()
            eqx.tree_serialise_leaves(kept, state)
            kept.seek(0)
            state = eqx.tree_deserialise_leaves(kept, observer.init(y[1], u[1]))
        state, now = step(state, u[k - 1], y[k], t[k] - t[k - 1])
    assert now is not None
    np.testing.assert_allclose(now.value, found.value[60], rtol=0, atol=1e-12)
    fused = aslo.replay(observer, t, u, y, engine="fused")
    np.testing.assert_allclose(fused.value, found.value, rtol=0, atol=1e-11)


@pytest.mark.slow
def test_parameters_of_a_schedule_have_gradients_both_ways():
    t, u, y, flux = log(150, 0.5)
    y = y + 0.01 * np.random.default_rng(5).standard_normal(y.shape)

    @eqx.filter_jit
    def loss(parameters):
        per_speed, low, scale = parameters
        schedule = PerSpeed(per_speed, low, 300.0)
        table = Table(
            lambda u, y: y[0] ** 2, jnp.array([0.1, 2.0]), scale * jnp.array([5.0, 40.0])
        )
        observer = aslo.AlgebraicObserver(
            FLUX, aslo.LowPass(schedule), aslo.LeastSquares(forgetting=aslo.LowPass(table))
        )
        return jnp.mean((aslo.replay(observer, t, u, y).value - flux)[30:] ** 2) * 1e6

    at = jnp.array([1.3, 2.5, 0.9])
    forward, reverse = jax.jacfwd(loss)(at), jax.grad(loss)(at)
    np.testing.assert_allclose(forward, reverse, rtol=1e-7)
    for k in range(3):
        e = 1e-5 * jnp.eye(3)[k]
        slope = (loss(at + e) - loss(at - e)) / 2e-5
        np.testing.assert_allclose(forward[k], slope, rtol=2e-4, atol=1e-7)
    assert (jnp.abs(forward) > 0).all()


@pytest.mark.slow
def test_other_machines_and_observers_take_schedules():
    """The bearing, and the magnet's flux without its size; FO1 approaches."""
    bearing = PrescribedBearing(aslo.plants.MagneticBearing.laboratory(), lambda t: t)
    fast = aslo.LowPass(lambda t, u, y: 20.0 + 30.0 * jnp.sin(5 * t) ** 2)
    bearing_by = lambda law: aslo.BearingObserver(
        aslo.AlgebraicObserver(bearing.bearing.flux_relation(), law), aslo.LowPass(200.0)
    )
    magnet = lambda t: MOTOR.flux(t) - MOTOR.inductance * MOTOR.current(t)
    for motion, truth, observer, bound in (
        (bearing, bearing.truth, bearing_by(fast), 1e-7),
        (MOTOR, magnet, aslo.AlgebraicMagnet(FLUX, fast), 1e-8),
        (MOTOR, MOTOR.flux, aslo.FO1(FLUX, fast, 5.0), 1e-2),
    ):
        ts = jnp.array([0.1, 0.6, 1.5])
        found = observe_by_scipy(observer, motion.voltage, motion.current, ts, 1e-10, 1e-18)
        expected = jax.vmap(truth)(ts)
        error = jnp.abs(found.value - expected) / jnp.abs(expected).max(axis=0)
        assert not found.coasting.any()
        assert error[-1].max() < bound


def test_missing_samples_are_coasted_over():
    observer = aslo.AlgebraicObserver(FLUX, aslo.LowPass(SCHEDULES["fast start"]))
    t, u, y, flux = log(500)
    y = y.at[260:264].set(jnp.nan)
    found = aslo.replay(observer, t, u, y, missing="coast")
    error = jnp.linalg.norm(found.value - flux, axis=1) / MOTOR.magnet_flux
    assert found.coasting[260:264].all() and not found.coasting[240:260].any()
    assert jnp.isfinite(found.value).all()
    assert error[240:].max() < 0.01


def test_single_precision_stays_single():
    single = lambda tree: jax.tree.map(
        lambda x: x.astype(jnp.float32) if eqx.is_array(x) else x, tree
    )
    for name in ("speed", "certificate", "fast start"):
        observer = single(aslo.AlgebraicObserver(FLUX, aslo.LowPass(SCHEDULES[name])))
        t, u, y, flux = log(400)
        found = replayed(observer, t, *single((u, y)))
        assert found.value.dtype == jnp.float32
        error = jnp.linalg.norm(found.value - flux, axis=1)[100:]
        assert error.max() < 0.02 * MOTOR.magnet_flux


def test_arguments_are_refused_with_the_remedy():
    for wrong, words in (
        (lambda: PerSpeed(-1.0), "Argument `per_speed` must be positive"),
        (lambda: PerSpeed(low=0.0), "Argument `low` must be positive"),
        (lambda: Certified(2.0, -1.0), "Argument `high` must be positive"),
        (lambda: Certified(2.0, 1.0), "Argument `low` must be at most `high`"),
        (lambda: FastStart(2.0, gain=0.0), "Argument `gain` must be positive"),
        (lambda: Table(lambda u, y: y, jnp.array([1.0]), jnp.array([2.0])), "at least 2"),
        (
            lambda: Table(lambda u, y: y, jnp.array([1.0, 1.0]), jnp.array([2.0, 3.0])),
            "must increase",
        ),
        (
            lambda: Table(
                lambda u, y: y, jnp.array([1.0, 2.0]), jnp.array([2.0, 3.0, 4.0])
            ),
            "one shape",
        ),
        (lambda: KINKED.equilibrium(1.0), "must have a constant rate here"),
        (lambda: aslo.LowPass("fast"), "Argument `rate` must hold real numbers"),
    ):
        with pytest.raises(ValueError, match=words):
            wrong()
    three = aslo.AlgebraicObserver(
        aslo.plants.IntegratorChain(4).relation(), aslo.LowPass(PerSpeed(3.0))
    )
    with pytest.raises(ValueError, match="must give the two entries"):
        three.init(jnp.zeros(()))


@pytest.mark.parametrize("engine", ["scan", "fused"])
def test_its_clock_keeps_time_in_single_precision(engine):
    """Six minutes of milliseconds: their plain sum would be late by two seconds."""
    rows, h = 400_001, 1e-3
    single = lambda tree: jax.tree.map(
        lambda x: jnp.asarray(x, jnp.float32) if eqx.is_inexact_array(x) else x, tree
    )
    rate = single(Schedule(lambda t, u, y: 1.0 + 0.01 * t))
    observer = single(aslo.AlgebraicObserver(CHAIN, aslo.LowPass(rate)))
    signal = np.zeros(rows, np.float32)
    t = h * np.arange(rows)
    _, state = aslo.replay(observer, t, signal, signal, engine=engine, return_state=True)
    time, lost = state.states["rate.time"]
    assert time.dtype == jnp.float32
    assert abs(float(time) + float(lost) - 400.0) < 1e-6 * 400.0
