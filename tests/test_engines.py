"""The engines agree: with each other, on modules of the library and on a user's own, with
the accurate solution, whatever the number of threads; and so do their derivatives."""

import warnings

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from motor_loops import MOTOR, motor_loop, samples
from own_modules import NET, Network, Solved, Spinner, Washout, spinning, spun

import aslo_jax as aslo
from aslo_jax.engines import NotFusible, run_batch
from aslo_jax.metrics import (
    CoastingFraction,
    FinalError,
    PeakError,
    RMSError,
    SettlingTime,
)

pytest.importorskip("llvmlite")
RNG = np.random.default_rng(2)
METRICS = {
    "rms": RMSError("smooth", 0.02),
    "peak": PeakError("smooth", 0.02),
    "final": FinalError("smooth"),
    "settled": SettlingTime("smooth", 1e-3),
    "coasting": CoastingFraction("flux"),
}


def flux(record):
    return record.t, record.estimates["flux"].value, record.hidden


@pytest.mark.parametrize("noisy", [pytest.param(False, marks=pytest.mark.slow), True])
def test_fused_and_scan_agree(noisy):
    """1e-10 after a tenth of a second, noise, records and metrics included."""
    make = lambda s: motor_loop(s, noisy)
    batch = samples(5)
    settings = dict(metrics=METRICS, record=flux, every=250)
    a, b = (
        run_batch(make, batch, 1000, engine=engine, **settings)
        for engine in ("fused", "scan")
    )
    assert jax.tree.structure(a) == jax.tree.structure(b)
    for x, y in zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True):
        assert x.shape == y.shape and x.dtype == y.dtype
        np.testing.assert_allclose(x, y, rtol=1e-10, atol=1e-12)
    assert a.metrics["rms"].shape == (5, 2) and a.record[1].shape == (5, 5, 2)
    assert np.ptp(np.asarray(a.metrics["rms"][:, 0])) > 0


def test_the_scan_engine_runs_the_experiment():
    """Metrics by hand from the whole record of each run."""
    batch = samples(3)
    found = run_batch(motor_loop, batch, 400, metrics=METRICS, engine="scan")
    for k in range(3):
        one = motor_loop(jax.tree.map(lambda x, k=k: x[k], batch)).run(400)
        error = np.asarray(one.estimates["smooth"].value - one.hidden)
        late = np.asarray(one.t) >= 0.02
        size = np.linalg.norm(error, axis=1)
        outside = np.flatnonzero(size > 1e-3)
        settled = one.t[outside[-1] + 1] if outside[-1] + 1 < len(size) else np.inf
        expected = {
            "rms": np.sqrt(np.mean(error[late] ** 2, axis=0)),
            "peak": np.abs(error[late]).max(axis=0),
            "final": error[-1],
            "settled": settled,
            "coasting": np.mean(np.asarray(one.estimates["flux"].coasting)),
        }
        for name, value in expected.items():
            got = np.asarray(found.metrics[name])[k]
            np.testing.assert_allclose(got, value, rtol=1e-9, atol=1e-13)


@pytest.mark.slow
def test_the_order_is_that_of_the_integrator():
    """Against diffrax at 1e-12: the error of the plant falls by 16 with half the interval,
    under a voltage that is held no shorter."""

    def errors(interval):
        def make(sample):
            command = aslo.control.OpenLoop(lambda t: held(t, sample))
            return aslo.Experiment(MOTOR, command, {}, interval)

        steps = round(0.032 / interval)
        keep = lambda r: r.hidden
        return run_batch(
            make, jnp.array([0.7]), steps, record=keep, every=steps, engine="fused"
        ).record[0, -1]

    def held(t, phase):
        k = jnp.floor(t / 4e-3 + 1e-6)
        return 40.0 * jnp.stack([jnp.cos(k + phase), jnp.sin(k + phase)])

    x = MOTOR.initial()
    for k in range(8):
        u = held(jnp.asarray((k + 0.5) * 4e-3), 0.7)
        x = diffrax.diffeqsolve(
            diffrax.ODETerm(lambda t, x, u: MOTOR.vector_field(t, x, u)),
            diffrax.Dopri8(),
            0.0,
            4e-3,
            None,
            x,
            args=u,
            stepsize_controller=diffrax.PIDController(rtol=1e-12, atol=1e-14),
        ).ys
        x = jax.tree.map(lambda x: x[-1], x)
    coarse, fine = (jnp.abs(errors(h) - x.flux).max() for h in (0.125e-3, 0.0625e-3))
    assert 1e-11 < fine < coarse
    assert 12.0 < coarse / fine < 20.0


def test_bits_do_not_depend_on_threads_or_on_the_size_of_the_batch():
    batch = samples(150)
    make = lambda s: motor_loop(s, True)
    like = jax.tree.map(lambda x: x[0], batch)
    one, two = (
        aslo.Runner(make, like, 100, metrics=METRICS, engine="fused", threads=n)
        for n in (1, 2)
    )
    whole = one(batch)
    for a, b in zip(jax.tree.leaves(whole), jax.tree.leaves(two(batch)), strict=True):
        np.testing.assert_array_equal(a, b)
    part = two(jax.tree.map(lambda x: x[140:], batch))
    for a, b in zip(jax.tree.leaves(whole), jax.tree.leaves(part), strict=True):
        np.testing.assert_array_equal(a[140:], b)


