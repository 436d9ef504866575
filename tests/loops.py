"""Small loops for the fused engine, and what they find by hand."""

import collections

import jax
import jax.numpy as jnp
import numpy as np

from aslo_jax._ir.loop import varying
from aslo_jax._ir.selection import selected
from aslo_jax._ir.specialisation import specialised
from aslo_jax.engines._fused.program import Bodies, Program

X = np.array([0.3, -1.2, 0.9])
REAL = jax.ShapeDtypeStruct((), np.float64)
PAIRS = (X, np.array([1.7, 0.6, -0.8]))


def program(begin, advance, finish, *, record=None, x=X, widths=(4,)):
    """Of functions of numbers: `begin(x)`, `advance(k, carry, x)`, `finish(carry)`, and
    perhaps `record(carry)`, of what a step begins with."""
    bodies = Bodies(
        lambda inputs: (begin(inputs["lane"]), None),
        lambda k, carry, inputs: (
            advance(k, carry, inputs["lane"]),
            None if record is None else record(carry),
        ),
        lambda carry, inputs: finish(carry),
    )
    shapes = jax.tree.map(lambda a: jax.ShapeDtypeStruct((), a.dtype), x)
    return Program.of(bodies, {"lane": shapes}, widths)


def by_hand(begin, advance, finish, steps, *, record=None, x=X):
    """The records, one for each lane and step, and what is final, one for each lane."""
    records, final = [], []
    for lane in range(len(jax.tree.leaves(x)[0])):
        one = jax.tree.map(lambda a: jnp.asarray(a[lane]), x)  # noqa: B023
        carry, row = begin(one), []
        for k in range(steps):
            row.append(None if record is None else record(carry))
            carry = advance(k, carry, one)
        records.append(_stacked(row))
        final.append(finish(carry))
    return _stacked(records), _stacked(final)


def _stacked(trees):
    return jax.tree.map(lambda *a: np.stack(a), *trees)


def check(begin, advance, finish, steps=7, *, record=None, x=X, widths=(4,), rtol=1e-13):
    """The loop, found right."""
    made = program(begin, advance, finish, record=record, x=x, widths=widths)
    found = made({"lane": x}, len(jax.tree.leaves(x)[0]), steps)
    expected = by_hand(begin, advance, finish, steps, record=record, x=x)
    for ours, theirs in zip(*map(jax.tree.leaves, (found, expected)), strict=True):
        assert ours.dtype == theirs.dtype
        np.testing.assert_allclose(ours, theirs, rtol=rtol)
    return made


def operations(loop):
    """How many instructions of each kind a step takes for its carry."""
    graph, carry = loop.graph, loop.carry
    varies = varying(graph, graph.reachable(list(carry)))
    made = selected(graph, [n for n, (over_time, _) in varies.items() if over_time], carry)
    return collections.Counter(instruction.op for instruction in made)


def count(loop, op, kind="f"):
    """The nodes of one operation in a step, of one kind of numbers."""
    nodes = [loop.graph.nodes[n] for n in loop.of_a_step()]
    return sum(node.op == op and node.dtype.kind == kind for node in nodes)


def total(made):
    return operations(made.loop).total()


def series(x, y, terms=20):
    """Some operations for each term, bounded by 2 where x and y are by 1."""
    total = x
    for j in range(terms):
        total = 0.5 * total * y + x / (2.0 + j) - 0.1 * total * total * x
    return total


def ends(loop):
    """How many operations a step has, and the longer and the shorter of its bodies."""
    graph, roots = loop.graph, loop.carry
    busy = lambda numbers: sum(graph.nodes[n].op not in ("const", "input") for n in numbers)
    assert loop.switches
    each = [{n: usual == same for n, usual in loop.switches} for same in (False, True)]
    both = [specialised(graph, roots, known).nodes for known in each]
    return busy(graph.reachable(list(roots))), *map(busy, both)
