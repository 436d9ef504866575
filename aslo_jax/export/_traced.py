"""A block as a loop of the engine, with names for what is in it."""

import contextlib
import dataclasses
import importlib
from collections.abc import Collection, Iterator
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from .._ir.goal import Goal
from .._ir.loop import Loop
from .._ir.rewrite import alive, pruned
from .._typing import PyTree
from ..engines._fused.program import Bodies, looped
from ..engines._passes import optimised
from ._blocks import Block
from ._fields import Field, fields_of

# Loops where they are shorter than what they stand for; a processor of a drive has little
# memory for a program, and none of its own for wide products.
PORTABLE = Goal(fuses=False, large=100, many=4)
# Passes that give the state another meaning, or need it to run over many steps.
UNFIT = ("commoning", "factors", "timetable", "unswitching")


class Traced(NamedTuple):
    """`loop`, whose `("shared", k)` are the `parameters`, `("lane", k)` the inputs of the
    start and `("log", k)` those of a step, entry by entry, an interval last where it is an
    input; `numbers` are the places in the state of what is left of the carry."""

    loop: Loop
    parameters: list[Field]
    state: list[Field]
    first: list[Field]
    inputs: list[Field]
    outputs: list[Field]
    interval: float | None

    @property
    def dtype(self) -> np.dtype:
        """That of the inputs."""
        return self.inputs[0].dtype


@contextlib.contextmanager
def precision(dtype: np.dtype) -> Iterator[None]:
    """JAX in the precision of a type, whatever it is set to."""
    # Where it is, and where it was before JAX 0.8.
    home: Any = (
        jax if hasattr(jax, "enable_x64") else importlib.import_module("jax.experimental")
    )
    with home.enable_x64(dtype == np.float64):
        yield


def in_type(tree: PyTree, dtype: np.dtype) -> PyTree:
    """Real numbers in a tree of arrays or shapes as another type."""

    def one(x: Any) -> Any:
        if not (hasattr(x, "dtype") and np.issubdtype(x.dtype, np.floating)):
            return x
        if isinstance(x, jax.ShapeDtypeStruct):
            return jax.ShapeDtypeStruct(x.shape, dtype)
        return jnp.asarray(x, dtype)

    return jax.tree.map(one, tree)


def is_number(x: Any) -> bool:
    """Whether a leaf is an array of real numbers, which may be a parameter."""
    return isinstance(x, np.ndarray | jax.Array) and np.issubdtype(x.dtype, np.floating)


def traced(
    block: Block, dtype: np.dtype, interval: float | None, fixed: Collection[str]
) -> Traced:
    """The loop of a block in one precision. Parameters that are `fixed`, by name or, with
    `"all"`, all of them, are constants.

    **Raises:** [`NotFusible`][], with the user's line, for what the engine does not take;
    `ValueError` for a fixed parameter that there is none of."""
    with precision(dtype):
        module = in_type(block.module, dtype)
        names = [f.name for f in fields_of(eqx.filter(module, is_number), "parameter")]
        _check_fixed(fixed, names)
        mask = iter([not ({"all", name} & set(fixed)) for name in names])
        tunable = jax.tree.map(lambda x: is_number(x) and next(mask), module)
        parameters, rest = eqx.partition(module, tunable)
        inputs = in_type(block.inputs, dtype)
        if interval is None:
            inputs = inputs | {"dt": jax.ShapeDtypeStruct((), dtype)}
        first = {name: inputs[name] for name in block.first}
        bodies = _bodies(block, rest, interval)
        shaped = lambda x: jax.ShapeDtypeStruct(np.shape(x), x.dtype)
        given = {
            "shared": jax.tree.map(shaped, parameters),
            "lane": first,
            "log": inputs,
        }
        loop, shapes = looped(bodies, given, PORTABLE)
    loop, state = _lean(loop, fields_of(shapes.carry, "state"))
    return Traced(
        loop,
        fields_of(parameters, "parameter"),
        state,
        fields_of(first, "y"),
        fields_of(inputs, "y"),
        fields_of(shapes.record, "value"),
        interval,
    )


def _check_fixed(fixed: Collection[str], names: list[str]) -> None:
    for name in fixed:
        if name not in (*names, "all"):
            raise ValueError(
                f"Argument `fixed` must hold names of parameters, {', '.join(names)}, or "
                f'"all", but got {name!r}.'
            )


def _bodies(block: Block, rest: PyTree, interval: float | None) -> Bodies:
    def begin(inputs: dict[str, PyTree]) -> tuple[PyTree, PyTree]:
        return block.start(eqx.combine(inputs["shared"], rest), inputs["lane"])

    def advance(k: Any, state: PyTree, inputs: dict[str, PyTree]) -> tuple[PyTree, PyTree]:
        signals = dict(inputs["log"])
        dt = signals.pop("dt") if interval is None else interval
        return block.step(eqx.combine(inputs["shared"], rest), state, signals, dt)

    return Bodies(begin, advance, lambda carry, inputs: carry)


def _lean(loop: Loop, fields: list[Field]) -> tuple[Loop, list[Field]]:
    """Without the entries of the state that no output depends on, and those that always
    equal another one; the members that are left."""
    entries = [(f, k) for f, field in enumerate(fields) for k in range(field.size)]
    loop = dataclasses.replace(loop, final=())
    entries = [entries[i] for i in alive(loop)]
    loop = pruned(loop)
    for without in (UNFIT, (*UNFIT, "congruence")):
        lean, kept = _optimised(loop, without)
        if not _needs_the_start(lean):
            break
    return lean, list(_members(fields, [entries[i] for i in kept]))


def _optimised(loop: Loop, without: Collection[str]) -> tuple[Loop, list[int]]:
    """After the passes that suit, and which entries of the carry are left."""
    graph = loop.graph
    now = [graph.input(graph.dtype(n), ("carry", i)) for i, n in enumerate(loop.carry)]
    lean = optimised(dataclasses.replace(loop, final=tuple(now)), without=without)
    kept = [0] * len(lean.carry)
    for i, number in reversed(list(enumerate(lean.final))):
        slot = graph.nodes[number].data
        if graph.nodes[number].op == "input" and slot[0] == "carry":
            kept[slot[1]] = i
    lean = dataclasses.replace(lean, final=())
    still = alive(lean)
    return pruned(lean), [kept[j] for j in still]


def _needs_the_start(loop: Loop) -> bool:
    """Whether a step uses what only the start is given."""
    nodes = loop.graph.nodes
    slots = (nodes[n].data for n in loop.of_a_step() if nodes[n].op == "input")
    return any(kind == "lane" for kind, _ in slots)


def _members(fields: list[Field], entries: list[tuple[int, int]]) -> Iterator[Field]:
    """Fields with the entries of theirs that are left."""
    for f, field in enumerate(fields):
        left = [k for g, k in entries if g == f]
        if len(left) == field.size:
            yield field
        elif left:
            places = [str(tuple(map(int, np.unravel_index(k, field.shape)))) for k in left]
            which = f"{field.origin}, of shape {field.shape}, entries {', '.join(places)}"
            yield field._replace(shape=(len(left),), origin=which)
