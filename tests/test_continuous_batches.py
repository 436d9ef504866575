"""Batches of continuous experiments: metrics, records and results by both engines."""

import pickle

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import aslo_jax as aslo
from aslo_jax.disturbances import SampledNoise

pytest.importorskip("llvmlite")
PLANT = aslo.plants.IntegratorChain(2)
STEPS, INTERVAL, RATE = 40, 0.05, 3.0


def push(t):
    return jnp.cos(2.0 * t)


def experiment(sample, **settings):
    """The printed ASLO, whose error is the transient of a filter from its first values."""
    observer = aslo.AlgebraicObserver(
        PLANT.relation(),
        aslo.LowPass(RATE),
        completion=aslo.Repeat(),
        guard=None,
        start="paper",
    )
    given = dict(rtol=1e-9, atol=1e-11, initial=jnp.stack([sample, 0.1 + 0.0 * sample]))
    return aslo.ContinuousExperiment(
        PLANT, push, {"A": observer}, INTERVAL, **(given | settings)
    )


SAMPLES = jnp.linspace(-1.0, 1.0, 11)
ASKED = dict(
    metrics={"rms": aslo.metrics.RMSError}, record=lambda r: (r.t, r.x, r.u), every=5
)


@pytest.fixture(scope="module")
def batch():
    return aslo.run_batch(experiment, SAMPLES, STEPS, engine="fused", **ASKED)


def test_metrics_and_records_in_closed_form(batch):
    t = INTERVAL * np.arange(STEPS + 1)
    first = RATE * np.asarray(SAMPLES) - 0.1
    error = first[:, None] * np.exp(-RATE * t)
    rms = np.sqrt((error**2).mean(axis=1))
    np.testing.assert_allclose(batch.metrics["rms"]["A"][:, 0], rms, atol=1e-8)
    times, x, u = batch.record
    np.testing.assert_allclose(times, np.broadcast_to(t[::5], (11, 9)), atol=1e-14)
    np.testing.assert_allclose(u, np.cos(2.0 * times), atol=1e-12)
    np.testing.assert_allclose(x[..., 1], 0.1 + 0.5 * np.sin(2.0 * times), atol=1e-8)


def test_both_engines_agree(batch):
    other = aslo.run_batch(experiment, SAMPLES, STEPS, engine="scan", **ASKED)
    for ours, theirs in zip(*map(jax.tree.leaves, (batch, other)), strict=True):
        assert ours.shape == theirs.shape and ours.dtype == theirs.dtype
        np.testing.assert_allclose(ours, theirs, atol=1e-7)


@pytest.mark.parametrize("engine", ["fused", "scan"])
def test_integrals_are_states_in_closed_form(engine):
    """To the tolerance, where trapezoids between records are wrong by parts in a thousand;
    from an instant on that is no record either."""
    start = 0.73  # s

    def square(record):
        return (record.estimates["A"].value[0] - record.hidden[0]) ** 2

    metrics = {
        "whole": aslo.metrics.IntegralSquaredError,
        "later": aslo.metrics.Integral(square, after=start),
        "peak": aslo.metrics.PeakError,
    }
    make = lambda sample: experiment(sample, rtol=1e-8, atol=1e-10)
    asked = dict(metrics=metrics, engine=engine)
    found = aslo.run_batch(make, SAMPLES[:3], STEPS, **asked).metrics
    first = RATE * np.asarray(SAMPLES[:3]) - 0.1
    end = np.exp(-2 * RATE * STEPS * INTERVAL)
    integral = lambda since: first**2 * (np.exp(-2 * RATE * since) - end) / (2 * RATE)
    np.testing.assert_allclose(found["whole"]["A"][:, 0], integral(0.0), atol=1e-8)
    np.testing.assert_allclose(found["later"], integral(start), atol=1e-8)
    np.testing.assert_allclose(found["peak"]["A"][:, 0], np.abs(first), atol=1e-8)


def test_a_runner_tells_its_shapes_and_takes_chunks(batch):
    runner = aslo.Runner(experiment, SAMPLES[0], STEPS, **ASKED)
    assert runner.engine == "fused"
    assert [s.shape for s in runner.shapes.record] == [(), (2,), ()]
    pieces = [runner(SAMPLES[:3]), runner(SAMPLES[3:])]
    joined = jax.tree.map(lambda *x: jnp.concatenate(x), *pieces)
    for ours, theirs in zip(*map(jax.tree.leaves, (joined, batch)), strict=True):
        np.testing.assert_array_equal(ours, theirs)
    sent = pickle.loads(pickle.dumps(runner))
    assert sent.shapes == runner.shapes


@pytest.mark.slow
def test_noise_is_held_and_each_run_has_its_own():
    """The same numbers as `random.normal` gives for the instants."""
    keys = jax.vmap(aslo.random.fold, (None, 0))(aslo.random.key(5), jnp.arange(3))

    def make(key):
        noise = SampledNoise(0.3, INTERVAL, key)
        return experiment(jnp.asarray(0.2), input_sensor=noise, rtol=1e-5, atol=1e-7)

    u = aslo.run_batch(make, keys, 4, record=lambda r: r.u, every=1, engine="fused").record
    t = INTERVAL * np.arange(5)
    for row, key in zip(u, keys, strict=True):
        held = [0.3 * float(aslo.random.normal(key, k, 0, ())) for k in range(4)]
        np.testing.assert_allclose(row[:4], np.cos(2 * t[:4]) + held, atol=1e-12)


@pytest.mark.slow
def test_a_run_that_needs_too_many_steps_has_no_metrics():
    make = lambda sample: experiment(sample, max_steps=3)
    with pytest.warns(UserWarning, match="Of 2 runs 2 took all of their `max_steps`"):
        found = aslo.run_batch(make, SAMPLES[:2], STEPS, engine="fused", **ASKED)
    assert np.isnan(found.metrics["rms"]["A"]).all()
    assert np.isfinite(found.record[1][:, 0]).all()
    assert np.isnan(found.record[1][:, -1]).all()


def test_what_does_not_fit_is_refused():
    with pytest.raises(ValueError, match=r"`interval` must be positive"):
        aslo.ContinuousExperiment(PLANT, push, {}, -1.0)
    with pytest.raises(ValueError, match=r"`rtol` must be positive"):
        experiment(SAMPLES[0], rtol=0.0)
    delayed = lambda x: experiment(x, sensor=aslo.disturbances.Delay(0.1, 2))
    with pytest.raises(ValueError, match="no state that is updated at samples"):
        aslo.run_batch(delayed, SAMPLES, 4, engine="fused")
    run = lambda x: aslo.run_batch(experiment, x, 5, engine="fused", **ASKED)
    with pytest.raises(NotImplementedError, match="no derivatives in continuous time"):
        jax.jvp(run, (SAMPLES,), (SAMPLES,))
