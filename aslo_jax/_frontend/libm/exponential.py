"""Elementary functions without branches, as formulas on scalar expressions.

The accuracy of each, in units in the last place, is stated in `ULP` and tested over its
whole range; sine, cosine and tangent of a computed angle are those of one that is off by
two units in its own last place at most (up to 1e15 in float64, 4e6 in float32; beyond,
sine and cosine are those of some angle). float64 and float32 share the formulas. A result
below the least normal number is right but for that number.

Source: reductions and polynomials after fdlibm (Sun Microsystems, 1993).
"""

import math
from fractions import Fraction

import numpy as np

from .expression import Expression, horner, where
from .formats import LN2, format_of

# Largest errors in float64, in units in the last place, over the ranges of the tests.
ULP = {
    "sin": 1.5,
    "cos": 1.5,
    "tan": 3.0,
    "asin": 3.0,
    "acos": 3.0,
    "atan": 2.0,
    "atan2": 2.5,
    "exp": 1.5,
    "exp2": 1.5,
    "expm1": 3.0,
    "log": 1.5,
    "log1p": 3.0,
    "log2": 4.0,
    "tanh": 4.0,
    "sinh": 4.0,
    "cosh": 3.0,
    "asinh": 4.0,
    "acosh": 4.0,
    "atanh": 4.0,
    "logistic": 4.0,
    "pow": 8.0,
    "cbrt": 1.5,
    "erf": 3.0,
    "erfc": 5.0,
    "erf_inv": 8.0,
    "rem": 0.0,
}


EXP = tuple(1.0 / math.factorial(k) for k in range(14, 1, -1))


def _power_of_two(n: Expression) -> Expression:
    """`2^n` of a whole number n within the normal exponents, from the bits of `n + bias +
    2^mantissa`, whose low bits are n + bias."""
    form = format_of(n)
    shifted = n + (2.0**form.mantissa + form.bias)
    return (shifted.bits(form.integer) << form.mantissa).bits(n.dtype)


def _exponential(r: Expression) -> Expression:
    """`exp(r) - 1` of a small r."""
    return (r * r).near_plus(horner(r, EXP), r)


def _scaled(x: Expression, n: Expression) -> Expression:
    """`2^n x` in two factors, since 2^n may be out of range where the product is not."""
    half = (0.5 * n).floor()
    return x * _power_of_two(half) * _power_of_two(n - half)


def _reduced(x: Expression) -> tuple[Expression, Expression]:
    n = (x * (1.0 / math.log(2.0))).rint()
    high, low = format_of(x).ln2
    return n, n.times_plus(-low, n.times_plus(-high, x))


def _clamped(x: Expression) -> Expression:
    form = format_of(x)
    x = where(x > form.overflow + 1.0, form.overflow + 1.0, x)
    return where(x < form.underflow - 1.0, form.underflow - 1.0, x)


def exp(x: Expression) -> Expression:
    n, r = _reduced(_clamped(x))
    return _scaled(1.0 + _exponential(r), n)


def exp2(x: Expression) -> Expression:
    form = format_of(x)
    top, bottom = form.bias + 2.0, -(form.bias + form.mantissa + 2.0)
    x = where(x > top, top, where(x < bottom, bottom, x))
    n = x.rint()
    return _scaled(1.0 + _exponential((x - n) * math.log(2.0)), n)


def expm1(x: Expression) -> Expression:
    large = x > format_of(x).overflow - 1.0
    n, r = _reduced(_clamped(where(large, 0.0, x)))
    n = where(n < -64.0, -64.0, n)
    scale = _power_of_two(n)
    return where(large, exp(x), scale.near_plus(_exponential(r), scale - 1.0))


LOG = (
    1.479819860511658591e-01,
    1.531383769920937332e-01,
    1.818357216161805012e-01,
    2.222219843214978396e-01,
    2.857142874366239149e-01,
    3.999999999940941908e-01,
    6.666666666666735130e-01,
)


def mantissa(x: Expression) -> tuple[Expression, Expression]:
    """k and m of `x = 2^k m`, m from sqrt(1/2) to sqrt(2), for a positive finite x."""
    form = format_of(x)
    small = x < form.tiny
    x = where(small, x * 2.0 ** (form.mantissa + 2), x)
    bits = x.bits(form.integer)
    # Where m would be above sqrt(2), half of it: the comparison works on the bits.
    one = bits.like(int(np.asarray(1.0, x.dtype).view(form.integer)))
    root = bits.like(int(np.asarray(math.sqrt(0.5), x.dtype).view(form.integer)))
    k = (bits + (one - root)) >> form.mantissa
    m = (bits - ((k - form.bias) << form.mantissa)).bits(x.dtype)
    # A whole number as the low bits of a float.
    magic = 2.0**form.mantissa
    number = (k + int(np.asarray(magic, x.dtype).view(form.integer))).bits(x.dtype)
    exponent = number - (magic + form.bias)
    return where(small, exponent - (form.mantissa + 2.0), exponent), m


def log(x: Expression) -> Expression:
    k, m = mantissa(x)
    f = m - 1.0
    s = f / (2.0 + f)
    z = s * s
    half = 0.5 * f * f
    high, low = exact_ln2(x)
    tail = s * (half + z * horner(z, LOG)) + k * low
    value = k * high - ((half - tail) - f)
    return _log_of_the_rest(x, value)


def exact_ln2(x: Expression) -> tuple[float, float]:
    """ln 2 in two parts, exponents times the first of which are exact."""
    bits = format_of(x).mantissa - 12
    high = math.floor(math.log(2.0) * 2.0**bits) / 2.0**bits
    return high, float(Fraction(LN2) - Fraction(high))


def _log_of_the_rest(x: Expression, value: Expression) -> Expression:
    value = where(x.equals(math.inf), math.inf, value)
    value = where(x.equals(0.0), -math.inf, value)
    return where((x >= 0.0), value, math.nan)


def log1p(x: Expression) -> Expression:
    u = 1.0 + x
    gone = u.equals(1.0) | u.equals(math.inf)
    value = log(u) * (x / where(gone, 1.0, u - 1.0))
    return where(gone, x, value)


def logistic(x: Expression) -> Expression:
    return 1.0 / (1.0 + exp(-x))
