"""From a graph to LLVM's intermediate representation: one function that advances many
lanes through many steps, its vectors explicit.

What a step reads lies in a frame of memory: the carry, twice, since a step reads one half
and writes the other, constants, what varies over lanes only, and values that wait
(`spilling`). LLVM would load a place once, keep what it found, and store that elsewhere
for lack of registers. So a step takes turns with several pointers to the frame, of which
LLVM does not know that they are the same.
"""

from typing import NamedTuple

from ..._ir.loop import Slot
from .._backend.step import Step
from .layout import POINTERS, Layout
from .saving import Saving
from .switching import WAYS, Condition, branch
from .values import Values
from .vectors import Vectors

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
    through `*steps` steps, read again before each of them: a negative number that another
    thread writes there ends the run. `table` holds one pointer for each of the loop's
    slots. `memory` is for the frame where that is larger than what is left to the stack,
    begins at a multiple of 64 and is one for each call.
    """
    return _Kernel(step).emitted()


class _Kernel:
    def __init__(self, step: Step) -> None:
        self.layout = Layout(step)
        self.values = values = Values(self.layout)
        self.out, self.groups = self.layout.out, values.groups
        self.graph, self.loop = self.layout.graph, self.layout.loop
        self.body, self.varies = step.body, step.body.varies
        self.saving = None if self.loop.adaptive is None else Saving(values)
        self.inputs: dict[Slot, int] = {
            self.graph.nodes[n].data: n
            for n in self.varies
            if self.graph.nodes[n].op == "input" and n in self.groups.single
        }

    def _varying(self, over_lanes: bool) -> list[int]:
        """What does not change over time, and does over lanes or does not."""
        wanted = False, over_lanes
        return [n for n, varies in self.varies.items() if varies == wanted]

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
            self.values.pointers[slot] = self.out.define(f"load ptr, ptr {place}")
        self.out.line("%self = alloca ptr")
        self.out.line("store ptr %memory, ptr %self")
        for k in range(POINTERS):
            self.out.line(f"%frame{k} = load volatile ptr, ptr %self")
        for slot, number in self.inputs.items():
            if slot[0] == "shared":
                dtype = self.graph.dtype(number)
                self.values.scalars[number] = self.out.load(
                    self.values.pointers[slot], dtype, False
                )
        self.values.compute(
            n for n, varies in self.varies.items() if varies == (False, False)
        )
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
                place = self.out.offset(self.values.pointers[slot], dtype, "%lane")
                self.values.vectors[number] = self.out.load(place, dtype, True)
        self.values.compute(
            n for n, varies in self.varies.items() if varies == (False, True)
        )
        self.groups.fill(True)
        for i, number in enumerate(self.loop.begin):
            self._keep(i, self.values.operand(number, True), "0")
        for number, offset in self.layout.fixed.items():
            value, dtype = self.values.operand(number, True), self.graph.dtype(number)
            self.layout.put(value, self.layout.at(offset), dtype)
        if self.loop.first:
            self._write("record", self.loop.first[self.loop.head :], "0")
        if self.saving is not None:
            self.saving.begin()
        self.out.line("br label %time")

    def _keep(self, i: int, value: str, base: str) -> None:
        self.layout.put(
            value, self.layout.at(*self.layout.home(i, base)), self.layout.carried[i]
        )

    def _write(self, kind: str, numbers: tuple[int, ...], row: str) -> None:
        for i, number in enumerate(numbers):
            value, dtype = self.values.operand(number, True), self.graph.dtype(number)
            self.out.store(
                value,
                self.values.place_of(row, self.values.pointers[kind, i], dtype),
                dtype,
            )

    def _advance(self) -> None:
        """For each step: the next state."""
        rows, begun = 1 if self.loop.first else 0, f"%{self.groups.block}"
        self.out.label("time")
        self.out.line(f"%k = phi i64 [ 0, {begun} ], [ %next_k, %advanced ]")
        self.out.line(f"%left = phi i64 [ %every, {begun} ], [ %next_left, %advanced ]")
        self.out.line(f"%saved = phi i64 [ {rows}, {begun} ], [ %next_saved, %advanced ]")
        self.out.line(f"%now = phi i64 [ 0, {begun} ], [ %next, %advanced ]")
        if self.saving is not None:
            self.out.line(f"%ended = phi i1 [ false, {begun} ], [ %all_ended, %advanced ]")
        self.out.line(f"%next = sub i64 {self.layout.half}, %now")
        self.out.line("%steps = load volatile i64, ptr %limit")
        self.out.line("%running = icmp slt i64 %k, %steps")
        running = "%running"
        if self.saving is not None:
            running = self.out.define("select i1 %ended, i1 false, i1 %running")
        self.out.line(f"br i1 {running}, label %advance, label %finish")
        self.out.label("advance")
        self.invariant = dict(
            self.values.vectors
        )  # a splat made in here is of no use after it
        for slot, number in self.inputs.items():
            if slot[0] not in ("carry", "lane log"):
                self.values.read(slot, number)
        self.values.compute(self.body.scalars)
        for group in self.body.groups:
            self.groups.reserve(group)
        ways = self.layout.step.ways
        if len(ways) > 1:
            self._count()
            self._choose()
        left, saved = [], []
        for which, name in zip(range(len(ways)), WAYS, strict=False):
            if len(ways) > 1:
                self.out.label(name)
            vectors = Vectors(self.values, which)
            vectors.make()
            if len(ways) == 1:
                self._count()
            suffix = "" if len(ways) == 1 else f"_{name}"
            if self.saving is not None:
                self._adapt(vectors, self.saving)
                return
            end, record = self.out.block, f"record{suffix}"
            self.out.line(f"br i1 %due, label %{record}, label %advanced")
            self._record(vectors, suffix)
            left += [f"[ %fewer, %{end} ]", f"[ %every, %{record} ]"]
            saved += [f"[ %saved, %{end} ]", f"[ %more_saved{suffix}, %{record} ]"]
        self.out.label("advanced")
        self.out.line(f"%next_left = phi i64 {', '.join(left)}")
        self.out.line(f"%next_saved = phi i64 {', '.join(saved)}")
        self.out.line("br label %time")

    def _adapt(self, vectors: Vectors, saving: Saving) -> None:
        """After an attempted step: the rows that lanes save from it, and whether all have
        ended."""
        self._again(vectors)
        ended = saving.ended()
        if saving.entries:
            saving.rows()
        else:
            self.out.line("br label %advanced")
        self.out.label("advanced")
        self.out.line(f"%all_ended = and i1 {ended}, true")
        self.out.line("%next_left = add i64 %left, 0")
        self.out.line("%next_saved = add i64 %saved, 0")
        self.out.line("br label %time")
        self.values.vectors = dict(self.invariant)

    def _count(self) -> None:
        """Steps, and those until the next record."""
        self.out.line("%next_k = add i64 %k, 1")
        self.out.line("%fewer = sub i64 %left, 1")
        self.out.line("%due = icmp eq i64 %fewer, 0")

    def _choose(self) -> None:
        """Which way a step goes."""
        conditions = []
        for number, usual in self.loop.switches:
            vector = self.values.differs(number)
            name = self._mask(number) if vector else self.values.operand(number, False)
            conditions.append(Condition(name, vector, usual))
        branch(self.out, conditions, agreed=len(self.layout.step.ways) == 2)

    def _mask(self, switch: int) -> str:
        """The switch of all lanes, by the instructions that make it in a body."""
        for number in self.graph.reachable([switch]):
            node, made = self.graph.nodes[number], self.body.instructions.get(number)
            if number in self.layout.fixed:
                place = self.layout.at(self.layout.fixed[number])
                self.values.vectors[number] = self.layout.got(place, node.dtype)
            elif node.op == "input" and node.data[0] in ("carry", "lane log"):
                self.values.read(node.data, number)
            elif made is not None:
                x = [self.values.operand(a, True) for a in made.args]
                self.values.vectors[number] = self.values.result(
                    number, made.op, made.args, x, True
                )
        mask, self.values.vectors = self.values.vectors[switch], dict(self.invariant)
        return mask

    def _record(self, made: Vectors, suffix: str) -> None:
        """After every n-th step: what only the records need, and the records."""
        self.out.label(f"record{suffix}")
        self._again(made)
        self.values.compute(made.way.body.record, made.way.body.nodes)
        self._write("record", made.way.body.loop.record, "%saved")
        self.out.line(f"%more_saved{suffix} = add i64 %saved, 1")
        self.out.line("br label %advanced")
        self.values.vectors = dict(self.invariant)

    def _again(self, made: Vectors) -> None:
        """Reads what a record needs of its step."""
        self.values.vectors = dict(self.invariant)
        for slot, number in self.inputs.items():
            if slot[0] in ("carry", "lane log"):
                self.values.read(slot, number)
        for number, home in made.leaving.items():
            if number in self.groups.results:
                continue  # read where it is needed
            place, dtype = self.layout.at(*home), self.graph.dtype(number)
            self.values.vectors[number] = self.layout.got(place, dtype)

    def _finish(self) -> None:
        """For each block of lanes: what its last state leaves."""
        self.out.label("finish")
        for slot, number in self.inputs.items():
            if slot[0] == "carry":
                self.values.read(slot, number)
        if self.saving is not None:
            self.saving.read()
        self.groups.forget()
        self.values.compute(self.body.moving(self.graph.reachable(list(self.loop.final))))
        self._write("final", self.loop.final, "0")
        self.out.line(f"%next_lane = add i64 %lane, {self.out.width}")
        self.out.line("br label %block")
        self.out.label("done")
        self.out.line("ret void")
