"""What a loop returns: every leaf, with its lanes and rows first."""

import jax.numpy as jnp
import numpy as np
import pytest
from loops import X, check, program

pytest.importorskip("llvmlite")


def halved(k, carry, x):
    return (0.5 * carry[0],)


def results(carry):
    """Leaves of several shapes and types, one of them empty."""
    a = carry[0]
    return {
        "number": a,
        "array": jnp.stack([a, 2.0 * a])[:, None] * jnp.arange(1.0, 4.0),
        "empty": jnp.zeros((2, 0)),
        "truth": jnp.stack([a > 0.1, a < 0.0, a > -9.0]),
        "whole": jnp.floor(9.0 * a).astype(jnp.int32),
    }


def test_leaves_of_any_shape_and_type():
    """Five lanes, which no kernel advances at a time."""
    x = np.array([*X, 2.4, -0.7])
    check(lambda x: (x,), halved, results, record=results, steps=3, x=x)


def test_a_loop_without_steps_returns_its_beginning():
    made = program(lambda x: (x,), halved, lambda c: c[0], record=results)
    record, final = made({"lane": X}, 3, 0)
    np.testing.assert_array_equal(final, X)
    assert record["array"].shape == (3, 0, 2, 3) and record["truth"].shape == (3, 0, 3)
