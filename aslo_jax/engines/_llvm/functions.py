"""Functions of vectors with several results, from arrays in memory to another one."""

from collections.abc import Sequence

import numpy as np

from ..._ir.selection import selected
from ..._ir.several import Several
from .._backend.scheduling import depth_first
from .loops import Array, operation
from .writer import Writer


def several(
    out: Writer,
    function: Several,
    members: Sequence[int],
    arrays: Sequence[Array],
    types: Sequence[str],
    step: int,
) -> None:
    """The results `members` of a function, to places `step` bytes apart. The arrays have
    what changes over time, and the rest by types, those `types` of their entries."""
    graph, results = function.graph, [function.results[k] for k in members]
    counts = dict.fromkeys(range(len(arrays)), 0)
    places: dict[int, tuple[int, int]] = {}  # of an argument: which array, and where
    inputs = sorted(
        (node.data[1], n) for n, node in enumerate(graph.nodes) if node.op == "input"
    )
    for k, number in inputs:
        which = 0
        if k >= function.moving:
            which = 1 + types[1:].index(graph.dtype(number).name)
        places[number] = which, k if which == 0 else counts[which]
        counts[which] += 1
    names: dict[int, str] = {}
    if function.gated:
        _gate(out, graph.dtype(inputs[0][1]), [graph.dtype(n) for n in results], step)

    def constant(number: int) -> str:
        """A real one from memory, which an instruction takes as it is: large addresses of
        single constants would take an instruction each."""
        node = graph.nodes[number]
        if node.dtype.kind != "f":
            return out.constant(node.data, node.dtype, True)
        table, k = held[number]
        place = out.define(f"getelementptr i8, ptr {table}, i64 {k * node.dtype.itemsize}")
        return out.splat(out.load(place, node.dtype, False), node.dtype)

    def operand(number: int) -> str:
        node = graph.nodes[number]
        if node.op == "const":
            return constant(number)
        if number not in names and node.op == "input":
            which, k = places[number]
            offset = k * arrays[which].stride
            place = out.define(f"getelementptr i8, ptr %a{which}, i64 {offset}")
            names[number] = out.load(place, node.dtype, True)
        return names[number]

    needed = graph.reachable(results)
    held: dict[int, tuple[str, int]] = {}
    for dtype in dict.fromkeys(graph.dtype(n) for n in needed):
        of_type = [
            n for n in needed if graph.nodes[n].op == "const" and graph.dtype(n) == dtype
        ]
        if dtype.kind == "f" and of_type:
            values = np.array([graph.value(n) for n in of_type], dtype)
            table = out.hidden(out.table(values))
            held |= {n: (table, k) for k, n in enumerate(of_type)}
    order = depth_first(graph, results, set(needed))
    kept = set(results)
    for number, op, args in selected(graph, order, kept):
        x = [operand(a) for a in args]
        names[number] = operation(out, graph, number, op, args, x, True)
    for k, number in enumerate(results):
        value, dtype = operand(number), graph.dtype(number)
        place = out.define(f"getelementptr i8, ptr %to, i64 {k * step}")
        out.store(value, place, dtype)
    out.line("ret void")


def _gate(out: Writer, gate: np.dtype, results: Sequence[np.dtype], step: int) -> None:
    """Leaves a function, with results of zero, where its first argument is zero in all
    lanes."""
    kind, zero = out.type(gate, True), out.constant(0, gate, True)
    given = out.load("%a0", gate, True)
    wanted = out.agree(out.define(f"fcmp une {kind} {given}, {zero}"), False)
    out.line(f"br i1 {wanted}, label %some, label %none")
    out.label("none")
    for k, dtype in enumerate(results):
        place = out.define(f"getelementptr i8, ptr %to, i64 {k * step}")
        out.store(out.constant(0, dtype, True), place, dtype)
    out.line("ret void")
    out.label("some")
