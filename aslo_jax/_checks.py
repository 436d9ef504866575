"""Checks of arguments at construction: concrete values are refused, tracers pass."""

import operator
from typing import Any

import jax
import jax.core
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float


def real(x: Any) -> Array:
    """Convert `x` to a floating-point array; arrays keep their floating dtype."""
    dtype = getattr(x, "dtype", None)
    floating = dtype is not None and jnp.issubdtype(dtype, jnp.floating)
    if not is_concrete(x):
        return jnp.asarray(x, None if floating else float)
    # A module that is made while something else is traced holds numbers, not tracers.
    with jax.ensure_compile_time_eval():
        return jnp.asarray(x, None if floating else float)


def optional_real(x: Any) -> Array | None:
    """As [`real`][], but `None` stays `None`."""
    return None if x is None else real(x)


def is_concrete(*xs: Any) -> bool:
    """Whether every value can be read now, that is, none is being traced."""
    return not any(isinstance(x, jax.core.Tracer) for x in xs)


def positive(name: str, x: Array | np.ndarray | float, unit: str = "") -> None:
    """Refuse a concrete `x` with an entry that is not a finite positive number."""
    if not isinstance(x, jax.Array | np.ndarray | float | int) or not is_concrete(x):
        return  # a placeholder of a tree transformation, or a value that is traced
    value = np.asarray(x)
    if not (np.isfinite(value).all() and (value > 0).all()):
        unit = f" ({unit})" if unit else ""
        raise ValueError(
            f"Argument `{name}` must be positive and finite{unit}, but got "
            f"{value.tolist()}."
        )


def kind(name: str, x: Any, *kinds: type, hint: str) -> None:
    """Refuse an `x` that is none of the `kinds`; the `hint` says what it should be. What a
    transformation of a tree puts in the place of a leaf passes."""
    if isinstance(x, kinds) or x is None or type(x) is object:
        return
    raise unlike(name, x, hint)


def unlike(name: str, x: Any, hint: str) -> ValueError:
    """The error of an `x` that is not what the `hint` says."""
    plain = isinstance(x, bool | int | float | str)
    got = repr(x) if plain else f"a `{type(x).__name__}`"
    return ValueError(f"Argument `{name}` must be {hint}, but got {got}.")


def whole(name: str, x: int) -> None:
    """Refuse an `x` that is not at least one."""
    if x < 1:
        raise ValueError(f"Argument `{name}` must be at least 1, but got {x}.")


def counted(name: str, x: Any) -> int:
    """A whole number, as `int`; anything else is refused, `True` too."""
    try:
        if isinstance(x, bool):
            raise TypeError
        return operator.index(x)
    except TypeError:
        raise ValueError(
            f"Argument `{name}` must be a whole number, but got {x!r}."
        ) from None


def stable(name: str, A: Float[Array, "k k"]) -> None:
    """Refuse a concrete matrix that has an eigenvalue with a non-negative real part."""
    if not isinstance(A, jax.Array | np.ndarray) or not is_concrete(A):
        return
    largest = float(np.linalg.eigvals(np.asarray(A)).real.max(initial=-np.inf))
    if not largest < 0:
        raise ValueError(
            f"Argument `{name}` must be a stable matrix (every eigenvalue with a negative "
            f"real part), but the largest real part is {largest:.6g}."
        )


def known_start(start: str) -> None:
    """Refuse a start that is neither the exact nor the paper's."""
    if start not in ("exact", "paper"):
        raise ValueError(f'Argument `start` must be "exact" or "paper", but got {start!r}.')


def nonnegative(name: str, x: Array | np.ndarray | float) -> None:
    """Refuse a concrete `x` with an entry that is negative or not finite."""
    if not isinstance(x, jax.Array | np.ndarray | float | int) or not is_concrete(x):
        return
    value = np.asarray(x)
    if not (np.isfinite(value).all() and (value >= 0).all()):
        raise ValueError(
            f"Argument `{name}` must be finite and not negative, but got {value.tolist()}."
        )


def divides(every: int, steps: int) -> None:
    """Refuse to record one of every so many `steps` where that misses the last."""
    if steps < 1 or every < 1 or steps % every:
        raise ValueError(
            "Argument `every` must divide `steps`, both at least 1, but got "
            f"steps = {steps}, every = {every}."
        )
