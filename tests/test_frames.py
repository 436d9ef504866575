"""Frames: closed forms, and the conventions of motulator."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import aslo_jax as aslo
from aslo_jax.frames import clarke, inverse_clarke, inverse_park, park

RANDOM = np.random.default_rng(5)


def space_vector(a, b, c):
    """The definition: 2/3 (a + b e^(j 2 pi/3) + c e^(j 4 pi/3))."""
    turn = np.exp(2j * np.pi / 3.0)
    return 2.0 / 3.0 * (a + b * turn + c * turn**2)


def test_clarke_is_the_space_vector_of_the_phases():
    phases = RANDOM.normal(size=(3, 5, 3))  # whose sum is not zero
    expected = space_vector(*np.moveaxis(phases, -1, 0))
    found = clarke(phases)
    assert found.shape == (3, 5, 2)
    np.testing.assert_allclose(found[..., 0] + 1j * found[..., 1], expected, rtol=1e-13)


def test_the_examples_of_motulator():
    """Of `abc2complex` and `complex2abc` in its documentation."""
    found = clarke(np.array([1.0, 2.0, 3.0]))
    np.testing.assert_allclose(found, [-1.0, -0.5773502691896258], rtol=1e-14)
    phases = inverse_clarke(np.array([1.0, -0.5]))
    np.testing.assert_allclose(phases, [1.0, -0.9330127, -0.0669873], atol=5e-8)


def test_two_phases_are_three_that_sum_to_zero():
    two = RANDOM.normal(size=(7, 2))
    three = np.column_stack([two, -two.sum(axis=1)])
    np.testing.assert_allclose(clarke(two), clarke(three), rtol=1e-13, atol=1e-15)


def test_the_inverse_takes_the_zero_sequence_away():
    phases = RANDOM.normal(size=(4, 3))
    expected = phases - phases.mean(axis=1, keepdims=True)
    for invariant in (False, True):
        vector = clarke(phases, power_invariant=invariant)
        found = inverse_clarke(vector, power_invariant=invariant)
        np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-15)


def test_what_each_scaling_keeps():
    angle = np.linspace(0.0, 5.0, 40)
    lagging = angle[:, None] - 2.0 * np.pi / 3.0 * np.arange(3)
    u, i = 3.0 * np.cos(lagging), 0.7 * np.cos(lagging + 0.4)
    np.testing.assert_allclose(np.hypot(*clarke(u).T), 3.0, rtol=1e-13)
    power = (u * i).sum(axis=1)
    same = clarke(u, power_invariant=True) * clarke(i, power_invariant=True)
    np.testing.assert_allclose(same.sum(axis=1), power, rtol=1e-13)
    np.testing.assert_allclose(1.5 * (clarke(u) * clarke(i)).sum(axis=1), power, rtol=1e-13)


def test_park_turns_the_vector_back():
    x, angle = RANDOM.normal(size=(6, 2)), RANDOM.normal(size=6)
    turned = (x[:, 0] + 1j * x[:, 1]) * np.exp(-1j * angle)
    np.testing.assert_allclose(park(x, angle), np.c_[turned.real, turned.imag], rtol=1e-12)
    np.testing.assert_allclose(inverse_park(park(x, angle), angle), x, rtol=1e-12)
    # A vector along the d axis, and one that leads it by 90 degrees.
    np.testing.assert_allclose(park(np.array([0.6, 0.8]), np.arctan2(0.8, 0.6)), [1, 0])
    np.testing.assert_allclose(inverse_park(np.array([0.0, 2.0]), 0.0), [0.0, 2.0])


def test_arrays_of_jax_stay_so():
    phases = jnp.asarray(RANDOM.normal(size=(4, 3)))
    angle = jnp.asarray(0.3)
    found = jax.jit(lambda p, a: park(clarke(p), a))(phases, angle)
    assert isinstance(found, jax.Array)
    expected = park(clarke(np.asarray(phases)), 0.3)
    assert isinstance(expected, np.ndarray)
    np.testing.assert_allclose(found, expected, rtol=1e-12)
    slope = jax.jacfwd(lambda a: park(clarke(phases[0]), a))(angle)
    d, q = park(clarke(phases[0]), angle)
    np.testing.assert_allclose(slope, [q, -d], rtol=1e-12)


def test_other_sizes_are_refused():
    with pytest.raises(ValueError, match=r"`phases` .* 2 or 3 entries .* shape is \(4,\)"):
        aslo.frames.clarke(np.zeros(4))
    with pytest.raises(ValueError, match=r"`vector` .* 2 entries .* shape is \(5, 3\)"):
        park(np.zeros((5, 3)), 0.0)
