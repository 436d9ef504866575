"""The shapes of u and y that a relation or an observer takes, from its annotations.

`u: Float[Array, " 2"]` is a declaration: signals of another width broadcast in its formulas
and leave an estimate that is wrong and certified.
"""

import functools
import inspect
from collections.abc import Callable, Mapping
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array

from ._typing import PyTree

Shape = tuple[int | None, ...]  # a size that is not known is None


@functools.cache  # every pass over the equations asks
def declared(function: Callable[..., Any]) -> dict[str, Shape]:
    """The shapes that the annotations of a function give its arguments `u` and `y`."""
    found: dict[str, Shape] = {}
    parameters = inspect.signature(function).parameters
    for name in ("u", "y"):
        annotation = parameters[name].annotation if name in parameters else None
        sizes = getattr(annotation, "dim_str", None)
        if isinstance(sizes, str) and not any(c in sizes for c in "*.#=+-"):
            found[name] = tuple(int(s) if s.isdigit() else None for s in sizes.split())
    return found


def check_signals(owner: Any, function: Callable[..., Any], u: PyTree, y: PyTree) -> None:
    """Refuse a `u` or `y` at an instant that is not what `owner` takes: what its `signals`
    say, shapes by name, or else the annotations of `function`."""
    shapes = getattr(owner, "signals", None)
    shapes = declared(function) if shapes is None else shapes
    check_shapes(type(owner).__name__, shapes, u, y)


def check_shapes(owner: str, shapes: Mapping[str, Shape], u: PyTree, y: PyTree) -> None:
    """Refuse a `u` or `y` at an instant that is complex, or of another shape than that by
    its name."""
    for name, signal in (("y", y), ("u", u)):
        leaves = jax.tree.leaves(signal)
        if any(map(jnp.iscomplexobj, leaves)):
            raise ValueError(
                f"Argument `{name}` must be real, but is complex; stack real and imaginary "
                "parts, alpha and beta, along the last axis."
            )
        expected = shapes.get(name)
        if expected is None:
            continue
        got = jnp.shape(signal) if leaves and leaves[0] is signal else None
        if got is None or not _fits(got, expected):
            what = ("None" if signal is None else "a tree") if got is None else got
            raise ValueError(
                f"Argument `{name}` must have the shape {_text(expected)} at each instant "
                f"for `{owner}`, but got {what}; a log has one "
                "row of that shape for each instant."
            )


def vector(name: str, x: Any, size: int) -> Array:
    """`x` as a vector of `size` entries, which a number may be where that is one."""
    x = jnp.atleast_1d(x)
    check_shapes("a system of these matrices", {name: (size,)}, x, x)
    return x


def _fits(got: tuple[int, ...], expected: Shape) -> bool:
    return len(got) == len(expected) and all(
        size is None or size == n for n, size in zip(got, expected, strict=True)
    )


def _text(shape: Shape) -> str:
    sizes = ", ".join("n" if size is None else str(size) for size in shape)
    return f"({sizes},)" if len(shape) == 1 else f"({sizes})"
