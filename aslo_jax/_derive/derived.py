"""What is derived from a model: the relation, and all that is known of it."""

import dataclasses
from collections.abc import Sequence
from typing import Any, overload

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._checks import unlike
from .._filters import AbstractFilter
from .._guard import Guard
from .._structure import Region
from ..observers import Adaptive, Lifted
from ..plants import AbstractMechanicalSystem, AbstractModelledPlant
from .certificate import Certificate, certificate
from .changes import Change, changed, integrating
from .closure import Closure, Constant
from .decoding import decoder, lifted_states
from .dictionary import Matrix, covectors
from .lifted import Lowered, closed, lower
from .mechanical import DerivedVelocities, derive_velocities
from .model import Model
from .observer import Coordinates, StateObserver, state_observer
from .of_plant import once
from .plant import ModelPlant, plant_of
from .polynomials import Ring, Sampled
from .refusal import reason, refusal
from .relation import DerivedRelation, Parts, relation_of
from .symbols import Program, program

NOISELESS = 1e-9  # the deviation of inputs that are known
DRAWN = 256  # points of the ranges, which say how large the relation's x is
PERTURBED = 0.2  # of parameters, to see whether a closure holds for others too


@dataclasses.dataclass(frozen=True, eq=False)
class Derived:
    """A relation that was derived from a model.

    - `model`: the model; `relation`: for [`AlgebraicObserver`][] and what takes relations;
    - `lifted`: what the entries of the relation's x are, in words, `v~` being a state v in
      coordinates that depend on what is measured; `states`: the states of
      the model that are found from it, `undetermined` those that are not; `notes` on what
      is left open of a state, by its name;
    - `kind`: that of the relation, in words; `proved`: whether it holds by the form of the
      model alone, or was checked at points of its ranges besides;
    - `slowest`: the rate (rad/s) that the low-pass filter of a least-squares observer must
      be above, half of it for one that repeats; zero where any will do;
    - `unused`: why equations of the model are not part of it;
    - `coordinates`: from the relation's x to the states.
    """

    model: Model
    relation: DerivedRelation
    lifted: tuple[str, ...]
    states: tuple[str, ...]
    undetermined: tuple[str, ...]
    notes: dict[str, str]
    kind: str
    proved: bool
    slowest: float
    unused: tuple[str, ...]
    coordinates: Coordinates
    _ring: Ring = dataclasses.field(repr=False)
    _basis: tuple[Constant, ...] = dataclasses.field(repr=False)

    def decode(
        self, X: Float[Array, "*batch n"], y: Float[Array, "*batch p"]
    ) -> Float[Array, "*batch k"]:
        """The `states`, shape `(..., k)`, from the relation's x, `X` of shape `(..., n)`,
        and the outputs, `y` of shape `(..., p)`."""
        of = self.relation.values, jnp.asarray(X), jnp.asarray(y)
        return self.coordinates.states(*of)[0]

    def lift(
        self, x: Float[Array, "N n"], y: Float[Array, "N p"]
    ) -> Float[np.ndarray, "N m"]:
        """The relation's x, shape `(N, m)`, of all states of the model, `x` of shape `(N,
        n)`, unknown parameters the last ones, and the outputs, `y` of shape `(N, p)`."""
        values, change = np.asarray(x, float), self.coordinates.change
        if change is not None:
            into = jax.vmap(lambda x, y: change.into(x, y, self.relation.values))
            values = np.asarray(into(jnp.asarray(values), jnp.asarray(y)))
        return lifted_states(self._ring, self._basis, values, self.model.values())

    def certificate(self, cutoff: float | None = None, seed: int = 0) -> Certificate:
        """What the relation is worth on simulated signals: an exact relation may be useless
        with the least noise.

        - `cutoff` (rad/s): of the filter, by default above `slowest` and as fast as the
          outputs change; `seed`: of signals and noise.
        """
        return certificate(self.relation, self.model, self.slowest, cutoff, seed)

    def observer(
        self,
        filter: AbstractFilter,
        *,
        gain: Float[Array, ""] | float | None = None,
        initial: Any = None,
        **settings: Any,
    ) -> StateObserver:
        """The observer of the `states`.

        - `filter`: that of the Swapping Lemma;
        - `gain` (rad/s): makes it an A-ASLO of the relation's x; by default none;
        - `initial`: the states before the first certified instant, shape `(k,)`;
        - `settings`: `completion`, `guard` and `start` of [`AlgebraicObserver`][].
        """
        return state_observer(
            self.relation, self.coordinates, filter, gain, initial, **settings
        )

    def kalman_filter(
        self,
        output_deviation: Any,
        input_deviation: Any = 0.0,
        *,
        prior: Any = None,
        threshold: float | None = 0.9,
        initial: Any = None,
    ) -> StateObserver:
        """The Kalman filter of the relation ([`Lifted`][]), as an observer of the `states`.

        - `output_deviation`, `input_deviation`: standard deviations of white noise on every
          sample of the outputs and of the inputs, in their units, one number or one each;
        - `prior`: that of the first belief of the relation's x, about the middle of what
          the ranges of the states make of it, shape `(n,)`: by default half the width;
        - `threshold`: the certificate below which the estimate coasts, `1/(1 + r)`, r the
          largest variance of a state beside the square of half its range; `None` returns
          the filter's mean as it is;
        - `initial`: the states before the first certified instant, shape `(k,)`.
        """
        low, high = self._bounds()
        guard = None if threshold is None else Guard(threshold)
        lifted = Lifted(
            self.relation,
            output_deviation,
            jnp.maximum(jnp.asarray(input_deviation, float), NOISELESS),
            prior=0.5 * (high - low) if prior is None else prior,
            initial=0.5 * (low + high),
            guard=None,
        )
        return StateObserver(lifted, self.coordinates, guard, initial)

    def adaptive_filter(
        self,
        output_deviation: Any,
        input_deviation: Any = 0.0,
        *,
        parameters: Sequence[str],
        deviations: Any,
        **settings: Any,
    ) -> StateObserver:
        """The Kalman filter of the relation some of whose parameters are not known
        ([`Adaptive`][]), as an observer of the `states`, with an [`AdaptiveEstimate`][].

        - `output_deviation`, `input_deviation`: as of [`Derived.kalman_filter`][];
        - `parameters`: the names of those of the model that are not known, that with the
          bank first; `deviations`, relative, shape `(q,)`;
        - `settings`: `drift`, `hold`, `bank` and `tolerance` of [`Adaptive`][].

        **Raises:** `ValueError` for a relation that is not quadratic or holds for the
        present parameters only, and as [`Adaptive`][].
        """
        kind, change = self.relation.kind, self.coordinates.change
        if kind != "quadratic" or change or not self.coordinates.decoder.is_selection:
            raise ValueError(
                "A filter of unknown parameters is for a model whose relation is "
                f"quadratic, but that of this one is {self.kind}: name them in `unknown` "
                "of the model, which makes states of them where the relation still closes."
            )
        if not self.relation.parameters:
            raise ValueError(
                "A filter of unknown parameters needs a relation that holds for others, "
                "but this one holds for the present values of the model's alone."
            )
        low, high = self._bounds()
        adaptive = Adaptive(
            self.relation,
            output_deviation,
            jnp.maximum(jnp.asarray(input_deviation, float), NOISELESS),
            tuple(parameters),
            deviations,
            initial=0.5 * (low + high),
            **settings,
        )
        return StateObserver(adaptive, self.coordinates, None)

    def plant(self) -> ModelPlant:
        """The model as a plant, whose `hidden` part are the `states`.

        **Raises:** `ValueError` for a model whose equations do not give its outputs.
        """
        return plant_of(self.model, self)

    def _bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """The least and the largest of each entry of the relation's x, on the ranges."""
        x, y = _drawn(self.model.ranges), _drawn(self.model.outputs, 1)
        every = self.lift(jnp.asarray(x), jnp.asarray(y))
        return np.nanmin(every, axis=0), np.nanmax(every, axis=0)

    def __str__(self) -> str:
        sure = "proved" if self.proved else "checked"
        lines = [
            f"relation: {self.kind}, {sure}",
            f"x of the relation: {', '.join(self.lifted)}",
            f"states: {', '.join(map(self._with_note, self.states)) or 'none'}",
        ]
        if self.undetermined:
            lines.append(f"not determined: {', '.join(self.undetermined)}")
        slowest = "any" if not self.slowest else f"above {self.slowest:.4g} rad/s"
        lines.append(f"cutoff of the filter: {slowest}")
        lines += [f"not used: {each}" for each in self.unused]
        return "\n".join(lines)

    def _with_note(self, name: str) -> str:
        note = self.notes.get(name)
        return f"{name} ({note})" if note else name