INERTIAS = jnp.asarray(RNG.uniform(0.5, 2.0, (7, 3)))


def test_modules_of_the_user():
    metrics = {"rms": RMSError("w"), "coasting": CoastingFraction("w")}
    settings = dict(metrics=metrics, record=lambda r: (r.x, r.u), every=10)
    a, b = (run_batch(spun, INERTIAS, 100, engine=e, **settings) for e in ("fused", "scan"))
    for x, y in zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True):
        np.testing.assert_allclose(x, y, rtol=1e-10, atol=1e-12)
    assert jnp.ptp(a.record[0][:, -1, 2]) > 0.01


def test_systems_of_equations_in_a_module_of_the_user():
    def make(sample):
        body = Solved(sample, jnp.array([0.1, 0.2, 0.3]))
        return aslo.Experiment(body, Network(NET), {"w": Washout(jnp.array(8.0))}, 1e-2)

    keep = lambda r: (r.x, r.u)
    a, b = (
        run_batch(make, INERTIAS, 50, record=keep, every=10, engine=e).record
        for e in ("fused", "scan")
    )
    for x, y in zip(a, b, strict=True):
        np.testing.assert_allclose(x, y, rtol=1e-10, atol=1e-12)
    assert jnp.ptp(a[0][:, -1, 2]) > 0.01


def test_one_step_from_random_states():
    """1e-13, from states that no run has visited."""
    experiment = motor_loop(jax.tree.map(lambda x: x[0], samples(1)))
    carry, _ = experiment.init()
    leaves, tree = jax.tree.flatten(carry)

    def make(sample):
        start = jax.tree.unflatten(tree, sample).x
        return motor_loop((8.875, 30.0, 20.0, None), initial=start)

    many = [
        jnp.asarray(RNG.normal(size=(20, *x.shape))).astype(x.dtype) * 0.3 for x in leaves
    ]
    keep = lambda r: (r.x, r.u, r.estimates)
    a, b = (run_batch(make, many, 1, record=keep, engine=e) for e in ("fused", "scan"))
    for x, y in zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True):
        scale = max(1.0, float(np.abs(y).max()))
        np.testing.assert_allclose(x, y, rtol=1e-13, atol=1e-13 * scale)


def test_known_indices_are_known_under_jit():
    """A chain's relation sets an entry at a known place. By hand: from rest under u = 1
    the speed is t, and so is the estimate."""
    chain = aslo.plants.IntegratorChain(2)

    def make(push):
        observer = aslo.AlgebraicObserver(chain.relation(), aslo.LowPass(30.0))
        command = aslo.control.OpenLoop(lambda t: push + 0.0 * t)
        return aslo.Experiment(chain, command, {"speed": observer}, 1e-3)

    keep = lambda r: r.estimates["speed"].value
    run = jax.jit(lambda b: run_batch(make, b, 20, record=keep, engine="fused").record)
    found = run(jnp.array([1.0, 2.0]))[:, -1, 0]
    # A parabola between samples is held as a line: wrong by no more than lam h^2 per unit.
    np.testing.assert_allclose(found / jnp.array([1.0, 2.0]), 0.02, atol=30.0 * 1e-3**2)


def test_what_cannot_be_compiled_is_refused_or_runs_by_scan_with_a_warning():
    with pytest.raises(NotFusible, match=r"own_modules\.py:\d+") as caught:
        run_batch(spinning, INERTIAS, 10, engine="fused")
    assert "`jnp.linalg.eigh` (primitive `eigh`)" in str(caught.value)
    with pytest.warns(UserWarning, match='Running with engine="scan"'):
        found = run_batch(spinning, INERTIAS, 10, record=lambda r: r.x)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        same = run_batch(spun, INERTIAS, 10, record=lambda r: r.x, engine="auto")
    np.testing.assert_allclose(found.record, same.record, rtol=1e-9, atol=1e-12)


def test_modules_made_while_something_is_traced():
    """Their numbers are numbers; what is traced itself must come with the samples."""

    def made(gain, closed):
        def make(sample):
            rate = gain if closed else sample
            observer = Washout(jnp.array(8.0) * rate)
            command = aslo.control.OpenLoop(lambda t: jnp.zeros(3))
            return aslo.Experiment(
                Spinner(INERTIAS[0], INERTIAS[1]), command, {"w": observer}, 1e-2
            )

        batch = jnp.full(2, gain)
        keep = lambda r: r.estimates["w"].value
        return run_batch(make, batch, 4, record=keep, engine="fused").record[:, -1]

    within = jax.jit(lambda gain: made(gain, False))(1.5)
    np.testing.assert_allclose(within, made(1.5, True), rtol=1e-12)
    with pytest.raises(NotFusible, match="hand it over in `parameters`"):
        jax.jit(lambda gain: made(gain, True))(1.5)


