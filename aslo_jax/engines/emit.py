"""From a graph to LLVM's intermediate representation: one function that advances many
lanes through many steps, its vectors explicit."""

from collections.abc import Iterable

import numpy as np

from .instructions import SHIFTS, Writer
from .loop import Loop, Slot
from .order import ordered


def emit(loop: Loop, width: int) -> str:
    """The kernel's text, for `width` lanes at a time: `void kernel(i64 first, i64 last, i64
    lanes, i64 steps, i64 every, ptr table)`.

    It runs the lanes first to last - 1 of `lanes` (multiples of width) through `steps`
    steps. `table` holds one pointer for each of the loop's slots.
    """
    return _Kernel(loop, width).text()


class _Kernel(Writer):
    def __init__(self, loop: Loop, width: int):
        super().__init__(width)
        self.loop, self.graph = loop, loop.graph
        self.scalars: dict[int, str] = {}
        self.vectors: dict[int, str] = {}
        self.varies: dict[int, tuple[bool, bool]] = {}  # over time, over lanes
        for number in loop.needed():
            node = self.graph.nodes[number]
            self.varies[number] = node.varies([self.varies[a] for a in node.args])
        self.inputs: dict[Slot, int] = {
            self.graph.nodes[n].data: n
            for n in self.varies
            if self.graph.nodes[n].op == "input"
        }
        self.carried = [self.graph.dtype(n) for n in loop.carry]

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
            if node.op == "table":
                result = self.lookup(node.data, x[0], vector)
            elif node.op in SHIFTS:
                amount = self.graph.value(node.args[1])
                result = self.shift(node.op, node.dtype, x, vector, amount)
            else:
                source = self.graph.dtype(node.args[-1])
                result = self.operation(node.op, node.dtype, source, x, vector)
            (self.vectors if vector else self.scalars)[number] = result

    # -- blocks --------------------------------------------------------------------------

    def text(self) -> str:
        in_step = self.graph.reachable(list(self.loop.carry))
        in_record = set(self.graph.reachable(list(self.loop.record))) - set(in_step)
        self._entry()
        self._begin()
        self._advance(ordered(self.graph, self._moving(in_step)))
        self._record(self._moving(sorted(in_record)))
        self._finish(self._moving(self.graph.reachable(list(self.loop.final))))
        arguments = ", ".join(
            f"i64 %{a}" for a in ("first", "last", "lanes", "steps", "every")
        )
        wide = '"prefer-vector-width"="512" "min-legal-vector-width"="512"'
        return "\n".join(
            [
                *(definition for _, definition in self.tables.values()),
                f"define void @kernel({arguments}, ptr noalias %table) #0 {{",
                *self.lines,
                "}",
                *sorted(self.declarations),
                f"attributes #0 = {{ nounwind {wide} }}",
                "",
            ]
        )

    def _moving(self, numbers: Iterable[int]) -> list[int]:
        return [n for n in numbers if self.varies[n][0]]

    def _entry(self) -> None:
        """Once: pointers, and what varies over neither time nor lanes."""
        self.label("entry")
        self.pointers: dict[Slot, str] = {}
        for k, slot in enumerate(self.loop.slots):
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
        """For each block of lanes: its first state, and what varies over lanes only."""
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
        self.compute(n for n, varies in self.varies.items() if varies == (False, True))
        self._keep(self.loop.begin)
        if self.loop.first:
            self._write("record", self.loop.first, "0")
        self.line("br label %time")

    def _keep(self, numbers: tuple[int, ...]) -> None:
        """The state of a block of lanes."""
        values = [self.operand(n, True) for n in numbers]
        for value, buffer, dtype in zip(values, self.buffers, self.carried, strict=True):
            self.store(value, buffer, dtype)

    def _write(self, kind: str, numbers: tuple[int, ...], row: str) -> None:
        for i, number in enumerate(numbers):
            value, dtype = self.operand(number, True), self.graph.dtype(number)
            self.store(value, self._place(row, self.pointers[kind, i], dtype), dtype)

    def _advance(self, numbers: list[int]) -> None:
        """For each step: the next state."""
        rows = 1 if self.loop.first else 0
        self.label("time")
        self.line("%k = phi i64 [ 0, %begin ], [ %next_k, %advanced ]")
        self.line("%left = phi i64 [ %every, %begin ], [ %next_left, %advanced ]")
        self.line(f"%saved = phi i64 [ {rows}, %begin ], [ %next_saved, %advanced ]")
        self.line("%running = icmp slt i64 %k, %steps")
        self.line("br i1 %running, label %advance, label %finish")
        self.label("advance")
        self.invariant = dict(self.vectors)  # a splat made in here is of no use after it
        for slot, number in self.inputs.items():
            self._read(slot, number)
        self.compute(numbers)
        self._keep(self.loop.carry)
        self.line("%next_k = add i64 %k, 1")
        self.line("%fewer = sub i64 %left, 1")
        self.line("%due = icmp eq i64 %fewer, 0")
        self.line("br i1 %due, label %record, label %advanced")

    def _read(self, slot: Slot, number: int) -> None:
        """An input that varies over time."""
        (kind, i), dtype = slot, self.graph.dtype(number)
        if kind == "step":
            self.scalars[number] = "%k"
        elif kind in ("log", "time"):
            place = self.offset(self.pointers[slot], dtype, "%k")
            self.scalars[number] = self.load(place, dtype, False)
        elif kind == "lane log":
            place = self._place("%k", self.pointers[slot], dtype)
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
        self._write("record", self.loop.record, "%saved")
        self.line("%more_saved = add i64 %saved, 1")
        self.line("br label %advanced")
        self.vectors = self.invariant
        self.label("advanced")
        self.line("%next_left = phi i64 [ %fewer, %advance ], [ %every, %record ]")
        self.line("%next_saved = phi i64 [ %saved, %advance ], [ %more_saved, %record ]")
        self.line("br label %time")

    def _finish(self, numbers: list[int]) -> None:
        """For each block of lanes: what its last state leaves."""
        self.label("finish")
        for slot, number in self.inputs.items():
            if slot[0] == "carry":
                self._read(slot, number)
        self.compute(numbers)
        self._write("final", self.loop.final, "0")
        self.line(f"%next_lane = add i64 %lane, {self.width}")
        self.line("br label %block")
        self.label("done")
        self.line("ret void")
