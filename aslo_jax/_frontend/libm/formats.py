"""Floating-point types: their widths, and constants split for exact reductions."""

import math
from fractions import Fraction

import numpy as np

from .expression import Expression


def split(value: str, dtype: np.dtype, parts: int) -> list[float]:
    """A constant, given to 60 digits, as a sum of numbers of `dtype`."""
    rest, found = Fraction(value), []
    for _ in range(parts):
        part = float(dtype.type(float(rest)))
        found.append(part)
        rest -= Fraction(part)
    return found


HALF_PI = "1.57079632679489661923132169163975144209858469968755291048747"
LN2 = "0.693147180559945309417232121458176568075500134360255254120680"


class Format:
    """Widths and constants of a floating-point type."""

    def __init__(self, dtype: np.dtype) -> None:
        info = np.finfo(dtype)
        self.mantissa = info.nmant
        self.bias = 2 ** (info.bits - 2 - info.nmant) - 1
        self.integer = np.dtype(f"int{info.bits}")
        self.half_pi = split(HALF_PI, dtype, 3)
        self.ln2 = split(LN2, dtype, 2)
        self.tiny = float(info.tiny)
        # A number between these has a finite, normal exponential.
        self.overflow = float(math.log(2.0) * (self.bias + 1))
        self.underflow = -float(math.log(2.0) * (self.bias + info.nmant + 1))


_FORMATS = {np.dtype(d): Format(np.dtype(d)) for d in (np.float32, np.float64)}


def format_of(x: Expression) -> Format:
    return _FORMATS[x.dtype]
