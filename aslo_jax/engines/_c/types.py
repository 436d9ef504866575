"""Types and constants of C."""

from typing import Any

import numpy as np

TYPES = {
    "float64": "double",
    "float32": "float",
    "bool": "bool",
    **{f"{k}{n}": f"{k}{n}_t" for k in ("int", "uint") for n in (8, 16, 32, 64)},
}


def short(dtype: np.dtype) -> str:
    """The type in a name, as `f64`."""
    kind = {"f": "f", "i": "i", "u": "u", "b": "b"}[dtype.kind]
    return f"{kind}{8 * dtype.itemsize}"


def c_type(dtype: np.dtype) -> str:
    return TYPES[dtype.name]


def literal(value: Any, dtype: np.dtype) -> str:
    """A finite number in as few digits as tell it from all others of its type."""
    if dtype.kind == "b":
        return "true" if value else "false"
    if dtype.kind == "f":
        text = str(dtype.type(value))
        text = text if "." in text or "e" in text else f"{text}.0"
        return text + ("f" if dtype.itemsize == 4 else "")
    bits, value = 8 * dtype.itemsize, int(value)
    if bits < 32:
        return f"({c_type(dtype)}){value}" if value >= 0 else f"({c_type(dtype)})({value})"
    macro = f"{'U' if dtype.kind == 'u' else ''}INT{bits}_C"
    if value >= 0:
        return f"{macro}({value})"
    if value == np.iinfo(dtype).min:  # which has no opposite
        return f"(-{macro}({-(value + 1)}) - 1)"
    return f"(-{macro}({-value}))"


def unsigned(dtype: np.dtype) -> str:
    """The type in which whole numbers are computed, modulo a power of two."""
    return "uint64_t" if dtype.itemsize == 8 else "uint32_t"
