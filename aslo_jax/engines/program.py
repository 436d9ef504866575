"""A loop over time, traced, compiled, and run over lanes by a pool of threads."""

import ctypes
import functools
import itertools
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import PyTree

from .._extras import require
from .emit import Loop, emit, slots
from .flatten import flatten
from .graph import Graph

Body = Callable[[Any, PyTree, PyTree, PyTree, PyTree, PyTree], tuple[PyTree, PyTree]]

KINDS = ("shared", "lane", "log", "lane log")


class Traced(NamedTuple):
    """A body as a closed jaxpr, and the trees of what it returns."""

    closed: Any
    carry: PyTree
    record: PyTree


def trace(body: Body, carry: PyTree, inputs: dict[str, PyTree]) -> Traced:
    """`body(k, carry, shared, lane, log, lane_log) -> (carry, record)`, traced.

    Arguments are given as trees of shapes and types without the axes of lanes and steps:
    `carry`, and by kind the `inputs`: `shared` by all lanes, one for each `lane`, one for
    each step (`log`), or for both (`lane log`)."""
    arguments = [inputs.get(kind) for kind in KINDS]
    closed, out = jax.make_jaxpr(body, return_shape=True)(_step(), carry, *arguments)
    if _shapes(out[0]) != _shapes(carry):
        raise ValueError(
            "The carry of a loop must keep its shapes and types, but a step makes "
            f"{_shapes(out[0])} of {_shapes(carry)}."
        )
    return Traced(closed, *out)


def numbered(
    carry: PyTree, inputs: dict[str, PyTree]
) -> tuple[Graph, dict[str, list[np.ndarray]]]:
    """A graph of inputs only, and by kind the nodes of each leaf; `step` is the index."""
    graph = Graph()
    step = graph.convert(graph.input(np.int64, ("step", 0)), _step().dtype)
    numbers = {"step": [np.asarray(step)], "carry": _numbered(graph, "carry", carry)}
    for kind in KINDS:
        numbers[kind] = _numbered(graph, kind, inputs.get(kind))
    return graph, numbers


def _step() -> jax.ShapeDtypeStruct:
    wide = jax.config.jax_enable_x64  # pyright: ignore[reportAttributeAccessIssue]
    return jax.ShapeDtypeStruct((), np.dtype(np.int64 if wide else np.int32))


