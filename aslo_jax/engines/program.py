"""A loop over time, traced, compiled, and run over lanes by a pool of threads."""

import ctypes
import functools
import itertools
import threading
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import PyTree

from .emit import emit
from .flatten import flatten
from .graph import Graph
from .host import available_threads, compiled, register, run_in_threads
from .loop import Loop
from .reduce import reduced
from .step import Body, Step, chosen
from .timetable import timetable

KINDS = ("shared", "lane", "log", "lane log")
# Of several threads one rewrites and compiles, and the others wait.
_COMPILING = threading.RLock()


class Bodies(NamedTuple):
    """What a loop does, as functions of trees of arrays:

    - `begin(inputs) -> (carry, first)`;
    - `advance(k, carry, inputs) -> (carry, record)`, for each step k;
    - `finish(carry, inputs) -> final`.

    `inputs` are trees by kind: `shared` by all lanes, one for each `lane`, one for each
    step (`log`), or for both (`lane log`); only `advance` has the logs. `first` is a record
    of what is before the first step, or None.
    """

    begin: Callable[[dict[str, PyTree]], tuple[PyTree, PyTree]]
    advance: Callable[[Any, PyTree, dict[str, PyTree]], tuple[PyTree, PyTree]]
    finish: Callable[[PyTree, dict[str, PyTree]], PyTree]


class Traced(NamedTuple):
    """The bodies as closed jaxprs, and the trees of shapes of what they return."""

    begin: Any
    advance: Any
    finish: Any
    carry: PyTree
    first: PyTree
    record: PyTree
    final: PyTree


def trace(bodies: Bodies, inputs: dict[str, PyTree]) -> Traced:
    """The bodies, traced for inputs of the given shapes, those of one lane and one step."""
    make = functools.partial(jax.make_jaxpr, return_shape=True)
    fixed = constant_in_time(inputs)
    begin, (carry, first) = make(bodies.begin)(fixed)
    advance, (after, record) = make(bodies.advance)(_step(), carry, inputs)
    finish, final = make(bodies.finish)(carry, fixed)
    if _shapes(after) != _shapes(carry):
        raise ValueError(
            "The carry of a loop must keep its shapes and types, but a step makes "
            f"{_shapes(after)} of {_shapes(carry)}."
        )
    return Traced(begin, advance, finish, carry, first, record, final)


def constant_in_time(inputs: dict[str, PyTree]) -> dict[str, PyTree]:
    return {kind: tree for kind, tree in inputs.items() if kind in ("shared", "lane")}


class Inputs:
    """A graph of inputs only, and the nodes of each of their leaves."""

    def __init__(self, carry: PyTree, inputs: dict[str, PyTree]):
        self.graph = Graph()
        step = self.graph.input(np.int64, ("step", 0))
        self.step = np.asarray(self.graph.convert(step, _step().dtype))
        self.carry = _numbered(self.graph, "carry", carry)
        # In the order of `jax.tree.leaves` of the dictionary.
        self.by_kind = {k: _numbered(self.graph, k, inputs[k]) for k in sorted(inputs)}

    @property
    def all(self) -> list[np.ndarray]:
        return [n for numbers in self.by_kind.values() for n in numbers]

    @property
    def fixed(self) -> list[np.ndarray]:
        return [n for numbers in constant_in_time(self.by_kind).values() for n in numbers]


def _step() -> jax.ShapeDtypeStruct:
    wide = jax.config.jax_enable_x64  # pyright: ignore[reportAttributeAccessIssue]
    return jax.ShapeDtypeStruct((), np.dtype(np.int64 if wide else np.int32))


