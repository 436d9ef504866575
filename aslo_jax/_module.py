"""The base of every module of the library."""

from typing import Any

import equinox as eqx
import jax
import jax.core
import numpy as np
import wadler_lindig as wl

WIDTH = 92  # columns
ENTRIES = 8  # from which on an array is abbreviated


class Module(eqx.Module):
    """An `equinox.Module` whose `repr` shows values where it can, not types alone."""

    def __repr__(self) -> str:
        return wl.pformat(self, width=WIDTH, custom=_value)


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
