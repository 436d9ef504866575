"""Plants that state their equations once, for their simulation and for `derive`."""

import abc
from collections.abc import Mapping
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .._checks import nonnegative, positive, real
from .._typing import PyTree, RealArray
from ._base import AbstractPlant

__all__ = ["AbstractModelledPlant", "AbstractVectorPlant", "Span", "parameter"]

# What a parameter is made of; it is kept as an array.
Scalar = Float[Array, ""] | float

BALANCING = 8  # Gauss-Newton steps to the input that holds a state


class Span(NamedTuple):
    """Where a signal usually is: from `low` to `high`, in its `unit`."""

    low: float
    high: float
    unit: str = ""


def parameter(about: str, unit: str, default: float, *, sign: str = "+") -> Any:
    """A field of a plant: what it is `about`, in words, its `unit` and its `default` in it,
    and its `sign`: "+", "0" where it may be zero, or "" where it may have either."""
    metadata = {"about": about, "unit": unit, "sign": sign}
    return eqx.field(converter=real, default=default, metadata=metadata)


class AbstractModelledPlant(AbstractPlant):
    """A plant whose equations are plain functions of what is not measured, x, what is, y,
    and the input u, all of them vectors: those of a [`Model`][]. So [`derive`][] takes it
    as it takes a model, and what else is needed of its equations comes from them too.

    It states

    - `states`, `outputs`, `inputs`: the names of the entries of x, y and u, with the range
      that each usually is in;
    - `unknown`: parameters that are not known. They are entries of x after the states, and
      of the hidden part.
    """

    states: ClassVar[Mapping[str, Span]]
    outputs: ClassVar[Mapping[str, Span]]
    inputs: ClassVar[Mapping[str, Span]]
    unknown: ClassVar[tuple[str, ...]] = ()

    def __check_init__(self) -> None:
        for name, field in self.parameters().items():
            value, sign = getattr(self, name), field.metadata["sign"]
            if sign == "+":
                positive(name, value, field.metadata["unit"])
            elif sign == "0":
                nonnegative(name, value)

    @abc.abstractmethod
    def f(self, x: Float[Array, " n"], y: Float[Array, " p"], u: Float[Array, " m"]) -> Any:
        """The rates of the states, in their units per second."""

    def g(self, x: Float[Array, " n"], y: Float[Array, " p"], u: Float[Array, " m"]) -> Any:
        """The rates of the outputs, `None` in the place of one that is not used; by default
        of them all."""
        del x, y, u
        return [None] * len(self.outputs)

    def h(self, x: Float[Array, " n"], y: Float[Array, " p"], u: Float[Array, " m"]) -> Any:
        """Expressions that are zero; by default there are none."""
        del x, y, u
        return []

    @classmethod
    def parameters(cls) -> dict[str, Any]:
        """The fields that are numbers of the equations, by name."""
        fields = cls.__dataclass_fields__
        return {name: each for name, each in fields.items() if "about" in each.metadata}

    @classmethod
    def hidden_units(cls) -> dict[str, str]:
        """The names of the entries of the hidden part, and their units."""
        units = {name: each.unit for name, each in cls.states.items()}
        fields = cls.parameters()
        return units | {name: fields[name].metadata["unit"] for name in cls.unknown}

    def no_input(self, y: PyTree) -> Any:
        return jnp.zeros(len(self.inputs), jnp.result_type(y))

    def constants(self) -> list[RealArray]:
        """The values of the unknown parameters."""
        return [getattr(self, name) for name in self.unknown]


class AbstractVectorPlant(AbstractModelledPlant):
    """One whose state is a vector: the `states`, and then what else moves, `others`, which
    is by default what is measured, with the rates of that. `first` is where it starts by
    default."""

    others: ClassVar[Mapping[str, Span] | None] = None
    first: ClassVar[tuple[float, ...]]

    @classmethod
    def moving(cls) -> dict[str, Span]:
        """The names of the entries of the state, and where each usually is."""
        return {**cls.states, **(cls.outputs if cls.others is None else cls.others)}

    def measured(self, x: Float[Array, " n"], w: Float[Array, " k"]) -> Float[Array, " p"]:
        """The outputs, of the states x and the `others` w; by default w."""
        del x
        return w

    def other_rates(
        self, x: Float[Array, " n"], w: Float[Array, " k"], u: Float[Array, " m"]
    ) -> Any:
        """The rates of the `others` w; by default those of the outputs."""
        return self.g(x, w, u)

    def initial(self) -> PyTree:
        dtype = jnp.result_type(*(getattr(self, name) for name in self.parameters()))
        return jnp.asarray(self.first, dtype)

    def vector_field(self, t: RealArray, x: PyTree, u: PyTree) -> PyTree:
        del t
        own, w = self._parts(x)
        rates = [*self.f(own, self.measured(own, w), u), *self.other_rates(own, w, u)]
        return jnp.stack([jnp.asarray(each, x.dtype) for each in rates])

    def output(self, x: PyTree) -> PyTree:
        return self.measured(*self._parts(x))

    def hidden(self, x: PyTree) -> RealArray:
        constants = [jnp.asarray(each, x.dtype)[None] for each in self.constants()]
        return jnp.concatenate([x[: len(self.states)], *constants])

    def balance(self, x: Float[Array, " s"]) -> Float[Array, " m"]:
        """The input that holds the plant in a state `x`, in the sense of least squares of
        rates over their ranges."""
        sizes = jnp.asarray([each.high - each.low for each in self.moving().values()])
        rate = lambda u: self.vector_field(jnp.zeros(()), x, u) / sizes
        u = self.no_input(self.output(x))
        for _ in range(BALANCING if u.size else 0):
            u = u - jnp.linalg.lstsq(jax.jacfwd(rate)(u), rate(u))[0]
        return u

    def _parts(self, x: Float[Array, " s"]) -> tuple[RealArray, RealArray]:
        n = len(self.states)
        return x[:n], x[n:]
