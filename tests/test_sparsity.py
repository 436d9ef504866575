"""Entries that are always 0 or 1, against derivatives at random points."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import aslo_jax as aslo
from aslo_jax._sparsity import listed


def plain(x):
    """Which entries of nested lists are plain numbers, and which."""
    return (
        [plain(e) for e in x] if isinstance(x, list) else x if isinstance(x, int) else None
    )


def slopes(resistance, u, y):
    return jax.jacfwd(lambda y: u - resistance * y)(y)


def test_what_does_not_depend_is_a_plain_zero():
    found = listed(slopes, jnp.asarray(3.7), jnp.ones(2), jnp.asarray([0.3, 1.1]))
    assert plain(found) == [[None, 0], [0, None]]
    assert found[0][0] == -3.7 and found[1][1] == -3.7


def test_ones_and_sums_with_zeros():
    def function(a, x):
        both = jnp.stack([0.0 * a + 1.0, (1.0 + 0.0 * x[0]) * a])
        scalar = {"one": x[0] / x[0], "zero": 0.0 * a}
        return {"both": both, "none": -(0.0 / a) * x, "x": x + 0.0 * a} | scalar

    x = jnp.asarray([2.0, 5.0, 9.0])
    found = listed(function, jnp.asarray(4.0), x)
    assert plain(found["both"]) == [1, None] and plain(found["none"]) == [0, 0, 0]
    assert plain(found["x"]) == [None] * 3
    assert plain(found["one"]) is None and plain(found["zero"]) == 0
    np.testing.assert_array_equal(jnp.stack(found["x"]), x)


@pytest.mark.parametrize(
    "function",
    [
        lambda x: jnp.where(x > 7.0, x, 0.0),  # no zero, though it is one here
        lambda x: jnp.floor(0.1 * x),
        lambda x: x - x,
        lambda x: jax.lax.while_loop(lambda v: v < 0.0, lambda v: v + 1.0, 0.0 * x[0]) * x,
        lambda x: x.astype(jnp.float16),
        lambda x: jnp.exp(x) * 0.3,
    ],
)
def test_what_is_zero_by_chance_is_none(function):
    x = jnp.asarray([1.0, 2.0])
    found = listed(function, x)
    assert plain(found) == [None, None]
    np.testing.assert_array_equal(jnp.stack(found), function(x))


def test_a_function_that_looks_at_its_values_is_taken_as_it_is():
    def function(x):
        return 0.0 * x if x[0] > 0.5 else x

    found = listed(function, jnp.asarray([1.0, 2.0]))
    assert plain(found) == [None, None]
    np.testing.assert_array_equal(jnp.stack(found), [0.0, 0.0])


def test_it_is_known_under_transformations():
    def trace(r):
        found = listed(slopes, r, jnp.ones(2), jnp.ones(2))
        assert plain(found) == [[None, 0], [0, None]]
        return found[0][0] * found[1][1]

    r = jnp.asarray([2.0, 3.0])
    np.testing.assert_allclose(jax.vmap(jax.grad(trace))(r), 2.0 * r)
    np.testing.assert_allclose(jax.jit(jax.vmap(trace))(r), r * r)


@pytest.mark.slow
def test_a_step_takes_the_operations_that_it_needs():
    """Beside those of an algebraic observer: 1.2 and 2.05 times as many."""
    from benchmarks.quality.operations import counted_observer, operations

    relation = aslo.plants.PMSM.bmp0701f().flux_relation()
    algebraic = aslo.AlgebraicObserver(relation, aslo.LowPass(25.0))
    least = counted_observer(algebraic, jnp.ones(2), jnp.ones(2))
    counts = operations()
    assert counts["Lifted"] < 1.3 * least
    assert counts["Adaptive"] < 2.1 * least
