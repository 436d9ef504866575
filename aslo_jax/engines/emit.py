"""From a graph to LLVM's intermediate representation: one function that advances many
lanes through many steps, its vectors explicit."""

import dataclasses
from collections.abc import Iterable

import numpy as np

from .graph import Graph, Node
from .instructions import SHIFTS, Writer

Slot = tuple[str, int]


@dataclasses.dataclass(frozen=True)
class Loop:
    """What a kernel computes: nodes of `graph`, whose inputs have the slots

    - `("step", 0)`: the time index, int64;
    - `("shared", i)`, `("lane", i)`: constant in time, one value for all lanes or one each;
    - `("log", i)`, `("lane log", i)`: the same, with one entry for each step;
    - `("carry", i)`: the i-th of `carry`, which holds the nodes of the next values.

    `record` holds the nodes that are written at every so manyth step.
    """

    graph: Graph
    carry: tuple[int, ...]
    record: tuple[int, ...]


def slots(loop: Loop) -> list[Slot]:
    """The pointers that the kernel takes, in their order: every input that is used but
    the step, all of the carry, and the records."""
    graph = loop.graph
    used = {
        graph.nodes[n].data
        for n in graph.reachable([*loop.carry, *loop.record])
        if graph.nodes[n].op == "input"
    }
    inputs = sorted(s for s in used if s[0] not in ("carry", "step"))
    carry = [("carry", i) for i in range(len(loop.carry))]
    return [*inputs, *carry, *(("record", i) for i in range(len(loop.record)))]


def emit(loop: Loop, width: int) -> str:
    """The kernel's text, for `width` lanes at a time: `void kernel(i64 first, i64 last, i64
    lanes, i64 start, i64 steps, i64 every, ptr table)`.

    It advances the lanes first to last - 1 of `lanes` (multiples of width) by `steps` steps
    from the time index `start`. `table` holds one pointer for each of [`slots`][].
    """
    return _Kernel(loop, width).text()


