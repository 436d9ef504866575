"""Error functions without branches, as formulas on scalar expressions.

`erf_inv` after Wichura 1988, algorithm AS 241, doi:10.2307/2347330. `erfc` as `exp(-x^2)`
and a polynomial in `(x - 3)/(x + 3)`, after Shepherd and Laframboise 1981,
doi:10.1090/S0025-5718-1981-0595058-X; the coefficients are Chebyshev's, for 60 bits.
"""

import math

from .exponential import exp, log
from .expression import Expression, horner, where

# erf(x)/x in x^2, up to x = 1.
NEAR = (
    5.958930743134941e-11,
    -1.1373902296430911e-09,
    1.4660051998394848e-08,
    -1.6350354461959655e-07,
    1.6461004480962034e-06,
    -1.4925595519506043e-05,
    0.00012055331122299266,
    -0.0008548326981129666,
    0.005223977624823223,
    -0.026866170645077334,
    0.11283791670954882,
    -0.3761263890318375,
    1.1283791670955126,
)
# (1 + 2 x) exp(x^2) erfc(x) in (x - 3)/(x + 3), from x = 1/2.
AWAY = (
    3.4249205916692647e-09,
    -2.348451119310849e-08,
    1.8458135872731135e-08,
    1.3332704134332104e-07,
    -1.236270622879906e-07,
    -6.546648543935782e-07,
    3.5213240915433996e-07,
    3.4976967807320543e-06,
    -7.332184157458106e-07,
    -2.0110864373905455e-05,
    4.951142730162947e-06,
    0.0001251020159416466,
    -0.00010516033866816239,
    -0.0007798327088754327,
    0.00188869045027922,
    0.002529391859817476,
    -0.023770514926871256,
    0.06830802734151944,
    -0.11927366341494751,
    0.12964515870282553,
    -0.04756229435345671,
    -0.1356211061245817,
    1.2530080582697296,
)


def _near(x: Expression) -> Expression:
    return x * horner(x * x, NEAR)


def _away(x: Expression) -> Expression:
    """The complement of a number from 1/2."""
    x = where(x > 30.0, 30.0, x)  # of which it is zero
    value = horner((x - 3.0) / (x + 3.0), AWAY) / (1.0 + 2.0 * x)
    square = x * x
    lost = x.times_plus(x, -square)
    return exp(-square) * (value - value * lost)


def erf(x: Expression) -> Expression:
    size = abs(x)
    far = 1.0 - _away(size)
    return where(size < 1.0, _near(x), where(x < 0.0, -far, far))


def erfc(x: Expression) -> Expression:
    size = abs(x)
    far = _away(size)
    far = where(x < 0.0, 2.0 - far, far)
    return where(size < 0.5, 1.0 - _near(x), far)


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
