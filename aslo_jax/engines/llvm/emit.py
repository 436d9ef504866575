"""From a graph to LLVM's intermediate representation: one function that advances many
lanes through many steps, its vectors explicit.

What a step reads lies in a frame of memory: the carry, twice, since a step reads one half
and writes the other, constants, what varies over lanes only, and values that wait
(`registers`). LLVM would load a place once, keep what it found, and store that elsewhere
for want of registers. Hence a step takes turns with several pointers to the frame, of which
LLVM does not know that they are the same.
"""

from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from ..backend.grouping import LOOPED, Group, phases
from ..backend.splitting import Part
from ..backend.step import Step, Way
from ..ir.graph import Node
from ..ir.loop import Slot
from ..ir.selection import Instruction
from .arrays import Groups
from .layout import POINTERS, Layout
from .loops import operation
from .switching import WAYS, Condition, branch
from .writer import PARTIAL

# Bytes of a frame that a kernel puts on the stack of its thread, a quarter of the smallest
# stack of a thread in use.
STACK = 1 << 17
ALIGNED = 64  # bytes: the longest register


class Emitted(NamedTuple):
    """The text of a kernel, and how many bytes of memory it must be handed, if any."""

    text: str
    memory: int


def emit(step: Step) -> Emitted:
    """A kernel whose loop has that step: `void kernel(i64 first, i64 last, i64 lanes, ptr
    steps, i64 every, ptr table, ptr memory)`.

    It runs the lanes first to last - 1 of `lanes`, all three multiples of the step's width,
    through `*steps` steps, read anew before each of them: a negative number that another
    thread writes there ends the run. `table` holds one pointer for each of the loop's
    slots. `memory` is for the frame where that is larger than what is left to the stack,
    begins at a multiple of 64 and is one for each call.
    """
    return _Kernel(step).emitted()


