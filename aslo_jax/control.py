"""Controllers of the continuous loop."""

import abc
from collections.abc import Callable

import equinox as eqx
from jaxtyping import Array, Float, PyTree


class AbstractController(eqx.Module):
    """From the measurement to the input, with a state of its own where it needs one."""

    @abc.abstractmethod
    def init(self, y: PyTree) -> PyTree:
        """The state at the first measurement."""

    @abc.abstractmethod
    def vector_field(self, t: Float[Array, ""], state: PyTree, y: PyTree) -> PyTree:
        """The derivative of the state at time t (s)."""

    @abc.abstractmethod
    def __call__(self, t: Float[Array, ""], state: PyTree, y: PyTree) -> PyTree:
        """The input u."""


class OpenLoop(AbstractController):
    """`u = signal(t)`, whatever is measured."""

    signal: Callable[[Float[Array, ""]], PyTree]

    def init(self, y):
        del y

    def vector_field(self, t, state, y):
        del t, state, y

    def __call__(self, t, state, y):
        del state, y
        return self.signal(t)
