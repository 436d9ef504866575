"""The engines agree: with each other, on modules of the library and on a user's own, with
the accurate solution, whatever the number of threads; and so do their derivatives."""

import warnings

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import aslo_jax as aslo
from aslo_jax.control import AbstractController, FieldOriented, MotorFeedback
from aslo_jax.disturbances import SampledNoise
from aslo_jax.engines import NotFusible, run_batch
from aslo_jax.metrics import (
    CoastingFraction,
    FinalError,
    PeakError,
    RMSError,
    SettlingTime,
)
from aslo_jax.plants import AbstractPlant

pytest.importorskip("llvmlite")
MOTOR = aslo.plants.PMSM.bmp0701f()
RNG = np.random.default_rng(2)
METRICS = {
    "rms": RMSError("smooth", 0.02),
    "peak": PeakError("smooth", 0.02),
    "final": FinalError("smooth"),
    "settled": SettlingTime("smooth", 1e-3),
    "coasting": CoastingFraction("flux"),
}


def speed(t):
    return 20.0 + 5.0 * jnp.sin(t)


def measured(y, x, estimates):
    return MotorFeedback(y, MOTOR.pole_pairs * x.angle, x.speed)


def motor_loop(sample, noisy=False, interval=1e-4, initial=None):
    """A PMSM under speed control, its resistance and the observers' rates given."""
    resistance, rate, gain, key = sample
    motor = eqx.tree_at(lambda m: m.resistance, MOTOR, resistance)
    relation = MOTOR.flux_relation()
    flux = aslo.AlgebraicObserver(relation, aslo.LowPass(rate), guard=aslo.Guard(1e-4))
    return aslo.Experiment(
        motor,
        FieldOriented(MOTOR, speed, 2.3),
        {"flux": flux, "smooth": aslo.Asymptotic(flux, gain)},
        interval,
        feedback=measured,
        sensor=SampledNoise(0.01, interval, key) if noisy else None,
        initial=initial,
    )


def samples(count):
    keys = jax.vmap(aslo.random.key)(jnp.arange(count))
    spread = jnp.asarray(RNG.uniform(0.9, 1.1, (3, count)))
    return 8.875 * spread[0], 30.0 * spread[1], 20.0 * spread[2], keys


def flux(record):
    return record.t, record.estimates["flux"].value, record.hidden


@pytest.mark.parametrize("noisy", [False, True])
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


class Gyroscope(AbstractPlant):
    """A spinning body, `J w' = J w x w + u - d w`: a user's own plant, with a product of
    matrices, a remainder, an update in place and a map inside."""

    inertia: jax.Array
    damping: jax.Array

    def initial(self):
        return jnp.array([0.3, -2.0, 1.1])

    def vector_field(self, t, x, u):
        J = jnp.diag(self.inertia).at[0, 1].set(0.1).at[1, 0].set(0.1)
        momentum = J @ x
        drag = jax.vmap(lambda d, w: d * w * jnp.abs(w))(self.damping, x)
        phase = (t * 7.0) % (2 * jnp.pi)
        push = jnp.zeros(3).at[2].set(jnp.sin(phase))
        return self.divided(J, jnp.cross(momentum, x) + u + push - drag)

    def divided(self, J, torque):
        """By a product that is one: the vectors of an eigenvalue problem."""
        vectors = jnp.linalg.eigh(J)[1]
        return vectors @ vectors.T @ torque

    def output(self, x):
        return x[:2]

    def hidden(self, x):
        return x[2:]

    def no_input(self, y):
        return jnp.zeros(3)


class Network(AbstractController):
    """A small perceptron from the measurement to the torques."""

    net: eqx.nn.MLP

    def init(self, fed):
        return jnp.zeros(())

    def vector_field(self, t, state, fed):
        return jnp.tanh(fed[0]) - 0.1 * state

    def __call__(self, t, state, fed):
        return self.net(jnp.append(fed, state))


class Washout(aslo.AbstractObserver):
    """A user's own observer: a filter and a state with a limit."""

    rate: jax.Array

    def equations(self, F, u, y):
        F = F.using(aslo.LowPass(self.rate))
        rate = F.p(y[0], "rate")
        z = F.state("z", jnp.zeros(()), lambda z: jnp.clip(rate - z, -1.0, 1.0))
        return aslo.Estimate(z[None], jnp.ones(()), z > 0.5)


NET = eqx.nn.MLP(3, 3, 8, 2, activation=jnp.tanh, key=jax.random.key(4))


def spinning(sample):
    body = eqx.tree_at(
        lambda g: g.inertia, Gyroscope(jnp.ones(3), jnp.array([0.1, 0.2, 0.3])), sample
    )
    return aslo.Experiment(body, Network(NET), {"w": Washout(jnp.array(8.0))}, 1e-2)


class Solved(Gyroscope):
    """With systems of equations that vary from lane to lane."""

    def divided(self, J, torque):
        shifted = J @ J.T + jnp.eye(3)
        solved = jnp.linalg.inv(J) @ jnp.linalg.solve(shifted, torque)
        definite = jnp.linalg.cholesky(shifted)
        return J @ definite @ (definite.T @ solved)


