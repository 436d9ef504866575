"""Branches in what users write: observers, loops and metrics, in batches and over logs."""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from loops import ends, series

import aslo_jax as aslo
from aslo_jax.engines import Runner
from aslo_jax.metrics import AbstractMetric

pytest.importorskip("llvmlite")


class Slow(aslo.AbstractObserver):
    """A filter of the measurement, and until its clock has run a series of it."""

    until: jax.Array  # s

    def equations(self, F, u, y):
        clock = F.state("clock", jnp.zeros(()), jnp.ones(()))
        low = F.state("low", y, lambda low: 20.0 * (y - low))
        costly = lambda low: series(0.3 * low, 0.2 * jnp.cos(low), 30)
        value = jax.lax.cond(clock < self.until, costly, lambda low: 0.3 * low, low)
        F.state("after", jnp.zeros(()), lambda after: 5.0 * (value - after))
        return aslo.Estimate(value[None], jnp.ones(()), jnp.asarray(False))


class Falling(aslo.plants.AbstractPlant):
    """`x' = -x + u`, measured."""

    def initial(self):
        return jnp.asarray(1.0)

    def vector_field(self, t, x, u):
        return u - x

    def output(self, x):
        return x

    def hidden(self, x):
        return x[None]


def experiment(sample):
    until, amplitude = sample
    drive = aslo.control.OpenLoop(lambda t: amplitude * jnp.sin(5.0 * t))
    return aslo.Experiment(Falling(), drive, {"slow": Slow(until)}, 1e-2)


class Duck(eqx.Module):
    """A loop of a user's own."""

    sample: tuple

    def init(self):
        a = 0.5 * self.sample[1]
        return (a, 0.0 * a), self.record(a, 0.0 * a)

    def prepare(self, carry):
        return None

    def advance(self, k, carry, prepared):
        def costly(carry):
            a, t = carry
            return series(a, 0.3 * jnp.cos(a), 30), t + 1e-2

        def plain(carry):
            a, t = carry
            return 0.9 * a + 0.01 * jnp.sin(a), t + 1e-2

        carry = jax.lax.cond(carry[1] < self.sample[0], costly, plain, carry)
        return carry, self.record(*carry)

    def record(self, a, t):
        estimate = aslo.Estimate(a[None], jnp.ones(()), jnp.asarray(False))
        return aslo.Record(t, a, a[None], a, a, {"slow": estimate})


class Total(AbstractMetric):
    """Of the estimates."""

    def init(self, record):
        return jnp.zeros(())

    def update(self, metric, record):
        return metric + jnp.sum(record.estimates["slow"].value)

    def result(self, metric):
        return metric


@pytest.mark.parametrize("make", [experiment, Duck], ids=["observer", "loop"])
def test_experiments_switch_and_agree_with_scan(make):
    """With their derivatives, whose bits do not depend on the neighbours either."""
    rng = np.random.default_rng(1)
    samples = rng.uniform(0.05, 0.3, 9), rng.uniform(0.5, 1.0, 9)
    like = jax.tree.map(lambda x: x[0], samples)
    keep = lambda record: record.estimates["slow"].value
    fused, scan = (
        Runner(make, like, 40, metrics={"m": Total()}, record=keep, every=10, engine=engine)
        for engine in ("fused", "scan")
    )
    whole, _, plain = ends(fused._fused.program.loop)
    assert plain < whole - 100

    def run(runner, amplitude, until):
        batch = runner((until, amplitude))
        return batch.metrics, batch.record

    def pushed(runner, until, amplitude):
        one = functools.partial(run, runner, until=until)
        return jax.jvp(one, (amplitude,), (jnp.ones_like(amplitude),))

    until, amplitude = map(jnp.asarray, samples)
    found, expected = (pushed(r, until, amplitude) for r in (fused, scan))
    for ours, theirs in zip(*map(jax.tree.leaves, (found, expected)), strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-9, atol=1e-12)
    single = [pushed(fused, until[k : k + 1], amplitude[k : k + 1]) for k in (2, 5)]
    for k, one in zip((2, 5), single, strict=True):
        for ours, theirs in zip(*map(jax.tree.leaves, (found, one)), strict=True):
            np.testing.assert_array_equal(np.asarray(ours)[k], np.asarray(theirs)[0])


def test_a_replay_switches():
    t = 1e-2 * np.arange(41)
    u, y = jnp.sin(3.0 * t), jnp.cos(2.0 * t)
    observer = Slow(jnp.asarray(0.13))
    ours, theirs = (
        aslo.replay(observer, t, u, y, engine=engine) for engine in ("fused", "scan")
    )
    np.testing.assert_allclose(ours.value, theirs.value, rtol=1e-10, atol=1e-13)
