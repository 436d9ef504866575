"""Signals for a test, and what the library makes of them."""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from .._typing import PyTree
from ._blocks import Block
from ._traced import Traced, in_type, precision

ROWS = 64
LONGEST = 200  # rows of a log
INTERVAL = 1e-3  # s, where it is an input


class Vectors(NamedTuple):
    """`inputs`, shape `(N, p)`, and `outputs`, shape `(N, q)`: of every row the entries of
    their fields, one after the other. The first row is that of the start, whose inputs
    other than those of the start are zero.

    `conditioning`: the largest change of an output that is a real number, relative to its
    signal, where the last bits of the inputs change: what rounding may do to a test."""

    inputs: np.ndarray
    outputs: np.ndarray
    conditioning: float

    @classmethod
    def of(cls, block: Block, signals: PyTree, made: Traced, dtype: np.dtype) -> "Vectors":
        """What a block makes of signals, trees with a leading axis of length N; where these
        have an interval `dt`, of its own."""
        with precision(dtype):
            outputs, nudged = run(
                in_type(block.module, dtype), block, signals, made.interval, dtype
            )
        columns = _flat(signals)
        first = {id(f) for f in made.inputs if f.name in {g.name for g in made.first}}
        at = 0
        for field in made.inputs:
            if id(field) not in first:
                columns[0, at : at + field.size] = 0.0
            at += field.size
        outputs, nudged = _flat(outputs), _flat(nudged)
        real = [f.dtype.kind == "f" for f in made.outputs for _ in range(f.size)]
        size = np.max(np.abs(outputs), axis=0, initial=0.0)
        change = np.abs(nudged - outputs) / np.where(size > 0, size, 1.0)
        return cls(columns, outputs, float(np.max(change[:, real], initial=0.0)))


def run(
    module: PyTree, block: Block, signals: PyTree, interval: float | None, dtype: np.dtype
) -> tuple[PyTree, PyTree]:
    """The outputs, with a leading axis, and those for inputs whose last bits differ."""
    arrays, rest = eqx.partition(module, eqx.is_array)
    signals = jax.tree.map(lambda x: jnp.asarray(x, dtype), signals)
    nudged = jax.tree.map(lambda x: _nudged(np.asarray(x)), signals)

    @jax.jit
    def whole(arrays, signals):
        module = eqx.combine(arrays, rest)
        first = jax.tree.map(lambda x: x[0], {n: signals[n] for n in block.first})
        state, begun = block.start(module, first)

        def step(state, row):
            row = dict(row)
            dt = row.pop("dt") if interval is None else interval
            return block.step(module, state, row, dt)

        _, later = jax.lax.scan(step, state, jax.tree.map(lambda x: x[1:], signals))
        return jax.tree.map(lambda a, b: jnp.concatenate([a[None], b]), begun, later)

    return whole(arrays, signals), whole(arrays, nudged)


def _nudged(x: np.ndarray) -> np.ndarray:
    """Numbers of which every other one is greater, and less, by the last bit."""
    sign = 1.0 - 2.0 * (np.arange(x.size).reshape(x.shape) % 2)
    return (x * (1.0 + sign * np.finfo(x.dtype).eps)).astype(x.dtype)


def _flat(tree: PyTree) -> np.ndarray:
    """The leaves of a tree, entry by entry."""
    leaves = [np.asarray(x, float) for x in jax.tree.leaves(tree)]
    return np.concatenate([x.reshape(len(x), -1) for x in leaves], axis=1)


def excited(block: Block, interval: float | None) -> PyTree:
    """Sinusoids, each entry with a frequency of its own, in 64 rows."""
    k, count = np.arange(ROWS), 0
    shapes, tree = jax.tree.flatten(block.inputs)
    found = []
    for shape in shapes:
        size = int(np.prod(shape.shape, dtype=int))
        number = np.arange(count, count + size)
        count += size
        wave = np.cos(0.3 * k[:, None] + 0.02 * k[:, None] * number + 1.1 * number)
        found.append(np.round(wave, 6).reshape(ROWS, *shape.shape))
    signals = jax.tree.unflatten(tree, found)
    if interval is None:
        signals["dt"] = np.round(INTERVAL * (1.0 + 0.25 * np.sin(k)), 9)
    return signals


def recorded(block: Block, interval: float | None, log: Any) -> PyTree:
    """The first rows of a log as the signals of steps: each with the u that was held before
    it."""
    t, u, y = log
    t = np.asarray(t, float)[:LONGEST]
    cut = lambda tree: jax.tree.map(lambda x: np.asarray(x, float)[:LONGEST], tree)
    u, y = cut(u), cut(y)
    late = jax.tree.map(lambda x: np.concatenate([0.0 * x[:1], x[:-1]]), u)
    signals = {name: {"u": late, "y": y}[name] for name in block.inputs}
    if interval is None:
        signals["dt"] = np.concatenate([[0.0], np.diff(t)])
    return signals
