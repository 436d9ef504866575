"""Completions: from one row `r'x = b`, or from several, to an estimate of all n entries of
x."""

import abc
from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from ._checks import kind
from ._filters import AbstractFilter, LowPass
from ._module import Module
from ._realise import Pass
from ._relations import Row, settled, swap
from ._small import safe_reciprocal, safe_rsqrt, solve_definite, solve_rows
from ._swapped import INFORMATION, KNOWN, Motion
from ._typing import RealArray
from ._varying import Varying

__all__ = ["AbstractCompletion", "FilterBank", "LeastSquares", "Repeat"]


class AbstractCompletion(Module):
    """Completes a row, or a batch of them, to n independent ones and solves them.

    Called with a pass and a row, it returns

    - `x`, shape `(n,)`, in the units of the state;
    - the certificate, shape `()`: the reciprocal condition number of the problem, taken as
      the harmonic mean of the eigenvalues of the information matrix `R'R` whose columns
      are scaled by the size of the terms that the row is the difference of. It is
      dimensionless, at most about one, and zero where x is not observable: a state at
      rest has small rows beside large terms.
    """

    @abc.abstractmethod
    def __call__(
        self, F: Pass, row: Row
    ) -> tuple[Float[Array, " n"], Float[Array, ""]]: ...


class Repeat(AbstractCompletion):
    """The paper's completion: the Swapping Lemma again, n - 1 times, with one filter.

    Source: paper, Prop. 2, w7 to w9; theory, section 3.
    """

    def __call__(self, F: Pass, row: Row) -> tuple[RealArray, RealArray]:
        rows = [row]
        for k in range(1, row.r.shape[-1]):
            rows.append(swap(F.scope(f"repeat{k}"), rows[-1]))
        return _solve(rows)


def _several(filters: Any) -> tuple[AbstractFilter, ...]:
    if not isinstance(filters, list | tuple):
        kind("filters", filters, list, hint="a list of filters")
    for k, each in enumerate(filters):
        kind(f"filters[{k}]", each, AbstractFilter, hint="a filter")
    return tuple(filters)


class FilterBank(AbstractCompletion):
    """One further row for each of `filters`, at least n - 1 of them; more than that are
    solved in the sense of least squares.

    Source: paper, O7 and conclusions ("different filters"); theory, section 3.

    **Raises:** `ValueError` for fewer `filters` than that, once the relation gives n.
    """

    filters: tuple[AbstractFilter, ...] = eqx.field(converter=_several)

    def __call__(self, F: Pass, row: Row) -> tuple[RealArray, RealArray]:
        n, given = row.r.shape[-1], 1 if row.r.ndim == 1 else row.r.shape[0]
        if given * (1 + len(self.filters)) < n:
            least = -(-n // given) - 1
            what = "n - 1" if given == 1 else f"n/{given} - 1"
            raise ValueError(
                f"Argument `filters` must hold at least {what} = {least} filters for a "
                f"state of {n} entries, but got {len(self.filters)}."
            )
        bank = enumerate(self.filters, start=1)
        return _solve([row] + [swap(F.scope(f"bank{k}").using(f), row) for k, f in bank])


class LeastSquares(AbstractCompletion):
    """Kreisselmeier's regressor: `M = F[r r']`, `v = F[r b] + ...`, `x = M^-1 v`.

    M is symmetric, positive semidefinite, and never crosses zero, so a change of sign of
    the paper's determinant is no event. `forgetting` is the low-pass filter of M, by
    default the observer's own.

    Source: theory, section 3; Kreisselmeier 1977, doi:10.1109/TAC.1977.1101401.

    **Raises:** `ValueError` where `forgetting` is not given and the observer's filter is no
    [`LowPass`][].
    """

    forgetting: LowPass | None = None

    def __call__(self, F: Pass, row: Row) -> tuple[RealArray, RealArray]:
        forgetting = F.filter if self.forgetting is None else self.forgetting
        if not isinstance(forgetting, LowPass | Varying):
            raise ValueError(
                "Argument `forgetting` must be a `LowPass` when the observer's filter is "
                f"not one, but got {type(forgetting).__name__}: any other filter may make "
                "the information matrix indefinite."
            )
        F = F.using(forgetting)
        r, b, motion = row.r, row.b, Motion(row.z, row.A)
        if r.ndim == 1:
            rr, rb = F.inject(r[:, None] * r), F.inject(r * b)
        else:
            rr = F.inject(jnp.sum(r[:, :, None] * r[:, None, :], axis=0))
            rb = F.inject(jnp.sum(r * b[:, None], axis=0))
        if row.A is None:
            M = F.hidden(rr, "M")
        elif row.constant and not F.exact:
            A = row.A

            def drive(M):
                return rr - A.T @ M - M @ A

            still = settled(lambda M: F.filter.flow(M, drive(M)), rr)
            M = F.standing(drive, still, "M")
        else:
            M = F.carried(INFORMATION, rr, motion, "M")
        v = F.carried(KNOWN, rb, motion, "v", X=M, w=rr)
        if row.A is None:
            # In a hole M decays and this does not, so that the certificate does.
            scale = F.hidden(F.filter.inject(row.scale**2), "scale")
        else:
            M, v, scale = F.output(M), F.output(v), row.scale**2
        if row.honest:
            scale = jnp.maximum(scale, jnp.diagonal(M))
        return solve_definite(M, v, scale)


def _solve(rows: list[Row]) -> tuple[Float[Array, " n"], Float[Array, ""]]:
    join = jnp.stack if rows[0].r.ndim == 1 else jnp.concatenate
    R, b = join([row.r for row in rows]), join([row.b for row in rows])
    if rows[0].isotropic:
        square = jnp.max(jnp.sum(R * R, axis=-1)) / R.shape[-1]
        size = square * safe_rsqrt(square)
    else:
        size = jnp.max(jnp.abs(R), axis=0)
    unit = safe_reciprocal(size + rows[0].scale)
    x, certificate = solve_rows(R * unit, b)
    return x * unit, certificate
