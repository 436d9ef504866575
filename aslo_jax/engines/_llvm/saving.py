"""Rows that lanes save from their steps, each at instants of its own."""

from typing import NamedTuple

import numpy as np

from .values import Values


class Parts(NamedTuple):
    """The nodes of a record by when they are computed: whether a row is `due`, which is
    asked before each, what is `common` to the rows of a step, and the rest, for `each`."""

    due: list[int]
    common: list[int]
    each: list[int]


class Saving:
    """The rows of an adaptive loop: `places` in the frame of what goes on from one to the
    next."""

    def __init__(self, values: Values) -> None:
        self.values, self.layout, self.out = values, values.layout, values.out
        self.graph, self.loop = values.graph, values.layout.loop
        assert self.loop.adaptive is not None
        count, head = self.loop.adaptive.saving, self.loop.head
        self.entries = self.loop.record[head - count : head]
        self.places = [
            self.layout.frame.place(("saving", i), self.layout.size(self.graph.dtype(n)))
            for i, n in enumerate(self.entries)
        ]

    def begin(self) -> None:
        """What goes on, before the first step."""
        head = self.loop.head
        starts = self.loop.first[head - len(self.entries) : head]
        for place, number in zip(self.places, starts, strict=True):
            value, dtype = self.values.operand(number, True), self.graph.dtype(number)
            self.layout.put(value, self.layout.at(place), dtype)

    def ended(self) -> str:
        """Whether all lanes have, after a step whose results are read back."""
        number = self.loop.record[0]
        needed = set(self.graph.reachable([number]))
        self.values.compute([n for n in self.values.layout.body.record if n in needed])
        return self.out.agree(self.values.operand(number, True), True)

    def rows(self) -> None:
        """Saves those that are due after a step whose results are read back, and goes on to
        `advanced`."""
        parts, out, groups = self._parts(), self.out, self.values.groups
        before, there = dict(self.values.vectors), set(groups.there)
        self.read()
        self.values.compute(parts.due)
        self._branch("prelude")
        out.label("prelude")
        self.values.vectors, groups.there = before, there
        self.values.compute(parts.common)
        out.line("br label %rows")
        out.label("rows")
        common, there = dict(self.values.vectors), set(groups.there)
        self.read()
        self.values.compute(parts.due)
        self._branch("row")
        out.label("row")
        self.values.compute(parts.each)
        self._write()
        out.line("br label %rows")
        self.values.vectors, groups.there = common, there

    def _parts(self) -> Parts:
        """Those that change over time and a step does not make."""
        record, own = self.values.layout.body.record, set[int]()
        for number in record:
            node = self.graph.nodes[number]
            saving = node.op == "input" and node.data[0] == "saving"
            if saving or not own.isdisjoint(node.args):
                own.add(number)
        due = set(self.graph.reachable([self.loop.record[1]]))
        common = [n for n in record if n not in own]
        first = [n for n in record if n in due]
        return Parts(
            first,
            [n for n in common if n not in due],
            [n for n in record if n in own and n not in due],
        )

    def read(self) -> None:
        """What goes on from row to row."""
        for i, number in enumerate(self.entries):
            dtype = self.graph.dtype(number)
            given = self.graph.input(dtype, ("saving", i))
            self.values.vectors[given] = self.layout.got(
                self.layout.at(self.places[i]), dtype
            )

    def _branch(self, name: str) -> None:
        due = self.out.agree(self.values.operand(self.loop.record[1], True), False)
        self.out.line(f"br i1 {due}, label %{name}, label %advanced")

    def _write(self) -> None:
        """The columns of lanes whose row is due and kept, and what goes on."""
        record, head, out = self.loop.record, self.loop.head, self.out
        mask, wide = out.type(np.bool_, True), out.type(np.int64, True)
        due, kept, row = (self.values.operand(n, True) for n in record[1:4])
        written = out.define(f"and {mask} {due}, {kept}")
        lanes = out.splat("%lanes", np.int64)
        first = out.splat("%lane", np.int64)
        places = ", ".join(f"i64 {k}" for k in range(out.width))
        place = out.define(f"add {wide} {first}, <{places}>")
        start = out.define(f"mul {wide} {row}, {lanes}")
        place = out.define(f"add {wide} {start}, {place}")
        for i, number in enumerate(record[head:]):
            value, dtype = self.values.operand(number, True), self.graph.dtype(number)
            self._scatter(value, dtype, self.values.pointers["record", i], place, written)
        pairs = zip(self.entries, self.places, strict=True)
        new = [(self.values.operand(n, True), at, self.graph.dtype(n)) for n, at in pairs]
        for k, (value, at, dtype) in enumerate(new):
            given = self.graph.input(dtype, ("saving", k))
            old = self.values.vectors[given]
            kind = out.type(dtype, True)
            value = out.define(f"select {mask} {due}, {kind} {value}, {kind} {old}")
            self.layout.put(value, self.layout.at(at), dtype)

    def _scatter(
        self, value: str, dtype: np.dtype, pointer: str, place: str, mask: str
    ) -> None:
        out, lanes = self.out, self.out.width
        scalar, kind = out.stored(dtype, False), out.stored(dtype, True)
        if dtype == np.bool_:
            value = out.define(f"zext {out.type(dtype, True)} {value} to {kind}")
        wide = out.type(np.int64, True)
        at = out.define(f"getelementptr {scalar}, ptr {pointer}, {wide} {place}")
        name = {"double": "f64", "float": "f32"}.get(scalar, scalar)
        call = f"@llvm.masked.scatter.v{lanes}{name}.v{lanes}p0"
        kinds = f"{kind}, <{lanes} x ptr>, i32, <{lanes} x i1>"
        out.declarations.add(f"declare void {call}({kinds})")
        align = max(dtype.itemsize, 1)
        out.line(
            f"call void {call}({kind} {value}, <{lanes} x ptr> {at}, i32 {align}, "
            f"<{lanes} x i1> {mask})"
        )
