"""Circular functions without branches, as formulas on scalar expressions.

Source: reduction and polynomials after fdlibm (Sun Microsystems, 1993).
"""

import math
from fractions import Fraction

from .expression import Expression, horner, where
from .formats import HALF_PI, Format, format_of

SIN = (
    1.58969099521155010221e-10,
    -2.50507602534068634195e-08,
    2.75573137070700676789e-06,
    -1.98412698298579493134e-04,
    8.33333333332248946124e-03,
    -1.66666666666666324348e-01,
)
COS = (
    -1.13596475577881948265e-11,
    2.08757232129817482790e-09,
    -2.75573143513906633035e-07,
    2.48015872894767294178e-05,
    -1.38888888888741095749e-03,
    4.16666666666666019037e-02,
)


def _in_right_angles(coefficients: tuple[float, ...], power: int) -> tuple[float, ...]:
    """Of a polynomial in x^2, times x^power, those for x in units of pi/2."""
    unit, last = Fraction(HALF_PI), len(coefficients) - 1
    powers = (power + 2 * (last - k) for k in range(last + 1))
    return tuple(
        float(Fraction(c) * unit**p) for c, p in zip(coefficients, powers, strict=True)
    )


BOUND = 0.8  # above pi/4 and what rounding adds to it
SIN_OF_RIGHT = _in_right_angles((*SIN, 1.0), 1)  # without the first factor of the sine
COS_OF_RIGHT = _in_right_angles((*COS, -0.5, 1.0), 0)


def _circular(x: Expression) -> tuple[Expression, Expression, Expression]:
    """The multiple n of pi/2 nearest to x, a whole number whose low bits count, and sine
    and cosine of what is left."""
    return _of_computed(x) if _computed(x) else _of_given(x)


def _computed(x: Expression) -> bool:
    """Whether it is the result of a sum or a product, or of the step before: then it has
    been rounded, and its multiple in right angles is as exact as it is."""
    node = x.graph.nodes[x.number]
    carried = node.op == "input" and node.data[0] == "carry"
    return carried or node.op in ("add", "sub", "mul", "fma")


def _of_computed(x: Expression) -> tuple[Expression, Expression, Expression]:
    """In right angles, the multiple is a whole number and what is left is exact; the unit
    meets other factors of the angle."""
    form = format_of(x)
    angle = x * (2.0 / math.pi)
    n = angle.rint()
    r = angle - n
    z = r * r
    shifted = n + _shift(form)
    return (
        shifted.bits(form.integer),
        r * horner(z, SIN_OF_RIGHT),
        horner(z, COS_OF_RIGHT),
    )


def _of_given(x: Expression) -> tuple[Expression, Expression, Expression]:
    """By Cody and Waite: pi/2 has as many digits as the nearest multiple needs."""
    form = format_of(x)
    if x.graph.goal.fuses:
        shifted = x.times_plus(2.0 / math.pi, _shift(form))
        n = shifted - _shift(form)
    else:
        n = (x * (2.0 / math.pi)).rint()
        shifted = n + _shift(form)
    r = x
    for part in form.half_pi:
        r = n.times_plus(-part, r)
    # Of an angle with fewer digits than the multiple has, any rest within its bounds will
    # do: sine and cosine stay those of one angle.
    r = where(r > BOUND, BOUND, where(r < -BOUND, -BOUND, r))
    z = r * r
    sine = (r * z).near_plus(horner(z, SIN), r)
    cosine = horner(z, (*COS, -0.5, 1.0))
    return shifted.bits(form.integer), sine, cosine


def _shift(form: Format) -> float:
    """Added to this, a number has its nearest whole one in the low bits of its mantissa."""
    return 1.5 * 2.0**form.mantissa


class _Quadrant:
    """Of a whole number n of right angles: whether it is odd, and the signs of sine and
    cosine, all of which the two lowest bits tell."""

    def __init__(self, n: Expression) -> None:
        top = 8 * n.dtype.itemsize - 1
        self.lowest, self.second = n << top, n << (top - 1)
        self.sign = n.like(-(2**top))
        self.odd = self.lowest < 0

    def signed(self, value: Expression, turn: Expression) -> Expression:
        bits = value.bits(turn.dtype) ^ (turn & self.sign)
        return bits.bits(value.dtype)


def sin(x: Expression) -> Expression:
    n, sine, cosine = _circular(x)
    quadrant = _Quadrant(n)
    return quadrant.signed(where(quadrant.odd, cosine, sine), quadrant.second)


def cos(x: Expression) -> Expression:
    n, sine, cosine = _circular(x)
    quadrant = _Quadrant(n)
    turn = quadrant.second ^ quadrant.lowest
    return quadrant.signed(where(quadrant.odd, sine, cosine), turn)


def tan(x: Expression) -> Expression:
    n, sine, cosine = _circular(x)
    odd = _Quadrant(n).odd
    return where(odd, -cosine, sine) / where(odd, sine, cosine)


ATAN = (
    1.62858201153657823623e-02,
    -3.65315727442169155270e-02,
    4.97687799461593236017e-02,
    -5.83357013379057348645e-02,
    6.66107313738753120669e-02,
    -7.69187620504482999495e-02,
    9.09088713343650656196e-02,
    -1.11111104054623557880e-01,
    1.42857142725034663711e-01,
    -1.99999999998764832476e-01,
    3.33333333333329318027e-01,
)


def atan2(y: Expression, x: Expression) -> Expression:
    form = format_of(x)
    width, height = abs(x), abs(y)
    steep = height > width
    small, large = where(steep, width, height), where(steep, height, width)
    both = small.equals(math.inf)
    small, large = where(both, 1.0, small), where(both, 1.0, large)
    big = small > large * math.tan(math.pi / 8)
    over = where(big, small - large, small)
    under = where(big, small + large, large)
    t = over / where(under.equals(0.0), 1.0, under)
    z = t * t
    angle = t - t * (z * horner(z, ATAN))
    quarter, rest = 0.5 * form.half_pi[0], 0.5 * form.half_pi[1]
    angle = where(big, quarter + (angle + rest), angle)
    angle = where(steep, form.half_pi[0] - (angle - form.half_pi[1]), angle)
    backward = x.bits(form.integer) < 0
    turn = 2.0 * form.half_pi[0]
    angle = where(backward, turn - (angle - 2.0 * form.half_pi[1]), angle)
    angle = where(y.bits(form.integer) < 0, -angle, angle)
    return where(x.differs(x) | y.differs(y), x + y, angle)


def atan(x: Expression) -> Expression:
    return atan2(x, x.like(1.0))


def asin(x: Expression) -> Expression:
    return atan2(x, ((1.0 - x) * (1.0 + x)).sqrt())


def acos(x: Expression) -> Expression:
    return atan2(((1.0 - x) * (1.0 + x)).sqrt(), x)
