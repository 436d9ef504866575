"""The groups of a kernel: which arrays of the frame their loops read and write, when these
are filled, and the calls."""

from collections.abc import Callable, Iterable, Sequence

import numpy as np

from ..._ir.node import LOOPED
from .._backend.grouping import Group, phases
from .functions import several
from .layout import Layout
from .loops import Array, copied, entrywise, rows
from .writer import Writer

# Inputs that a loop copies into an array, at least.
COPIED = 16
# Stores in a basic block: LLVM compares each with all others of it.
BLOCK = 64

Entries = tuple[int, ...]


class Groups:
    """Arrays by their entries, and the loops, each a function of LLVM.

    An entry that does not change over time is filled in once, by `fill`: before all lanes,
    or for each block of them. `operand` gives the names of nodes, as vectors or not."""

    def __init__(self, layout: Layout, operand: Callable[[int, bool], str]) -> None:
        self.layout, self.out, self.operand = layout, layout.out, operand
        self.graph, self.varies = layout.graph, layout.varies
        self.definitions: list[str] = []
        self.block = ""  # the last one that a filling has begun
        self.results: dict[int, Array] = {}
        self.slots = {slot: k for k, slot in enumerate(layout.loop.slots)}
        self.there: set[tuple[Array, int]] = set()  # entries that this pass has put
        self._arrays: dict[tuple[Entries, bool], Array] = {}
        self._filled: set[tuple[Entries, bool]] = set()
        self._functions: dict[tuple[str, ...], str] = {}
        body, loop = layout.body, layout.loop
        finish = body.moving(self.graph.reachable(list(loop.final)))
        self.moving = [*body.groups]
        for numbers in (body.scalars, body.record, finish):
            self.moving += self._groups(numbers)
        self._hosts: dict[int, list[tuple[Group, Entries, int]]] = {}
        for group in self.moving:
            for each in self.arrays(group):
                for k, number in enumerate(each):
                    self._hosts.setdefault(number, []).append((group, each, k))
        self.single = self._single(
            [*self.moving, *self._groups(n for n, v in self.varies.items() if not v[0])]
        )

    def _groups(self, numbers: Iterable[int]) -> list[Group]:
        return [g for p in phases(self.graph.nodes, numbers, self.varies) for g in p.groups]

    def _single(self, groups: list[Group]) -> set[int]:
        """What is needed elsewhere than in arrays that loops fill."""
        loop, nodes = self.layout.loop, self.graph.nodes
        found = {*loop.begin, *loop.carry, *loop.record, *loop.first, *loop.final}
        for number in self.varies:
            if nodes[number].op not in LOOPED:
                found.update(nodes[number].args)
        for group in groups:
            # Rows of an adaptive loop may have them in groups of other members.
            apart = loop.adaptive is not None and nodes[group.members[0]].op != "dot"
            for array in self.arrays(group):
                if apart or self._kind(array) not in ("lane", "shared"):
                    found.update(array)
        return found

    # -- arrays --------------------------------------------------------------------------

    def _kind(self, array: Entries) -> str:
        """Of the inputs that an array has, if a loop is to fill it."""
        kinds = {
            node.data[0] if node.op == "input" else node.op
            for node in (self.graph.nodes[n] for n in array)
        }
        return kinds.pop() if len(kinds) == 1 and len(array) >= COPIED else ""

    def _wide(self, group: Group, array: Entries) -> bool:
        if self.graph.nodes[group.members[0]].op in ("call", "part"):
            return self.varies[group.members[0]][1]
        return any(self.varies[n][1] for n in array)

    def arrays(self, group: Group) -> list[Entries]:
        """Those that a group reads; of a number that is an argument of all of its calls,
        one entry."""
        given = group.arrays(self.graph)
        if self.graph.nodes[group.members[0]].op != "call":
            return given
        return [each[:1] if len(set(each)) == 1 else each for each in given]

    def array(self, group: Group, array: Entries) -> tuple[Array, bool]:
        """One that a group reads, and whether something else fills it: what has made its
        entries, or it is a table of constants."""
        dtype, wide = self.graph.dtype(array[0]), self._wide(group, array)
        stride = self.layout.size(dtype) if wide else dtype.itemsize
        made = [self.results.get(n) for n in array]
        if made[0] is not None and made[0].wide == wide:
            first = made[0].base
            assert isinstance(first, int), "results are in the frame"
            if all(
                a is not None and a.base == first + k * stride for k, a in enumerate(made)
            ):
                return made[0], True
        if not wide and self._kind(array) == "const":
            values = np.array([self.graph.value(n) for n in array], dtype)
            return Array(self.out.table(values), stride, False), True
        key = array, wide
        if key not in self._arrays:
            offset = self.layout.frame.place(key, len(array) * stride)
            self._arrays[key] = Array(offset, stride, wide)
        return self._arrays[key], False

    def reserve(self, group: Group) -> None:
        """Places for what a group makes: in an array of another one that reads it, or of
        its own."""
        number = group.members[0]
        dtype, wide = self.graph.dtype(number), self.varies[number][1]
        stride = self.layout.size(dtype) if wide else dtype.itemsize
        offset = self._within(group.members, wide, stride)
        if offset is None:
            offset = self.layout.frame.place(group, len(group.members) * stride)
        for k, number in enumerate(group.members):
            self.results[number] = Array(offset + k * stride, stride, wide)

    def _within(self, members: Entries, wide: bool, stride: int) -> int | None:
        """Where an array has them beside each other, and more."""
        for reader, each, first in self._hosts.get(members[0], ()):
            within = each[first : first + len(members)] == members
            if within and len(each) > len(members) and self._wide(reader, each) == wide:
                key = each, wide
                if key not in self._arrays:
                    offset = self.layout.frame.place(key, len(each) * stride)
                    self._arrays[key] = Array(offset, stride, wide)
                base = self._arrays[key].base
                assert isinstance(base, int)
                return base + first * stride
        return None

    def _made(self, number: int, array: Array, k: int) -> bool:
        """Whether a group makes a number as the k-th entry of an array."""
        made = self.results.get(number)
        if made is None or made.wide != array.wide:
            return False
        assert isinstance(array.base, int)
        return made.base == array.base + k * array.stride

    def own(self, group: Group) -> Iterable[tuple[Entries, Array]]:
        """The arrays that are filled for a group."""
        for each in self.arrays(group):
            array, known = self.array(group, each)
            if not known:
                yield each, array

    def fill(self, wide: bool) -> None:
        """What does not change over time, of the arrays of later groups."""
        for group in self.moving:
            for each in self.arrays(group):
                fixed = any(not self.varies[n][0] for n in each)
                if fixed and self._wide(group, each) == wide:
                    array, known = self.array(group, each)
                    if not known:
                        self._fill_fixed(each, array)

    def _fill_fixed(self, each: Entries, array: Array) -> None:
        key = each, array.wide
        if key in self._filled:
            return
        self._filled.add(key)
        if self._kind(each) == ("lane" if array.wide else "shared"):
            self._copy(each, array)
            return
        for k, number in enumerate(each):
            if not self.varies[number][0] and not self._made(number, array, k):
                self.put(number, array, k)
            if k % BLOCK == BLOCK - 1:
                self.block = self.out.next_block()

    def put(self, number: int, array: Array, k: int) -> None:
        dtype, place = self.graph.dtype(number), self.place(array, k)
        value = self.operand(number, array.wide)
        if array.wide:
            self.layout.put(value, place, dtype)
        else:
            kind = self.out.type(dtype, False)
            self.out.line(f"store {kind} {value}, ptr {place}, align {dtype.itemsize}")

    def place(self, array: Array, k: int = 0, offset: int = 0) -> str:
        """A pointer to so many bytes behind where the k-th entry of an array begins."""
        if isinstance(array.base, str):
            return array.base
        return self.layout.at(array.base + k * array.stride + offset)

    def home(self, number: int) -> int:
        """Where a vector of a step that its record needs is in the frame."""
        if number in self.results:
            base = self.results[number].base
            assert isinstance(base, int), "results are in the frame"
            return base
        return self.layout.frame.place(number, self.layout.size(self.graph.dtype(number)))

    def forget(self) -> None:
        """The results of a step are not those of what comes after the last one."""
        fixed = {n: a for n, a in self.results.items() if not self.varies[n][0]}
        self.results, self.there = fixed, set()

    # -- loops ---------------------------------------------------------------------------

    def compute(self, group: Group) -> None:
        """Emits a group where all of its arguments have names."""
        for each, array in self.own(group):
            if not self.varies[group.members[0]][0]:
                self._fill_fixed(each, array)
            # Rows of an adaptive loop are computed in pieces, whose groups may be others
            # than those of all, which `fill` knows.
            filled = (each, array.wide) in self._filled
            for k, number in enumerate(each):
                fixed = not self.varies[number][0]
                if not (fixed and filled) and self._missing(number, array, k):
                    self.put(number, array, k)
        self.reserve(group)
        self.call(group)

    def _missing(self, number: int, array: Array, k: int) -> bool:
        """Whether an entry of an array is still to be put there, now."""
        if (array, k) in self.there or self._made(number, array, k):
            return False
        self.there.add((array, k))
        return True

    def load(self, number: int) -> str:
        """A name for what a group has made."""
        array = self.results[number]
        return self.out.load(self.place(array), self.graph.dtype(number), array.wide)

    def call(self, group: Group) -> None:
        """The loop, once its arrays are there."""
        number = group.members[0]
        node, result = self.graph.nodes[number], self.results[number]
        given = self.arrays(group)
        arrays = [self.array(group, each)[0] for each in given]
        if node.op == "dot":
            out = self._writer(self.layout.step.width)
            count, inner = len(group.members), len(node.args) // 2
            rows(out, count, inner, node.dtype, arrays, result.stride)
        elif node.op == "part":
            out = self._writer(self.layout.step.width)
            members = [self.graph.nodes[n].data[1] for n in group.members]
            types = [self.graph.dtype(a[0]).name for a in group.arrays(self.graph)]
            several(out, node.data[0], members, arrays, types, result.stride)
        else:
            self._entrywise(group, given, arrays)
            return
        self._call(out, [self.place(a) for a in arrays], self.place(result))

    def _entrywise(
        self, group: Group, given: Sequence[Entries], arrays: Sequence[Array]
    ) -> None:
        """Of arrays in the frame their distances from the result: a pointer for each would
        take more registers than there are."""
        number = group.members[0]
        result, count = self.results[number], len(group.members)
        base = result.base
        assert isinstance(base, int), "results are in the frame"
        uniform = [len(each) < count for each in given]
        many = self.layout.step.parts(number) if result.wide and not any(uniform) else 1
        out = self._writer(self.layout.step.width // many)
        tables = [a for a in arrays if isinstance(a.base, str)]
        offsets = [
            f"%a{tables.index(a)}" if isinstance(a.base, str) else a.base - base
            for a in arrays
        ]
        function, step = self.graph.nodes[number].data, result.stride // many
        entrywise(out, function, count * many, offsets, uniform, step, result.wide)
        self._call(out, [self.place(a) for a in tables], self.place(result))

    def _copy(self, each: Entries, array: Array) -> None:
        out, dtype = self._writer(self.layout.step.width), self.graph.dtype(each[0])
        slots = [self.slots[self.graph.nodes[n].data] for n in each]
        copied(out, slots, dtype, array.stride, array.wide)
        lane = "%lane" if array.wide else "0"
        self._call(out, ["%table"], self.place(array), f", i64 {lane}")

    def _writer(self, width: int) -> Writer:
        """Of a function, which has tables and declarations in common with the kernel."""
        out = Writer(width)
        out.tables, out.declarations = self.out.tables, self.out.declarations
        return out

    def _call(self, out: Writer, arrays: list[str], to: str, extra: str = "") -> None:
        key = tuple(out.lines)
        parameters = "".join(f", ptr noalias %a{k}" for k in range(len(arrays)))
        parameters += ", i64 %lane" if extra else ""
        if key not in self._functions:
            name = self._functions[key] = f"@loop{len(self._functions)}"
            head = f"define internal void {name}(ptr noalias %to{parameters}) #0 {{"
            self.definitions += [head, "entry:", *out.lines, "}"]
        given = "".join(f", ptr {a}" for a in arrays)
        self.out.line(f"call void {self._functions[key]}(ptr {to}{given}{extra})")

    # -- within a step -------------------------------------------------------------------

    def stored(self, made: set[int]) -> dict[int, list[int]]:
        """Places in arrays for what a step makes, once the results have theirs."""
        found: dict[int, list[int]] = {}
        for group in self.layout.body.groups:
            for each, array in self.own(group):
                for k, number in enumerate(each):
                    if number in made and not self._made(number, array, k):
                        assert isinstance(array.base, int)
                        self.there.add((array, k))
                        found.setdefault(number, []).append(array.base + k * array.stride)
        return {n: list(dict.fromkeys(places)) for n, places in found.items()}

    def given(self, group: Group, made: set[int]) -> Iterable[tuple[int, Array, int]]:
        """What changes over time and a step does not make, of the arrays of a group."""
        for each, array in self.own(group):
            for k, number in enumerate(each):
                moving = self.varies[number][0] and number not in made
                if moving and self._missing(number, array, k):
                    yield number, array, k
