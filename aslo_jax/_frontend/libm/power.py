"""Powers, roots and remainders without branches, as formulas on scalar expressions."""

import math

from .exponential import exact_ln2, exp, log, mantissa
from .expression import Expression, horner, where
from .formats import format_of


def power(x: Expression, y: Expression) -> Expression:
    """As IEEE 754 has it: `pow(x, 0)` and `pow(1, y)` are 1 for any other argument."""
    size = abs(x)
    whole = y.equals(y.floor())
    odd = whole & (0.5 * y).differs((0.5 * y).floor())
    value = where(size.equals(1.0), 1.0, _positive_power(size, y))
    up = y > 0.0
    value = where(size.equals(0.0), where(up, y.like(0.0), math.inf), value)
    value = where(size.equals(math.inf), where(up, y.like(math.inf), 0.0), value)
    negative = x.bits(format_of(x).integer) < 0  # as a zero may be
    value = where(negative & odd, -value, value)
    value = where((x < 0.0) & (x > -math.inf) & ~whole, math.nan, value)
    value = where(x.differs(x) | y.differs(y), x + y, value)
    return where(y.equals(0.0) | x.equals(1.0), 1.0, value)


def _positive_power(x: Expression, y: Expression) -> Expression:
    """`exp(y log x)` with the logarithm to twice the precision: `log m = 2 artanh(s)`,
    `s = f/(2 + f)`, of which the series beyond 2 s is a hundredth at most."""
    k, m = mantissa(x)
    f = m - 1.0
    d = 2.0 + f
    s = f / d
    rest = ((-s).times_plus(d, f) - s * (f - (d - 2.0))) / d
    z = s * s
    series = s * z * horner(z, tuple(2.0 / (2 * j + 1) for j in range(12, 0, -1)))
    high, low = exact_ln2(x)
    first, second = k * high, 2.0 * s
    total = first + second
    back = total - first
    lost = (first - (total - back)) + (second - back)
    tail = lost + (series + 2.0 * rest + k * low)
    total, tail = total + tail, tail - ((total + tail) - total)
    product = y * total
    remainder = y.times_plus(total, -product) + y * tail
    value = exp(product)
    corrected = value.times_plus(remainder, value)
    return where(value.equals(math.inf) | value.equals(0.0), value, corrected)


def cbrt(x: Expression) -> Expression:
    """By the logarithm, and a step of Newton's method."""
    size = abs(x)
    usual = (size > 0.0) & (size < math.inf)
    size = where(usual, size, 1.0)
    root = exp(log(size) / 3.0)
    root = root - (root - size / (root * root)) / 3.0
    return where(usual, where(x < 0.0, -root, root), x)


def rem(x: Expression, y: Expression) -> Expression:
    """The remainder of the division truncated towards zero, with the sign of x: exact for
    quotients up to 2^96 (2^80 in float32), and zero for larger ones."""
    size, divisor = abs(x), abs(y)
    left = size
    for _ in range(2 if x.dtype.itemsize == 8 else 4):
        left = (-_shortened(left / divisor)).times_plus(divisor, left)
    left = where(left < 0.0, left + divisor, left)
    inside = (left >= 0.0) & (left < divisor)
    lost = where((size < math.inf) & (divisor > 0.0), size.like(0.0), math.nan)
    left = where(inside, left, lost)
    left = where(size < divisor, size, left)
    return where(x < 0.0, -left, left)


def _shortened(quotient: Expression) -> Expression:
    """The whole number next to a quotient, to three digits less than it has: times the
    divisor it leaves what can be told exactly, though the last two may be wrong."""
    bits = quotient.rint().bits(format_of(quotient).integer)
    return ((bits + 4) & -8).bits(quotient.dtype)
