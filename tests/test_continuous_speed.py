"""What makes the continuous engine fast, each against what it replaces."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import aslo_jax as aslo
from aslo_jax._frontend.lower import flatten
from aslo_jax._frontend.outlining import name_of
from aslo_jax._ir.goal import Goal
from aslo_jax._ir.graph import Graph
from aslo_jax.engines._adaptive.alike import traced
from aslo_jax.engines._adaptive.stepper import _exp2, _largest, _log2

pytest.importorskip("llvmlite")


# -- states that are always equal ---------------------------------------------------------

RATES = {"rates": jnp.array([2.0, 3.0, 0.5])}


def first(given, corner=0.0):
    return {"x": given["rates"], "M": jnp.zeros((3, 3)).at[0, 2].set(corner)}


def filtered(given, t, state):
    """A filter of the symmetric matrix `x x'`."""
    x, M = state["x"], state["M"]
    return {"x": -given["rates"] * x + jnp.cos(t), "M": 7.0 * (x[:, None] * x - M)}


def test_of_a_symmetric_matrix_half_is_integrated():
    states = traced(first, filtered)(RATES)
    assert len(states.first) == 9 and states.of.size == 12
    x = np.arange(1.0, 10.0)
    tree = states.tree(x)
    np.testing.assert_array_equal(tree["M"], tree["M"].T)
    rate = states.field_at(RATES, 1).at(0.3, x)
    expected = filtered(RATES, 0.3, tree)
    for ours, theirs in zip(
        *map(jax.tree.leaves, (states.tree(rate), expected)), strict=True
    ):
        np.testing.assert_allclose(ours, theirs, rtol=1e-14)
    np.testing.assert_array_equal(states.tree(states.start(RATES))["x"], RATES["rates"])


def test_states_that_begin_or_go_on_differently_are_two():
    """The corner begins elsewhere than its mirror image, or has a rate of its own."""
    states = traced(lambda given: first(given, 1.0), filtered)(RATES)
    assert len(states.first) == 10

    def skewed(given, t, state):
        rate = filtered(given, t, state)
        return rate | {"M": rate["M"].at[1, 2].add(t)}

    assert len(traced(first, skewed)(RATES).first) == 10


# -- divisors that are fixed --------------------------------------------------------------


@pytest.mark.parametrize("inverts", [True, False])
def test_a_divisor_that_is_fixed_is_inverted_once(inverts):
    graph = Graph(Goal(inverts=inverts))
    x = graph.input(np.float64, ("carry", 0))
    a, b = (graph.input(np.float64, ("lane", k)) for k in (0, 1))
    op = lambda n: graph.nodes[n].op
    assert op(graph.op("div", x, a)) == ("mul" if inverts else "div")
    assert op(graph.op("div", x, graph.op("mul", a, b))) == ("mul" if inverts else "div")
    for over, under in ((a, b), (b, x), (x, graph.op("add", x, a))):
        assert op(graph.op("div", over, under)) == "div"


def test_a_function_is_put_into_a_graph_once():
    """However often it is called, and again for other fixed arguments."""
    seen = []

    def body(t, x, scale):
        seen.append(None)
        return jnp.sin(scale * x) + t

    def calls(x, scale):
        inner = lambda t, x: body(t, x, scale)
        inner.__name__ = name_of(4)
        f = jax.jit(inner)
        return f(0.3, f(0.2, f(0.1, x)))

    closed = jax.make_jaxpr(calls)(np.ones(3), np.ones(3))
    graph = Graph(Goal(outlined=50))
    x = np.array([graph.input(np.float64, ("carry", k)) for k in range(3)])
    scale = np.array([graph.input(np.float64, ("lane", k)) for k in range(3)])
    (found,) = flatten(graph, closed, [x, scale])
    (_, outline), *others = graph.outlined.values()
    assert not others and len(outline.results) == 3 and len(seen) == 1
    needed = graph.reachable([int(n) for n in found])
    assert sum(graph.nodes[n].op == "part" for n in needed) == 9
    flatten(graph, closed, [x, scale[::-1]])
    assert len(graph.outlined) == 2


# -- the controller of the step -----------------------------------------------------------


def test_logarithm_and_power_of_the_controller():
    x = np.geomspace(1e-10, 1e20, 5001).astype(np.float32)
    np.testing.assert_allclose(_log2(x), np.log2(x), atol=3e-4)
    y = np.linspace(-12.0, 12.0, 5001).astype(np.float32)
    np.testing.assert_allclose(_exp2(y), np.exp2(y), rtol=2e-4)
    for k in range(-5, 6):  # continuous where the exponent changes
        below = np.float32(2.0**k) * np.float32(1 - 1e-6)
        assert abs(_log2(below) - k) < 1e-5 and abs(
            _exp2(np.float32(k - 1e-6)) - 2.0**k
        ) < (1e-5 * 2.0**k)


@pytest.mark.parametrize("count", [1, 2, 3, 7, 13])
def test_the_largest_of_some(count):
    for k in range(count):
        x = jnp.zeros(count).at[k].set(2.5)
        assert _largest(x) == 2.5


def test_the_parts_of_a_loop_are_traced_once_each():
    """The first state, the derivative and the record, whatever the number of stages."""
    seen = []

    def push(t):
        seen.append(None)
        return jnp.cos(3.0 * t)

    plant = aslo.plants.IntegratorChain(2)
    # Looser and tighter: 7 and 16 stages.
    for rtol in (1e-3, 1e-9):
        seen.clear()
        solution = aslo.simulate(
            plant, push, {}, t1=1.0, ts=np.array([1.0]), rtol=rtol, engine="fused"
        )
        exact = (1.0 - np.cos(3.0)) / 9.0
        np.testing.assert_allclose(solution.x[0, 0], exact, atol=10 * rtol)
        assert len(seen) <= 3
