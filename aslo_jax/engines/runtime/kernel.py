"""A loop as machine code."""

import ctypes
from typing import Any

import numpy as np

from ..backend.step import Step
from ..llvm.emit import emit
from .host import compiled, run_in_threads


class Kernel:
    def __init__(self, step: Step):
        self.loop, self.width = step.body.loop, step.width
        self._function = compiled(emit(step), step.target.features)

    def __call__(
        self,
        columns: dict[Any, np.ndarray],
        lanes: int,
        steps: int,
        every: int = 1,
        threads: int = 1,
    ) -> None:
        """From and to the columns of its slots: records are rows of lanes, which are a
        multiple of the width."""
        slots = self.loop.slots
        table = (ctypes.c_void_p * max(len(slots), 1))(
            *(columns[slot].ctypes.data for slot in slots)
        )
        address = ctypes.addressof(table)

        def work(span: tuple[int, int]) -> None:
            self._function(*span, lanes, steps, every, address)

        run_in_threads(work, self._spans(lanes, threads), threads)

    def _spans(self, lanes: int, threads: int) -> list[tuple[int, int]]:
        """Pieces for the threads, the last ones small, so that none waits long for
        another."""
        blocks, first, found = lanes // self.width, 0, []
        while first < blocks:
            size = blocks if threads == 1 else max((blocks - first) // (2 * threads), 1)
            found.append((first * self.width, (first + size) * self.width))
            first += size
        return found
