"""The memory of a kernel: what a step reads lies in a frame of its own."""

import contextlib
from collections.abc import Iterator, Sequence

import numpy as np

from ..._ir.node import LOOPED, Node
from ..._ir.rewrite import carries
from ..._ir.selection import Instruction
from .._backend.grouping import entries
from .._backend.splitting import Part
from .._backend.step import Step, Way
from .frame import Frame
from .writer import Writer

POINTERS = 6


class Layout:
    """Places in the frame, and the instructions that read and write them."""

    def __init__(self, step: Step) -> None:
        self.out = Writer(step.width, exact=len(step.ways) > 1)
        self.step, self.body, self.register = step, step.body, step.target.register
        self.loop, self.graph = step.body.loop, step.body.loop.graph
        self.varies = step.body.varies
        self.carried = [self.graph.dtype(n) for n in self.loop.carry]
        self.frame = Frame()
        self.turns = 0
        self._lay_out()

    def _lay_out(self) -> None:
        """Places for what a step reads and does not make: constants, what is fixed, and
        the carry."""
        numbers: dict[int, None] = {}
        overlaps = [self._overlaps(way, numbers) for way in self.step.ways]
        left = [self._left(way) for way in self.step.ways]
        double = self._double(overlaps, left)
        self.half = sum(
            self.size(d) for d, two in zip(self.carried, double, strict=True) if two
        )
        ends = {True: 0, False: 2 * self.half}
        self.carry_places: list[tuple[int, bool]] = []
        for dtype, two in zip(self.carried, double, strict=True):
            self.carry_places.append((ends[two], two))
            ends[two] += self.size(dtype)
        self.frame.place("carry", ends[False])
        self._asides = [
            {
                i: self.frame.place(("aside", i), self.size(self.carried[i]))
                for i, overlap in enumerate(some)
                if overlap and not double[i] and i not in unchanged
            }
            for some, unchanged in zip(overlaps, left, strict=True)
        ]
        self._still = [{i for i in some if not double[i]} for some in left]
        self.constants: dict[int, int] = {}  # their places
        self.fixed: dict[int, int] = {}  # over time, and different for each lane
        for number in numbers:
            node = self.graph.nodes[number]
            if node.op == "const" and node.data and node.dtype != np.bool_:
                self.constants[number] = self.frame.place(number, self.register)
            elif self.varies[number] == (False, True):
                self.fixed[number] = self.frame.place(number, self.size(node.dtype))

    def _double(
        self, overlaps: Sequence[Sequence[bool]], left: Sequence[set[int]]
    ) -> list[bool]:
        """The entries of the carry with two places, one for each of two steps. What the
        usual way leaves as it is stays where it is, and costs it nothing: others make it
        aside and move it there at their end, which must not be before a record of what it
        was."""
        double = [any(some) for some in zip(*overlaps, strict=True)]
        recorded = [self._recorded(way) for way in self.step.ways]
        for i in left[0]:
            late = [i in r and i not in l for r, l in zip(recorded, left, strict=True)]
            double[i] = double[i] and any(late)
        return double

    def _left(self, way: Way) -> set[int]:
        """The entries of the carry that a way leaves as they are."""
        nodes = ((i, self.graph.nodes[n]) for i, n in enumerate(way.body.loop.carry))
        return {i for i, n in nodes if n.op == "input" and n.data == ("carry", i)}

    def _recorded(self, way: Way) -> set[int]:
        """Those of which its record needs what they were."""
        body = way.body
        read = {a for n in body.record for a in self._single(body.nodes[n])}
        return set(carries(self.graph, read | set(body.loop.record)))

    def _read(self, instruction: Instruction[Part]) -> Sequence[Part]:
        """What an instruction reads: one that is a group, of what changes over time."""
        if instruction.op != "group":
            return instruction.args
        array = entries(self.graph, [self.body.groups[instruction.result.place]])
        return [v for n in array if self.varies[n][0] for v in self.parts(n)]

    def _single(self, node: Node) -> Sequence[int]:
        """The arguments of a node that are not only in arrays."""
        if node.op not in LOOPED:
            return node.args
        return [a for a in node.args if self.varies[a][0]]

    def _overlaps(self, way: Way, numbers: dict[int, None]) -> list[bool]:
        """For each entry of the carry, whether it needs two places: it is made before its
        predecessor is read for the last time. One that is made of that last reading needs
        only one. What is read goes to the `numbers`."""
        body = way.body
        instructions = [e.instruction for e in way.events if e.instruction]
        end = len(instructions)
        made = {x.result: time for time, x in enumerate(instructions)}
        read = {a: time for time, x in enumerate(instructions) for a in self._read(x)}
        outside = {a for n in body.record for a in self._single(body.nodes[n])}
        outside |= {*body.loop.carry, *body.loop.record}
        read |= {v: end for n in outside for v in self.parts(n)}
        numbers |= dict.fromkeys(v.number for v in read)
        inputs = carries(self.graph, {v.number for v in read})

        def overlaps(i: int, number: int) -> bool:
            if i not in inputs:
                return False
            before, after = self.parts(inputs[i]), self.parts(number)
            if len(before) != len(after):
                return True
            pairs = zip(before, after, strict=True)
            return any(made.get(a, -1) < read.get(b, -1) for b, a in pairs)

        return [overlaps(i, n) for i, n in enumerate(body.loop.carry)]

    def size(self, dtype: np.dtype) -> int:
        """Bytes of a value of all lanes in the frame, a mask as wide as doubles."""
        size = self.step.width * (8 if dtype == np.bool_ else dtype.itemsize)
        return -(-size // self.register) * self.register

    def parts(self, number: int) -> list[Part]:
        return [Part(number, k) for k in range(self.step.parts(number))]

    def lanes(self, number: int) -> int:
        """Of one part of a value."""
        return self.step.width // self.step.parts(number)

    def first(self, value: Part) -> int:
        """Where a part begins, in bytes from where its value does."""
        dtype = self.graph.dtype(value.number)
        size = 8 if dtype == np.bool_ else dtype.itemsize
        return value.place * self.lanes(value.number) * size

    @contextlib.contextmanager
    def on(self, lanes: int) -> Iterator[None]:
        """Vectors have so many lanes."""
        self.out.width, before = lanes, self.out.width
        yield
        self.out.width = before

    def put(self, value: str, place: str, dtype: np.dtype) -> None:
        """Into the frame, where a mask is as wide as doubles, or as many bits for each
        register of doubles where masks have registers of their own."""
        if dtype != np.bool_:
            return self.out.store(value, place, dtype)
        kind, wide = self.out.type(dtype, True), self.out.type(np.int64, True)
        if self.register < 64:
            value, kind = self.out.define(f"sext {kind} {value} to {wide}"), wide
            return self.out.line(
                f"store {kind} {value}, ptr {place}, align {self.register}"
            )
        for k, (lanes, pointer) in enumerate(self._masks(place)):
            part = self.out.cut(value, k * lanes, lanes, dtype)
            self.out.line(
                f"store <{lanes} x i1> {part}, ptr {pointer}, align {self.register}"
            )
        return None

    def got(self, place: str, dtype: np.dtype) -> str:
        """From the frame."""
        if dtype != np.bool_:
            return self.out.load(place, dtype, True)
        if self.register < 64:
            kind = self.out.type(np.int64, True)
            found = self.out.define(f"load {kind}, ptr {place}, align {self.register}")
            return self.out.define(f"icmp slt {kind} {found}, zeroinitializer")
        masks = [
            self.out.define(f"load <{lanes} x i1>, ptr {pointer}, align {self.register}")
            for lanes, pointer in self._masks(place)
        ]
        return self.out.joined(masks, dtype)

    def _masks(self, place: str) -> Iterator[tuple[int, str]]:
        """Lanes and places of the bits of a mask."""
        lanes = min(self.out.width, self.register // 8)
        for k in range(self.out.width // lanes):
            offset = k * self.register
            yield lanes, self.out.define(f"getelementptr i8, ptr {place}, i64 {offset}")

    def at(self, offset: int, base: str = "0", turn: bool = False) -> str:
        """A pointer into the frame, for what is read many times one that takes turns."""
        self.turns += turn
        pointer = f"%frame{self.turns % POINTERS if turn else 0}"
        if base != "0":
            pointer = self.out.define(f"getelementptr i8, ptr {pointer}, i64 {base}")
        return self.out.define(f"getelementptr i8, ptr {pointer}, i64 {offset}")

    def home(self, i: int, base: str) -> tuple[int, str]:
        """Where the i-th entry of the carry is, that of `%now` or of `%next`: its offset
        and what to add to it."""
        offset, two = self.carry_places[i]
        return offset, base if two else "0"

    def made(self, i: int, way: int) -> tuple[int, str] | None:
        """Where a way puts the next i-th entry of the carry: none where it is there."""
        if i in self._still[way]:
            return None
        aside = self._asides[way].get(i)
        return self.home(i, "%next") if aside is None else (aside, "0")

    def settle(self, way: int) -> None:
        """Moves what a way has made aside."""
        for i, aside in self._asides[way].items():
            value = self.got(self.at(aside), self.carried[i])
            self.put(value, self.at(*self.home(i, "%next")), self.carried[i])
