"""What is held of a long log until its rates are chosen."""

import dataclasses
import itertools
from collections.abc import Callable

import numpy as np
from jaxtyping import Bool, Float

from ..logs import Log
from ._noise import Noise, pooled

BLOCK = 50_000  # rows condensed at once: however a log comes, its blocks are the same


def blocks(rows: int) -> list[slice]:
    """The blocks of a log of `rows` rows, of which the last has what is left over, too: the
    noise of a few rows says nothing."""
    starts = [BLOCK * k for k in range(max(rows // BLOCK, 1))]
    return [slice(a, b) for a, b in itertools.pairwise([*starts, rows])]


@dataclasses.dataclass(frozen=True)
class CondensedLog(Log):
    """Of a log, or of a piece of one, what its rates are chosen by, in as few columns as it
    takes; `noise`: that of its samples, where rates depend on it.
    """

    noise: Noise | None = None


class Condensing:
    """A log of which pieces come in order and are condensed in blocks by `condensed`, but
    for rows in which a sample is missing, which are left to the observer."""

    def __init__(self, condensed: Callable[[Log], CondensedLog]) -> None:
        self._condensed = condensed
        self._waiting: list[Log] = []
        self._blocks: list[CondensedLog] = []
        self._there: list[Bool[np.ndarray, " K"]] = []

    def add(self, log: Log) -> None:
        self._waiting.append(log)
        count = sum(piece.t.size for piece in self._waiting)
        if count < 2 * BLOCK:
            return
        log = _joined(self._waiting)
        *whole, rest = blocks(count)
        for rows in whole:
            self._close(_rows(log, rows))
        self._waiting = [_rows(log, rest)]

    def result(self, t: Float[np.ndarray, " N"]) -> CondensedLog:
        """The whole, whose instants (s) are `t`. Nothing is held any longer."""
        if any(log.t.size for log in self._waiting) or not self._blocks:
            self._close(_joined(self._waiting))
        there, blocks = np.concatenate(self._there), self._blocks
        self._waiting, self._blocks, self._there = [], [], []
        noises = [block.noise for block in blocks if block.noise is not None]
        return CondensedLog(
            t if there.all() else t[there],
            np.concatenate([block.u for block in blocks]),
            np.concatenate([block.y for block in blocks]),
            {},
            noise=pooled(noises) if noises else None,
        )

    def _close(self, log: Log) -> None:
        finite = np.isfinite(np.concatenate([log.u, log.y], axis=1))
        there = np.asarray(finite.all(axis=1))
        self._there.append(there)
        if there.any() or not there.size:
            log = log if there.all() else _rows(log, there)
            self._blocks.append(self._condensed(log))


def _joined(logs: list[Log]) -> Log:
    t, u, y = (np.concatenate([getattr(log, k) for log in logs]) for k in ("t", "u", "y"))
    return Log(t, u, y, {})


def _rows(log: Log, rows: slice | Bool[np.ndarray, " N"]) -> Log:
    return Log(log.t[rows], log.u[rows], log.y[rows], {})
