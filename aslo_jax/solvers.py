"""Runge and Kutta's fourth-order step, for the sampled loop and as a solver of diffrax."""

from collections.abc import Callable
from typing import Any, ClassVar

import diffrax
import jax
from jaxtyping import PyTree


def runge_kutta(rate: Callable[[Any, PyTree], PyTree], t: Any, x: PyTree, h: Any) -> PyTree:
    """x at t + h, from `x' = rate(t, x)`; one step, written out."""

    def plus(scale, k):
        return jax.tree.map(lambda x, k: x + scale * k, x, k)

    k1 = rate(t, x)
    k2 = rate(t + 0.5 * h, plus(0.5 * h, k1))
    k3 = rate(t + 0.5 * h, plus(0.5 * h, k2))
    k4 = rate(t + h, plus(h, k3))
    total = jax.tree.map(lambda a, b, c, d: a + 2.0 * (b + c) + d, k1, k2, k3, k4)
    return plus(h / 6.0, total)


class RungeKutta4(diffrax.AbstractSolver):
    """The classical fourth-order method with fixed steps, written out: it has no loop over
    stages and no error estimate, so that a step costs less than one of `diffrax.Tsit5`.

    For `simulate(..., solver=RungeKutta4(), stepsize_controller=diffrax.ConstantStepSize(),
    dt0=...)`. Between steps the solution is interpolated by cubic Hermite polynomials.
    """

    term_structure: ClassVar = diffrax.AbstractTerm
    interpolation_cls: ClassVar[Callable[..., diffrax.AbstractLocalInterpolation]] = (
        diffrax.ThirdOrderHermitePolynomialInterpolation
    )

    def order(self, terms):
        return 4

    def init(self, terms, t0, t1, y0, args):
        return None

    def step(self, terms, t0, t1, y0, args, solver_state, made_jump):
        del solver_state, made_jump
        h = t1 - t0

        def rate(t, y):
            return terms.vf(t, y, args)

        y1 = runge_kutta(rate, t0, y0, h)
        steps = [jax.tree.map(lambda k: h * k, rate(*at)) for at in ((t0, y0), (t1, y1))]
        dense = {"y0": y0, "y1": y1, "k0": steps[0], "k1": steps[1]}
        return y1, None, dense, None, diffrax.RESULTS.successful

    def func(self, terms, t0, y0, args):
        return terms.vf(t0, y0, args)