class Program:
    """A loop, compiled: `carry` and `record` are trees of shapes and types, `found` the
    nodes of their leaves, those of the carry first."""

    def __init__(
        self,
        graph: Graph,
        carry: PyTree,
        record: PyTree,
        found: list[np.ndarray],
        width: int,
    ):
        split = len(jax.tree.leaves(carry))
        self.carry, self.record = _shapes(carry), _shapes(record)
        self.record_tree = jax.tree.structure(record)
        self.loop = Loop(graph, _flat(found[:split]), _flat(found[split:]))
        self.width = width
        self.slots = slots(self.loop)
        self._function = _compiled(emit(self.loop, width))

    @classmethod
    def of(
        cls, body: Body, carry: PyTree, inputs: dict[str, PyTree], width: int
    ) -> "Program":
        """Of a function, see [`trace`][]."""
        traced = trace(body, carry, inputs)
        graph, numbers = numbered(carry, inputs)
        found = flatten(graph, traced.closed, [n for ns in numbers.values() for n in ns])
        return cls(graph, carry, traced.record, found, width)

    @property
    def operations(self) -> int:
        """How many operations one step of one lane takes, constants and what is hoisted
        out of the loop included."""
        graph = self.loop.graph
        needed = graph.reachable([*self.loop.carry, *self.loop.record])
        return sum(graph.nodes[n].op not in ("const", "input") for n in needed)

    def __call__(
        self,
        carry: PyTree,
        inputs: dict[str, PyTree],
        lanes: int,
        steps: int,
        *,
        every: int = 1,
        start: int = 0,
        threads: int | None = None,
    ) -> tuple[PyTree, PyTree]:
        """The final carry and the records, NumPy arrays with a leading axis of `lanes`;
        records have a second one of `steps // every`."""
        padded = -(-lanes // self.width) * self.width
        columns = {("carry", i): c for i, c in enumerate(_columns(carry, padded))}
        for kind, tree in inputs.items():
            made = _COLUMNS[kind](tree, padded)
            columns |= {(kind, i): c for i, c in enumerate(made)}
        saved = steps // every
        for i, number in enumerate(self.loop.record):
            dtype = _stored(self.loop.graph.dtype(number))
            columns["record", i] = np.empty((saved, padded), dtype)
        table = (ctypes.c_void_p * max(len(self.slots), 1))(
            *(columns[slot].ctypes.data for slot in self.slots)
        )
        address = ctypes.addressof(table)

        def work(span: tuple[int, int]) -> None:
            self._function(*span, padded, start, steps, every, address)

        run_in_threads(work, _spans(padded, self.width, threads), threads)
        final = [columns["carry", i] for i in range(len(self.loop.carry))]
        record = [columns["record", i] for i in range(len(self.loop.record))]
        return (
            jax.tree.unflatten(
                jax.tree.structure(carry), _gathered(final, self.carry, lanes)
            ),
            jax.tree.unflatten(self.record_tree, _gathered(record, self.record, lanes)),
        )


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


def _flat(arrays: list[np.ndarray]) -> tuple[int, ...]:
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


def _gathered(columns: list[np.ndarray], shapes: list, lanes: int) -> list[np.ndarray]:
    """Leaves with the axis of lanes first, then that of steps where there is one."""
    found, first = [], 0
    for shape, dtype in shapes:
        size = int(np.prod(shape, dtype=int))
        group = columns[first : first + size]
        first += size
        lead = (lanes, *group[0].shape[:-1]) if group else (lanes,)
        leaf = np.empty((*lead, size), dtype)
        for k, column in enumerate(group):
            leaf[..., k] = column[..., :lanes].T
        found.append(leaf.reshape(*lead, *shape))
    return found


# ---- threads and compilation ---------------------------------------------------------


def available_threads() -> int:
    """The processors that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


@functools.cache
def _pool(threads: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(threads, thread_name_prefix="aslo_jax")


def run_in_threads(
    work: Callable[[tuple[int, int]], None],
    spans: list[tuple[int, int]],
    threads: int | None,
) -> None:
    """`work` on every span; the kernel releases the interpreter's lock."""
    threads = available_threads() if threads is None else threads
    if threads == 1 or len(spans) == 1:
        for span in spans:
            work(span)
        return
    for result in [_pool(threads).submit(work, span) for span in spans]:
        result.result()


def _spans(padded: int, width: int, threads: int | None) -> list[tuple[int, int]]:
    """Some pieces for each thread, so that none waits long for another."""
    threads = available_threads() if threads is None else threads
    blocks = padded // width
    pieces = min(blocks, 8 * threads if threads > 1 else 1)
    edges = [blocks * k // pieces * width for k in range(pieces + 1)]
    return [(a, b) for a, b in itertools.pairwise(edges) if b > a]


@functools.cache
def _machine() -> Any:
    llvm = require("llvmlite.binding", "study")
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    return llvm.Target.from_default_triple()


_SIGNATURE = ctypes.CFUNCTYPE(None, *[ctypes.c_int64] * 6, ctypes.c_void_p)


@functools.lru_cache(maxsize=128)
def _compiled(text: str) -> Callable[..., None]:
    """The machine code of a kernel; the engine that owns it lives as long as it does."""
    target = _machine()
    llvm = require("llvmlite.binding", "study")
    module = llvm.parse_assembly(text)
    machine = target.create_target_machine(
        cpu=llvm.get_host_cpu_name(),
        features=llvm.get_host_cpu_features().flatten(),
        opt=3,
        jit=True,
    )
    engine = llvm.create_mcjit_compiler(module, machine)
    engine.finalize_object()
    function = _SIGNATURE(engine.get_function_address("kernel"))

    def call(*arguments: Any) -> None:
        function(*arguments)

    call.engine = engine  # pyright: ignore[reportFunctionMemberAccess]
    return call
