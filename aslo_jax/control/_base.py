"""The protocol of every controller."""

import abc
from collections.abc import Callable
from typing import Any

from jaxtyping import Array, Float

from .._checks import unlike
from .._module import Module
from .._typing import PyTree, RealArray
from ..plants import AbstractPlant

__all__ = ["AbstractController", "OpenLoop", "controlled"]


class AbstractController(Module):
    """From what it is fed to the input u, with a state of its own where it needs one.

    In continuous time the state is integrated with the plant; sampled, it advances by
    `dt vector_field` after each sample. What it is fed is the measurement y, unless the
    loop has a `feedback` of its own: `feedback(y, x, estimates)` makes it from the
    measurement, the state of the plant (an encoder, say) and the observers' estimates.
    """

    @abc.abstractmethod
    def init(self, fed: PyTree) -> PyTree:
        """The state at the first instant."""

    @abc.abstractmethod
    def vector_field(self, t: Float[Array, ""], state: PyTree, fed: PyTree) -> PyTree:
        """The derivative of the state at time t (s)."""

    @abc.abstractmethod
    def __call__(self, t: Float[Array, ""], state: PyTree, fed: PyTree) -> PyTree:
        """The input u at time t (s)."""


def controlled(controller: Any) -> AbstractController:
    """A controller as it is, a function of time as [`OpenLoop`][].

    **Raises:** `ValueError` for what is neither."""
    if isinstance(controller, AbstractController):
        return controller
    if callable(controller) and not isinstance(controller, AbstractPlant | type):
        return OpenLoop(controller)
    hint = "a controller, or a function of time (s) for an open loop"
    raise unlike("controller", controller, hint)


def held_input(controller: AbstractController) -> Any:
    """What an open loop puts out where that is held and jumps, `None` otherwise."""
    signal = controller.signal if isinstance(controller, OpenLoop) else None
    return signal if getattr(signal, "has_jumps", False) else None


class OpenLoop(AbstractController):
    """`u = signal(t)`, whatever is measured."""

    signal: Callable[[Float[Array, ""]], PyTree]

    def init(self, fed: PyTree) -> PyTree:
        del fed

    def vector_field(self, t: RealArray, state: PyTree, fed: PyTree) -> PyTree:
        del t, state, fed

    def __call__(self, t: RealArray, state: PyTree, fed: PyTree) -> PyTree:
        del state, fed
        return self.signal(t)
