"""Runge and Kutta's fourth-order step, for the sampled loop and as a solver of diffrax."""

from ._solvers import RungeKutta4 as RungeKutta4

__all__ = [
    "RungeKutta4",
]
