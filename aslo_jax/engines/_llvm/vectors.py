"""The vectors that a step makes, by its plan: which wait in registers, which in memory."""

from collections.abc import Sequence

from ..._ir.node import LOOPED
from ..._ir.selection import Instruction
from .._backend.grouping import Group
from .._backend.splitting import Part
from .._backend.step import Way
from .values import Values
from .writer import PARTIAL


class Vectors:
    """Of one way of a step, by its number, as parts in registers. `leaving`: where those
    are in the frame that its record needs."""

    def __init__(self, values: Values, which: int) -> None:
        self.layout, self.out, self.graph = values.layout, values.out, values.graph
        self.values, self.which = values, which
        self.way: Way = self.layout.step.ways[which]
        self.made = self.way.made
        self.parts: dict[Part, str] = {}
        self.spreads: dict[tuple[int, int], str] = {}
        self.leaving: dict[int, tuple[int, str]] = {}

    def make(self) -> None:
        """Emits them, and the next carry."""
        way, leaving = self.way, self.way.body.leaving
        carry: dict[int, list[int]] = {}
        for i, number in enumerate(way.body.loop.carry):
            carry.setdefault(number, []).append(i)
        places = {n: self.layout.made(i, self.which) for n, (i, *_) in carry.items()}
        whole = {n: place for n, place in places.items() if place is not None}
        for n in leaving - carry.keys():
            whole[n] = self.values.groups.home(n), "0"
        self.values.groups.there = set()
        listed = self.values.groups.stored(self.made)
        home = {
            v: (offset + self.layout.first(v), base)
            for n, (offset, base) in (
                {n: (places[0], "0") for n, places in listed.items()} | whole
            ).items()
            for v in self.layout.parts(n)
        }
        for event in way.events:
            value = event.value
            if event.instruction is not None and event.instruction.op == "group":
                self._loop(self.layout.body.groups[value.place])
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
        self.layout.settle(self.which)
        self.leaving = {n: whole[n] for n in leaving}

    def _loop(self, group: Group) -> None:
        """A group of a step, whose registers are free."""
        for number, array, k in self.values.groups.given(group, self.made):
            if not array.wide:
                self.values.groups.put(number, array, k)
                continue
            with self.layout.on(self.layout.lanes(number)):
                for value in self.layout.parts(number):
                    place = self.values.groups.place(array, k, self.layout.first(value))
                    self.layout.put(self._lasting(value), place, self.graph.dtype(number))
        self.values.groups.call(group)

    def _keep_part(self, i: int, value: Part, name: str) -> None:
        made = self.layout.made(i, self.which)
        if made is None:
            return
        offset, base = made
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
            if not self.values.differs(first.number):
                many = 1
            literal = partial and position + many == len(args)
            x.append(self._operand(args[position : position + many], instruction, literal))
            nodes.append(first.number)
            position += many
        return self.values.result(number, op, tuple(nodes), x, True)

    def _operand(
        self, parts: Sequence[Part], instruction: Instruction[Part], literal: bool
    ) -> str:
        """Of an instruction, an argument in some parts; a constant as a `literal`."""
        number, lanes = parts[0].number, self.out.width
        alike = number not in self.made and not self.values.differs(number)
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
        if self.values.differs(value.number):
            return self._given(value)
        return self._alike(value.number)

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
            place = self.out.offset(self.values.pointers[node.data], node.dtype, "%k")
            return self.out.splat(self.out.load(place, node.dtype, False), node.dtype)
        if key not in self.spreads:
            self.spreads[key] = self.out.splat(self.values.scalars[number], node.dtype)
        return self.spreads[key]

    def _given(self, value: Part) -> str:
        """A part of what a step does not make, and what is another for each lane."""
        number, node = value.number, self.graph.nodes[value.number]
        if node.op in LOOPED and self.values.varies[number][0]:
            place = self.layout.at(
                self.values.groups.home(number) + self.layout.first(value), turn=True
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
        row = self.values.place_of("%k", self.values.pointers[node.data], node.dtype)
        return self.out.load(
            self.out.offset(row, node.dtype, str(value.place * self.out.width)),
            node.dtype,
            True,
        )
