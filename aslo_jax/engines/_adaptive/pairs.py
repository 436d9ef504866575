"""Embedded pairs of explicit Runge-Kutta methods with interpolants."""

import functools
from typing import NamedTuple

import numpy as np

from . import verner


class Pair(NamedTuple):
    """An embedded pair: `stages`, shape `(N, N)`, below the diagonal what is added up for
    each stage, of which the first `main` make a step and the others the interpolant alone;
    `weights` and `error`, shape `(main,)`, of the solution, of the given `order`, and of
    the estimate of its error, which vanishes with the power `falls` of the step; `dense`,
    shape `(N, powers)`, the weights of the interpolant as polynomials, without constants,
    of the fraction of a step. `gain`, the exponent of the integral part of the step's PI
    controller; `stable`, how far the pair is so on the negative real axis."""

    name: str
    order: int
    falls: int
    main: int
    stages: np.ndarray
    weights: np.ndarray
    error: np.ndarray
    dense: np.ndarray
    gain: float
    stable: float

    @property
    def reuses(self) -> bool:
        """Whether the last stage is at the end of a step, and so the first of the next."""
        return bool((self.stages[self.main - 1, : self.main] == self.weights).all())

    @property
    def nodes(self) -> np.ndarray:
        """The fractions of a step at which the stages are, shape `(N,)`."""
        return self.stages.sum(axis=1)


def _parsed(text: str, rows: int, columns: int) -> np.ndarray:
    found = np.zeros((rows, columns))
    row, words = 0, iter(text.split())
    for word in words:
        if word.endswith(":"):
            row = int(word[:-1]) - 1
        else:
            found[row, int(word) - 1] = float(next(words))
    return found


@functools.cache
def verner98() -> Pair:
    """Verner's pair of orders 9 and 8."""
    weights, error = _parsed(verner.WEIGHTS, 2, 16)
    stages = _parsed(verner.STAGES, 26, 26)
    dense = _parsed(verner.DENSE, 26, 9)
    return Pair("Verner 9(8)", 9, 9, 16, stages, weights, error, dense, 0.04, 4.48)


@functools.cache
def tsit5() -> Pair:
    """Tsitouras' pair of orders 5 and 4, with his interpolant of order 4.

    Ch. Tsitouras, Runge-Kutta pairs of order 5(4) satisfying only the first column
    simplifying assumption, Computers and Mathematics with Applications 62 (2011), 770-775,
    doi:10.1016/j.camwa.2011.06.002; the coefficients of the steps are those of diffrax."""
    import diffrax

    tableau = diffrax.Tsit5.tableau
    stages = np.zeros((7, 7))
    for row, given in enumerate(tableau.a_lower, 1):
        stages[row, :row] = given
    error = np.asarray(tableau.b_error)
    z = np.poly1d([1.0, 0.0])
    polynomials = [
        -1.0530884977290216
        * z
        * (z - 1.3299890189751412)
        * (z**2 - 1.4364028541716351 * z + 0.7139816917074209),
        0.1017 * z**2 * (z**2 - 2.1966568338249754 * z + 1.2949852507374631),
        2.490627285651252793
        * z**2
        * (z**2 - 2.38535645472061657 * z + 1.57803468208092486),
        -16.54810288924490272
        * z**2
        * (z - 1.21712927295533244)
        * (z - 0.61620406037800089),
        47.37952196281928122
        * z**2
        * (z - 1.203071208372362603)
        * (z - 0.658047292653547382),
        -34.87065786149660974 * z**2 * (z - 1.2) * (z - 0.666666666666666667),
        2.5 * z**2 * (z - 1) * (z - 0.6),
    ]
    dense = np.array([p.coeffs[::-1][1:5] for p in polynomials])
    return Pair("Tsit5", 5, 5, 7, stages, stages[6], error, dense, 0.07, 3.51)


LOOSE = 2e-5  # tolerance from which on the pair of lower order takes less


def pair_for(tolerance: float) -> Pair:
    """The pair that takes less for a relative tolerance."""
    return tsit5() if tolerance >= LOOSE else verner98()
