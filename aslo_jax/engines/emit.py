"""From a graph to LLVM's intermediate representation: one function that advances many
lanes through many steps, its vectors explicit.

What a step reads lies in a frame of memory: the carry, twice, since a step reads one half
and writes the other, constants, what varies over lanes only, and values that wait
(`registers`). LLVM would load a place once, keep what it found, and store that elsewhere
for want of registers. Hence a step takes turns with several pointers to the frame, of which
LLVM does not know that they are the same.
"""

from collections.abc import Collection, Iterable

import numpy as np

from .frame import Frame
from .instructions import SHIFTS, Writer, literal
from .loop import Slot
from .reduce import carries
from .registers import Instruction
from .step import Step

POINTERS = 6


def emit(step: Step) -> str:
    """The text of a kernel whose loop has that step: `void kernel(i64 first, i64 last, i64
    lanes, i64 steps, i64 every, ptr table)`.

    It runs the lanes first to last - 1 of `lanes`, all three multiples of the step's width,
    through `steps` steps. `table` holds one pointer for each of the loop's slots.
    """
    return _Kernel(step).text()


class _Kernel(Writer):
    def __init__(self, step: Step):
        super().__init__(step.width)
        self.step, self.body, self.register = step, step.body, step.register
        self.loop, self.graph = step.body.loop, step.body.loop.graph
        self.varies = step.body.varies
        self.scalars: dict[int, str] = {}
        self.vectors: dict[int, str] = {}
        self.inputs: dict[Slot, int] = {
            self.graph.nodes[n].data: n
            for n in self.varies
            if self.graph.nodes[n].op == "input"
        }
        self.carried = [self.graph.dtype(n) for n in self.loop.carry]
        self.frame = Frame()
        self.turns = 0

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
            result = self.result(number, node.op, node.args, x, vector)
            (self.vectors if vector else self.scalars)[number] = result

    def result(
        self, number: int, op: str, args: tuple[int, ...], x: list[str], vector: bool
    ) -> str:
        """`op`, on the nodes `args` that have the names x."""
        node = self.graph.nodes[number]
        if op == "table":
            return self.lookup(node.data, x[0], vector)
        if op in SHIFTS:
            return self.shift(op, node.dtype, x, vector, self.graph.value(args[1]))
        return self.operation(op, node.dtype, self.graph.dtype(args[-1]), x, vector)

    # -- blocks --------------------------------------------------------------------------

    def text(self) -> str:
        self._lay_out()
        self._entry()
        self._begin()
        self._advance()
        self._record()
        self._finish()
        arguments = ", ".join(
            f"i64 %{a}" for a in ("first", "last", "lanes", "steps", "every")
        )
        wide = '"prefer-vector-width"="512" "min-legal-vector-width"="512"'
        return "\n".join(
            [
                *(definition for _, definition in self.tables.values()),
                f"define void @kernel({arguments}, ptr noalias %table) #0 {{",
                "entry:",
                f"  %memory = alloca [{max(self.frame.size, 1)} x i8], align 64",
                *self.lines,
                "}",
                *sorted(self.declarations),
                f"attributes #0 = {{ nounwind {wide} }}",
                "",
            ]
        )

    def _lay_out(self) -> None:
        """Places for what a step reads and does not make: constants, what is fixed, and
        the carry. An entry of it that is made before its predecessor is read for the last
        time has two places; one that is made of that last reading needs only one."""
        instructions = [e.instruction for e in self.step.events if e.instruction]
        made = {x.number: time for time, x in enumerate(instructions)}
        read = {a: time for time, x in enumerate(instructions) for a in x.args}
        read |= {a: len(made) for n in self.body.record for a in self.graph.nodes[n].args}
        read |= {n: len(made) for n in (*self.loop.carry, *self.loop.record)}
        inputs = carries(self.graph, read)
        double = [
            made.get(n, -1) < read.get(inputs.get(i, -1), -1)
            for i, n in enumerate(self.loop.carry)
        ]
        self.half = sum(
            self._size(d) for d, two in zip(self.carried, double, strict=True) if two
        )
        ends = {True: 0, False: 2 * self.half}
        self.carry_places: list[tuple[int, bool]] = []
        for dtype, two in zip(self.carried, double, strict=True):
            self.carry_places.append((ends[two], two))
            ends[two] += self._size(dtype)
        self.frame.place("carry", ends[False])
        self.constants: dict[int, int] = {}  # their places
        self.fixed: dict[int, int] = {}  # over time, and different for each lane
        for number in read:
            node = self.graph.nodes[number]
            if node.op == "const" and node.data and node.dtype != np.bool_:
                self.constants[number] = self.frame.place(number, self.register)
            elif self.varies[number] == (False, True):
                self.fixed[number] = self.frame.place(number, self._size(node.dtype))

    def _size(self, dtype: np.dtype) -> int:
        """Bytes of a vector of all lanes in the frame."""
        return self.step.registers(dtype) * self.register

    def _entry(self) -> None:
        """Once: pointers, and what varies over neither time nor lanes."""
        self.pointers: dict[Slot, str] = {}
        for k, slot in enumerate(self.loop.slots):
            place = self.define(f"getelementptr ptr, ptr %table, i64 {k}")
            self.pointers[slot] = self.define(f"load ptr, ptr {place}")
        self.line("%self = alloca ptr")
        self.line("store ptr %memory, ptr %self")
        for k in range(POINTERS):
            self.line(f"%frame{k} = load volatile ptr, ptr %self")
        for slot, number in self.inputs.items():
            if slot[0] == "shared":
                dtype = self.graph.dtype(number)
                self.scalars[number] = self.load(self.pointers[slot], dtype, False)
        self.compute(n for n, varies in self.varies.items() if varies == (False, False))
        for number, offset in self.constants.items():
            node = self.graph.nodes[number]
            kind, lanes = self._one_register(node.dtype)
            entry = f"{self.type(node.dtype, False)} {literal(node.data)}"
            entries = ", ".join([entry] * lanes)
            self.line(f"store {kind} <{entries}>, ptr {self._at(offset)}")
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
        for i, number in enumerate(self.loop.begin):
            self._keep(i, self.operand(number, True), "0")
        for number, offset in self.fixed.items():
            value, dtype = self.operand(number, True), self.graph.dtype(number)
            self._put(value, self._at(offset), dtype)
        if self.loop.first:
            self._write("record", self.loop.first, "0")
        self.line("br label %time")

    def _put(self, value: str, place: str, dtype: np.dtype) -> None:
        """Into the frame, where a mask is as wide as it is in registers."""
        if dtype != np.bool_:
            return self.store(value, place, dtype)
        kind, wide = self.type(dtype, True), self.type(np.int64, True)
        if self.register < 64:
            value, kind = self.define(f"sext {kind} {value} to {wide}"), wide
        return self.line(f"store {kind} {value}, ptr {place}, align {self.register}")

    def _got(self, place: str, dtype: np.dtype) -> str:
        """From the frame."""
        if dtype != np.bool_:
            return self.load(place, dtype, True)
        if self.register == 64:
            kind = self.type(dtype, True)
            return self.define(f"load {kind}, ptr {place}, align {self.register}")
        kind = self.type(np.int64, True)
        found = self.define(f"load {kind}, ptr {place}, align {self.register}")
        return self.define(f"icmp slt {kind} {found}, zeroinitializer")

    def _at(self, offset: int, base: str = "0", turn: bool = False) -> str:
        """A pointer into the frame, for what is read many times one that takes turns."""
        self.turns += turn
        pointer = f"%frame{self.turns % POINTERS if turn else 0}"
        if base != "0":
            pointer = self.define(f"getelementptr i8, ptr {pointer}, i64 {base}")
        return self.define(f"getelementptr i8, ptr {pointer}, i64 {offset}")

    def _home(self, i: int, base: str) -> tuple[int, str]:
        """Where the i-th entry of the carry is, that of `%now` or of `%next`: its offset
        and what to add to it."""
        offset, two = self.carry_places[i]
        return offset, base if two else "0"

    def _keep(self, i: int, value: str, base: str) -> None:
        self._put(value, self._at(*self._home(i, base)), self.carried[i])

    def _write(self, kind: str, numbers: tuple[int, ...], row: str) -> None:
        for i, number in enumerate(numbers):
            value, dtype = self.operand(number, True), self.graph.dtype(number)
            self.store(value, self._place(row, self.pointers[kind, i], dtype), dtype)

    def _advance(self) -> None:
        """For each step: the next state."""
        rows = 1 if self.loop.first else 0
        self.label("time")
        self.line("%k = phi i64 [ 0, %begin ], [ %next_k, %advanced ]")
        self.line("%left = phi i64 [ %every, %begin ], [ %next_left, %advanced ]")
        self.line(f"%saved = phi i64 [ {rows}, %begin ], [ %next_saved, %advanced ]")
        self.line("%now = phi i64 [ 0, %begin ], [ %next, %advanced ]")
        self.line(f"%next = sub i64 {self.half}, %now")
        self.line("%running = icmp slt i64 %k, %steps")
        self.line("br i1 %running, label %advance, label %finish")
        self.label("advance")
        self.invariant = dict(self.vectors)  # a splat made in here is of no use after it
        for slot, number in self.inputs.items():
            if slot[0] != "carry":
                self._read(slot, number)
        self.compute(self.body.scalars)
        self._make()
        self.line("%next_k = add i64 %k, 1")
        self.line("%fewer = sub i64 %left, 1")
        self.line("%due = icmp eq i64 %fewer, 0")
        self.line("br i1 %due, label %record, label %advanced")

    def _make(self) -> None:
        """The vectors of a step, and the next carry."""
        carry: dict[int, list[int]] = {}
        for i, number in enumerate(self.loop.carry):
            carry.setdefault(number, []).append(i)
        leaving = self.body.leaving
        made = {e.number for e in self.step.events if e.instruction}
        home = {n: self._home(places[0], "%next") for n, places in carry.items()}
        for n in leaving - carry.keys():
            home[n] = self.frame.place(n, self._size(self.graph.dtype(n))), "0"
        for event in self.step.events:
            number, dtype = event.number, self.graph.dtype(event.number)
            if event.action == "load":
                place = self._at(*home[number], turn=True)
                self.vectors[number] = self._got(place, dtype)
            elif event.action == "store":
                home[number] = self.frame.place(number, self._size(dtype)), "0"
                self._put(self.vectors[number], self._at(*home[number]), dtype)
            elif event.action == "free":
                self.frame.free(number)
            elif event.instruction is not None:
                value = self.vectors[number] = self._done(event.instruction, made)
                for i in carry.get(number, ()):
                    self._keep(i, value, "%next")
                if number in leaving and number not in carry:
                    self._put(value, self._at(*home[number]), dtype)
        for number, places in carry.items():
            for i in places if number not in made else ():
                self._keep(i, self._given(number), "%next")
        self.leaving = {n: home[n] for n in leaving}

    def _done(self, instruction: Instruction, made: Collection[int]) -> str:
        """The name of what an instruction of a step makes."""
        number, op, args = instruction
        shift = len(args) - 1 if op in SHIFTS else -1  # by constants that are literal
        x = [
            self.vectors[a] if a in made else self._given(a, as_literal=k == shift)
            for k, a in enumerate(args)
        ]
        return self.result(number, op, args, x, True)

    def _given(self, number: int, as_literal: bool = False) -> str:
        """What a step does not make, from the frame where it has a place there."""
        node = self.graph.nodes[number]
        kind = node.data[0] if node.op == "input" else node.op
        if kind == "carry":
            place = self._at(*self._home(node.data[1], "%now"), turn=True)
            return self._got(place, node.dtype)
        if number in self.fixed:
            return self._got(self._at(self.fixed[number], turn=True), node.dtype)
        if number not in self.constants or as_literal:
            return self.operand(number, True)
        # One register for all vectors of the lanes.
        whole, lanes = self._one_register(node.dtype)
        place = self._at(self.constants[number], turn=True)
        one = self.define(f"load {whole}, ptr {place}")
        mask = ", ".join(f"i32 {k % lanes}" for k in range(self.width))
        mask = f"<{self.width} x i32> <{mask}>"
        return self.define(f"shufflevector {whole} {one}, {whole} poison, {mask}")

    def _one_register(self, dtype: np.dtype) -> tuple[str, int]:
        """The type of a vector that is one register, and its lanes."""
        lanes = self.register // dtype.itemsize
        return f"<{lanes} x {self.type(dtype, False)}>", lanes

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
            place = self._at(*self._home(i, "%now"))
            self.vectors[number] = self._got(place, dtype)

    def _place(self, row: str, pointer: str, dtype: np.dtype) -> str:
        """Where the lanes of a row are."""
        first = self.define(f"mul i64 {row}, %lanes")
        return self.offset(pointer, dtype, self.define(f"add i64 {first}, %lane"))

    def _record(self) -> None:
        """At every so manyth step: what only the records need, and the records."""
        self.label("record")
        self.vectors = dict(self.invariant)
        for slot, number in self.inputs.items():
            if slot[0] in ("carry", "lane log"):
                self._read(slot, number)
        for number, home in self.leaving.items():
            place, dtype = self._at(*home), self.graph.dtype(number)
            self.vectors[number] = self._got(place, dtype)
        self.compute(self.body.record)
        self._write("record", self.loop.record, "%saved")
        self.line("%more_saved = add i64 %saved, 1")
        self.line("br label %advanced")
        self.vectors = self.invariant
        self.label("advanced")
        self.line("%next_left = phi i64 [ %fewer, %advance ], [ %every, %record ]")
        self.line("%next_saved = phi i64 [ %saved, %advance ], [ %more_saved, %record ]")
        self.line("br label %time")

    def _finish(self) -> None:
        """For each block of lanes: what its last state leaves."""
        self.label("finish")
        for slot, number in self.inputs.items():
            if slot[0] == "carry":
                self._read(slot, number)
        self.compute(self.body.moving(self.graph.reachable(list(self.loop.final))))
        self._write("final", self.loop.final, "0")
        self.line(f"%next_lane = add i64 %lane, {self.width}")
        self.line("br label %block")
        self.label("done")
        self.line("ret void")
