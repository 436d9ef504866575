"""Functions of the bits of a floating-point number."""

import math

from .expression import Expression, where
from .formats import format_of


def nextafter(x: Expression, y: Expression) -> Expression:
    """The number next to x in the direction of y."""
    integer = format_of(x).integer
    bits = x.bits(integer)
    # Away from zero the bits, without that of the sign, count upwards.
    outwards = (x < y) ^ (x < 0.0)
    beside = (bits + where(outwards, bits.like(1), -1)).bits(x.dtype)
    least = bits.like(1).bits(x.dtype)
    beside = where(x.equals(0.0), where(y > 0.0, least, -least), beside)
    value = where(x.equals(y), y, beside)
    return where(x.differs(x) | y.differs(y), math.nan, value)