def _drawn(ranges: Any, seed: int = 0) -> np.ndarray:
    """Points of ranges, shape `(N, n)`."""
    rng, pairs = np.random.default_rng(seed), np.array(list(ranges.values()), float)
    pairs = pairs.reshape(-1, 2)
    return rng.uniform(pairs[:, 0], pairs[:, 1], (DRAWN, len(pairs)))


@overload
def derive(model: Model | AbstractModelledPlant, region: None = None) -> Derived: ...
@overload
def derive(
    model: AbstractMechanicalSystem, region: Region | None = None
) -> DerivedVelocities: ...


def derive(
    model: Model | AbstractModelledPlant | AbstractMechanicalSystem,
    region: Region | None = None,
) -> Derived | DerivedVelocities:
    """Derive the algebraic observer of what a `model` does not measure, or of the hidden
    part of a plant that is one; that of a plant is kept for the next time.

    Its functions are traced and lowered as for the fused engine, and interpreted as
    polynomials in the states (with sines, cosines and exponentials of these, every branch
    of a `where` on measured signals, linear equations whose matrix is measured, and loops
    of fixed length); anything else on the way from a state refuses the equation, with its
    line. Then the rows are closed under differentiation, which gives a state-affine system.
    What is measured is taken as free: whether a record excites it, the certificate tells.

    Of a mechanical system, whose inertia is known as such, the rule is its structure
    ([`structure_of`][]): velocities one after the other, each from a momentum alone, which
    takes a quarter of the operations of all of them together. `region` is where it moves, a
    pair (low, high) of coordinates; a model has ranges instead.

    **Raises:** [`StructureError`][] for a mechanical system that is not of the class;
    [`NotDerivable`][] where no equation closes, with the reason, the pair of
    states that is in the way, and the measurement that would help; [`NotFusible`][] for a
    primitive that is not known; `ValueError` for a model that is not finite on its ranges.

    Source: theory, "deriving the observer from a model"; Fliess and Kupka 1983,
    doi:10.1137/0321041.
    """
    if isinstance(model, AbstractMechanicalSystem):
        return derive_velocities(model, region)
    if region is not None:
        raise ValueError("Argument `region` must be left out for a model with ranges.")
    if isinstance(model, AbstractModelledPlant):
        return once(model, derive)
    if not isinstance(model, Model):
        hint = "a `Model`, a plant that is one or an `AbstractMechanicalSystem`"
        raise unlike("model", model, hint)
    lowered = lower(model)
    closure, algebra = closed(lowered)
    for find in (integrating, covectors) if closure.failures else ():
        change = find(lowered)
        if change is None:
            continue
        other = lower(changed(model, change))
        for k, name in enumerate(model.states):
            if isinstance(change, Matrix) or change.factors[k] is not None:
                other.ring.names[k] = f"{name}~"
        found, sampled = closed(other)
        if len(found.failures) < len(closure.failures):
            rates = program(lowered.graph, lowered.nodes["f"])
            derived = _derived(model, other, found, sampled, rates, change)
            if isinstance(change, Matrix) and derived.undetermined:
                continue  # a state takes all of them
            return derived
    if not closure.rows:
        raise refusal(lowered, closure.failures)
    rates = program(lowered.graph, lowered.nodes["f"])
    return _derived(model, lowered, closure, algebra, rates, None)


