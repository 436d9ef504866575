"""Hyperbolic functions and their inverses without branches, as formulas on scalar
expressions."""

import math

from .exponential import exp, expm1, log, log1p
from .expression import Expression, where


def _odd(x: Expression, value: Expression) -> Expression:
    """The value of an odd function from that at the size of x."""
    return where(x < 0.0, -value, value)


def tanh(x: Expression) -> Expression:
    e = expm1(-2.0 * abs(x))
    return _odd(x, -e / (2.0 + e))


def sinh(x: Expression) -> Expression:
    size = abs(x)
    e = expm1(size)
    near = 0.5 * (e + e / (e + 1.0))
    half = exp(0.5 * size)
    return _odd(x, where(size > 20.0, 0.5 * half * half, near))


def cosh(x: Expression) -> Expression:
    half = exp(0.5 * abs(x))
    square = half * half
    return where(abs(x) > 20.0, 0.5 * half * half, 0.5 * (square + 1.0 / square))


def _of_twice(x: Expression) -> Expression:
    """`log(2 x)`, also where 2 x is out of range."""
    return log(x) + math.log(2.0)


FAR = 2.0**28  # from here on, asinh and acosh are log(2 x)


def asinh(x: Expression) -> Expression:
    size = abs(x)
    far = size > FAR
    near = where(far, 1.0, size)
    square = near * near
    value = log1p(near + square / (1.0 + (1.0 + square).sqrt()))
    return _odd(x, where(far, _of_twice(size), value))


def acosh(x: Expression) -> Expression:
    far = x > FAR
    over = where(far, 1.0, x) - 1.0
    value = log1p(over + (over * (2.0 + over)).sqrt())
    return where(x < 1.0, math.nan, where(far, _of_twice(x), value))


def atanh(x: Expression) -> Expression:
    size = abs(x)
    return _odd(x, 0.5 * log1p(2.0 * size / (1.0 - size)))