class Spinner(Gyroscope):
    """Without an eigenvalue problem, which is not compiled."""

    def vector_field(self, t, x, u):
        J = jnp.diag(self.inertia).at[0, 1].set(0.1).at[1, 0].set(0.1)
        drag = jax.vmap(lambda d, w: d * w * jnp.abs(w))(self.damping, x)
        phase = (t * 7.0) % (2 * jnp.pi)
        push = jnp.zeros(3).at[2].set(jnp.sin(phase))
        return jnp.cross(J @ x, x) + u + push - drag


def spun(sample):
    body = Spinner(sample, jnp.array([0.1, 0.2, 0.3]))
    return aslo.Experiment(body, Network(NET), {"w": Washout(jnp.array(8.0))}, 1e-2)


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
    with pytest.raises(NotFusible, match=r"test_engines\.py:\d+") as caught:
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


def test_single_precision():
    single = lambda tree: jax.tree.map(
        lambda x: x.astype(jnp.float32) if eqx.is_inexact_array(x) else x, tree
    )
    make = lambda s: single(motor_loop(s))
    keep = lambda r: (r.x, r.estimates["smooth"].value)
    batch = single(samples(4))
    a, b = (run_batch(make, batch, 200, record=keep, engine=e) for e in ("fused", "scan"))
    for x, y in zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True):
        assert x.dtype == y.dtype == jnp.float32
        np.testing.assert_allclose(x, y, rtol=1e-3, atol=1e-3 * np.abs(y).max())


def test_no_samples_and_results_without_entries():
    chain = aslo.plants.IntegratorChain(2)
    command = aslo.control.OpenLoop(lambda t: jnp.cos(9.0 * t))

    def make(rate):
        observer = aslo.AlgebraicObserver(chain.relation(), aslo.LowPass(rate))
        return aslo.Experiment(chain, command, {"speed": observer}, 1e-2)

    keep = lambda r: (r.estimates["speed"].value, jnp.zeros((0,)))
    run = lambda rates, engine="fused": run_batch(
        make, rates, 20, record=keep, every=10, engine=engine
    )
    none = jnp.zeros(0)
    for fused, scan in zip(run(none).record, run(none, "scan").record, strict=True):
        assert fused.shape == scan.shape and fused.dtype == scan.dtype
    rates = jnp.array([[3.0, 5.0], [4.0, 6.0], [5.0, 7.0]])
    value, nothing = jax.vmap(run)(rates).record
    assert nothing.shape == (3, 2, 3, 0)
    np.testing.assert_array_equal(value[1], run(rates[1]).record[0])


def test_a_runner_is_as_precise_as_jax():
    """Made like doubles while JAX has none."""
    with jax.enable_x64(False):
        chain = aslo.plants.IntegratorChain(2)

        def make(rate):
            command = aslo.control.OpenLoop(lambda t: rate * jnp.cos(9.0 * t))
            observer = aslo.AlgebraicObserver(chain.relation(), aslo.LowPass(rate))
            return aslo.Experiment(chain, command, {"speed": observer}, 1e-2)

        keep = lambda r: r.estimates["speed"].value
        like = jax.ShapeDtypeStruct((), np.float64)
        runner = aslo.Runner(make, like, 20, record=keep, engine="fused")
        found = runner(np.array([3.0, 5.0])).record
        expected = run_batch(make, jnp.array([3.0, 5.0]), 20, record=keep, engine="scan")
        assert found.dtype == jnp.float32 and np.isfinite(found).all()
        np.testing.assert_allclose(found, expected.record, rtol=1e-3, atol=1e-3)


@pytest.mark.parametrize("dtype", [np.float32, np.int64])
def test_samples_take_the_type_that_a_runner_is_made_for(dtype):
    """For values and for derivatives, whose columns are read by their type."""
    inertias = np.array([[2, 3, 1], [1, 1, 4]], dtype)
    like = (1.0, np.ones(3))
    make = lambda sample: spun(sample[0] * sample[1])
    found = {}
    for engine in ("fused", "scan"):
        runner = aslo.Runner(make, like, 20, record=lambda r: r.x, engine=engine)
        scaled = lambda c, run=runner: run((c * jnp.ones(2, c.dtype), inertias)).record
        c = jnp.asarray(1.5, np.float32)
        found[engine] = (
            runner((np.float32([1.5, 1.5]), inertias)).record,
            *jax.jvp(scaled, (c,), (jnp.ones_like(c),)),
        )
    for ours, theirs in zip(*map(jax.tree.leaves, found.values()), strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-5, atol=1e-9)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (dict(steps=0), "`every` must divide `steps`"),
        (dict(every=3), "`every` must divide `steps`"),
        (dict(engine="warp"), '`engine` must be "auto", "fused" or "scan"'),
        (dict(parameters=(jnp.ones(2), jnp.ones(3))), "one leading axis of common length"),
        (dict(parameters=jnp.ones(())), "one leading axis of common length"),
    ],
)
def test_arguments_out_of_range_are_refused(change, message):
    arguments = dict(make=spun, parameters=INERTIAS, steps=10, every=5) | change
    with pytest.raises(ValueError, match=message):
        run_batch(**arguments)
