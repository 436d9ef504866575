"""A model: what is not measured, what is, and how these depend on each other."""

import dataclasses
import inspect
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._checks import function as check_function, unlike

Range = tuple[float | int, float | int]
SPREAD = 0.5  # half the range of an unknown parameter, relative


@dataclasses.dataclass(frozen=True, eq=False)
class Model:
    """Plain functions of what is not measured, x, what is, y, and the input u.

    - `f(x, y, u)`: the rates `x'`, one for each state;
    - `g(x, y, u)`: the rates `y'` of measured signals that are states, one for each output,
      `None` in the place of one without;
    - `h(x, y, u)`: expressions that are zero, in any number;
    - `states`, `outputs`, `inputs`: the names of the entries of x, y and u, each with its
      usual range `(low, high)`;
    - `parameters`: numbers by name. A function with a fourth argument gets them, as a
      dictionary; they stay parameters of what is derived;
    - `unknown`: the parameters that are not known: they become states that do not change;
    - `units`: of states, outputs, inputs and parameters, by name.

    x, y and u are vectors, of the shapes `(n,)`, `(p,)` and `(m,)`; what the functions
    return is an array, or a list of numbers and arrays.

    **Raises:** `ValueError` for a range that is empty, for names that occur twice, and for
    an unknown parameter that is none.
    """

    f: Callable[..., Any]
    g: Callable[..., Any] | None = None
    h: Callable[..., Any] | None = None
    _: dataclasses.KW_ONLY
    states: Mapping[str, Range]
    outputs: Mapping[str, Range]
    inputs: Mapping[str, Range] = dataclasses.field(default_factory=dict)
    parameters: Mapping[str, float | int] = dataclasses.field(default_factory=dict)
    unknown: Sequence[str] = ()
    units: Mapping[str, str] = dataclasses.field(default_factory=dict)

    def __post_init__(self) -> None:
        for name in ("f", "g", "h"):
            check_function(name, getattr(self, name))
        if self.g is None and self.h is None:
            raise ValueError(
                "Arguments `g` and `h` must not both be left out: without a rate of what "
                "is measured, or an equation with it, nothing is known of the states."
            )
        for group in ("states", "outputs", "inputs"):
            ranges = getattr(self, group)
            if not isinstance(ranges, Mapping):
                raise unlike(group, ranges, "a dictionary from names to ranges")
            for name, each in ranges.items():
                _check_range(group, name, each)
        names = [*self.states, *self.outputs, *self.inputs, *self.parameters]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise ValueError(f"Every name must occur once, but {', '.join(twice)} do not.")
        for name in self.unknown:
            if name not in self.parameters:
                raise ValueError(
                    "Argument `unknown` must name parameters, which are "
                    f"{', '.join(self.parameters) or 'none'}, but got `{name}`."
                )
        unnamed = sorted(set(self.units) - set(names))
        if unnamed:
            raise ValueError(
                "Argument `units` must be by the names of the model, but has "
                f"{', '.join(unnamed)}."
            )

    @property
    def known(self) -> dict[str, float]:
        """The parameters that are known, by the alphabet: as JAX has a dictionary."""
        every = sorted(self.parameters.items())
        return {k: float(v) for k, v in every if k not in self.unknown}

    @property
    def ranges(self) -> dict[str, Range]:
        """The ranges of all states, with the unknown parameters as the last ones."""
        found = dict(self.states)
        for name in self.unknown:
            value = float(self.parameters[name])
            half = SPREAD * abs(value) or SPREAD
            found[name] = value - half, value + half
        return found

    def unit(self, name: str) -> str:
        """The unit of a name, empty where there is none."""
        return self.units.get(name, "")

    @property
    def sizes(self) -> dict[str, int]:
        """How many entries `x`, `y`, `u` and `p`, the known parameters, have."""
        counts = len(self.ranges), len(self.outputs), len(self.inputs), len(self.known)
        return dict(zip("xyup", counts, strict=True))

    def rates(self, x: Array, y: Array, u: Array, p: Array) -> list[Array]:
        """The rates of all states, zero for unknown parameters."""
        found = entries(self._called(self.f, x, y, u, p))
        self._count("f", found, len(self.states), "states")
        return [*found, *(jnp.zeros(()) for _ in self.unknown)]

    def measured_rates(self, x: Array, y: Array, u: Array, p: Array) -> dict[int, Array]:
        """The rates of outputs, by their numbers."""
        if self.g is None:
            return {}
        given = self._called(self.g, x, y, u, p)
        some = isinstance(given, list | tuple) and any(each is None for each in given)
        found = list(given) if some else entries(given)
        self._count("g", found, len(self.outputs), "outputs")
        pairs = enumerate(found)
        return {k: jnp.reshape(jnp.asarray(r), ()) for k, r in pairs if r is not None}

    def equations(self, x: Array, y: Array, u: Array, p: Array) -> list[Array]:
        """The expressions that are zero."""
        return [] if self.h is None else entries(self._called(self.h, x, y, u, p))

    def _called(self, function: Callable, x: Array, y: Array, u: Array, p: Array) -> Any:
        count = len(self.states)
        named = dict(zip(self.known, p, strict=True))
        named |= dict(zip(self.unknown, x[count:], strict=True))
        parameters = {name: named[name] for name in self.parameters}
        arguments = x[:count], y, u
        if wants_parameters(function):
            arguments = *arguments, parameters
        try:
            return function(*arguments)
        except (LookupError, AttributeError, NameError, ArithmeticError) as error:
            name = next(each for each in "fgh" if getattr(self, each) is function)
            raise ValueError(
                f"Argument `{name}` must be a function of x, y, u and p, but fails: "
                f"{type(error).__name__}: {error}."
            ) from error

    def _count(self, name: str, found: Sequence[Any], count: int, what: str) -> None:
        if len(found) != count:
            raise ValueError(
                f"Argument `{name}` must return one rate for each of the {count} {what} "
                f"{', '.join(getattr(self, what))}, but returns {len(found)}."
            )

    def values(self) -> Float[np.ndarray, " k"]:
        """The known parameters."""
        return np.array(list(self.known.values()), float)


def entries(tree: Any) -> list[Array]:
    """The numbers of a list of numbers and arrays, or of an array."""
    parts = tree if isinstance(tree, list | tuple) else [tree]
    return [each for part in parts for each in jnp.ravel(jnp.asarray(part, float))]


def wants_parameters(function: Callable[..., Any]) -> bool:
    """Whether a function takes parameters, as its fourth argument."""
    kinds = (inspect.Parameter.POSITIONAL_ONLY, inspect.Parameter.POSITIONAL_OR_KEYWORD)
    every = inspect.signature(function).parameters.values()
    return sum(each.kind in kinds and each.default is each.empty for each in every) > 3


def _check_range(group: str, name: str, given: Any) -> None:
    pair = isinstance(given, tuple | list) and len(given) == 2
    numbers = pair and all(isinstance(x, int | float) for x in given)
    if not numbers or not (np.isfinite(given).all() and given[0] < given[1]):
        raise ValueError(
            f"Argument `{group}` must give `{name}` a range (low, high), low < high, but "
            f"got {given!r}."
        )