def _derived(
    model: Model,
    lowered: Lowered,
    closure: Closure,
    algebra: Sampled,
    rates: Program,
    change: Change | Matrix | None,
) -> Derived:
    parts = Parts(lowered, closure, algebra)
    # A factor is a series of numbers, for the present values of the parameters.
    free = (change is None or change.symbolic) and (
        closure.structural or _holds_for_others(lowered, closure)
    )
    relation, basis = relation_of(parts, free)
    steps = decoder(lowered.ring, basis, _drawn(model.ranges), model.values())
    names = list(model.ranges)
    middle = tuple(0.5 * (low + high) for low, high in model.ranges.values())
    half = tuple(0.5 * (high - low) for low, high in model.ranges.values())
    text = lowered.ring.text
    lifted = tuple(
        " + ".join(text(m) if c == 1 else f"{c:.4g} {text(m)}" for m, c in b.items())
        for b in basis
    )
    found = tuple(names[k] for k in steps.states)
    return Derived(
        model,
        relation,
        lifted,
        found,
        tuple(name for name in names if name not in found),
        {names[k]: note for k, note in steps.notes.items()},
        _kind(parts, relation),
        closure.structural,
        _slowest(parts),
        tuple(reason(lowered, each) for each in closure.failures),
        Coordinates(steps, rates, middle, half, change),
        lowered.ring,
        tuple(basis),
    )


def _holds_for_others(lowered: Lowered, closure: Closure) -> bool:
    """Whether the closure is the same for parameters nearby."""
    values = lowered.model.values()
    if not values.size:
        return True
    rng = np.random.default_rng(1)
    nearby = values * (1.0 + PERTURBED * rng.uniform(-1.0, 1.0, values.shape))
    nearby = np.where(values == 0.0, PERTURBED, nearby)
    other, _ = closed(lowered, nearby)
    same = other.pivots == closure.pivots and len(other.rows) == len(closure.rows)
    return same and all(
        a.keys() == b.keys() and np.allclose(list(a.values()), list(b.values()))
        for a, b in zip(other.basis, closure.basis, strict=True)
    )


def _slowest(parts: Parts) -> float:
    A = parts.state_matrix()
    fastest = float(np.max(-np.linalg.eigvals(A).real, initial=0.0)) if A.size else 0.0
    return (
        2.0 * fastest if fastest > 1e-9 * max(np.abs(A).max(initial=0.0), 1e-300) else 0.0
    )


def _kind(parts: Parts, relation: DerivedRelation) -> str:
    words = {
        "linear": "linear",
        "rate": "a rate",
        "quadratic": "quadratic",
        "rows": f"{len(parts.rows)} rows" if len(parts.rows) > 1 else "one row",
    }[relation.kind]
    moving = not all(parts.is_zero(n) for row in parts.A for n in row)
    return f"{words}, state-affine" if moving and relation.kind != "quadratic" else words
