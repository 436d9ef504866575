"""Several disturbances, one after the other."""

from collections.abc import Iterator
from typing import Any

import jax
import numpy as np

from .._typing import HostArray, PyTree, RealArray
from ._base import AbstractDisturbance, DisturbanceState

__all__ = ["Chain"]


class Chain(AbstractDisturbance):
    """Passes the signal through `parts` in their order: `Chain(a, b)` is b of what a makes.

    One with a state that is integrated, as [`ParasiticLag`][] has, comes after those that
    are updated at the samples, as [`Delay`][] is: these know their signal at samples only.

    **Raises:** `ValueError` without `parts`, and for parts in an order that cannot be.
    """

    parts: tuple[AbstractDisturbance, ...]

    def __init__(self, *parts: AbstractDisturbance) -> None:
        self.parts = parts

    def __check_init__(self) -> None:
        if not self.parts:
            raise ValueError("Argument `parts` must hold a disturbance, but is empty.")

    def init(self, t: RealArray, signal: PyTree, output: PyTree = None) -> DisturbanceState:
        states: list[DisturbanceState] = []
        for part in self.parts:
            state = part.init(t, signal, output)
            integrated = any(jax.tree.leaves(s.continuous) for s in states)
            if integrated and jax.tree.leaves(state.sampled):
                raise ValueError(
                    f"Argument `parts` must have {type(part).__name__}, which is updated "
                    "at samples, before what is integrated, but it comes after."
                )
            states.append(state)
            signal = part(t, state, signal, output)
        return DisturbanceState(
            tuple(s.continuous for s in states), tuple(s.sampled for s in states)
        )

    def vector_field(
        self, t: RealArray, state: DisturbanceState, signal: PyTree, output: PyTree = None
    ) -> PyTree:
        passed = self._passed(t, state, signal, output)
        return tuple(part.vector_field(t, s, x, output) for part, s, x, _ in passed)

    def update(
        self, t: RealArray, state: DisturbanceState, signal: PyTree, output: PyTree = None
    ) -> PyTree:
        passed = self._passed(t, state, signal, output)
        return tuple(part.update(t, s, x, output) for part, s, x, _ in passed)

    def __call__(
        self,
        t: RealArray,
        state: DisturbanceState | None,
        signal: PyTree,
        output: PyTree = None,
    ) -> PyTree:
        return list(self._passed(t, state, signal, output))[-1][-1]

    @property
    def has_jumps(self) -> bool:
        return any(part.has_jumps for part in self.parts)

    def jumps(self, t0: float, t1: float) -> HostArray:
        return np.unique(np.concatenate([part.jumps(t0, t1) for part in self.parts]))

    def _passed(
        self, t: Any, state: DisturbanceState | None, signal: PyTree, output: PyTree
    ) -> Iterator[tuple[AbstractDisturbance, DisturbanceState, PyTree, PyTree]]:
        """Each part with its state, what it is given and what it makes of that."""
        nothing = (None,) * len(self.parts)
        both = (nothing, nothing) if state is None else (state.continuous, state.sampled)
        for part, *own in zip(self.parts, *both, strict=True):
            inner = DisturbanceState(*own)
            given, signal = signal, part(t, inner, signal, output)
            yield part, inner, given, signal
