"""Operations on constants (constant folding), with the results of a run."""

from collections.abc import Callable
from fractions import Fraction
from typing import Any

import numpy as np


def _quotient(x: Any, y: Any) -> Any:
    """Of whole numbers, towards zero: all ones where y is zero; `-x`, which wraps, where it
    is -1."""
    if x.dtype.kind == "f":
        return x / y
    if y == 0:
        return ~x.dtype.type(0)
    size = abs(int(x)) // abs(int(y))
    value = -size if (x < 0) != (y < 0) else size
    return x if value > np.iinfo(x.dtype).max else x.dtype.type(value)


def _shift(operation: Callable[[Any, Any], Any]) -> Callable[[Any, Any], Any]:
    def fold(x, y):
        return operation(x, y) if 0 <= y < x.dtype.itemsize * 8 else x.dtype.type(0)

    return fold


def _shift_of_sign(x: Any, y: Any) -> Any:
    """By so many bits or more, or by less than none, only the sign is left."""
    bits = x.dtype.itemsize * 8
    amount = int(y) if 0 <= y < bits else bits - 1
    return (x.view(f"i{x.dtype.itemsize}") >> amount).view(x.dtype)


def _bits(x: Any) -> int:
    return int(x) % 2 ** (8 * x.dtype.itemsize)


# Those that mean the same of numbers and, entry by entry, of arrays.
UFUNCS: dict[str, Callable[..., Any]] = {
    "add": np.add,
    "sub": np.subtract,
    "mul": np.multiply,
    "neg": np.negative,
    "abs": np.abs,
    "sqrt": np.sqrt,
    "floor": np.floor,
    "ceil": np.ceil,
    "rint": np.rint,
    "and": np.bitwise_and,
    "or": np.bitwise_or,
    "xor": np.bitwise_xor,
    "not": np.invert,
    "eq": np.equal,
    "ne": np.not_equal,
    "lt": np.less,
    "le": np.less_equal,
    "gt": np.greater,
    "ge": np.greater_equal,
}
FOLD: dict[str, Callable[..., Any]] = {
    **UFUNCS,
    "div": _quotient,
    "shl": _shift(np.left_shift),
    "lshr": _shift(lambda x, y: (x.view(f"u{x.dtype.itemsize}") >> int(y)).view(x.dtype)),
    "ashr": _shift_of_sign,
    "ones": lambda x: _bits(x).bit_count(),
    "zeros": lambda x: 8 * x.dtype.itemsize - _bits(x).bit_length(),
}


def converted(x: Any, dtype: np.dtype) -> Any:
    """A number as `dtype`. A real number becomes the nearest whole one towards zero that
    the type has, and zero where it is none; a whole number wraps."""
    if x.dtype.kind != "f" or dtype.kind not in "iu":
        return x.astype(dtype)
    bounds = np.iinfo(dtype)
    if not np.isfinite(x):
        return dtype.type(0 if np.isnan(x) else bounds.max if x > 0 else bounds.min)
    return dtype.type(min(max(int(x), bounds.min), bounds.max))


def fused(x: Any, y: Any, z: Any) -> Any:
    """`x y + z` of finite doubles, rounded once."""
    total = Fraction(float(x)) * Fraction(float(y)) + Fraction(float(z))
    if not total:
        return x * y + z
    try:
        return np.float64(float(total))
    except OverflowError:
        return np.float64(np.inf if total > 0 else -np.inf)
