"""Elementary functions without branches, as formulas on scalar expressions.

The accuracy of each, in units in the last place, is stated in `ULP` and tested over its
whole range; sine, cosine and tangent of a computed angle are those of one that is off by
two units in its own last place at most (up to 1e15 in float64, 4e6 in float32). float64
and float32 share the formulas.

Source: reductions and polynomials after fdlibm (Sun Microsystems, 1993); `erf_inv` after
Wichura 1988, algorithm AS 241, doi:10.2307/2347330.
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
    "tanh": 4.0,
    "sinh": 4.0,
    "cosh": 3.0,
    "logistic": 4.0,
    "pow": 8.0,
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
    return (r * r).times_plus(horner(r, EXP), r)


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
    return where(large, exp(x), scale.times_plus(_exponential(r), scale - 1.0))


LOG = (
    1.479819860511658591e-01,
    1.531383769920937332e-01,
    1.818357216161805012e-01,
    2.222219843214978396e-01,
    2.857142874366239149e-01,
    3.999999999940941908e-01,
    6.666666666666735130e-01,
)


def _mantissa(x: Expression) -> tuple[Expression, Expression]:
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
    k, m = _mantissa(x)
    f = m - 1.0
    s = f / (2.0 + f)
    z = s * s
    half = 0.5 * f * f
    high, low = _exact_ln2(x)
    tail = s * (half + z * horner(z, LOG)) + k * low
    value = k * high - ((half - tail) - f)
    return _log_of_the_rest(x, value)


def _exact_ln2(x: Expression) -> tuple[float, float]:
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


def tanh(x: Expression) -> Expression:
    e = expm1(-2.0 * abs(x))
    value = -e / (2.0 + e)
    return where(x < 0.0, -value, value)


def sinh(x: Expression) -> Expression:
    size = abs(x)
    e = expm1(size)
    near = 0.5 * (e + e / (e + 1.0))
    half = exp(0.5 * size)
    value = where(size > 20.0, 0.5 * half * half, near)
    return where(x < 0.0, -value, value)


def cosh(x: Expression) -> Expression:
    half = exp(0.5 * abs(x))
    square = half * half
    return where(abs(x) > 20.0, 0.5 * half * half, 0.5 * (square + 1.0 / square))


def logistic(x: Expression) -> Expression:
    return 1.0 / (1.0 + exp(-x))


def power(x: Expression, y: Expression) -> Expression:
    size = abs(x)
    whole = y.equals(y.floor())
    odd = whole & (0.5 * y).differs((0.5 * y).floor())
    up = y > 0.0
    value = _positive_power(size, y)
    value = where(size.equals(0.0), where(up, y.like(0.0), math.inf), value)
    value = where(size.equals(math.inf), where(up, y.like(math.inf), 0.0), value)
    value = where(x < 0.0, where(whole, where(odd, -value, value), math.nan), value)
    value = where(x.differs(x) | y.differs(y), x + y, value)
    return where(y.equals(0.0) | x.equals(1.0), 1.0, value)


def _positive_power(x: Expression, y: Expression) -> Expression:
    """`exp(y log x)` with the logarithm to twice the precision: `log m = 2 artanh(s)`,
    `s = f/(2 + f)`, of which the series beyond 2 s is a hundredth at most."""
    k, m = _mantissa(x)
    f = m - 1.0
    d = 2.0 + f
    s = f / d
    rest = ((-s).times_plus(d, f) - s * (f - (d - 2.0))) / d
    z = s * s
    series = s * z * horner(z, tuple(2.0 / (2 * j + 1) for j in range(12, 0, -1)))
    high, low = _exact_ln2(x)
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


# Wichura's rational functions: numerator and denominator, the highest power first.
CENTRE = (
    (
        2.5090809287301226727e3,
        3.3430575583588128105e4,
        6.7265770927008700853e4,
        4.5921953931549871457e4,
        1.3731693765509461125e4,
        1.9715909503065514427e3,
        1.3314166789178437745e2,
        3.3871328727963666080e0,
    ),
    (
        5.2264952788528545610e3,
        2.8729085735721942674e4,
        3.9307895800092710610e4,
        2.1213794301586595867e4,
        5.3941960214247511077e3,
        6.8718700749205790830e2,
        4.2313330701600911252e1,
        1.0,
    ),
)
MIDDLE = (
    (
        7.74545014278341407640e-4,
        2.27238449892691845833e-2,
        2.41780725177450611770e-1,
        1.27045825245236838258e0,
        3.64784832476320460504e0,
        5.76949722146069140550e0,
        4.63033784615654529590e0,
        1.42343711074968357734e0,
    ),
    (
        1.05075007164441684324e-9,
        5.47593808499534494600e-4,
        1.51986665636164571966e-2,
        1.48103976427480074590e-1,
        6.89767334985100004550e-1,
        1.67638483018380384940e0,
        2.05319162663775882187e0,
        1.0,
    ),
)
FAR = (
    (
        2.01033439929228813265e-7,
        2.71155556874348757815e-5,
        1.24266094738807843860e-3,
        2.65321895265761230930e-2,
        2.96560571828504891230e-1,
        1.78482653991729133580e0,
        5.46378491116411436990e0,
        6.65790464350110377720e0,
    ),
    (
        2.04426310338993978564e-15,
        1.42151175831644588870e-7,
        1.84631831751005468180e-5,
        7.86869131145613259100e-4,
        1.48753612908506148525e-2,
        1.36929880922735805310e-1,
        5.99832206555887937690e-1,
        1.0,
    ),
)


def _rational(x: Expression, fraction: tuple) -> Expression:
    return horner(x, fraction[0]) / horner(x, fraction[1])


def erf_inv(x: Expression) -> Expression:
    """By the quantile of the normal distribution at `(1 + x)/2`."""
    q = 0.5 * x
    centre = q * _rational(0.180625 - q * q, CENTRE)
    tail = 0.5 * (1.0 - abs(x))
    r = (-log(tail)).sqrt()
    beyond = where(r <= 5.0, _rational(r - 1.6, MIDDLE), _rational(r - 5.0, FAR))
    beyond = where(tail.equals(0.0), math.inf, where(x < 0.0, -beyond, beyond))
    beyond = where(x.equals(-1.0), -math.inf, beyond)
    return where(abs(q) <= 0.425, centre, beyond) * math.sqrt(0.5)


def rem(x: Expression, y: Expression) -> Expression:
    """The remainder of the division truncated towards zero, with the sign of x: exact for
    quotients up to 2^mantissa."""
    size, divisor = abs(x), abs(y)
    quotient = (size / divisor).floor()
    left = (-quotient).times_plus(divisor, size)
    left = where(left < 0.0, left + divisor, left)
    left = where(left >= divisor, left - divisor, left)
    left = where(divisor.equals(math.inf) & (size < math.inf), size, left)
    return where(x < 0.0, -left, left)
