"""The statements of a function that computes nodes of a graph."""

import collections
import re
from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple

import numpy as np

from ..._ir.graph import Function, Graph
from ..._ir.node import LOOPED, Node
from .._backend.grouping import Group, phases
from .places import Place, Run, Value, filled, runs
from .scalars import bare, expression
from .types import c_type
from .unit import Unit

NAME = r"[A-Za-z_]\w*(->\w+)?"
ATOM = re.compile(rf"\d[\d.]*(e[-+]?\d+)?f?|{NAME}(\[[^]]*\])?")
CALL = re.compile(r"[A-Za-z_]\w*\(")
LONGEST = 72  # characters of an expression within another one
SAME = collections.defaultdict(lambda: (False, False))


class Target(NamedTuple):
    """Where to put the nodes `numbers`: the entries of an array, or one name."""

    name: str
    numbers: tuple[int, ...]
    is_array: bool


class Body:
    """Statements that compute `roots` of a graph.

    - `given`: where the input of a slot is;
    - `kept`: nodes that must have names of their own, since what they are made of is
      overwritten before they are used.

    `lines` are the statements, `declarations` those that must come first; `automatic` the
    bytes of what they declare.
    """

    def __init__(
        self,
        unit: Unit,
        graph: Graph,
        roots: Iterable[int],
        given: Callable[[tuple[str, int]], Value],
        kept: Iterable[int] = (),
    ) -> None:
        self.unit, self.graph, self.given = unit, graph, given
        self.kept, self.lines, self.automatic = set(kept), list[str](), 0
        self._roots = list(roots)
        self._values: dict[int, Value] = {}
        self._arrays: dict[tuple[int, ...], str] = {}
        self._count = 0
        self._compute()

    @property
    def declarations(self) -> list[str]:
        """Of the counters of its loops."""
        text = "\n".join(self.lines)
        return [f"size_t {k};" for k in ("i", "j") if f"for ({k} = " in text]

    # -- values --------------------------------------------------------------------------

    def value(self, number: int) -> Value:
        """Where a node is, or an expression for it."""
        if number not in self._values:
            node = self.graph.nodes[number]
            if node.op == "const":
                self._values[number] = self.unit.constant(node.data, node.dtype)
            elif node.op == "input":
                self._values[number] = self.given(node.data)
            else:
                self._values[number] = self._expression(number)
        return self._values[number]

    def text(self, number: int) -> str:
        value = self.value(number)
        return value if isinstance(value, str) else value.text

    def _operand(self, number: int) -> str:
        """In brackets, where it is more than a name or a number."""
        text = self.text(number)
        call = CALL.match(text)
        closed = call is not None and bare(text[call.end() - 1 :]) != text[call.end() - 1 :]
        simple = closed or ATOM.fullmatch(text) or bare(text) != text
        return text if simple else f"({text})"

    def _expression(self, number: int) -> str:
        node = self.graph.nodes[number]
        source = self.graph.dtype(node.args[-1])
        return expression(self.unit, node, source, [self._operand(a) for a in node.args])

    # -- statements ----------------------------------------------------------------------

    def _compute(self) -> None:
        nodes = self.graph.nodes
        order = self.graph.reachable(self._roots)
        made = [n for n in order if nodes[n].op not in ("const", "input")]
        parts = phases(nodes, made, SAME)
        uses = self._uses(made, [g for part in parts for g in part.groups])
        for groups, rest in parts:
            self._products([g for g in groups if nodes[g.members[0]].op == "dot"])
            for group in groups:
                if nodes[group.members[0]].op == "call":
                    self._calls(group)
            for number in rest:
                single = uses[number] == 1 and number not in self.kept
                if not (single and len(self._expression(number)) <= LONGEST):
                    self._name(number)

    def _uses(self, made: list[int], groups: list[Group]) -> collections.Counter[int]:
        uses = collections.Counter(self._roots)
        for number in made:
            if self.graph.nodes[number].op not in LOOPED:
                uses.update(self.graph.nodes[number].args)
        arrays = {array for group in groups for array in group.arrays(self.graph)}
        for array in arrays:
            uses.update(array)
        return uses

    def _name(self, number: int) -> None:
        """Gives a node a name of its own."""
        dtype = self.graph.dtype(number)
        name = self._new("v")
        self.lines.append(
            f"const {c_type(dtype)} {name} = {bare(self._expression(number))};"
        )
        self.automatic += dtype.itemsize
        self._values[number] = name

    def _new(self, kind: str) -> str:
        self._count += 1
        return f"{kind}{self._count}"

    def copied(self, numbers: Sequence[int]) -> None:
        """Gives inputs names of their own, or an array where there are many."""
        if len(numbers) == 1:
            dtype, name = self.graph.dtype(numbers[0]), self._new("v")
            self.lines.append(f"const {c_type(dtype)} {name} = {self.text(numbers[0])};")
            self.automatic += dtype.itemsize
            self._values[numbers[0]] = name
            return
        name = self._array([self.value(n) for n in numbers], self.graph.dtype(numbers[0]))
        for k, number in enumerate(numbers):
            self._values[number] = Place(name, k)

    def put(self, target: Target) -> None:
        """Writes nodes to where they are wanted."""
        if target.is_array:
            self.lines += filled(target.name, [self._bare(n) for n in target.numbers])
        else:
            (number,) = target.numbers
            self.lines.append(f"{target.name} = {bare(self.text(number))};")

    def _bare(self, number: int) -> Value:
        value = self.value(number)
        return bare(value) if isinstance(value, str) else value

    # -- loops ---------------------------------------------------------------------------

    def _declared(self, dtype: np.dtype, size: int) -> str:
        name = self._new("a")
        self.lines.append(f"{c_type(dtype)} {name}[{size}];")
        self.automatic += size * dtype.itemsize
        return name

    def _array(self, values: Sequence[Value], dtype: np.dtype) -> str:
        name = self._declared(dtype, len(values))
        self.lines += filled(name, values)
        return name

    def _pointer(self, numbers: tuple[int, ...]) -> str:
        """The entries one after the other: where they are so, or in an array of their
        own."""
        dtype = self.graph.dtype(numbers[0])
        constants = [self.graph.value(n) for n in numbers]
        if all(c is not None for c in constants):
            return self.unit.table(np.array(constants, dtype))
        values = [self._bare(n) for n in numbers]
        (run, *others) = runs(values)
        if not others and run.is_array and (run.stride == 1 or run.length == 1):
            return f"&{run.array}[{run.first}]" if run.first else run.array
        if numbers not in self._arrays:
            self._arrays[numbers] = self._array(values, dtype)
        return self._arrays[numbers]

    def _products(self, groups: list[Group]) -> None:
        """Groups that have the rows of a matrix in common, each as one product."""
        alike: dict[tuple[int, ...], list[Group]] = {}
        for group in groups:
            alike.setdefault(group.arrays(self.graph)[0], []).append(group)
        for rows, some in alike.items():
            count, dtype = len(some[0].members), self.graph.dtype(some[0].members[0])
            inner = len(rows) // count
            others = tuple(n for g in some for n in g.arrays(self.graph)[1])
            first, second = self._pointer(rows), self._pointer(others)
            name = self._declared(dtype, count * len(some))
            function = self.unit.helper("products", dtype)
            self.lines.append(
                f"{function}({name}, {first}, {second}, {count}U, {len(some)}U, {inner}U);"
            )
            for k, number in enumerate(n for g in some for n in g.members):
                self._values[number] = Place(name, k)

    def _calls(self, group: Group) -> None:
        node = self.graph.nodes[group.members[0]]
        name, count = scalar_function(self.unit, node), len(group.members)
        arguments = [self._argument(array) for array in group.arrays(self.graph)]
        out = self._declared(node.dtype, count)
        self.lines += [
            f"for (i = 0U; i < {count}U; ++i) {{",
            f"    {out}[i] = {name}({', '.join(arguments)});",
            "}",
        ]
        for k, number in enumerate(group.members):
            self._values[number] = Place(out, k)

    def _argument(self, numbers: tuple[int, ...]) -> str:
        """The i-th entry of an array of nodes, within a loop over i."""
        (run, *others) = runs([self._bare(n) for n in numbers])
        if not others:
            return run.entry("i")
        return Run(self._pointer(numbers), 0, 1, len(numbers)).entry("i")


def scalar_function(unit: Unit, node: Node) -> str:
    """The name in C of the function that a node calls."""
    function: Function = node.data
    known = unit.named(function)
    if known is not None:
        return known
    name = f"{unit.prefix}_function{len(unit.functions)}"
    body = Body(unit, function.graph, [function.result], lambda slot: f"x{slot[1]}")
    kind = c_type(node.dtype)
    parameters = ", ".join(f"{kind} x{k}" for k in range(len(node.args)))
    result = f"return {bare(body.text(function.result))};"
    used = set(re.findall(r"\w+", "\n".join([*body.lines, result])))
    unused = [f"(void)x{k};" for k in range(len(node.args)) if f"x{k}" not in used]
    lines = [*body.declarations, *unused, *body.lines, result]
    text = "\n".join([f"static {kind} {name}({parameters})", "{", *_indented(lines), "}"])
    unit.add(function, text, name)
    return name


def _indented(lines: Iterable[str]) -> list[str]:
    return [f"    {line}" for line in lines]
