"""Arrays as nested lists, whose entries that are always 0 or 1 are plain numbers: with
[`_factored`][aslo_jax._factored], what these are multiplied by or added to costs nothing.

A compiler may not drop a product with zero, since what it multiplies may be infinite; of a
derivative it is what the function does not depend on.
"""

import functools
from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array

from ._typing import PyTree

# What a function raises whose Python looks at the values of its arrays.
CONCRETE = (jax.errors.ConcretizationTypeError, jax.errors.TracerArrayConversionError)
Nested = Any  # an array of shape (), a number, or a list of these


def listed(function: Callable[..., PyTree], *args: PyTree) -> PyTree:
    """`function(*args)`, a tree of arrays, with each of them as nested lists of its
    entries, plain 0 and 1 where they are that whatever the arrays in `args` are. The
    function, and what is no array in `args`, tell what it computes: it closes over no
    array."""
    arrays, rest = eqx.partition(args, eqx.is_array)
    shapes = jax.tree.map(lambda x: jax.ShapeDtypeStruct(x.shape, x.dtype), arrays)
    parts, structure = jax.tree.flatten((rest, shapes))
    found, tree = jax.tree.flatten(function(*args))
    try:
        hash((*parts, structure))
    except TypeError:
        known = _known(function, tuple(parts), structure)
    else:
        known = _kept(function, tuple(parts), structure)
    if known is None:
        known = [np.full(x.shape, None, object).tolist() for x in found]
    lists = [_lists(x, k) for x, k in zip(found, known, strict=True)]
    return jax.tree.unflatten(tree, lists)


def _lists(x: Array, known: Nested) -> Nested:
    if x.ndim:
        return [_lists(x[i], k) for i, k in enumerate(known)]
    return x if known is None else known


def _known(function: Any, parts: Sequence[Any], structure: Any) -> list[Nested] | None:
    """For each array that the function returns, 0, 1 or `None` of each entry; `None` where
    nothing is known of any."""
    from ._frontend.lower import NotFusible, flatten, unusual
    from ._ir.graph import Graph

    rest, shapes = jax.tree.unflatten(structure, parts)

    def of_arrays(arrays):
        return function(*eqx.combine(arrays, rest))

    try:
        closed, out = jax.make_jaxpr(of_arrays, return_shape=True)(shapes)
    except CONCRETE:
        return None
    leaves, outs = jax.tree.leaves(shapes), jax.tree.leaves(out)
    if unusual(*leaves, *outs) is not None:
        return None
    graph, count = Graph(), 0
    inputs = []
    for leaf in leaves:
        numbers = np.empty(leaf.shape, int)
        for place in np.ndindex(leaf.shape):
            numbers[place] = graph.input(leaf.dtype, ("lane", count))
            count += 1
        inputs.append(numbers)
    try:
        made = flatten(graph, closed, inputs)
    except NotFusible:
        return None
    values = np.array(_values(graph), object)
    every = (values[np.asarray(numbers, int)] for numbers in made)
    return [np.asarray(x, object).tolist() for x in every]


_kept = functools.lru_cache(maxsize=256)(_known)


def _values(graph: Any) -> list[int | None]:
    """Of each node, 0 or 1 where it is that for all finite inputs."""
    values: list[int | None] = []
    for node in graph.nodes:
        of = [values[a] for a in node.args]
        value = None
        if node.dtype.kind != "f":
            pass
        elif node.op == "const":
            value = int(node.data) if node.data in (0, 1) else None
        elif node.op == "mul":
            value = _product(*of)
        elif node.op == "add":
            value = _sum(*of)
        elif node.op == "fma":
            value = _sum(_product(*of[:2]), of[2])
        elif node.op in ("sub", "div"):
            neutral = 0 if node.op == "sub" else 1
            value = of[0] if of[1] == neutral or (node.op == "div" and of[0] == 0) else None
        elif node.op in ("neg", "abs", "sqrt", "convert"):
            value = 0 if of[0] == 0 else None
        elif node.op == "select":
            value = of[1] if of[1] == of[2] else None
        elif node.op == "dot":
            half = len(of) // 2
            terms = map(_product, of[:half], of[half:])
            value = functools.reduce(_sum, terms, 0)
        values.append(value)
    return values


def _product(a: int | None, b: int | None) -> int | None:
    if a == 0 or b == 0:
        return 0
    return b if a == 1 else a if b == 1 else None


def _sum(a: int | None, b: int | None) -> int | None:
    return b if a == 0 else a if b == 0 else None
