"""The protocol of every disturbance."""

import abc

import numpy as np
from jaxtyping import Array, Float

from .._module import Module
from .._typing import HostArray, PyTree, RealArray

__all__ = [
    "AbstractAtSamples",
    "AbstractDisturbance",
    "AbstractMemoryless",
    "AbstractSampled",
    "DisturbanceState",
]


class DisturbanceState(Module):
    """The state of a disturbance, a value: `continuous`, what is integrated beside the
    plant, and `sampled`, what is updated at the samples. Either is empty, `None`, where
    there is nothing of the kind.
    """

    continuous: PyTree = None
    sampled: PyTree = None


class AbstractDisturbance(Module):
    """Something a signal passes through, with a state of its own where it needs one.

    At every instant the disturbed signal is a function of the time `t` (s), the state and
    the `signal`. In all methods `output` is what the plant puts out at that instant, before
    any sensor, for what depends on it; beside a plant it is always given.
    """

    @abc.abstractmethod
    def init(
        self, t: Float[Array, ""], signal: PyTree, output: PyTree = None
    ) -> DisturbanceState:
        """The state at the first instant."""

    @abc.abstractmethod
    def vector_field(
        self,
        t: Float[Array, ""],
        state: DisturbanceState,
        signal: PyTree,
        output: PyTree = None,
    ) -> PyTree:
        """The derivative of `state.continuous`."""

    @abc.abstractmethod
    def update(
        self,
        t: Float[Array, ""],
        state: DisturbanceState,
        signal: PyTree,
        output: PyTree = None,
    ) -> PyTree:
        """`state.sampled` after the sample at t, for the next one."""

    @abc.abstractmethod
    def __call__(
        self,
        t: Float[Array, ""],
        state: DisturbanceState | None,
        signal: PyTree,
        output: PyTree = None,
    ) -> PyTree:
        """The disturbed signal. A disturbance without a state takes `None` for it."""

    @property
    @abc.abstractmethod
    def has_jumps(self) -> bool:
        """Whether the disturbed signal is held and jumps at known instants."""

    @abc.abstractmethod
    def jumps(self, t0: float, t1: float) -> Float[np.ndarray, " jumps"]:
        """The instants in (t0, t1) at which it jumps (s), for the solver to stop at."""


class AbstractAtSamples(AbstractDisturbance):
    """A disturbance with nothing to integrate and without jumps of its own."""

    def vector_field(
        self, t: RealArray, state: DisturbanceState, signal: PyTree, output: PyTree = None
    ) -> PyTree:
        del t, state, signal, output

    @property
    def has_jumps(self) -> bool:
        return False

    def jumps(self, t0: float, t1: float) -> HostArray:
        del t0, t1
        return np.empty(0)


class AbstractMemoryless(AbstractAtSamples):
    """A disturbance without a state and without jumps: only `__call__` is left to say."""

    def init(self, t: RealArray, signal: PyTree, output: PyTree = None) -> DisturbanceState:
        del t, signal, output
        return DisturbanceState()

    def update(
        self, t: RealArray, state: DisturbanceState, signal: PyTree, output: PyTree = None
    ) -> PyTree:
        del t, state, signal, output


class AbstractSampled(AbstractAtSamples):
    """A disturbance whose state changes at the samples only: `init`, `update` and
    `__call__` are left to say. It needs an [`Experiment`][]; `simulate` has no samples."""
