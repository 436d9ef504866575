"""Whether a loop is well-formed (a verifier), as every pass must leave it: it runs between
passes in the tests, so that a damaged loop is found where it was damaged."""

from collections.abc import Iterable
from typing import Any

import numpy as np

from .graph import FOLD, Graph
from .loop import Loop
from .node import BOOL, COMMUTES, COMPARISONS, Node

COUNTS = {"select": 3, "fma": 3, "convert": 1, "bitcast": 1, "table": 1}
COUNTS |= dict.fromkeys(("neg", "abs", "sqrt", "floor", "ceil", "rint"), 1)
COUNTS |= dict.fromkeys(("not", "ones", "zeros"), 1)
REAL = {"sqrt", "floor", "ceil", "rint", "fma"}
BITS = {"and", "or", "xor", "not", "shl", "lshr", "ashr"}
TIMELESS = ("shared", "lane")  # inputs of what is before the first step
INPUTS = ("step", *TIMELESS, "log", "lane log", "time", "carry", "saving")


class MalformedError(ValueError):
    """A loop that no kernel can be made of: an error of a pass, or of the front end."""


def verify(loop: Loop) -> None:
    """Raises where

    - an argument does not precede its user, or an operation has other operands than it
      takes, in number or type;
    - `begin` and `carry`, or `first` and `record`, differ in length or types;
    - an input has a slot of no kind, beyond the carry, or beyond the tables;
    - a branch is no condition;
    - `begin` and `first` use more than what is constant in time, or `final` more than that
      and the carry.
    """
    last: tuple[int, ...] = ()  # the results of a function share their arguments
    for number, node in enumerate(loop.graph.nodes):
        if node.args is last:
            continue
        last = node.args
        for a in node.args:
            if not 0 <= a < number:
                _refuse(f"%{number} = {node.op} uses %{a}, which does not precede it")
    seen: set[tuple[int, int]] = set()
    for number in loop.needed():
        _node(loop.graph, number, seen)
    _pairs(loop, "begin", "carry")
    if loop.first:
        _pairs(loop, "first", "record")
    _inputs(loop, "begin", loop.begin, TIMELESS)
    _inputs(loop, "first", loop.first, TIMELESS)
    _inputs(loop, "final", loop.final, (*TIMELESS, "carry", "saving"))
    _inputs(loop, "a step", (*loop.carry, *loop.record), INPUTS)
    conditions = (*loop.conditions, *loop.branches)
    _inputs(loop, "a branch", conditions, INPUTS)
    for number in conditions:
        if loop.graph.dtype(number) != BOOL:
            _refuse(f"the branch %{number} is {loop.graph.dtype(number)}")
    beside, along = loop.tables
    for table in (beside, along):
        if table is not None:
            verify(table)


def _refuse(what: str) -> None:
    raise MalformedError(f"Malformed loop: {what}.")


def _pairs(loop: Loop, one: str, other: str) -> None:
    graph, a, b = loop.graph, getattr(loop, one), getattr(loop, other)
    if len(a) != len(b):
        _refuse(f"{one} has {len(a)} entries, {other} {len(b)}")
    for i, (x, y) in enumerate(zip(a, b, strict=True)):
        if graph.dtype(x) != graph.dtype(y):
            types = f"{graph.dtype(x)} in {one} and {graph.dtype(y)} in {other}"
            _refuse(f"entry {i} is {types}")


