"""Checks of arguments at construction: concrete values are refused, tracers pass."""

import operator
from collections.abc import Mapping, Sequence
from typing import Any, get_args

import jax
import jax.core
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from . import _choices
from ._typing import Numbers


def real(x: Numbers, name: str | None = None) -> Array:
    """Convert `x`, the argument `name`, to a floating-point array; arrays keep their
    floating dtype."""
    dtype = getattr(x, "dtype", None)
    wrong = isinstance(x, str | bytes | bool | complex | Mapping) or x is None
    if wrong or (dtype is not None and _no_number(dtype)):
        argument = "Arguments" if name is None else f"Argument `{name}`"
        got = repr(x) if dtype is None else str(dtype)
        raise ValueError(f"{argument} must hold real numbers, but got {got}.")
    floating = dtype is not None and jnp.issubdtype(dtype, jnp.floating)
    if not is_concrete(x):
        return jnp.asarray(x, None if floating else float)
    # A module that is made while something else is traced holds numbers, not tracers.
    with jax.ensure_compile_time_eval():
        return jnp.asarray(x, None if floating else float)


def _no_number(dtype: Any) -> bool:
    """Whether an array of this type holds what is no real number: text, objects, dates."""
    real_number = jnp.issubdtype(dtype, jnp.integer) or jnp.issubdtype(dtype, jnp.floating)
    return not (real_number or jnp.issubdtype(dtype, jnp.bool_))


def optional_real(x: Numbers | None, name: str | None = None) -> Array | None:
    """As [`real`][], but `None` stays `None`."""
    return None if x is None else real(x, name)


def number(name: str, x: Any, unit: str) -> None:
    """Refuse an `x`, in `unit`, that is not one real number; it may be traced."""
    dtype, shape = getattr(x, "dtype", None), getattr(x, "shape", ())
    plain = isinstance(x, float | int) and not isinstance(x, bool)
    if plain or (dtype is not None and not _no_number(dtype) and shape == ()):
        return
    got = f"an array of shape {shape}" if shape else repr(x)
    raise ValueError(f"Argument `{name}` must be a number ({unit}), but got {got}.")


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


def function(name: str, x: Any) -> None:
    """Refuse an `x` that is neither a function nor `None`."""
    if not (x is None or callable(x) or type(x) is object):
        raise unlike(name, x, "a function")


def whole(name: str, x: int) -> None:
    """Refuse an `x` that is not at least one."""
    if x < 1:
        raise ValueError(f"Argument `{name}` must be at least 1, but got {x}.")


def check_substeps(x: Any) -> None:
    """Refuse what is no number of steps in an interval, whose instants lie in memory."""
    if not isinstance(x, int) or isinstance(x, bool) or x < 1:
        raise ValueError(
            f"Argument `substeps` must be an integer of at least 1, but got {x}."
        )
    if x > _choices.MOST_SUBSTEPS:
        raise ValueError(
            f"Argument `substeps` must be at most {_choices.MOST_SUBSTEPS}, but got {x}."
        )


def one_of(name: str, x: Any, choices: Any) -> None:
    """Refuse an `x` that is none of the `choices`, a `Literal` of strings or a sequence."""
    allowed: Sequence[str] = get_args(choices) or tuple(choices)
    if not isinstance(x, str) or x not in allowed:
        *others, last = (f'"{each}"' for each in allowed)
        words = f"{', '.join(others)} or {last}" if others else last
        raise ValueError(f"Argument `{name}` must be {words}, but got {x!r}.")


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


def known_start(start: Any) -> None:
    """Refuse a start that is neither the exact nor the paper's."""
    one_of("start", start, _choices.FilterStart)


def nonnegative(name: str, x: Array | np.ndarray | float) -> None:
    """Refuse a concrete `x` with an entry that is negative or not finite."""
    if not isinstance(x, jax.Array | np.ndarray | float | int) or not is_concrete(x):
        return
    value = np.asarray(x)
    if not (np.isfinite(value).all() and (value >= 0).all()):
        raise ValueError(
            f"Argument `{name}` must be finite and not negative, but got {value.tolist()}."
        )


def told_apart(steps: int, interval: Any) -> None:
    """Refuse more samples than the precision of the `interval` can count: their instants
    would fall together, and so would the noise that is keyed by them."""
    most = 2 ** (np.finfo(interval.dtype).nmant + 1)
    if steps > most:
        raise ValueError(
            f"Argument `steps` must be at most {most} in {interval.dtype}, whose instants "
            f"fall together after that, but got {steps}; give `interval` in float64 (with "
            "JAX's `jax_enable_x64`), or divide the run."
        )


def divides(every: int, steps: int) -> None:
    """Refuse to record one of every so many `steps` where that misses the last."""
    if steps < 1 or every < 1 or steps % every:
        raise ValueError(
            "Argument `every` must divide `steps`, both at least 1, but got "
            f"steps = {steps}, every = {every}."
        )
