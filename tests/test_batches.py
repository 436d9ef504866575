"""Batches: precision, types of samples, batches without samples, and what is refused."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from motor_loops import motor_loop, samples
from own_modules import spun

import aslo_jax as aslo
from aslo_jax.engines import run_batch
from aslo_jax.export._traced import precision

pytest.importorskip("llvmlite")

RNG = np.random.default_rng(2)


INERTIAS = jnp.asarray(RNG.uniform(0.5, 2.0, (7, 3)))


@pytest.mark.slow
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
    with precision(np.float32):
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
