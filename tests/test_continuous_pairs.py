"""The embedded pairs of the continuous engine: conditions of order, rooted tree by rooted
tree (Hairer, Norsett, Wanner, Solving Ordinary Differential Equations I, section II.2)."""

import functools
import itertools

import numpy as np
import pytest

from aslo_jax.engines._adaptive.pairs import LOOSE, pair_for, tsit5, verner98

pytest.importorskip("llvmlite")
PAIRS = {"Tsit5": (tsit5, 5, 4, 4), "Verner": (verner98, 9, 8, 9)}
ROUNDING = 2e-12  # of sums of coefficients up to 7e3 and their products
named = pytest.mark.parametrize("name", PAIRS)


@functools.cache
def trees(order):
    """Rooted trees, each a sorted tuple of its subtrees."""
    if order == 1:
        return [()]
    found = set()
    for first in range(1, order):
        for sub, rest in itertools.product(trees(first), trees(order - first)):
            found.add(tuple(sorted((*rest, sub))))
    return sorted(found)


def size(tree):
    return 1 + sum(map(size, tree))


def density(tree):
    return size(tree) * np.prod([density(sub) for sub in tree], initial=1.0)


def weights(tree, A):
    """The elementary weight of every stage."""
    found = np.ones(len(A))
    for sub in tree:
        found = found * (A @ weights(sub, A))
    return found


def residual(b, A, orders, scale=1.0):
    """The largest of the conditions of some orders at a fraction `scale` of a step."""
    return max(
        abs(b @ weights(tree, A)[: len(b)] - scale**order / density(tree))
        for order in orders
        for tree in trees(order)
    )


def test_trees_are_counted_as_in_the_literature():
    counts = [len(trees(order)) for order in range(1, 10)]
    assert counts == [1, 1, 2, 4, 9, 20, 48, 115, 286]


@named
def test_the_solution_and_its_estimate_have_their_orders(name):
    make, order, lower, _ = PAIRS[name]
    pair = make()
    b, embedded = pair.weights, pair.weights - pair.error
    assert pair.order == order and pair.falls == lower + 1
    assert residual(b, pair.stages, range(1, order + 1)) < ROUNDING
    assert residual(embedded, pair.stages, range(1, lower + 1)) < ROUNDING
    assert residual(embedded, pair.stages, [lower + 1]) > 1e3 * ROUNDING
    assert residual(b, pair.stages, [order + 1]) > 1e3 * ROUNDING


@named
@pytest.mark.parametrize("part", [0.3, 0.85])
def test_the_interpolant_has_its_order_within_a_step(name, part):
    make, _, _, order = PAIRS[name]
    pair = make()
    b = pair.dense @ part ** np.arange(1, pair.dense.shape[1] + 1)
    # Sums of products up to 1e4 with alternating signs.
    rounding = 1e-7 if name == "Tsit5" else 1e-11
    assert residual(b, pair.stages, range(1, order + 1), part) < rounding
    assert residual(b, pair.stages, [order + 1], part) > 10 * rounding


@named
def test_the_interpolant_ends_where_the_step_does(name):
    pair = PAIRS[name][0]()
    end = np.zeros(len(pair.stages))
    end[: pair.main] = pair.weights
    np.testing.assert_allclose(pair.dense.sum(axis=1), end, atol=1e-10)


@named
def test_the_interval_of_stability(name):
    pair = PAIRS[name][0]()
    A, b = pair.stages[: pair.main, : pair.main], pair.weights

    def growth(z):
        return abs(1 + z * b @ np.linalg.solve(np.eye(len(b)) - z * A, np.ones(len(b))))

    inside = np.linspace(-pair.stable + 0.01, -0.01, 400)
    assert max(map(growth, inside)) < 1.0 < growth(-pair.stable - 0.01)


def test_the_pair_follows_the_tolerance():
    assert pair_for(LOOSE).name == "Tsit5" and pair_for(1e-8).name == "Verner 9(8)"
    assert tsit5().reuses and not verner98().reuses
