"""From the entries of a relation's x back to the states of the model."""

import dataclasses
import math
from collections.abc import Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._small import safe_reciprocal
from .closure import Constant
from .polynomials import Monomial, Ring
from .symbols import Program, program


@dataclasses.dataclass(frozen=True)
class Step:
    """How one generator is found: `how`, from the entry `place`, which is the `known` terms
    plus the `factors` times it; or by a function of other generators. What it is divided by
    has usually the `size`, and the worth of the quotient goes with the square of it over
    that.

    Terms are pairs of a monomial of generators that are known already, and a number."""

    generator: int
    how: str
    place: int = 0
    factors: tuple[tuple[Monomial, float], ...] = ()
    known: tuple[tuple[Monomial, float], ...] = ()
    argument: tuple[int, int] = (0, 0)  # of a function: the first of its factors, how many
    size: float = 1.0


@dataclasses.dataclass(frozen=True)
class Decoder:
    """The steps from the entries of a relation's x to the states; `notes` on what is left
    open, by state: a period, a sign."""

    steps: tuple[Step, ...]
    states: tuple[int, ...]
    notes: dict[int, str]
    arguments: Program

    @property
    def is_selection(self) -> bool:
        """Whether every state is an entry of x."""
        return all(step.how == "linear" and not step.known for step in self.steps)

    def __call__(
        self, X: Float[Array, "*batch n"], p: Sequence[Any]
    ) -> tuple[Float[Array, "*batch k"], Float[Array, "*batch"]]:
        """The states that are found, in their order, along the last axis of X; and their
        worth beside that of X, one at most: a quotient of numbers that are about zero tells
        nothing, however well these are known."""
        values: dict[int, Any] = {}
        worth: Any = jnp.ones(X.shape[:-1], X.dtype)
        factors = self.arguments({"p": p})

        def total(terms: tuple[tuple[Monomial, float], ...]) -> Any:
            products = []
            for monomial, c in terms:
                product: Any = 1.0
                for generator in monomial:
                    value = values[generator]
                    product = value if isinstance(product, float) else product * value
                products.append(product if c == 1.0 else c * product)
            return sum(products[1:], start=products[0])

        for step in self.steps:
            if step.how in ("linear", "ratio", "root"):
                rest = X[..., step.place]
                if step.known:
                    rest = rest - total(step.known)
                factor = total(step.factors)
                if step.how == "root":
                    rest = jnp.sqrt(jnp.maximum(rest / factor, 0.0))
                    worth = jnp.minimum(worth, (rest / step.size) ** 2)
                elif step.how == "ratio":
                    rest = rest * safe_reciprocal(jnp.asarray(factor))
                    worth = jnp.minimum(worth, (factor / step.size) ** 2)
                elif factor != 1.0:
                    rest = rest / factor
                values[step.generator] = rest
                continue
            first, count = step.argument
            coefficient, *others = factors[first : first + count]
            if step.how == "angle":
                sine, cosine = (values[m[0]] for m, _ in step.factors)
                value = jnp.arctan2(sine, cosine)
                worth = jnp.minimum(worth, sine**2 + cosine**2)
            else:
                (m, _), *_ = step.factors
                value = jnp.log(jnp.maximum(values[m[0]], 1e-300))
                worth = jnp.minimum(worth, (values[m[0]] / step.size) ** 2)
            for (monomial, _), c in zip(step.known, others, strict=True):
                value = value - c * total(((monomial, 1.0),))
            values[step.generator] = value / coefficient
        return jnp.stack([values[g] for g in self.states], axis=-1), worth


def decoder(
    ring: Ring,
    basis: Sequence[Constant],
    x: Float[np.ndarray, "N n"],
    p: Float[np.ndarray, " k"],
) -> Decoder:
    """The steps that find as many states as there are to find; `x` are states as they
    usually are, and `p` the parameters."""
    search = _Decoding(ring, basis)
    search.run()
    states = tuple(g for g in range(ring.states) if g in search.found)
    arguments = program(ring.graph, search.roots)
    known = generators(ring, x, p)
    steps = tuple(
        dataclasses.replace(step, size=_usual(step, known)) for step in search.steps
    )
    return Decoder(steps, states, search.notes, arguments)


