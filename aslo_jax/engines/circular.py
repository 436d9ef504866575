"""Circular functions without branches, as formulas on scalar expressions.

Source: reduction and polynomials after fdlibm (Sun Microsystems, 1993).
"""

import math

from .expression import Expression, horner, where
from .formats import format_of

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


def _circular(x: Expression) -> tuple[Expression, Expression, Expression]:
    """The multiple n of pi/2 nearest to x, a whole number whose low bits count, and sine
    and cosine of what is left."""
    form = format_of(x)
    # Added to this, a number has its nearest whole one in the low bits of its mantissa.
    magic = 1.5 * 2.0**form.mantissa
    shifted = x.times_plus(2.0 / math.pi, magic)
    n = shifted - magic
    r = x
    for part in form.half_pi:
        r = n.times_plus(-part, r)
    z = r * r
    sine = (r * z).times_plus(horner(z, SIN), r)
    cosine = horner(z, (*COS, -0.5, 1.0))
    return shifted.bits(form.integer), sine, cosine


class _Quadrant:
    """Of a whole number n of right angles: whether it is odd, and the signs of sine and
    cosine, all of which the two lowest bits tell."""

    def __init__(self, n: Expression):
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
