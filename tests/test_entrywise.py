"""Steps of long states, whose sums of slopes are loops over their entries."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from aslo_jax._frontend.entrywise import entrywise
from aslo_jax._frontend.lower import flatten
from aslo_jax._ir.graph import Graph

pytest.importorskip("llvmlite")

from aslo_jax.engines._adaptive.simulation import Plan, Simulation
from aslo_jax.engines._adaptive.system import System

TS = np.linspace(0.0, 2.0, 23)
LONG = 12  # entries of the state, a loop's worth
MANY = 20  # inputs, which a loop copies


def decaying(rates, still):
    """`x' = -rates x + 1` but for `still` entries, whose slopes are fixed over time: of a
    few 1, a constant, and of many their own rates."""
    moving = len(rates) - still

    def rate(rates, t, x):
        del t
        slopes = jnp.ones(still) if still < MANY else rates[moving:]
        return jnp.concatenate([1.0 - rates[:moving] * x[:moving], slopes])

    return System(lambda rates: jnp.zeros_like(rates), rate, lambda rates, t, x: x)


def solved(rates, still, ts=TS):
    system = decaying(rates, still)
    plan = Plan(0.0, 2.0, ts, np.empty(0), 1e-10, 1e-12, 10_000)
    rows, _ = Simulation(system, plan, object(), jax.tree.structure(0), [1])([rates])
    moving = len(rates) - still
    grown = -np.expm1(-rates[:moving] * ts[:, None]) / rates[:moving]
    slopes = np.ones(still) if still < MANY else rates[moving:]
    return rows, np.hstack([grown, ts[:, None] * slopes])


@pytest.mark.parametrize(
    ("length", "still"), [(3, 0), (3, 1), (LONG, 0), (LONG, 1), (LONG, 3), (31, MANY)]
)
def test_rows_between_steps_are_those_of_the_solution(length, still):
    rates = np.linspace(0.3, 4.0, length)
    found, wanted = solved(rates, still)
    np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-9)


def test_entries_are_those_of_the_function():
    """By a program of one step: a sum of vectors with numbers as weights, of which one is
    known and one entry is fixed."""
    graph = Graph()
    x = np.array([graph.input(np.float64, ("carry", k)) for k in range(LONG)])
    x[3] = graph.const(2.0, np.float64)
    w = np.asarray(graph.input(np.float64, ("lane", 0)))
    of = entrywise(lambda x, w: w * x + 2.0)
    closed = jax.make_jaxpr(of)(jnp.zeros(LONG), 1.0)
    (found,) = flatten(graph, closed, [x, w])
    assert {graph.nodes[n].op for n in found} == {"call"}
    assert len({graph.nodes[n].data for n in found}) == 1
    # One of few entries is a sum like others, and so is one of numbers of several types.
    (few,) = flatten(graph, jax.make_jaxpr(of)(jnp.zeros(3), 1.0), [x[:3], w])
    assert {graph.nodes[n].op for n in few} == {"add"}
    low = np.asarray(graph.input(np.float32, ("lane", 1)))
    mixed = jax.make_jaxpr(of)(jnp.zeros(LONG), jnp.float32(1.0))
    (wide,) = flatten(graph, mixed, [x, low])
    assert {graph.nodes[n].op for n in wide} == {"add"}


def test_what_is_not_by_entries_is_no_loop():
    graph = Graph()
    x = np.array([graph.input(np.float64, ("carry", k)) for k in range(LONG)])
    counted = entrywise(lambda x: x * jnp.arange(1.0, LONG + 1.0))
    (found,) = flatten(graph, jax.make_jaxpr(counted)(jnp.zeros(LONG)), [x])
    assert found[0] == x[0] and {graph.nodes[n].op for n in found[1:]} == {"mul"}
