"""Loops over arrays in memory, each a function of its own: the products of the rows of a
matrix with a vector, a function of each entry, and copies of columns."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from ..._ir.graph import Function, Graph
from ..._ir.selection import selected
from .writer import PARTIAL, Writer

ROWS = 4  # whose sums grow beside each other
PRODUCTS = 4  # of each in one turn of a loop


class Array(NamedTuple):
    """Numbers beside each other, `stride` bytes from one to the next, from an offset in the
    frame or in a table of constants on; whether each is one for every lane."""

    base: int | str
    stride: int
    wide: bool


def operation(
    out: Writer,
    graph: Graph,
    number: int,
    op: str,
    args: tuple[int, ...],
    x: list[str],
    vector: bool,
) -> str:
    """The name of what `op` makes as a node of a graph, on the nodes `args` that have the
    names x."""
    node = graph.nodes[number]
    if op == "table":
        return out.lookup(node.data, x[0], vector)
    if op in PARTIAL and node.dtype.kind != "f":
        return out.partial(op, node.dtype, x, vector, graph.value(args[1]))
    return out.operation(op, node.dtype, graph.dtype(args[-1]), x, vector)


def rows(
    out: Writer, count: int, inner: int, dtype: np.dtype, arrays: Sequence[Array], step: int
) -> None:
    """Of a matrix, `count` rows of `inner` numbers, the product of each with a vector, from
    its first number to its last, to places `step` bytes apart. Some rows go together, since
    each sum waits for its last product."""
    matrix, vector = arrays
    wide = matrix.wide or vector.wide
    kind, zero = out.type(dtype, wide), out.constant(0, dtype, wide)

    def number(array: Array, pointer: str) -> str:
        found = out.load(pointer, dtype, array.wide)
        return out.splat(found, dtype) if wide and not array.wide else found

    def added(sums: list[str], row: str, column: str, k: int) -> list[str]:
        """With the k-th products from places of the first of the rows and of the vector."""
        x = number(vector, _at(out, column, k * vector.stride))
        found = []
        for r, total in enumerate(sums):
            place = _at(out, row, (r * inner + k) * matrix.stride)
            found.append(out.call("fmuladd", kind, [number(matrix, place), x, total]))
        return found

    def block(name: str, many: int, first: str) -> None:
        """So many rows from the one with the number `first`."""
        row = _by(out, "%a0", first, inner * matrix.stride)
        out.line(f"br label %{name}.products")
        turns = inner // PRODUCTS
        out.label(f"{name}.products")
        at = len(out.lines)
        left, right = (
            _by(out, pointer, f"%{name}.j", PRODUCTS * array.stride)
            for pointer, array in ((row, matrix), ("%a1", vector))
        )
        sums = [f"%{name}.sum{r}" for r in range(many)]
        for k in range(PRODUCTS):
            sums = added(sums, left, right, k)
        more = out.define(f"add i64 %{name}.j, 1")
        entered, again = f"%{name}", f"%{name}.products"
        out.lines[at:at] = [
            f"  %{name}.j = phi i64 [ 0, {entered} ], [ {more}, {again} ]",
            *(
                f"  %{name}.sum{r} = phi {kind} [ {zero}, {entered} ], [ {s}, {again} ]"
                for r, s in enumerate(sums)
            ),
        ]
        _branch(out, f"icmp ult i64 {more}, {turns}", f"{name}.products", f"{name}.rest")
        out.label(f"{name}.rest")
        for k in range(turns * PRODUCTS, inner):
            sums = added(sums, row, "%a1", k)
        to = _by(out, "%to", first, step)
        for r, total in enumerate(sums):
            place = _at(out, to, r * step)
            out.line(f"store {kind} {total}, ptr {place}, align {dtype.itemsize}")

    whole, rest = divmod(count, ROWS)
    out.line("br label %" + ("some" if whole else "last"))
    if whole:
        out.label("some")
        at = len(out.lines)
        block("some", ROWS, "%i")
        after = out.define(f"add i64 %i, {ROWS}")
        out.lines.insert(at, f"  %i = phi i64 [ 0, %entry ], [ {after}, %some.rest ]")
        _branch(out, f"icmp ult i64 {after}, {whole * ROWS}", "some", "last")
    out.label("last")
    if rest:
        block("last", rest, str(whole * ROWS))
    out.line("ret void")


def entrywise(
    out: Writer,
    function: Function,
    count: int,
    offsets: Sequence[int | str],
    uniform: Sequence[bool],
    step: int,
    vector: bool,
) -> None:
    """A function of each of `count` vectors, or numbers, in some arrays, `step` bytes
    apart there and in the result. `offsets` are those of the arrays from the result, or the
    names of pointers; what is `uniform` is one for all of them, and so is what is made of
    that alone, before the loop."""
    graph = function.graph
    dtype = graph.dtype(function.result)
    order = graph.reachable([function.result])
    made = selected(graph, order, {function.result})
    names: dict[int, str] = {}
    alike: set[int] = set()
    inputs = {n: graph.nodes[n].data[1] for n in order if graph.nodes[n].op == "input"}
    for number in order:
        node = graph.nodes[number]
        if node.op == "const":
            names[number] = out.constant(node.data, node.dtype, vector)
        if node.op == "const" or (number in inputs and uniform[inputs[number]]):
            alike.add(number)

    def read(number: int, to: str, shift: Callable[[str], str]) -> None:
        offset = offsets[inputs[number]]
        place = shift(offset) if isinstance(offset, str) else _at(out, to, offset)
        names[number] = out.load(place, dtype, vector)

    def compute(number: int, op: str, args: tuple[int, ...]) -> None:
        x = [names[a] for a in args]
        names[number] = operation(out, graph, number, op, args, x, vector)

    for number in sorted(alike & inputs.keys()):
        read(number, "%to", str)
    for number, op, args in made:
        if alike.issuperset(args):
            alike.add(number)
            compute(number, op, args)
    out.line("br label %some")
    out.label("some")
    at = len(out.lines)
    place = _by(out, "%to", "%i", step)
    for number in sorted(inputs.keys() - alike):
        read(number, place, lambda pointer: _by(out, pointer, "%i", step))
    for number, op, args in made:
        if number not in alike:
            compute(number, op, args)
    kind = out.type(dtype, vector)
    out.line(f"store {kind} {names[function.result]}, ptr {place}, align {dtype.itemsize}")
    _counted(out, at, count)


def copied(
    out: Writer, slots: Sequence[int], dtype: np.dtype, step: int, vector: bool
) -> None:
    """What the pointers in some slots of the table `%a0` point to, from the lane `%lane`
    on, to places `step` bytes apart."""
    name = out.table(np.array(slots, np.int64))
    out.line("br label %some")
    out.label("some")
    at = len(out.lines)
    slot = out.load(_by(out, name, "%i", 8), np.int64, False)
    column = out.define(f"load ptr, ptr {_by(out, '%a0', slot, 8)}")
    found = out.load(_by(out, column, "%lane", dtype.itemsize), dtype, vector)
    place, kind = _by(out, "%to", "%i", step), out.type(dtype, vector)
    out.line(f"store {kind} {found}, ptr {place}, align {dtype.itemsize}")
    _counted(out, at, len(slots))


def _counted(out: Writer, at: int, count: int) -> None:
    """Ends the block `some`, which began with the line `at` and is done so many times."""
    more = out.define("add i64 %i, 1")
    out.lines.insert(at, f"  %i = phi i64 [ 0, %entry ], [ {more}, %some ]")
    _branch(out, f"icmp ult i64 {more}, {count}", "some", "last")
    out.label("last")
    out.line("ret void")


def _branch(out: Writer, condition: str, then: str, other: str) -> None:
    going = out.define(condition)
    out.line(f"br i1 {going}, label %{then}, label %{other}")


def _at(out: Writer, pointer: str, offset: int) -> str:
    return out.define(f"getelementptr i8, ptr {pointer}, i64 {offset}")


def _by(out: Writer, pointer: str, index: str, step: int) -> str:
    """So many steps from a pointer."""
    offset = out.define(f"mul i64 {index}, {step}")
    return out.define(f"getelementptr i8, ptr {pointer}, i64 {offset}")