class _Kernel(Writer):
    def __init__(self, loop: Loop, width: int):
        super().__init__(width)
        self.loop, self.graph = loop, loop.graph
        self.scalars: dict[int, str] = {}
        self.vectors: dict[int, str] = {}
        self.varies: dict[int, tuple[bool, bool]] = {}  # over time, over lanes
        for number in self.graph.reachable([*loop.carry, *loop.record]):
            self.varies[number] = self._varies(self.graph.nodes[number])
        self.inputs: dict[Slot, int] = {
            self.graph.nodes[n].data: n
            for n in self.varies
            if self.graph.nodes[n].op == "input"
        }
        self.carried = [self.graph.dtype(n) for n in loop.carry]

    def _varies(self, node: Node) -> tuple[bool, bool]:
        if node.op == "input":
            kind = node.data[0]
            return kind not in ("shared", "lane"), kind in ("lane", "lane log", "carry")
        found = [self.varies[a] for a in node.args]
        return any(time for time, _ in found), any(lane for _, lane in found)

    def operand(self, number: int, vector: bool) -> str:
        node = self.graph.nodes[number]
        if node.op == "const":
            return self.constant(node.data, node.dtype, vector)
        if not vector:
            return self.scalars[number]
        if number not in self.vectors:
            self.vectors[number] = self.splat(self.scalars[number], node.dtype)
        return self.vectors[number]

    def compute(self, numbers: Iterable[int]) -> None:
        """Emits the nodes, each on a vector where it varies over lanes."""
        for number in numbers:
            node = self.graph.nodes[number]
            if node.op in ("const", "input"):
                continue
            vector = self.varies[number][1]
            x = [self.operand(a, vector) for a in node.args]
            if node.op in SHIFTS:
                amount = self.graph.value(node.args[1])
                result = self.shift(node.op, node.dtype, x, vector, amount)
            else:
                source = self.graph.dtype(node.args[-1])
                result = self.operation(node.op, node.dtype, source, x, vector)
            (self.vectors if vector else self.scalars)[number] = result

    # -- blocks --------------------------------------------------------------------------

    def text(self) -> str:
        in_loop = set(self.graph.reachable(list(self.loop.carry)))
        moving = [n for n, (time, _) in self.varies.items() if time]
        self._entry()
        self._begin()
        self._advance([n for n in moving if n in in_loop])
        self._record([n for n in moving if n not in in_loop])
        self._finish()
        arguments = ", ".join(
            f"i64 %{a}" for a in ("first", "last", "lanes", "start", "steps", "every")
        )
        wide = '"prefer-vector-width"="512" "min-legal-vector-width"="512"'
        return "\n".join(
            [
                f"define void @kernel({arguments}, ptr noalias %table) #0 {{",
                *self.lines,
                "}",
                *sorted(self.declarations),
                f"attributes #0 = {{ nounwind {wide} }}",
                "",
            ]
        )

    def _entry(self) -> None:
        """Once: pointers, and what varies over neither time nor lanes."""
        self.label("entry")
        self.pointers: dict[Slot, str] = {}
        for k, slot in enumerate(slots(self.loop)):
            place = self.define(f"getelementptr ptr, ptr %table, i64 {k}")
            self.pointers[slot] = self.define(f"load ptr, ptr {place}")
        self.buffers = [
            self.define(f"alloca {self.stored(dtype, True)}, align 64")
            for dtype in self.carried
        ]
        for slot, number in self.inputs.items():
            if slot[0] == "shared":
                dtype = self.graph.dtype(number)
                self.scalars[number] = self.load(self.pointers[slot], dtype, False)
        self.compute(n for n, varies in self.varies.items() if varies == (False, False))
        self.line("br label %block")

    def _begin(self) -> None:
        """For each block of lanes: its state, and what varies over lanes only."""
        self.label("block")
        self.line("%lane = phi i64 [ %first, %entry ], [ %next_lane, %finish ]")
        self.line("%begun = icmp slt i64 %lane, %last")
        self.line("br i1 %begun, label %begin, label %done")
        self.label("begin")
        for slot, number in self.inputs.items():
            if slot[0] == "lane":
                dtype = self.graph.dtype(number)
                place = self.offset(self.pointers[slot], dtype, "%lane")
                self.vectors[number] = self.load(place, dtype, True)
        for i, dtype in enumerate(self.carried):
            place = self.offset(self.pointers["carry", i], dtype, "%lane")
            self.store(self.load(place, dtype, True), self.buffers[i], dtype)
        self.compute(n for n, varies in self.varies.items() if varies == (False, True))
        self.line("br label %time")

    def _advance(self, numbers: list[int]) -> None:
        """For each step: the next state."""
        self.label("time")
        self.line("%j = phi i64 [ 0, %begin ], [ %next_j, %advanced ]")
        self.line("%left = phi i64 [ %every, %begin ], [ %next_left, %advanced ]")
        self.line("%saved = phi i64 [ 0, %begin ], [ %next_saved, %advanced ]")
        self.line("%running = icmp slt i64 %j, %steps")
        self.line("br i1 %running, label %advance, label %finish")
        self.label("advance")
        self.invariant = dict(self.vectors)  # a splat made in here is of no use after it
        self.line("%k = add i64 %start, %j")
        for slot, number in self.inputs.items():
            self._read(slot, number)
        self.compute(numbers)
        values = [self.operand(n, True) for n in self.loop.carry]
        for value, buffer, dtype in zip(values, self.buffers, self.carried, strict=True):
            self.store(value, buffer, dtype)
        self.line("%next_j = add i64 %j, 1")
        self.line("%fewer = sub i64 %left, 1")
        self.line("%due = icmp eq i64 %fewer, 0")
        self.line("br i1 %due, label %record, label %advanced")

    def _read(self, slot: Slot, number: int) -> None:
        """An input that varies over time."""
        (kind, i), dtype = slot, self.graph.dtype(number)
        if kind == "step":
            self.scalars[number] = "%k"
        elif kind == "log":
            place = self.offset(self.pointers[slot], dtype, "%j")
            self.scalars[number] = self.load(place, dtype, False)
        elif kind == "lane log":
            place = self._place("%j", self.pointers[slot], dtype)
            self.vectors[number] = self.load(place, dtype, True)
        elif kind == "carry":
            self.vectors[number] = self.load(self.buffers[i], dtype, True)

    def _place(self, row: str, pointer: str, dtype: np.dtype) -> str:
        """Where the lanes of a row are."""
        first = self.define(f"mul i64 {row}, %lanes")
        return self.offset(pointer, dtype, self.define(f"add i64 {first}, %lane"))

    def _record(self, numbers: list[int]) -> None:
        """At every so manyth step: what only the records need, and the records."""
        self.label("record")
        self.compute(numbers)
        for i, number in enumerate(self.loop.record):
            dtype = self.graph.dtype(number)
            value = self.operand(number, True)
            place = self._place("%saved", self.pointers["record", i], dtype)
            self.store(value, place, dtype)
        self.line("%more_saved = add i64 %saved, 1")
        self.line("br label %advanced")
        self.vectors = self.invariant
        self.label("advanced")
        self.line("%next_left = phi i64 [ %fewer, %advance ], [ %every, %record ]")
        self.line("%next_saved = phi i64 [ %saved, %advance ], [ %more_saved, %record ]")
        self.line("br label %time")

    def _finish(self) -> None:
        """For each block of lanes: its last state."""
        self.label("finish")
        for i, dtype in enumerate(self.carried):
            value = self.load(self.buffers[i], dtype, True)
            place = self.offset(self.pointers["carry", i], dtype, "%lane")
            self.store(value, place, dtype)
        self.line(f"%next_lane = add i64 %lane, {self.width}")
        self.line("br label %block")
        self.label("done")
        self.line("ret void")
