"""A loop over time, traced, compiled, and run over lanes by several threads."""

import contextlib
import functools
import gc
import os
import threading
from collections.abc import Callable, Collection, Iterator, Sequence
from typing import Any, NamedTuple

import jax
import numpy as np

from ..._frontend.lower import NotFusible, check_numbers, flatten
from ..._ir.goal import MACHINE_CODE, Goal
from ..._ir.graph import Graph
from ..._ir.loop import Loop, varying
from ..._typing import PyTree
from .._backend.step import Body, Step, chosen
from .._backend.target import Target
from .._passes import optimised
from .._runtime.columns import COLUMNS, blank, columns_of, gathered, stored
from .._runtime.host import available_threads, target as of_host
from .._runtime.kernel import Kernel

KINDS = ("shared", "lane", "log", "lane log")
# Of several threads one rewrites and compiles, and the others wait.
_COMPILING = threading.RLock()
if hasattr(os, "register_at_fork"):
    # Nor is the process forked meanwhile: the child would wait for a thread it has not.
    os.register_at_fork(
        before=_COMPILING.acquire,
        after_in_parent=_COMPILING.release,
        after_in_child=_COMPILING.release,
    )


@contextlib.contextmanager
def uncollected() -> Iterator[None]:
    """Without Python's search for cycles: tracing and rewriting make millions of objects,
    which it looks through again and again, and hardly a cycle."""
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()


class Bodies(NamedTuple):
    """What a loop does, as functions of trees of arrays:

    - `begin(inputs) -> (carry, first)`;
    - `advance(k, carry, inputs) -> (carry, record)`, for each step k;
    - `finish(carry, inputs) -> final`.

    `inputs` are trees by kind: `shared` by all lanes, one for each `lane`, one for each
    step (`log`), or for both (`lane log`); only `advance` has the logs. `first` is a record
    of what is before the first step, or None.

    What `begin` returns besides is for all steps: a further argument of `advance`.
    """

    begin: Callable[[dict[str, PyTree]], tuple[PyTree, ...]]
    advance: Callable[..., tuple[PyTree, PyTree]]
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
    check_numbers(inputs, "the samples or the logs have")
    begin, (carry, first, *kept) = make(bodies.begin)(fixed)
    check_numbers(carry, "the state of the loop has")
    advance, (after, record) = make(bodies.advance)(_step(), carry, inputs, *kept)
    finish, final = make(bodies.finish)(carry, fixed)
    check_numbers((first, record, final), "a result has")
    check_numbers(after, "the state of the loop has after a step")
    if _shapes(after) != _shapes(carry):
        raise NotFusible(
            "The fused engine needs a state that keeps its shapes and types, but a step "
            f'makes {_named(after)} of {_named(carry)}. Use engine="scan", or begin with '
            "the former."
        )
    if first is not None:
        _check_records(first, record)
    return Traced(begin, advance, finish, carry, first, record, final)


def _check_records(first: PyTree, later: PyTree) -> None:
    """That both kinds are rows of the same columns.

    **Raises:** `ValueError`, or [`NotFusible`][] for other types."""
    both = _named(first), _named(later)
    seen = f"but that at t = 0 has {both[0]}, and later ones have {both[1]}"
    if jax.tree.structure(first) != jax.tree.structure(later) or (
        [shape for shape, _ in both[0]] != [shape for shape, _ in both[1]]
    ):
        raise ValueError(f"All records must have the same structure and shapes, {seen}.")
    if both[0] != both[1]:
        raise NotFusible(
            f"The fused engine keeps records of the same types only, {seen}. "
            'Use engine="scan", or convert one of them.'
        )


def constant_in_time(inputs: dict[str, PyTree]) -> dict[str, PyTree]:
    return {kind: tree for kind, tree in inputs.items() if kind in ("shared", "lane")}


class Inputs:
    """A graph of inputs only, and the nodes of each of their leaves."""

    def __init__(
        self, carry: PyTree, inputs: dict[str, PyTree], goal: Goal = MACHINE_CODE
    ) -> None:
        self.graph = Graph(goal)
        step = self.graph.input(np.int64, ("step", 0))
        self.step = np.asarray(self.graph.convert(step, _step().dtype))
        self.carry = numbered(self.graph, "carry", carry)
        # In the order of `jax.tree.leaves` of the dictionary.
        self.by_kind = {k: numbered(self.graph, k, inputs[k]) for k in sorted(inputs)}

    @property
    def all(self) -> list[np.ndarray]:
        return [n for numbers in self.by_kind.values() for n in numbers]

    @property
    def fixed(self) -> list[np.ndarray]:
        return [n for numbers in constant_in_time(self.by_kind).values() for n in numbers]


def looped(
    bodies: Bodies, inputs: dict[str, PyTree], goal: Goal = MACHINE_CODE
) -> tuple[Loop, Traced]:
    """The loop of functions traced for inputs of the given shapes."""
    traced = trace(bodies, inputs)
    given = Inputs(traced.carry, inputs, goal)
    graph, size = given.graph, len(given.carry)
    begin = flatten(graph, traced.begin, given.fixed)
    end = size + len(jax.tree.leaves(traced.first))
    arguments = [given.step, *given.carry, *given.all, *begin[end:]]
    advance = flatten(graph, traced.advance, arguments)
    finish = flatten(graph, traced.finish, [*given.carry, *given.fixed])
    loop = Loop(
        graph,
        flat(begin[:size]),
        flat(advance[:size]),
        record=flat(advance[size:]),
        first=flat(begin[size:end]),
        final=flat(finish),
        branches=tuple(graph.branches),
    )
    return loop, traced