class Program:
    """A loop, compiled when it is first called: `record` and `final` are trees of shapes
    and types of what the nodes of the loop mean.

    It can be sent to other processes, which compile it for themselves."""

    def __init__(self, loop: Loop, record: PyTree, final: PyTree, widths: Sequence[int]):
        self.raw = loop
        self.record, self.final = record, final
        self.widths = widths

    def __getstate__(self) -> dict[str, Any]:
        """Without machine code, and what is quickly made again."""
        return {
            k: v for k, v in vars(self).items() if k not in ("_parts", "_step", "_kernels")
        }

    @functools.cached_property
    def _parts(self) -> tuple[Loop, Loop | None]:
        with _COMPILING:
            return timetable(reduced(self.raw))

    @functools.cached_property
    def _kernels(self) -> tuple[Callable[..., None], Callable[..., None] | None]:
        _, table = self._parts
        function = compiled(emit(self._step))
        if table is None:
            return function, None
        return function, compiled(emit(Step(Body(table), self.width, register())))

    @functools.cached_property
    def _step(self) -> Step:
        return chosen(self.loop, self.widths, register())

    @property
    def width(self) -> int:
        """How many lanes the kernel advances at a time."""
        return self._step.width

    @property
    def loop(self) -> Loop:
        return self._parts[0]

    @property
    def table(self) -> Loop | None:
        return self._parts[1]

    @classmethod
    def of(
        cls, bodies: Bodies, inputs: dict[str, PyTree], widths: Sequence[int]
    ) -> "Program":
        """Of functions, traced for inputs of the given shapes."""
        traced = trace(bodies, inputs)
        given = Inputs(traced.carry, inputs)
        graph, size = given.graph, len(given.carry)
        begin = flatten(graph, traced.begin, given.fixed)
        arguments = [given.step, *given.carry, *given.all]
        advance = flatten(graph, traced.advance, arguments)
        finish = flatten(graph, traced.finish, [*given.carry, *given.fixed])
        parts = begin[:size], advance[:size], advance[size:], begin[size:], finish
        loop = Loop(graph, *map(flat, parts))
        return cls(loop, traced.record, traced.final, widths)

    @property
    def operations(self) -> int:
        """How many operations one step of one lane takes, a product with a sum counted as
        two; what a step shares with all others or all lanes is not counted."""
        nodes, total = self.loop.graph.nodes, 0
        varies: dict[int, tuple[bool, bool]] = {}
        for number in self.loop.of_a_step():
            node = nodes[number]
            varies[number] = node.varies([varies[a] for a in node.args])
            if node.op not in ("const", "input") and all(varies[number]):
                total += 2 if node.op == "fma" else 1
        return total

    def __call__(
        self,
        inputs: dict[str, PyTree],
        lanes: int,
        steps: int,
        *,
        every: int = 1,
        threads: int | None = None,
    ) -> tuple[PyTree, PyTree]:
        """The records and what is final, NumPy arrays with a leading axis of `lanes`;
        records have a second one of `steps // every`, and one more for the first."""
        with _COMPILING:
            function, tabulate = self._kernels
        padded = -(-lanes // self.width) * self.width
        columns: dict[Any, np.ndarray] = {}
        for kind, tree in inputs.items():
            made = _COLUMNS[kind](tree, padded)
            columns |= {(kind, i): c for i, c in enumerate(made)}
        columns |= self._times(tabulate, columns, steps)
        rows = steps // every + (1 if self.loop.first else 0)
        dtype = lambda number: _stored(self.loop.graph.dtype(number))
        record = [np.empty((rows, padded), dtype(n)) for n in self.loop.record]
        final = [np.empty(padded, dtype(n)) for n in self.loop.final]
        columns |= {("record", i): c for i, c in enumerate(record)}
        columns |= {("final", i): c for i, c in enumerate(final)}
        table = _pointers(self.loop, columns)
        address = ctypes.addressof(table)

        def work(span: tuple[int, int]) -> None:
            function(*span, padded, steps, every, address)

        threads = available_threads() if threads is None else threads
        run_in_threads(work, _spans(padded, self.width, threads), threads)
        return _gathered(record, self.record, lanes), _gathered(final, self.final, lanes)

    def _times(
        self,
        tabulate: Callable[..., None] | None,
        columns: dict[Any, np.ndarray],
        steps: int,
    ) -> dict[Any, np.ndarray]:
        """The columns of the timetable."""
        table = self.table
        if table is None or tabulate is None:
            return {}
        padded = -(-steps // self.width) * self.width
        found = [np.empty(padded, _stored(table.graph.dtype(n))) for n in table.final]
        given = columns | {("lane", 0): np.arange(padded)}
        given |= {("final", i): c for i, c in enumerate(found)}
        pointers = _pointers(table, given)
        tabulate(0, padded, padded, 0, 1, ctypes.addressof(pointers))
        return {("time", i): c for i, c in enumerate(found)}


def _pointers(loop: Loop, columns: dict[Any, np.ndarray]) -> ctypes.Array:
    """The table that a kernel takes."""
    slots = loop.slots
    addresses = (columns[slot].ctypes.data for slot in slots)
    return (ctypes.c_void_p * max(len(slots), 1))(*addresses)


def _shapes(tree: PyTree) -> list[tuple[tuple[int, ...], np.dtype]]:
    return [(leaf.shape, np.dtype(leaf.dtype)) for leaf in jax.tree.leaves(tree)]


def _numbered(graph: Graph, kind: str, tree: PyTree) -> list[np.ndarray]:
    """An array of input nodes for each leaf; their slots count through the tree."""
    count, found = 0, []
    for shape, dtype in _shapes(tree):
        numbers = np.empty(shape, np.int64)
        for index in np.ndindex(shape):
            numbers[index] = graph.input(dtype, (kind, count))
            count += 1
        found.append(numbers)
    return found


def flat(arrays: list[np.ndarray]) -> tuple[int, ...]:
    return tuple(int(n) for array in arrays for n in array.flat)


def _stored(dtype: np.dtype) -> np.dtype:
    return np.dtype(np.uint8) if dtype == np.bool_ else dtype


def _columns(tree: PyTree, padded: int) -> list[np.ndarray]:
    """Every entry of every leaf as a contiguous array over the lanes, the last lane
    repeated up to `padded`."""
    found = []
    for leaf in jax.tree.leaves(tree):
        leaf = np.asarray(leaf)
        flat = leaf.reshape(len(leaf), -1).astype(_stored(leaf.dtype), copy=False)
        wide = np.empty((flat.shape[1], padded), flat.dtype)
        wide[:, : len(flat)] = flat.T
        wide[:, len(flat) :] = flat[-1:].T
        found += list(wide)
    return found


def _shared(tree: PyTree, padded: int) -> list[np.ndarray]:
    return [
        np.array([x], _stored(np.asarray(leaf).dtype))
        for leaf in jax.tree.leaves(tree)
        for x in np.asarray(leaf).reshape(-1)
    ]


def _logs(tree: PyTree, padded: int) -> list[np.ndarray]:
    found = []
    for leaf in jax.tree.leaves(tree):
        leaf = np.asarray(leaf)
        rows = leaf.reshape(len(leaf), -1).astype(_stored(leaf.dtype), copy=False)
        found += [np.ascontiguousarray(rows[:, k]) for k in range(rows.shape[1])]
    return found


def _lane_logs(tree: PyTree, padded: int) -> list[np.ndarray]:
    """Of leaves with axes of lanes and of steps: rows of steps, columns of lanes."""
    found = []
    for leaf in jax.tree.leaves(tree):
        leaf = np.asarray(leaf)
        rows = leaf.reshape(*leaf.shape[:2], -1).astype(_stored(leaf.dtype), copy=False)
        for k in range(rows.shape[2]):
            wide = np.empty((leaf.shape[1], padded), rows.dtype)
            wide[:, : len(leaf)] = rows[:, :, k].T
            wide[:, len(leaf) :] = rows[-1:, :, k].T
            found.append(wide)
    return found


_COLUMNS = {"shared": _shared, "lane": _columns, "log": _logs, "lane log": _lane_logs}


def _gathered(columns: list[np.ndarray], tree: PyTree, lanes: int) -> PyTree:
    """A tree whose leaves have the axis of lanes first, then that of rows where there is
    one, from a column for each of their entries."""
    leaves, structure = jax.tree.flatten(tree)
    found, first = [], 0
    for s in leaves:
        size = int(np.prod(s.shape, dtype=int))
        group = columns[first : first + size]
        first += size
        lead = (lanes, *columns[0].shape[:-1]) if columns else (lanes,)
        leaf = np.empty((*lead, size), s.dtype)
        for k, column in enumerate(group):
            leaf[..., k] = column[..., :lanes].T
        found.append(leaf.reshape(*lead, *s.shape))
    return jax.tree.unflatten(structure, found)


def _spans(padded: int, width: int, threads: int) -> list[tuple[int, int]]:
    """Some pieces for each thread, so that none waits long for another."""
    blocks = padded // width
    pieces = min(blocks, 8 * threads if threads > 1 else 1)
    edges = [blocks * k // pieces * width for k in range(pieces + 1)]
    return [(a, b) for a, b in itertools.pairwise(edges) if b > a]
