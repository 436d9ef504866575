"""A loop over time as nodes of a graph."""

import dataclasses
import functools
from collections.abc import Iterable
from typing import NamedTuple

from .graph import Graph

Slot = tuple[str, int]


class Tables(NamedTuple):
    """What makes the inputs `("time", k)` of a loop: those of `beside` first, then those of
    `along`.

    - `beside`: what depends on the time index and on what is shared alone. A loop without
      steps, whose lanes are the steps, given their indices as `("lane", 0)`, and whose
      final values are the columns.
    - `along`: what follows from step to step. A loop whose records are the columns.
    """

    beside: "Loop | None" = None
    along: "Loop | None" = None


NO_TABLES = Tables()


class Adaptive(NamedTuple):
    """What a loop is whose lanes each take steps of their own until all have ended.

    Its record begins with `done`, a boolean of a step: whether the lane has ended. That is
    all unless it saves. Then `due`, whether there is another row to save from this step;
    `written`, whether this row is kept; its number, int64; and `saving` values that go on
    from row to row, as the carry does from step to step. They are inputs ("saving", i),
    beginning with those of `first`. The rest are the columns of the row.

    After a step the rows that are due are saved one after the other; what does not depend
    on what goes on from row to row is computed once, and only if one is due.
    """

    saving: int = 0

    @property
    def head(self) -> int:
        """How many entries of the record are no columns."""
        return 4 + self.saving if self.saving else 1


class Switch(NamedTuple):
    """A boolean node of a step, and what it is where the step takes less."""

    condition: int
    usual: bool


@dataclasses.dataclass(frozen=True)
class Loop:
    """What a kernel computes: nodes of `graph`, whose inputs have the slots

    - `("step", 0)`: the time index, int64;
    - `("shared", i)`, `("lane", i)`: constant in time, one value for all lanes or one each;
    - `("log", i)`, `("lane log", i)`: the same, with one entry for each step;
    - `("time", i)`: a log that is computed beforehand (`timetable`);
    - `("carry", i)`: the i-th value that goes on from step to step.

    `begin` holds the nodes of the first carry, functions of what is constant in time, and
    `carry` those of the next one. `first`, none or as many as `record`, is written before
    the first step, and `record` after every n-th one. `final` is what the last carry
    leaves: functions of it and of what is constant in time. `tables` make the inputs
    `("time", i)`.

    `branches` are boolean nodes of a step that chose between branches in the source.
    `switches` are some of them: where all lanes of a vector are as usual in all of these,
    or in none, a body takes the step that does only what is needed then.

    An `adaptive` loop has no records after every n-th step, but those of its own instants.
    """

    graph: Graph
    begin: tuple[int, ...]
    carry: tuple[int, ...]
    record: tuple[int, ...] = ()
    first: tuple[int, ...] = ()
    final: tuple[int, ...] = ()
    tables: Tables = NO_TABLES
    branches: tuple[int, ...] = ()
    switches: tuple[Switch, ...] = ()
    adaptive: Adaptive | None = None

    @property
    def head(self) -> int:
        """How many entries of the record are not written to a row of their own."""
        return 0 if self.adaptive is None else self.adaptive.head

    @property
    def conditions(self) -> list[int]:
        """Of its switches."""
        return [s.condition for s in self.switches]

    def of_a_step(self) -> list[int]:
        """The nodes of a step, those of its record included, arguments first."""
        return self.graph.reachable([*self.carry, *self.record])

    def needed(self) -> list[int]:
        """All nodes, arguments first."""
        roots = [*self.begin, *self.carry, *self.record, *self.first, *self.final]
        return self.graph.reachable([*roots, *self.conditions])

    def listing(self) -> str:
        """As text for people: a node a line, arguments first, with a dot where no step
        needs it; then what the entries of the carry begin with and become."""
        graph, nodes = self.graph, self.graph.nodes
        moving, lines = set(self.of_a_step()), []
        for number in self.needed():
            node = nodes[number]
            args = [f"%{a}" for a in node.args]
            if node.op == "input":
                args = ["{}[{}]".format(*node.data)]
            elif node.op == "const":
                args = [str(node.data)]
            elif node.op == "table":
                args.append(f"of {len(node.data)}")
            mark = " " if number in moving else "."
            lines.append(f"{mark} %{number} = {node.op} {', '.join(args)} : {node.dtype}")
        for i, (begin, carry) in enumerate(zip(self.begin, self.carry, strict=True)):
            lines.append(f"carry[{i}] : {graph.dtype(carry)} = %{begin}, then %{carry}")
        for kind in ("first", "record", "final"):
            if numbers := getattr(self, kind):
                lines.append(f"{kind} = {', '.join(f'%{n}' for n in numbers)}")
        for number, usual in self.switches:
            lines.append(f"switch %{number}, {usual} as a rule")
        for name, table in zip(self.tables._fields, self.tables, strict=True):
            if table is not None:
                inner = "\n".join("  " + line for line in table.listing().splitlines())
                lines.append(f"table {name}:\n{inner}")
        return "\n".join(lines)

    @functools.cached_property
    def slots(self) -> list[Slot]:
        """The pointers that a kernel takes, in their order: every input but the step and
        the carry, then the records and what is final."""
        nodes = self.graph.nodes
        inputs = {nodes[n].data for n in self.needed() if nodes[n].op == "input"}
        return [
            *sorted(s for s in inputs if s[0] not in ("carry", "saving", "step")),
            *(("record", i) for i in range(len(self.record) - self.head)),
            *(("final", i) for i in range(len(self.final))),
        ]


def varying(graph: Graph, numbers: Iterable[int]) -> dict[int, tuple[bool, bool]]:
    """Whether nodes change over time, and over lanes; arguments come first."""
    found: dict[int, tuple[bool, bool]] = {}
    for number in numbers:
        node = graph.nodes[number]
        found[number] = node.varies([found[a] for a in node.args])
    return found


def uniform(loop: Loop) -> set[int]:
    """The entries of the carry that are the same for all lanes, and that follow from the
    time index and from what is shared alone."""
    graph = loop.graph
    numbers = graph.reachable([*loop.begin, *loop.carry])
    found = set(range(len(loop.carry)))
    while True:
        same: set[int] = set()
        for number in numbers:
            node = graph.nodes[number]
            kind, i = node.data if node.op == "input" else ("shared", 0)
            known = kind in ("step", "shared") or (kind == "carry" and i in found)
            if known and same.issuperset(node.args):
                same.add(number)
        fewer = {i for i in found if {loop.begin[i], loop.carry[i]} <= same}
        if fewer == found:
            return found
        found = fewer
