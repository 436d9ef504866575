"""The values of a kernel that have names: numbers that are the same for all lanes, and
vectors of all lanes of a block."""

from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from ..._ir.loop import Slot
from ..._ir.node import Node
from .._backend.grouping import phases
from .arrays import Groups
from .layout import Layout
from .loops import operation


class Values:
    """By the numbers of their nodes, `scalars` and `vectors`; the `pointers` to inputs and
    results by their slots."""

    def __init__(self, layout: Layout) -> None:
        self.layout, self.out = layout, layout.out
        self.graph, self.varies = layout.graph, layout.varies
        self.pointers: dict[Slot, str] = {}
        self.scalars: dict[int, str] = {}
        self.vectors: dict[int, str] = {}
        self.groups = Groups(layout, self.operand)

    def operand(self, number: int, vector: bool) -> str:
        node = self.graph.nodes[number]
        if node.op == "const":
            return self.out.constant(node.data, node.dtype, vector)
        if not vector:
            return self.scalars[number]
        if number not in self.vectors:
            made = self.groups.results.get(number)
            if made is not None and made.wide:
                self.vectors[number] = self.groups.load(number)
            else:
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
                self.groups.compute(group)
                if not self.varies[group.members[0]][1]:
                    self.scalars |= {n: self.groups.load(n) for n in group.members}
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

    def differs(self, number: int) -> bool:
        """Whether what a step does not make is another for each lane."""
        return self.varies[number][1]

    def read(self, slot: Slot, number: int) -> None:
        """An input that varies over time."""
        (kind, i), dtype = slot, self.graph.dtype(number)
        if kind == "step":
            self.scalars[number] = "%k"
        elif kind in ("log", "time"):
            place = self.out.offset(self.pointers[slot], dtype, "%k")
            self.scalars[number] = self.out.load(place, dtype, False)
        elif kind == "lane log":
            place = self.place_of("%k", self.pointers[slot], dtype)
            self.vectors[number] = self.out.load(place, dtype, True)
        elif kind == "carry":
            place = self.layout.at(*self.layout.home(i, "%now"))
            self.vectors[number] = self.layout.got(place, dtype)

    def place_of(self, row: str, pointer: str, dtype: np.dtype) -> str:
        """Where the lanes of a row are."""
        first = self.out.define(f"mul i64 {row}, %lanes")
        return self.out.offset(pointer, dtype, self.out.define(f"add i64 {first}, %lane"))
