"""The part of a log that a verdict looks at, which does not grow with the log."""

import dataclasses
from collections.abc import Iterable

import numpy as np
from jaxtyping import Bool, Float

from ..logs import Log

ROWS = 200_000  # of a log, at most
CHUNKS = 10  # of a longer one


@dataclasses.dataclass(frozen=True)
class Chunk:
    """Consecutive rows of a log; `broken`: rows after which something is missing or wrong,
    so that no integral goes over them; `angle`: the electrical one (rad) that a log in dq
    was turned by, and the rows `shift` by which u was moved after that."""

    t: Float[np.ndarray, " N"]
    u: Float[np.ndarray, "N m"]
    y: Float[np.ndarray, "N n"]
    broken: Bool[np.ndarray, " N"]
    angle: Float[np.ndarray, " N"] | None = None
    shift: float = 0.0


class Sample:
    """Chunks of a log of `rows` rows that comes piece by piece, each piece beginning with
    the last row of the one before; its u has been moved by `shift` rows."""

    def __init__(
        self, rows: int, most: int = ROWS, chunks: int = CHUNKS, shift: float = 0.0
    ):
        count = 1 if rows <= most else chunks
        size = min(rows, most // count if count > 1 else rows)
        firsts = np.linspace(0, rows - size, count).astype(int)
        self._ends = [(int(first), int(first) + size) for first in firsts]
        self._parts: list[list[Chunk]] = [[] for _ in self._ends]
        self._rows, self._shift = 0, shift

    def add(self, log: Log, broken: Bool[np.ndarray, " N"] | None = None) -> None:
        """The next piece."""
        begin = max(self._rows - 1, 0)
        skip = self._rows - begin
        broken = np.zeros(log.t.size, bool) if broken is None else broken
        for parts, (first, last) in zip(self._parts, self._ends, strict=True):
            rows = slice(max(first - begin, skip), max(last - begin, 0))
            if log.t[rows].size:
                t, u, y, bad = (np.array(x[rows]) for x in (log.t, log.u, log.y, broken))
                angle = None if log.angle is None else _held(log.angle[rows])
                parts.append(Chunk(t, u, y, bad, angle, self._shift))
        self._rows = begin + log.t.size

    def chunks(self) -> list[Chunk]:
        """Those that have rows."""
        return [_joined(parts) for parts in self._parts if parts]


def _joined(parts: Iterable[Chunk]) -> Chunk:
    parts = list(parts)
    join = lambda name: np.concatenate([getattr(part, name) for part in parts])
    angle = None if parts[0].angle is None else join("angle")
    t, u, y, broken = map(join, ("t", "u", "y", "broken"))
    return Chunk(t, u, y, broken, angle, parts[0].shift)


def _held(x: Float[np.ndarray, " N"]) -> Float[np.ndarray, " N"]:
    """The last value that was finite in place of others; zero before there is one."""
    last = np.maximum.accumulate(np.where(np.isfinite(x), np.arange(x.size), -1))
    return np.where(last >= 0, x[last], 0.0)
