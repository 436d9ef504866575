"""A loop as machine code."""

import ctypes
from typing import Any

import numpy as np

from .._backend.step import Step
from .._llvm.emit import ALIGNED, emit
from .host import compiled
from .threads import Run, Span

# Seconds of an instruction on a register, and far more than most take.
SLOW = 1e-8
# By that measure: what is not worth another thread, and how long a signal may wait.
SMALL, BRIEF = 1e-3, 5e-2


class Kernel:
    def __init__(self, step: Step) -> None:
        self.loop, self.width = step.body.loop, step.width
        self._once = len(self.loop.needed())
        self._each = max(len(way.events) for way in step.ways)
        text, self._memory = emit(step)
        self._function = compiled(text, step.target.features)

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
            *(_address(columns[slot]) for slot in slots)
        )
        address = ctypes.addressof(table)

        # The machine code has their addresses only: whoever may still run it keeps them.
        def work(span: Span, limit: int, _held: Any = (table, columns)) -> None:
            memory = _aligned(self._memory)
            self._function(*span, lanes, limit, every, address, memory.ctypes.data)

        most = lanes // self.width * (self._once + steps * self._each) * SLOW
        threads = max(min(threads, int(most / SMALL)), 1)
        run = Run(work, self._spans(lanes, threads), steps)
        run.by(threads, brief=most < BRIEF)

    def _spans(self, lanes: int, threads: int) -> list[Span]:
        """Pieces for the threads, the last ones small, so that none waits long for
        another."""
        blocks, first, found = lanes // self.width, 0, []
        while first < blocks:
            size = blocks if threads == 1 else max((blocks - first) // (2 * threads), 1)
            found.append((first * self.width, (first + size) * self.width))
            first += size
        return found


def _address(column: np.ndarray) -> int:
    """That of its first entry, in a fifth of the time of `column.ctypes.data` where the
    column may be written to: there are thousands of them."""
    try:
        held: Any = column
        return ctypes.addressof(ctypes.c_char.from_buffer(held))
    except (TypeError, ValueError, BufferError):
        return column.ctypes.data


def _aligned(size: int) -> np.ndarray:
    """Memory that is not on the stack, which is too short for what every lane has of a
    large network; from the operating system, and not touched before it is used."""
    whole = np.empty(size + ALIGNED if size else 0, np.uint8)
    first = -whole.ctypes.data % ALIGNED
    return whole[first : first + size]
