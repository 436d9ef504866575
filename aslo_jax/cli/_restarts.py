"""Doubt in what an observer says after it has started again amid a log."""

import itertools
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Shaped, UInt8

from ..diagnosis import Rows
from ..machines._base import Rates

FORGETS = 3.0  # time constants after which a filter has forgotten its start to 5 %


class Restarted:
    """Doubt in estimates after an observer has started again amid a log.

    Noise alone may carry the certificate above its threshold while the signals have hardly
    moved. So the first certified estimates are believed once they have been certified for
    as long as it took, or the slowest filter, of this `rate` (rad/s), forgets the start.
    """

    def __init__(self, rate: float) -> None:
        self.longest = FORGETS / rate
        self._since, self._until = -np.inf, -np.inf

    def doubting(
        self,
        t: Float[np.ndarray, " N"],
        coasting: Shaped[np.ndarray, " N"],
        parts: Sequence[slice],
    ) -> UInt8[np.ndarray, " N"]:
        """`coasting`, and where the estimates are in doubt, of a piece of a log at the
        instants `t` (s); each of its `parts` but the first begins with a restart."""
        doubted = coasting.astype(np.uint8)
        for part in parts:
            here, known = t[part], coasting[part] == 0
            if part.start:
                self._since, self._until = here[0], np.inf
            if self._until == np.inf and known.any():
                first = here[np.argmax(known)]
                self._until = first + min(first - self._since, self.longest)
            doubted[part] |= here < self._until
        return doubted


def stretches(rows: int, suspect: Rows | None) -> list[slice]:
    """The parts of a piece of so many `rows`, between which rows are lost."""
    lost = [] if suspect is None else suspect.lost.tolist()
    edges = [0, *(row + 1 for row in lost), rows]
    return [slice(a, b) for a, b in itertools.pairwise(edges)]


def slowest(rates: Rates) -> float:
    """Of the filters (rad/s); infinite where there is none."""
    of = {name: rate.least for name, rate in rates.items() if name != "pll_bandwidth"}
    filters = [rate for rate in of.values() if rate > 0.0]
    return min(filters, default=np.inf)