def loss(gains, engine):
    """Of two gains and a batch of resistances, differentiated in the gains alone."""
    resistance, _, _, keys = (jnp.array([8.5, 9.3]), None, None, jnp.zeros((2, 2)))
    rate, gain = (jnp.full(2, g) for g in gains)
    metrics = {"rms": METRICS["rms"], "coasting": METRICS["coasting"]}
    found = run_batch(
        motor_loop,
        (resistance, rate, gain, keys),
        400,
        metrics=metrics,
        record=lambda r: (r.estimates["smooth"].value, r.estimates["smooth"].coasting),
        every=200,
        engine=engine,
    )
    return jnp.mean(found.metrics["rms"]), found.record[0]


GAINS = jnp.array([30.0, 20.0])


@pytest.mark.slow
def test_forward_derivatives_are_those_of_scan():
    jacobian = lambda engine: jax.jacfwd(lambda g: loss(g, engine))(GAINS)
    (a, rows), (b, others) = jacobian("fused"), jacobian("scan")
    # Of the gradient as a whole: one entry is a hundredth of the other, and scan itself
    # moves by 1e-8 of it when the gains do by 1e-13.
    np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-9 * np.abs(b).max())
    np.testing.assert_allclose(rows, others, rtol=1e-7, atol=1e-12)
    assert rows.shape == (2, 3, 2, 2) and (jnp.abs(a) > 0).all()


def test_derivatives_under_jit_and_vmap():
    """Of a chain: a motor, as above, takes several times as long to compile, and each of
    these compiles again."""
    chain = aslo.plants.IntegratorChain(2)

    def make(sample):
        rate, gain = sample
        F = aslo.LowPass(rate)
        speed = aslo.AlgebraicObserver(chain.relation(), F, start="paper")
        smooth = aslo.Asymptotic(speed, gain, initial=jnp.zeros(1))
        command = aslo.control.OpenLoop(lambda t: jnp.cos(9.0 * t))
        return aslo.Experiment(
            chain, command, {"smooth": smooth}, 1e-2, initial=jnp.array([0.2, 1.0])
        )

    def fused(gains):
        batch = tuple(g * jnp.array([1.0, 1.1]) for g in gains)
        found = run_batch(make, batch, 100, metrics={"rms": METRICS["rms"]}, engine="fused")
        return jnp.mean(found.metrics["rms"])

    twice = jax.jacfwd(lambda g: (fused(g),) * 2, has_aux=True)
    traced = jax.jit(twice).trace(GAINS)
    # One run gives the value and both directions.
    assert str(traced.jaxpr).count("pure_callback") == 1
    jacobian = traced.lower().compile()
    one, value = jacobian(GAINS)
    assert (jnp.abs(one) > 0).all()
    np.testing.assert_allclose(value, fused(GAINS), rtol=1e-12)
    _, push = jax.jit(lambda g, v: jax.jvp(fused, (g,), (v,)))(
        GAINS, jnp.array([2.0, -1.0])
    )
    np.testing.assert_allclose(push, 2 * one[0] - one[1], rtol=1e-9)
    many = jnp.stack([GAINS, 1.2 * GAINS, 0.9 * GAINS])
    values = jax.jit(jax.vmap(fused))(many)
    np.testing.assert_allclose(values[1], fused(many[1]), rtol=1e-12)
    jacobians = jax.jit(jax.vmap(jax.jacfwd(fused)))(many)
    np.testing.assert_allclose(jacobians[0], one, rtol=1e-9)
    np.testing.assert_allclose(jacobians[2], jacobian(many[2])[0], rtol=1e-9)


def test_logs_are_read_at_the_time_and_in_the_row_of_a_lane():
    """A reference that all lanes share, and a row of a table for each of them, read where
    they stand, between samples too."""
    shared = RNG.normal(size=(90, 3))
    rows = RNG.normal(size=(5, 90))

    def make(row):
        def torque(t):
            k = jnp.floor(t / 1e-2 + 1e-6).astype(int)
            return jnp.asarray(shared)[k] * jnp.asarray(rows)[row, k]

        command = aslo.control.OpenLoop(torque)
        return aslo.Experiment(Spinner(INERTIAS[0], INERTIAS[1]), command, {}, 1e-2)

    lanes = jnp.array([4, 0, 2])
    a, b = (
        run_batch(make, lanes, 100, record=lambda r: (r.x, r.u), every=50, engine=e)
        for e in ("fused", "scan")
    )
    np.testing.assert_allclose(a.record[0], b.record[0], rtol=1e-10)
    for lane, row in enumerate([4, 0, 2]):
        held = (
            shared[50] * rows[row, 50],
            shared[-1] * rows[row, -1],
        )  # beyond the end: last
        np.testing.assert_array_equal(a.record[1][lane, 1:], held)