def _node(graph: Graph, number: int, seen: set[tuple[int, int]]) -> None:
    """That it has the operands that it takes, and their type; of the results of a function
    that have the same ones, `seen`, this is looked at once."""
    node = graph.nodes[number]
    what = f"%{number} = {node.op}"
    if node.op in ("const", "input"):
        if node.args:
            _refuse(f"{what} has arguments")
        if node.op == "const" and np.asarray(node.data).dtype != node.dtype:
            _refuse(f"{what} of {node.dtype} is a {np.asarray(node.data).dtype}")
        return
    if node.op in ("dot", "call"):
        _looped(graph, node, what, seen)
        return
    if node.op == "part":
        _part(graph, node, what, seen)
        return
    if node.op not in COUNTS and node.op not in FOLD and node.op not in COMMUTES:
        _refuse(f"{what} is no operation")
    if len(node.args) != COUNTS.get(node.op, 2):
        _refuse(f"{what} has {len(node.args)} operands")
    types = [graph.dtype(a) for a in node.args]
    if node.op == "select":
        if types[0] != BOOL:
            _refuse(f"{what} chooses by {types[0]}")
        types = types[1:]
    if node.op == "table":
        if types[0].kind not in "iu" or node.data.dtype != node.dtype:
            _refuse(f"{what} of {node.data.dtype} takes {types[0]} and gives {node.dtype}")
        return
    if node.op in ("convert", "bitcast"):
        if node.op == "bitcast" and types[0].itemsize != node.dtype.itemsize:
            _refuse(f"{what} takes {types[0]} and gives {node.dtype}")
        return
    if len(set(types)) > 1:
        _refuse(f"{what} has operands of {' and '.join(map(str, types))}")
    result = BOOL if node.op in COMPARISONS else types[0]
    if node.dtype != result:
        _refuse(f"{what} of {types[0]} gives {node.dtype}")
    if node.op in REAL and types[0].kind != "f":
        _refuse(f"{what} takes {types[0]}")
    if node.op in BITS and types[0].kind == "f":
        _refuse(f"{what} takes {types[0]}")


def _part(graph: Graph, node: Node, what: str, seen: set[tuple[int, int]]) -> None:
    """A result of a function with several."""
    function, k = node.data
    inner = function.graph
    if inner.dtype(function.results[k]) != node.dtype:
        _refuse(f"{what} is a result of {inner.dtype(function.results[k])}")
    key = id(function), id(node.args)
    if key in seen:
        return
    seen.add(key)
    for number in inner.reachable(list(function.results)):
        _node(inner, number, seen)
        slot = inner.nodes[number].data
        if inner.nodes[number].op != "input":
            continue
        if slot[0] != "argument" or not 0 <= slot[1] < len(node.args):
            _refuse(f"{what} is of a function of {slot}, with {len(node.args)} operands")
        if inner.dtype(number) != graph.dtype(node.args[slot[1]]):
            _refuse(f"{what} has an operand {slot[1]} of another type")


def _looped(graph: Graph, node: Node, what: str, seen: set[tuple[int, int]]) -> None:
    """An operation that many do in one loop."""
    types = {graph.dtype(a) for a in node.args}
    if types != {node.dtype} or node.dtype.kind != "f":
        _refuse(f"{what} of {' and '.join(map(str, types))} gives {node.dtype}")
    if node.op == "dot":
        if len(node.args) % 2:
            _refuse(f"{what} has {len(node.args)} operands, no row and vector")
        return
    inner = node.data.graph
    if inner.dtype(node.data.result) != node.dtype:
        _refuse(f"{what} calls a function that gives {inner.dtype(node.data.result)}")
    for number in inner.reachable([node.data.result]):
        _node(inner, number, seen)
        slot = inner.nodes[number].data
        if inner.nodes[number].op == "input" and (
            slot[0] != "argument" or not 0 <= slot[1] < len(node.args)
        ):
            _refuse(f"{what} calls a function of {slot}, with {len(node.args)} operands")


def _inputs(loop: Loop, what: str, roots: Iterable[int], allowed: tuple[str, ...]) -> None:
    """That `what` needs no others than those that it may, with slots in their range."""
    graph = loop.graph
    tables: list[tuple[Loop, Any]] = []
    beside, along = loop.tables
    if beside is not None:
        tables += [(beside, n) for n in beside.final]
    if along is not None:
        tables += [(along, n) for n in along.record]
    for number in graph.reachable(list(roots)):
        node = graph.nodes[number]
        if node.op != "input":
            continue
        kind, i = node.data
        if kind not in allowed:
            _refuse(f"{what} uses %{number}, an input of kind {kind!r}")
        saving = 0 if loop.adaptive is None else loop.adaptive.saving
        ends = {"step": 1, "carry": len(loop.carry), "time": len(tables), "saving": saving}
        if not 0 <= i < ends.get(kind, i + 1):
            _refuse(f"%{number} has the slot {i} of {ends.get(kind)} of kind {kind!r}")
        if kind == "carry":
            given = graph.dtype(loop.carry[i])
        elif kind == "saving":
            given = graph.dtype(loop.record[loop.head - ends["saving"] + i])
        elif kind == "time":
            given = tables[i][0].graph.dtype(tables[i][1])
        else:
            continue
        if node.dtype != given:
            _refuse(f"%{number} is {node.dtype}, and {kind} {i} is {given}")