def wide() -> bool:
    """Whether JAX is in double precision."""
    return jax.config.jax_enable_x64  # pyright: ignore[reportAttributeAccessIssue]


def _step() -> jax.ShapeDtypeStruct:
    return jax.ShapeDtypeStruct((), np.dtype(np.int64 if wide() else np.int32))


class Program:
    """A loop, compiled when it is first called: `record` and `final` are trees of shapes
    and types of what the nodes of the loop mean.

    It can be sent to other processes, which compile it for themselves. `target` is the host
    that compiles where none is given, and `without` names passes that are left out."""

    def __init__(
        self,
        loop: Loop,
        record: PyTree,
        final: PyTree,
        widths: Sequence[int],
        *,
        target: Target | None = None,
        without: Collection[str] = (),
    ) -> None:
        self.raw = loop
        self.record, self.final = record, final
        self.widths, self.target, self.without = widths, target, without

    def __getstate__(self) -> dict[str, Any]:
        """Without machine code, and what is quickly made again."""
        return {
            k: v for k, v in vars(self).items() if k not in ("loop", "_step", "_kernels")
        }

    @functools.cached_property
    def loop(self) -> Loop:
        """The one that is compiled."""
        with _COMPILING, uncollected():
            return optimised(self.raw, without=self.without)

    @functools.cached_property
    def _kernels(self) -> tuple[Kernel, Kernel | None, Kernel | None]:
        """The loop, and what makes its timetable."""
        beside, along = self.loop.tables
        target = self._step.target
        step = lambda loop, width: Kernel(Step(Body(loop), width, target))
        return (
            Kernel(self._step),
            None if beside is None else step(beside, self.width),
            None if along is None else step(along, 1),
        )

    def compile(self) -> None:
        """Now, where this has not been done."""
        with _COMPILING, uncollected():
            self._kernels  # noqa: B018

    @functools.cached_property
    def _step(self) -> Step:
        return chosen(self.loop, self.widths, self.target or of_host())

    @property
    def width(self) -> int:
        """How many lanes the kernel advances at a time."""
        return self._step.width

    @classmethod
    @uncollected()
    def of(
        cls,
        bodies: Bodies,
        inputs: dict[str, PyTree],
        widths: Sequence[int],
        **choice: Any,
    ) -> "Program":
        """Of functions, traced for inputs of the given shapes; further arguments as of
        `Program`."""
        loop, traced = looped(bodies, inputs)
        return cls(loop, traced.record, traced.final, widths, **choice)

    @property
    def operations(self) -> int:
        """How many operations one step of one lane takes, a product with a sum counted as
        two; what a step shares with all others or all lanes is not counted."""
        nodes, total = self.loop.graph.nodes, 0
        for number, varies in varying(self.loop.graph, self.loop.of_a_step()).items():
            if all(varies):
                total += nodes[number].size
        return total

    def __call__(
        self,
        inputs: dict[str, PyTree],
        lanes: int,
        steps: int,
        *,
        every: int = 1,
        threads: int | None = None,
        rows: int | None = None,
    ) -> tuple[PyTree, PyTree]:
        """The records and what is final, NumPy arrays with a leading axis of `lanes`;
        records have a second one of `steps // every`, and one more for the first."""
        self.compile()
        kernel, *_ = self._kernels
        padded = -(-lanes // self.width) * self.width
        columns: dict[Any, np.ndarray] = {}
        for kind, tree in inputs.items():
            columns |= _slots(kind, COLUMNS[kind](tree, padded))
        columns |= self._times(columns, steps)
        if rows is None:
            rows = steps // every + (1 if self.loop.first else 0)
        record, final = blank(self.record, rows, padded), blank(self.final, padded)
        if self.loop.adaptive is not None:
            for leaf in jax.tree.leaves(record):  # what a lane does not reach
                leaf.fill(np.nan if leaf.dtype.kind == "f" else 0)
        columns |= _slots("record", columns_of(record, 2))
        columns |= _slots("final", columns_of(final, 1))
        threads = available_threads() if threads is None else threads
        kernel(columns, padded, steps, every, threads)
        return gathered(record, self.record, lanes), gathered(final, self.final, lanes)

    def _times(self, columns: dict[Any, np.ndarray], steps: int) -> dict[Any, np.ndarray]:
        """The columns of the timetable."""
        _, beside, along = self._kernels
        found: list[np.ndarray] = []
        if beside is not None:
            padded = -(-steps // beside.width) * beside.width
            made = _columns(beside.loop, beside.loop.final, padded)
            given = columns | {("lane", 0): np.arange(padded)}
            beside(given | _slots("final", made), padded, 0)
            found += made
        if along is not None:
            made = _columns(along.loop, along.loop.record, steps, along.width)
            along(columns | _slots("record", made), along.width, steps)
            found += made
        return _slots("time", found)


def _slots(kind: str, columns: Sequence[np.ndarray]) -> dict[Any, np.ndarray]:
    return {(kind, i): column for i, column in enumerate(columns)}


def _columns(loop: Loop, numbers: Sequence[int], *axes: int) -> list[np.ndarray]:
    """For nodes of a loop."""
    return [np.empty(axes, stored(loop.graph.dtype(n))) for n in numbers]


def _shapes(tree: PyTree) -> list[tuple[tuple[int, ...], np.dtype]]:
    return [(leaf.shape, np.dtype(leaf.dtype)) for leaf in jax.tree.leaves(tree)]


def _named(tree: PyTree) -> list[tuple[tuple[int, ...], str]]:
    return [(shape, str(dtype)) for shape, dtype in _shapes(tree)]


def numbered(graph: Graph, kind: str, tree: PyTree) -> list[np.ndarray]:
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
