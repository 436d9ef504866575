"""A function compiled by the fused engine without a loop."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import aslo_jax as aslo
from aslo_jax import _replay
from aslo_jax.engines._fused import kept
from aslo_jax.engines._fused.once import once


def _mixed(scale, tree, name):
    """Of arrays and of what is none."""
    x, shift = tree
    return {"a": scale * jnp.sin(x) + shift, "name": name, "b": (x[0] > 0.0, None)}


def _sorted_by_callback(x):
    return jax.pure_callback(np.sort, jax.ShapeDtypeStruct(x.shape, x.dtype), x)


def test_it_returns_what_the_function_does():
    x = np.array([0.3, -1.1, 2.7])
    found = once(_mixed, np.asarray(2.5), (x, np.asarray(0.125)), "of")
    np.testing.assert_allclose(found["a"], 2.5 * np.sin(x) + 0.125, rtol=1e-15)
    assert found["a"].shape == (3,)
    assert found["name"] == "of"
    assert bool(found["b"][0])
    assert found["b"][1] is None


def test_other_numbers_take_the_same_program():
    kept._cached.cache_clear()
    for size in (1.0, -3.0):
        x = np.array([size, 0.5])
        found = once(_mixed, np.asarray(1.0), (x, np.asarray(0.0)), "one")
        np.testing.assert_allclose(found["a"], np.sin(x), rtol=1e-15)
    assert kept._cached.cache_info().misses == 1
    other = once(_mixed, np.asarray(1.0), (x, np.asarray(0.0)), "two")
    assert other["name"] == "two"
    assert kept._cached.cache_info().misses == 2


def test_what_it_cannot_compile_is_refused():
    with pytest.raises(aslo.NotFusible):
        once(_sorted_by_callback, np.array([2.0, 1.0]))


def test_a_start_by_machine_code_is_that_of_xla():
    motor = aslo.plants.PMSM(1.3, 2.9e-3, 0.071, 3, 1e-3)
    observer = aslo.AlgebraicObserver(motor.flux_relation(), aslo.LowPass(37.0))
    y, u = np.array([1.7, -0.4]), np.array([-12.0, 31.0])
    arguments = (observer, np.asarray(0.25), u, y, None, np.asarray(1.3e-4), False)
    found = _replay._begun_by_machine_code(*arguments)
    expected = _replay._begun(*arguments)
    assert jax.tree.structure(found) == jax.tree.structure(expected)
    for a, b in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-14, atol=1e-300)
