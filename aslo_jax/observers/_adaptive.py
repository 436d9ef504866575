"""The Kalman filter of a relation some of whose parameters are unknown."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from .._checks import is_concrete, kind, optional_real, positive, real
from .._realise import Pass
from .._typing import PyTree
from ._adaptive_filter import ALIVE, REACH, AdaptiveKalman
from ._adaptive_model import Model, leaf_of
from ._base import AbstractObserver, Estimate
from ._lifted import _deviation, curved_certificate
from ._lifted_filter import hole_of
from ._lifting import entries

IMPROBABLE = 5.0  # deviations of a parameter


def uncertain(certificate: Array, tolerance: Array) -> Bool[Array, "..."]:
    """Whether what is not known is more than `tolerance` of what is."""
    return certificate * (1.0 + tolerance * tolerance) < 1.0


def _one_each(x: Any) -> Array:
    """A tuple or a list is one array."""
    return real(jnp.asarray(x)) if isinstance(x, list | tuple) else real(x)


class AdaptiveEstimate(Estimate):
    """An [`Estimate`][] with the parameters of the relation.

    - `parameters`: their values, shape `(q,)`, in their own units, in the order in which
      the observer names them;
    - `parameter_covariance`: theirs, shape `(q, q)`, in products of their units;
    - `held`: whether the parameters are held, since the record does not tell what they
      are, shape `()`.
    """

    parameters: Float[Array, "*batch q"] = eqx.field(kw_only=True)
    parameter_covariance: Float[Array, "*batch q q"] = eqx.field(kw_only=True)
    held: Bool[Array, "*batch"] = eqx.field(kw_only=True)


class Adaptive(AbstractObserver[AdaptiveEstimate]):
    """The Kalman filter of a quadratic relation some of whose parameters are not known, for
    sampled signals: they are states beside x, and what is found of them is in the estimate.
    It starts from nothing known of x, by an algebraic fit for each of a bank of values of
    the first parameter, of which one filter is left where the record tells which.

    - `relation`: `relation(u, y)` gives the terms of one [`Quadratic`][] in the unmeasured
      x; for a motor a [`FluxRelation`][], the magnet flux in it;
    - `output_deviation`, `input_deviation`: as of [`Lifted`][];
    - `parameters`: the names of the scalar leaves of the relation that are not known, such
      as `("resistance", "magnet_flux")`, of a derived one those of its model. The first one
      is that of the bank: the one that moves x, on which the rest depends most;
    - `deviations`, shape `(q,)`: their standard deviations, relative to their values in the
      relation. The bank covers three times that of the first one, to both sides;
    - `drift`: their random walk, relative, for a temperature that changes: its standard
      deviation after a second (1/sqrt(s)), shape `()` or `(q,)`;
    - `hold`: the parameters are held where the first one is not known to this relative
      deviation and information on it comes so slowly that it may be what noise feigns;
    - `bank`: how many values of the first parameter;
    - `initial`: x before it is known, shape `(n,)`; zero by default;
    - `tolerance`: what is not known of x may be so much of its size, for a motor that of
      the flux of its magnet, where the estimate is given without a flag.

    The estimate is an [`AdaptiveEstimate`][]. It is `coasting` until the bank has started;
    where it is not known to the `tolerance`, as at rest; and while a rival solution lives:
    at one constant slow speed, a motor with another resistance whose magnet points the
    other way has the very same currents and voltages. So it is while a parameter is found 5
    of its `deviations` away: that is no solution.
    Its certificate is that of [`Lifted`][], and 0 before the start. Where a sample is
    missing it is carried along the known derivative, and says so; its covariance grows as
    if all that is held in place of the sample were wrong, and once x may be off by a tenth
    of its size, the bank starts again.

    A parameter must not be off by more than the bank covers, and at least one must be known
    a priori to some per cent: at a constant speed the resistance is known by the magnet
    flux alone. What is not named is taken as exact.

    Source: theory, section 10; Sorenson, Alspach 1971, doi:10.1016/0005-1098(71)90097-5
    (Gaussian sums); Schmidt 1966, doi:10.1016/B978-1-4831-6716-9.50011-4 (the hold).

    **Raises:** `ValueError` in continuous time; for parameters that are no numbers of the
    relation, or zero; for deviations that are not one for each, or so wide that the bank
    contains zero; for a bank of fewer than 3; and for a relation of another kind.
    """

    relation: Callable[[PyTree, PyTree], Any]
    output_deviation: PyTree = eqx.field(converter=_deviation)
    input_deviation: PyTree = eqx.field(converter=_deviation)
    parameters: tuple[str, ...] = eqx.field(
        static=True, converter=tuple, default=("resistance", "magnet_flux")
    )
    deviations: Float[Array, " q"] = eqx.field(converter=_one_each, default=(0.1, 0.02))
    drift: Float[Array, "*q"] = eqx.field(converter=real, default=0.0)
    hold: Float[Array, ""] = eqx.field(converter=real, default=0.03)
    bank: int = eqx.field(static=True, default=11)
    initial: Float[Array, " n"] | None = eqx.field(converter=optional_real, default=None)
    tolerance: Float[Array, ""] = eqx.field(converter=real, default=0.01)

    def __check_init__(self) -> None:
        if not callable(self.relation):
            kind("relation", self.relation, hint="a relation, `relation(u, y)`")
        for name in ("output_deviation", "input_deviation"):
            for leaf in jax.tree.leaves(getattr(self, name)):
                positive(name, leaf)
        positive("deviations", self.deviations)
        positive("hold", self.hold)
        positive("tolerance", self.tolerance)
        if not isinstance(self.bank, int) or self.bank < 3:
            raise ValueError(
                f"Argument `bank` must be an integer of at least 3, but got {self.bank!r}."
            )
        self._check_parameters()

    def _check_parameters(self) -> None:
        names, count = self.parameters, jnp.shape(self.deviations)
        if not names or len(set(names)) < len(names):
            raise ValueError(
                "Argument `parameters` must name leaves of the relation, each once, but "
                f"got {names!r}."
            )
        for name in names:
            value = leaf_of(self.relation, name)
            if type(value) is object:
                return
            if value is None or jnp.shape(value) != ():
                raise ValueError(
                    "Argument `parameters` must name numbers that the relation has, but "
                    f"`{name}` is none of {type(self.relation).__name__}."
                )
            number = is_concrete(value) and isinstance(value, jax.Array | float | int)
            if number and float(value) == 0.0:
                raise ValueError(
                    "Argument `parameters` must name parameters that are not zero, since "
                    f"deviations are relative, but `{name}` is; give it to the relation."
                )
        if not isinstance(self.deviations, jax.Array):
            return
        if count != (len(names),):
            raise ValueError(
                f"Argument `deviations` must be one for each of {names!r}, but has the "
                f"shape {count}."
            )
        if is_concrete(self.deviations) and REACH * float(self.deviations[0]) >= 1.0:
            raise ValueError(
                f"Argument `deviations` must be below {1 / REACH:.3g} for the first "
                "parameter, whose bank would have values of either sign, but got "
                f"{float(self.deviations[0]):g}."
            )

    @property
    def law(self) -> AdaptiveKalman:
        """The filter itself."""
        model = Model(
            self.relation, self.parameters, self.output_deviation, self.input_deviation
        )
        drift = jnp.broadcast_to(self.drift, self.deviations.shape)
        rest = self.hold, self.initial, self.bank
        return AdaptiveKalman(model, self.deviations, drift, *rest)

    def vector_field(self, t: Any, state: Any, u: PyTree, y: PyTree) -> Any:
        raise ValueError(
            "`Adaptive` is an observer of samples; use `step` or `replay`, or in "
            "continuous time a `Lifted`, which takes the parameters as known."
        )

    def equations(self, F: Pass, u: PyTree, y: PyTree) -> AdaptiveEstimate:
        law = self.law
        hole = hole_of(F, law.model.dtype(u, y))
        belief = F.evolve(law, (u, y, hole), law.start(u, y), "belief")
        model, q = law.model, len(self.parameters)
        n = belief.mean.shape[0] - q
        x, P = belief.mean[:n], belief.covariance
        row = model.row(belief.mean[n:], u, y)
        spread = [entries(line) for line in P[:n, :n]]
        certificate = curved_certificate((row,), x, spread)
        nominal = model.nominal().astype(x.dtype)
        improbable = jnp.any(jnp.abs(belief.mean[n:]) > IMPROBABLE * self.deviations)
        doubted = belief.rivals > ALIVE
        doubted = doubted | improbable | uncertain(certificate, self.tolerance)
        return AdaptiveEstimate(
            x,
            jnp.where(belief.started, certificate, 0.0),
            ~belief.started | doubted,
            P[:n, :n],
            parameters=nominal * (1.0 + belief.mean[n:]),
            parameter_covariance=nominal[:, None] * nominal * P[n:, n:],
            held=belief.held,
        )