def _usual(step: Step, values: dict[int, np.ndarray]) -> float:
    """The size of what a step divides by, rms."""
    if step.how not in ("ratio", "root", "logarithm"):
        return 1.0
    found: Any = values[step.generator]
    if step.how != "root":
        products = (c * np.prod([values[g] for g in m], axis=0) for m, c in step.factors)
        found = sum(products)
    size = float(np.sqrt(np.mean(np.square(found))))
    return size if np.isfinite(size) and size > 0 else 1.0


class _Decoding:
    def __init__(self, ring: Ring, basis: Sequence[Constant]) -> None:
        self.ring = ring
        self.basis = basis
        self.steps: list[Step] = []
        self.found: set[int] = set()
        self.notes: dict[int, str] = {}
        self.roots: list[int] = []

    def run(self) -> None:
        ways = (self._linear, self._function, self._ratio, self._root)
        while any(way() for way in ways):
            pass

    def _add(self, step: Step) -> bool:
        self.steps.append(step)
        self.found.add(step.generator)
        return True

    def _split(self, b: Constant, power: int) -> tuple[int, Constant, Constant] | None:
        """The one generator of b that is not known, what it is multiplied by, and what b
        has besides, where all its terms have that `power` of it."""
        unknown = {g for m in b for g in m if g not in self.found}
        if len(unknown) != 1:
            return None
        (generator,) = unknown
        factor, rest = {}, {}
        for m, c in b.items():
            if generator not in m:
                rest[m] = c
            elif m.count(generator) == power:
                factor[tuple(g for g in m if g != generator)] = c
            else:
                return None
        return generator, factor, rest

    def _direct(self, power: int, how: str, constant: bool) -> bool:
        for k, b in enumerate(self.basis):
            split = self._split(b, power)
            if split is None or (set(split[1]) == {()}) != constant:
                continue
            generator, factor, rest = split
            terms = tuple(factor.items()), tuple(rest.items())
            return self._add(Step(generator, how, k, *terms))
        return False

    def _linear(self) -> bool:
        return self._direct(1, "linear", True)

    def _ratio(self) -> bool:
        return self._direct(1, "ratio", False)

    def _root(self) -> bool:
        found = self._direct(2, "root", True)
        if found:
            generator = self.steps[-1].generator
            self.notes[generator] = "its sign is not known, and taken as positive"
        return found

    def _function(self) -> bool:
        for generator, rule in self.ring.rules.items():
            if rule.function == "cos" or generator not in self.found:
                continue
            if rule.function == "sin" and generator + 1 not in self.found:
                continue
            unknown = {g for m in rule.argument for g in m if g not in self.found}
            if len(unknown) != 1:
                continue
            (state,) = unknown
            if any(state in m and m != (state,) for m in rule.argument):
                continue
            others = [m for m in rule.argument if m != (state,)]
            first = len(self.roots)
            self.roots += [rule.argument[(state,)], *(rule.argument[m] for m in others)]
            arguments = (
                [generator] if rule.function == "exp" else [generator, generator + 1]
            )
            known = tuple((m, 1.0) for m in others)
            how = "logarithm" if rule.function == "exp" else "angle"
            if how == "angle":
                c = self.ring.graph.value(rule.argument[(state,)])
                period = "" if c is None else f" of {2 * math.pi / abs(float(c)):.4g}"
                self.notes[state] = f"up to a period{period}"
            factors = tuple(((g,), 1.0) for g in arguments)
            return self._add(Step(state, how, 0, factors, known, (first, 1 + len(others))))
        return False


def generators(
    ring: Ring, x: Float[np.ndarray, "N n"], p: Float[np.ndarray, " k"]
) -> dict[int, np.ndarray]:
    """The values of all generators for states `x`, shape `(N, n)`."""
    values = {g: x[:, g] for g in range(ring.states)}
    for g, rule in ring.rules.items():
        c = program(ring.graph, list(rule.argument.values()))({"p": p})
        argument = sum(
            each * np.prod([values[i] for i in m], axis=0)
            for each, m in zip(c, rule.argument, strict=True)
        )
        values[g] = getattr(np, rule.function)(argument)
    return values


def lifted_states(
    ring: Ring,
    basis: Sequence[Constant],
    x: Float[np.ndarray, "N n"],
    p: Float[np.ndarray, " k"],
) -> Float[np.ndarray, "N m"]:
    """The entries of the relation's x for states `x` of the model."""
    values = generators(ring, x, p)
    columns = [
        sum(c * np.prod([values[g] for g in m], axis=0) for m, c in b.items())
        for b in basis
    ]
    return np.stack([np.asarray(column) for column in columns], axis=1)
