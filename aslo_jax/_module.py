"""The base of every module of the library."""

import dataclasses
import functools
from types import MappingProxyType
from typing import Any, get_args

import equinox as eqx
import jax
import jax.core
import numpy as np
import wadler_lindig as wl

from ._checks import optional_real, real

WIDTH = 92  # columns
ENTRIES = 8  # from which on an array is abbreviated
AXES = {0: "a number", 1: "a vector", 2: "a matrix"}


class Module(eqx.Module):
    """An `equinox.Module` whose `repr` shows values where it can, not types alone. Its
    parameters, the fields that are converted to real numbers, have as many axes as their
    annotation says.

    **Raises:** `ValueError` for a parameter that holds what is no number, or that is an
    array where a number is meant.
    """

    def __init_subclass__(cls, **settings: Any) -> None:
        super().__init_subclass__(**settings)
        for name, field in vars(cls).items():
            if not isinstance(field, dataclasses.Field):
                continue
            converter: Any = field.metadata.get("converter")
            if converter is real or converter is optional_real:
                named = {"converter": functools.partial(converter, name=name)}
                field.metadata = MappingProxyType(dict(field.metadata) | named)

    def __check_init__(self) -> None:
        for name, axes in _axes(type(self)).items():
            x = getattr(self, name)
            if isinstance(x, jax.Array | np.ndarray) and x.ndim not in axes:
                words = " or ".join(AXES.get(n, f"an array of {n} axes") for n in axes)
                raise ValueError(
                    f"Argument `{name}` must be {words}, but got an array of shape "
                    f"{x.shape}."
                )

    def __repr__(self) -> str:
        return wl.pformat(self, width=WIDTH, custom=_value)


@functools.cache
def _axes(kind: type[Module]) -> dict[str, tuple[int, ...]]:
    """How many axes each parameter of a kind of modules may have, where that is known."""
    found = {}
    for field in dataclasses.fields(kind):
        annotations = get_args(field.type) or (field.type,)
        texts = [getattr(each, "dim_str", None) for each in annotations]
        sizes = [text.split() for text in texts if text is not None]
        known = not any("*" in size or size == "..." for each in sizes for size in each)
        if "converter" in field.metadata and sizes and known:
            found[field.name] = tuple(len(each) for each in sizes)
    return found


def _value(x: Any) -> wl.AbstractDoc | None:
    """The value of an array, abbreviated as NumPy does; of what is traced, or a key, its
    type and shape, as equinox does."""
    if not isinstance(x, jax.Array | np.ndarray):
        return None
    hidden = isinstance(x, jax.core.Tracer) or getattr(x.dtype, "kind", "V") not in "biufc"
    if isinstance(x, jax.Array) and not hidden:
        hidden = x.is_deleted() or not x.is_fully_addressable
    if hidden:
        return wl.array_summary(x.shape, str(x.dtype), kind=None)
    values = np.asarray(x)
    if not values.shape:
        return wl.TextDoc(str(values[()]))
    text = np.array2string(values, precision=6, separator=", ", threshold=ENTRIES)
    return wl.TextDoc(" ".join(text.split()))


__all__ = ["Module"]