class _Kernel:
    def __init__(self, step: Step):
        self.layout = Layout(step)
        self.out = self.layout.out
        self.graph, self.loop = self.layout.graph, self.layout.loop
        self.body, self.varies = step.body, step.body.varies
        self.pointers: dict[Slot, str] = {}
        self.scalars: dict[int, str] = {}
        self.vectors: dict[int, str] = {}
        self.groups = Groups(self.layout, self.operand)
        self.inputs: dict[Slot, int] = {
            self.graph.nodes[n].data: n
            for n in self.varies
            if self.graph.nodes[n].op == "input" and n in self.groups.single
        }

    def operand(self, number: int, vector: bool) -> str:
        node = self.graph.nodes[number]
        if node.op == "const":
            return self.out.constant(node.data, node.dtype, vector)
        if not vector:
            return self.scalars[number]
        if number not in self.vectors:
            self.vectors[number] = self.out.splat(self.scalars[number], node.dtype)
        return self.vectors[number]

    def compute(
        self,
        numbers: Iterable[int],
        nodes: Mapping[int, Node] | Sequence[Node] | None = None,
    ) -> None:
        """Emits the nodes, each on a vector where it varies over lanes."""
        nodes = self.graph.nodes if nodes is None else nodes
        for groups, rest in phases(nodes, numbers, self.varies):
            for group in groups:
                vector = self.varies[group.members[0]][1]
                made = self.groups.compute(group)
                (self.vectors if vector else self.scalars).update(made)
            for number in rest:
                node = nodes[number]
                if node.op in ("const", "input"):
                    continue
                vector = self.varies[number][1]
                x = [self.operand(a, vector) for a in node.args]
                made = self.result(number, node.op, node.args, x, vector)
                (self.vectors if vector else self.scalars)[number] = made

    def result(
        self, number: int, op: str, args: tuple[int, ...], x: list[str], vector: bool
    ) -> str:
        """`op`, on the nodes `args` that have the names x."""
        return operation(self.out, self.graph, number, op, args, x, vector)

    # -- blocks --------------------------------------------------------------------------

    def emitted(self) -> Emitted:
        self._entry()
        self._begin()
        self._advance()
        self._finish()
        size = max(self.layout.frame.size, 1)
        if size <= STACK:
            return Emitted(self._text(f"alloca [{size} x i8], align {ALIGNED}"), 0)
        return Emitted(self._text("getelementptr i8, ptr %given, i64 0"), size)

    def _text(self, memory: str) -> str:
        """With the instruction that finds the frame."""
        arguments = "i64 %first, i64 %last, i64 %lanes, ptr %limit, i64 %every"
        arguments += f", ptr noalias %table, ptr noalias align {ALIGNED} %given"
        wide = '"prefer-vector-width"="512" "min-legal-vector-width"="512"'
        # Of 1/sqrt(x) an estimate, with a step of Newton's method, is none at x = 0.
        wide += ' "reciprocal-estimates"="none"'
        return "\n".join(
            [
                *(definition for _, definition in self.out.tables.values()),
                *self.groups.definitions,
                f"define void @kernel({arguments}) #0 {{",
                "entry:",
                f"  %memory = {memory}",
                *self.out.lines,
                "}",
                *sorted(self.out.declarations),
                f"attributes #0 = {{ nounwind {wide} }}",
                "",
            ]
        )

    def _entry(self) -> None:
        """Once: pointers, and what varies over neither time nor lanes."""
        for k, slot in enumerate(self.loop.slots):
            if slot[0] not in ("record", "final") and slot not in self.inputs:
                continue
            place = self.out.define(f"getelementptr ptr, ptr %table, i64 {k}")
            self.pointers[slot] = self.out.define(f"load ptr, ptr {place}")
        self.out.line("%self = alloca ptr")
        self.out.line("store ptr %memory, ptr %self")
        for k in range(POINTERS):
            self.out.line(f"%frame{k} = load volatile ptr, ptr %self")
        for slot, number in self.inputs.items():
            if slot[0] == "shared":
                dtype = self.graph.dtype(number)
                self.scalars[number] = self.out.load(self.pointers[slot], dtype, False)
        self.compute(n for n, varies in self.varies.items() if varies == (False, False))
        self.groups.fill(False)
        for number, offset in self.layout.constants.items():
            node = self.graph.nodes[number]
            with self.layout.on(self.layout.register // node.dtype.itemsize):
                value = self.out.constant(node.data, node.dtype, True)
                self.out.store(value, self.layout.at(offset), node.dtype)
        self.out.line("br label %block")

    def _begin(self) -> None:
        """For each block of lanes: its first state, and what varies over lanes only."""
        self.out.label("block")
        entry = self.groups.block or "entry"
        self.out.line(f"%lane = phi i64 [ %first, %{entry} ], [ %next_lane, %finish ]")
        self.out.line("%asked = load volatile i64, ptr %limit")
        self.out.line("%wanted = icmp sge i64 %asked, 0")
        self.out.line("%within = icmp slt i64 %lane, %last")
        self.out.line("%begun = and i1 %wanted, %within")
        self.out.line("br i1 %begun, label %begin, label %done")
        self.out.label("begin")
        self.groups.block = "begin"
        for slot, number in self.inputs.items():
            if slot[0] == "lane":
                dtype = self.graph.dtype(number)
                place = self.out.offset(self.pointers[slot], dtype, "%lane")
                self.vectors[number] = self.out.load(place, dtype, True)
        self.compute(n for n, varies in self.varies.items() if varies == (False, True))
        self.groups.fill(True)
        for i, number in enumerate(self.loop.begin):
            self._keep(i, self.operand(number, True), "0")
        for number, offset in self.layout.fixed.items():
            value, dtype = self.operand(number, True), self.graph.dtype(number)
            self.layout.put(value, self.layout.at(offset), dtype)
        if self.loop.first:
            self._write("record", self.loop.first, "0")
        self.out.line("br label %time")

    def _keep(self, i: int, value: str, base: str) -> None:
        self.layout.put(
            value, self.layout.at(*self.layout.home(i, base)), self.layout.carried[i]
        )

    def _write(self, kind: str, numbers: tuple[int, ...], row: str) -> None:
        for i, number in enumerate(numbers):
            value, dtype = self.operand(number, True), self.graph.dtype(number)
            self.out.store(value, self._place(row, self.pointers[kind, i], dtype), dtype)

    def _advance(self) -> None:
        """For each step: the next state."""
        rows, begun = 1 if self.loop.first else 0, f"%{self.groups.block}"
        self.out.label("time")
        self.out.line(f"%k = phi i64 [ 0, {begun} ], [ %next_k, %advanced ]")
        self.out.line(f"%left = phi i64 [ %every, {begun} ], [ %next_left, %advanced ]")
        self.out.line(f"%saved = phi i64 [ {rows}, {begun} ], [ %next_saved, %advanced ]")
        self.out.line(f"%now = phi i64 [ 0, {begun} ], [ %next, %advanced ]")
        self.out.line(f"%next = sub i64 {self.layout.half}, %now")
        self.out.line("%steps = load volatile i64, ptr %limit")
        self.out.line("%running = icmp slt i64 %k, %steps")
        self.out.line("br i1 %running, label %advance, label %finish")
        self.out.label("advance")
        self.invariant = dict(self.vectors)  # a splat made in here is of no use after it
        for slot, number in self.inputs.items():
            if slot[0] not in ("carry", "lane log"):
                self._read(slot, number)
        self.compute(self.body.scalars)
        for group in self.body.groups:
            self.groups.reserve(group)
        ways = self.layout.step.ways
        if len(ways) > 1:
            self._count()
            self._choose()
        left, saved = [], []
        for way, name in zip(ways, WAYS, strict=False):
            if len(ways) > 1:
                self.out.label(name)
            self._make(way)
            if len(ways) == 1:
                self._count()
            suffix = "" if len(ways) == 1 else f"_{name}"
            end, record = self.out.block, f"record{suffix}"
            self.out.line(f"br i1 %due, label %{record}, label %advanced")
            self._record(way, suffix)
            left += [f"[ %fewer, %{end} ]", f"[ %every, %{record} ]"]
            saved += [f"[ %saved, %{end} ]", f"[ %more_saved{suffix}, %{record} ]"]
        self.out.label("advanced")
        self.out.line(f"%next_left = phi i64 {', '.join(left)}")
        self.out.line(f"%next_saved = phi i64 {', '.join(saved)}")
        self.out.line("br label %time")

    def _count(self) -> None:
        """Steps, and those until the next record."""
        self.out.line("%next_k = add i64 %k, 1")
        self.out.line("%fewer = sub i64 %left, 1")
        self.out.line("%due = icmp eq i64 %fewer, 0")

    def _choose(self) -> None:
        """Which way a step goes."""
        conditions = []
        for number, usual in self.loop.switches:
            vector = self._differs(number)
            name = self._mask(number) if vector else self.operand(number, False)
            conditions.append(Condition(name, vector, usual))
        branch(self.out, conditions, agreed=len(self.layout.step.ways) == 2)

    def _mask(self, switch: int) -> str:
        """The switch of all lanes, by the instructions that make it in a body."""
        for number in self.graph.reachable([switch]):
            node, made = self.graph.nodes[number], self.body.instructions.get(number)
            if number in self.layout.fixed:
                place = self.layout.at(self.layout.fixed[number])
                self.vectors[number] = self.layout.got(place, node.dtype)
            elif node.op == "input" and node.data[0] in ("carry", "lane log"):
                self._read(node.data, number)
            elif made is not None:
                x = [self.operand(a, True) for a in made.args]
                self.vectors[number] = self.result(number, made.op, made.args, x, True)
        mask, self.vectors = self.vectors[switch], dict(self.invariant)
        return mask

    def _make(self, way: Way) -> None:
        """The vectors of a step, and the next carry."""
        self.made, self.spreads = way.made, {}
        leaving = way.body.leaving
        carry: dict[int, list[int]] = {}
        for i, number in enumerate(way.body.loop.carry):
            carry.setdefault(number, []).append(i)
        whole = {n: self.layout.home(places[0], "%next") for n, places in carry.items()}
        for n in leaving - carry.keys():
            whole[n] = self.groups.home(n), "0"
        listed = self.groups.stored(self.made)
        home = {
            v: (offset + self.layout.first(v), base)
            for n, (offset, base) in (
                {n: (places[0], "0") for n, places in listed.items()} | whole
            ).items()
            for v in self.layout.parts(n)
        }
        self.parts: dict[Part, str] = {}
        for event in way.events:
            value = event.value
            if event.instruction is not None and event.instruction.op == "group":
                self._loop(self.body.groups[value.place])
                continue
            dtype, lanes = self.graph.dtype(value.number), self.layout.lanes(value.number)
            with self.layout.on(lanes):
                if event.action == "load" and value.number not in self.made:
                    self.parts[value] = self._lasting(value)
                elif event.action == "drop":
                    self.parts.pop(value)
                elif event.action == "load":
                    place = self.layout.at(*home[value], turn=True)
                    self.parts[value] = self.layout.got(place, dtype)
                elif event.action == "store":
                    size = self.layout.size(dtype) // self.layout.step.parts(value.number)
                    home[value] = self.layout.frame.place(value, size), "0"
                    self.layout.put(self.parts[value], self.layout.at(*home[value]), dtype)
                elif event.action == "free":
                    self.layout.frame.free(value)
                elif event.instruction is not None:
                    self.parts[value] = self._done(event.instruction)
                    for i in carry.get(value.number, ()):
                        self._keep_part(i, value, self.parts[value])
                    if value.number in leaving - carry.keys():
                        self.layout.put(
                            self.parts[value], self.layout.at(*home[value]), dtype
                        )
                    for offset in listed.get(value.number, ()):
                        place = self.layout.at(offset + self.layout.first(value))
                        self.layout.put(self.parts[value], place, dtype)
        for number in carry.keys() - self.made:
            with self.layout.on(self.layout.lanes(number)):
                for value in self.layout.parts(number):
                    given = self._lasting(value)
                    for i in carry[number]:
                        self._keep_part(i, value, given)
        self.leaving = {n: whole[n] for n in leaving}

    def _loop(self, group: Group) -> None:
        """A group of a step, whose registers are free."""
        for number, array, k in self.groups.given(group, self.made):
            if not array.wide:
                self.groups.put(number, array, k)
                continue
            with self.layout.on(self.layout.lanes(number)):
                for value in self.layout.parts(number):
                    place = self.groups.place(array, k, self.layout.first(value))
                    self.layout.put(self._lasting(value), place, self.graph.dtype(number))
        self.groups.call(group)

    def _keep_part(self, i: int, value: Part, name: str) -> None:
        offset, base = self.layout.home(i, "%next")
        place = self.layout.at(offset + self.layout.first(value), base)
        self.layout.put(name, place, self.layout.carried[i])

    def _done(self, instruction: Instruction[Part]) -> str:
        """The name of what an instruction of a step makes."""
        (number, _), op, args = instruction
        mine, position = self.layout.step.parts(number), 0
        partial = op in PARTIAL and self.graph.dtype(number).kind != "f"
        nodes, x = [], []
        while position < len(args):
            first = args[position]
            many = max(self.layout.step.parts(first.number) // mine, 1)
            if not self._differs(first.number):
                many = 1
            literal = partial and position + many == len(args)
            x.append(self._operand(args[position : position + many], instruction, literal))
            nodes.append(first.number)
            position += many
        return self.result(number, op, tuple(nodes), x, True)

    def _operand(
        self, parts: Sequence[Part], instruction: Instruction[Part], literal: bool
    ) -> str:
        """Of an instruction, an argument in some parts; a constant as a `literal`."""
        number, lanes = parts[0].number, self.out.width
        alike = number not in self.made and not self._differs(number)
        if (
            alike
            and not literal
            and parts[0] in self.parts
            and self.layout.lanes(number) == lanes
        ):
            return self.parts[parts[0]]
        if alike:
            return self._alike(number, literal)
        own, dtype = self.layout.lanes(number), self.graph.dtype(number)
        with self.layout.on(own):
            names = [self.parts.get(p) or self._given(p) for p in parts]
        if len(parts) > 1:
            return self.out.joined(names, dtype)
        with self.layout.on(own):
            first = instruction.result.place * lanes - parts[0].place * own
            return self.out.cut(names[0], max(first, 0), lanes, dtype)

    def _lasting(self, value: Part) -> str:
        """What a step does not make, in a register for several instructions."""
        if self._differs(value.number):
            return self._given(value)
        return self._alike(value.number)

    def _differs(self, number: int) -> bool:
        """Whether what a step does not make is another for each lane."""
        return self.varies[number][1]

    def _alike(self, number: int, literal: bool = False) -> str:
        """What is the same for all lanes, on as many as vectors have."""
        node, key = self.graph.nodes[number], (number, self.out.width)
        if number in self.layout.constants and not literal:
            return self.out.load(
                self.layout.at(self.layout.constants[number], turn=True), node.dtype, True
            )
        if node.op == "const":
            return self.out.constant(node.data, node.dtype, True)
        if node.op == "input" and node.data[0] in ("time", "log"):
            place = self.out.offset(self.pointers[node.data], node.dtype, "%k")
            return self.out.splat(self.out.load(place, node.dtype, False), node.dtype)
        if key not in self.spreads:
            self.spreads[key] = self.out.splat(self.scalars[number], node.dtype)
        return self.spreads[key]

    def _given(self, value: Part) -> str:
        """A part of what a step does not make, and what is another for each lane."""
        number, node = value.number, self.graph.nodes[value.number]
        if node.op in LOOPED and self.varies[number][0]:
            place = self.layout.at(
                self.groups.home(number) + self.layout.first(value), turn=True
            )
            return self.layout.got(place, node.dtype)
        if number in self.layout.fixed:
            place = self.layout.at(
                self.layout.fixed[number] + self.layout.first(value), turn=True
            )
            return self.layout.got(place, node.dtype)
        kind, i = node.data
        if kind == "carry":
            offset, base = self.layout.home(i, "%now")
            place = self.layout.at(offset + self.layout.first(value), base, turn=True)
            return self.layout.got(place, node.dtype)
        row = self._place("%k", self.pointers[node.data], node.dtype)
        return self.out.load(
            self.out.offset(row, node.dtype, str(value.place * self.out.width)),
            node.dtype,
            True,
        )

    def _read(self, slot: Slot, number: int) -> None:
        """An input that varies over time."""
        (kind, i), dtype = slot, self.graph.dtype(number)
        if kind == "step":
            self.scalars[number] = "%k"
        elif kind in ("log", "time"):
            place = self.out.offset(self.pointers[slot], dtype, "%k")
            self.scalars[number] = self.out.load(place, dtype, False)
        elif kind == "lane log":
            place = self._place("%k", self.pointers[slot], dtype)
            self.vectors[number] = self.out.load(place, dtype, True)
        elif kind == "carry":
            place = self.layout.at(*self.layout.home(i, "%now"))
            self.vectors[number] = self.layout.got(place, dtype)

    def _place(self, row: str, pointer: str, dtype: np.dtype) -> str:
        """Where the lanes of a row are."""
        first = self.out.define(f"mul i64 {row}, %lanes")
        return self.out.offset(pointer, dtype, self.out.define(f"add i64 {first}, %lane"))

    def _record(self, way: Way, suffix: str) -> None:
        """At every so manyth step: what only the records need, and the records."""
        self.out.label(f"record{suffix}")
        self.vectors = dict(self.invariant)
        for slot, number in self.inputs.items():
            if slot[0] in ("carry", "lane log"):
                self._read(slot, number)
        for number, home in self.leaving.items():
            place, dtype = self.layout.at(*home), self.graph.dtype(number)
            self.vectors[number] = self.layout.got(place, dtype)
        self.compute(way.body.record, way.body.nodes)
        self._write("record", way.body.loop.record, "%saved")
        self.out.line(f"%more_saved{suffix} = add i64 %saved, 1")
        self.out.line("br label %advanced")
        self.vectors = dict(self.invariant)

    def _finish(self) -> None:
        """For each block of lanes: what its last state leaves."""
        self.out.label("finish")
        for slot, number in self.inputs.items():
            if slot[0] == "carry":
                self._read(slot, number)
        self.groups.forget()
        self.compute(self.body.moving(self.graph.reachable(list(self.loop.final))))
        self._write("final", self.loop.final, "0")
        self.out.line(f"%next_lane = add i64 %lane, {self.out.width}")
        self.out.line("br label %block")
        self.out.label("done")
        self.out.line("ret void")
