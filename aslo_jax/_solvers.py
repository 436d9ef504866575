"""Runge and Kutta's fourth-order step, for the sampled loop and as a solver of diffrax."""

from collections.abc import Callable
from typing import Any, ClassVar

import diffrax
import jax

from ._runge_kutta import runge_kutta as runge_kutta

__all__ = ["RungeKutta4", "runge_kutta"]


class RungeKutta4(diffrax.AbstractSolver[None]):
    """The classical fourth-order method with fixed steps, written out: it has no loop over
    stages and no error estimate, so that a step costs less than one of `diffrax.Tsit5`.

    For `simulate(..., solver=RungeKutta4(), stepsize_controller=diffrax.ConstantStepSize(),
    dt0=...)`. Between steps the solution is interpolated by cubic Hermite polynomials.
    """

    term_structure: ClassVar = diffrax.AbstractTerm
    interpolation_cls: ClassVar[Callable[..., diffrax.AbstractLocalInterpolation]] = (
        diffrax.ThirdOrderHermitePolynomialInterpolation
    )

    def order(self, terms: Any) -> Any:
        return 4

    def init(self, terms: Any, t0: Any, t1: Any, y0: Any, args: Any) -> Any:
        return None

    def step(
        self,
        terms: Any,
        t0: Any,
        t1: Any,
        y0: Any,
        args: Any,
        solver_state: Any,
        made_jump: Any,
    ) -> Any:
        del solver_state, made_jump
        h = t1 - t0

        def rate(t, y):
            return terms.vf(t, y, args)

        y1 = runge_kutta(rate, t0, y0, h)
        steps = [jax.tree.map(lambda k: h * k, rate(*at)) for at in ((t0, y0), (t1, y1))]
        dense = {"y0": y0, "y1": y1, "k0": steps[0], "k1": steps[1]}
        return y1, None, dense, None, diffrax.RESULTS.successful

    def func(self, terms: Any, t0: Any, y0: Any, args: Any) -> Any:
        return terms.vf(t0, y0, args)
