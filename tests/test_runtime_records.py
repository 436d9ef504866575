"""Records and states whose types or shapes change, and batches without lanes."""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from iterations import GAINS, Iteration, last, recorded, rotated, runner, started, turned

from aslo_jax.engines import NotFusible, Runner

pytest.importorskip("llvmlite")


@pytest.mark.parametrize("lanes", [0, 3])
def test_no_batches_of_lanes(lanes):
    """Further axes may be empty, of values and of tangents, as with the other engine."""
    x, none = jnp.ones(lanes), jnp.ones((0, lanes))
    for run in (runner(), runner(engine="scan")):
        values = lambda x, run=run: run(x).record[0]
        pushed = lambda x, rate, f=values: jax.jvp(f, (x,), (rate,))
        assert jax.vmap(values)(none).shape == (0, lanes, 2)
        _, tangent = jax.vmap(pushed)(none, none)
        assert tangent.shape == (0, lanes, 2)
        _, tangent = jax.vmap(pushed, (None, 0))(x, none)
        assert tangent.shape == (0, lanes, 2)


class Counted(Iteration):
    """What is recorded at t = 0 is of another kind than later: `begun(sample)`."""

    begun: Callable = eqx.field(static=True)

    def init(self):
        return self.begin(self.sample), recorded(self.begun(self.sample))

    def advance(self, k, carry, prepared):
        after = self.step(carry, self.sample)
        return after, recorded(after[0])


def counted_run(begun, engine):
    make = lambda sample: Counted(sample, rotated, started, begun)
    return Runner(make, 1.0, 3, record=lambda r: r.x, every=1, engine=engine)(GAINS)


@pytest.mark.parametrize("begun", [jnp.int32, jnp.float32, lambda x: x > 0])
def test_records_of_other_types_at_the_start(begun):
    """Left to the other engine, which finds a type for both."""
    with pytest.raises(NotFusible, match=r"records of the same types.* at t = 0 has"):
        counted_run(begun, "fused")
    with pytest.warns(UserWarning, match="records of the same types"):
        found = np.asarray(counted_run(begun, "auto").record)
    assert found.dtype == np.float64
    np.testing.assert_array_equal(found[:, 0], np.asarray(begun(GAINS), np.float64))
    np.testing.assert_allclose(found[:, 3], turned(GAINS, 3), rtol=1e-12)


def test_records_of_plain_numbers_at_the_start():
    for engine in ("fused", "scan"):
        found = np.asarray(counted_run(lambda x: 0.25, engine).record)
        np.testing.assert_array_equal(found[:, 0], 0.25)
        np.testing.assert_allclose(found[:, 3], turned(GAINS, 3), rtol=1e-12)


def test_a_state_that_changes_its_type():
    """A whole number to begin with is real for the other engine."""
    begin, step = lambda x: (0, x), lambda z, x: (z[0] + 0.5 * x, z[1])
    with pytest.raises(NotFusible, match=r"keeps its shapes and types, but .*'int64'"):
        runner(begin=begin, step=step)
    with pytest.warns(UserWarning, match="keeps its shapes and types"):
        run = runner(4, engine="auto", begin=begin, step=step)
    np.testing.assert_allclose(last(run(GAINS)), 2.0 * GAINS, rtol=1e-12)


@pytest.mark.parametrize(
    "begun",
    [lambda x: x[None], lambda x: {"a": x}, lambda x: None],
    ids=["shape", "tree", "none"],
)
@pytest.mark.parametrize("engine", ["auto", "fused", "scan"])
def test_records_of_other_shapes_at_the_start(begun, engine):
    with pytest.raises((TypeError, ValueError), match=r"different|None"):
        counted_run(begun, engine)
