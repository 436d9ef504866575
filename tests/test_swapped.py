"""What the Swapping Lemma carries from the left end of an interval to its right one."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg

from aslo_jax._swapped import (
    FACTOR,
    INFORMATION,
    KNOWN,
    PRODUCT,
    ROW,
    Carried,
    Motion,
    Turning,
    back,
)

INTERVAL = 0.07
A = np.array([[-1.2, 2.0, 0.3], [-2.5, 0.4, 0.0], [0.9, -0.7, 1.1]])
LEFT, RIGHT = np.array([0.4, -1.3, 2.0]), np.array([-0.8, 0.5, 3.1])


def before(x, matrix):
    """The x of an interval ago where `x' = A x + z`, z a line from one value to the other:
    the same backwards, `(x, z, z')' = -(A x + z, z', 0)`."""
    n = len(x)
    whole = np.zeros((2 * n + 1, 2 * n + 1))
    whole[:n, :n], whole[:n, n:-1] = matrix, np.eye(n)
    whole[n:-1, -1] = (RIGHT - LEFT) / INTERVAL
    state = np.concatenate([x, RIGHT, [1.0]])
    return (scipy.linalg.expm(-INTERVAL * whole) @ state)[:n]


@pytest.mark.parametrize("turned", [1.0, 4.0])
def test_back_is_the_exponential_to_its_last_term(turned):
    """To the first terms that are left out, for frames that turn by a fifth of a radian in
    an interval, and by four fifths."""
    matrix = turned * A
    size = np.linalg.norm(INTERVAL * matrix, 2)
    by = back(
        Motion(jnp.asarray(LEFT), matrix), Motion(jnp.asarray(RIGHT), matrix), INTERVAL
    )
    omitted = 1.5 * size**6 / 720
    assert 0.15 * turned < size < 0.3 * turned
    for x in np.eye(3):
        exact = before(x, matrix) - before(np.zeros(3), matrix)
        np.testing.assert_allclose(by.S @ x, exact, rtol=0, atol=omitted)
    e = -before(np.zeros(3), matrix)
    np.testing.assert_allclose(by.e, e, rtol=0, atol=omitted * np.linalg.norm(e))
    np.testing.assert_allclose(by.row(jnp.asarray(LEFT)), LEFT @ by.S, rtol=1e-12)
    np.testing.assert_allclose(by.column(jnp.asarray(LEFT)), LEFT @ by.S, rtol=1e-12)


def test_back_takes_the_mean_of_a_matrix_that_varies():
    left, right = Motion(jnp.asarray(LEFT), 0.5 * A), Motion(jnp.asarray(RIGHT), 1.5 * A)
    mean = Motion(jnp.asarray(LEFT), A), Motion(jnp.asarray(RIGHT), A)
    for found, expected in zip(
        back(left, right, INTERVAL), back(*mean, INTERVAL), strict=True
    ):
        np.testing.assert_allclose(found, expected, rtol=1e-12)


def test_back_without_a_matrix_is_the_area_of_the_line():
    r = jnp.asarray(LEFT)
    by = back(Motion(r), Motion(jnp.asarray(RIGHT)), INTERVAL)
    zero = np.zeros((3, 3))
    np.testing.assert_allclose(by.e, -before(np.zeros(3), zero), rtol=1e-12)
    assert by.row(r) is r
    assert by.column(r) is r


RNG = np.random.default_rng(11)
M = jnp.asarray(RNG.normal(size=(3, 3)))
ROWS = jnp.asarray(RNG.normal(size=(2, 3)))  # of a filter with two states
KNOWNS, H = jnp.asarray(RNG.normal(size=(2, 2)))
Q = jnp.asarray(RNG.normal(size=(3, 3)))
TURNS = [Turning(H, H, Q + Q.T), Turning(H, H, jnp.asarray(0.7))]


CASES = {
    "row": (ROW, ROWS, None, None),
    "factor of a matrix": (FACTOR, ROWS, None, TURNS[0]),
    "factor of a number": (FACTOR, ROWS, None, TURNS[1]),
    "product": (PRODUCT, KNOWNS, ROWS, None),
    "known": (KNOWN, jnp.asarray(RIGHT), M, None),
    "information": (INFORMATION, M, None, None),  # nothing is carried without A
}


@pytest.mark.parametrize(
    ("case", "matrix"),
    [(name, jnp.asarray(A)) for name in CASES] + [(name, None) for name in [*CASES][:-1]],
)
def test_short_intervals_give_the_derivative(case, matrix):
    """What is carried over an interval grows with it at first as what is added to the
    derivative says, and stays where there is no interval."""
    rule, state, factor, turning = CASES[case]
    motion = Motion(jnp.asarray(LEFT), matrix)

    def carried(h):
        by = back(motion, motion, h)
        turned = 0.0 if turning is None else turning.by(turning.H, by.e)
        return rule.carried(state, factor, turned, by)

    value, slope = jax.jvp(carried, (jnp.zeros(()),), (jnp.ones(()),))
    added = rule.added(state, Carried(None, motion, factor, None, turning))
    np.testing.assert_allclose(value, state, rtol=1e-14)
    np.testing.assert_allclose(slope, added, rtol=1e-12, atol=1e-14)
    assert np.any(added != 0.0) != (rule is ROW and matrix is None)
