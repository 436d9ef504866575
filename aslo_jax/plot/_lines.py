"""Lines over time, as many points of them as can be seen."""

from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from ._style import SHADE

POINTS = 16_384  # of a line: several to a pixel


def thinned(
    t: Float[np.ndarray, " N"], x: Float[np.ndarray, " N"]
) -> tuple[Float[np.ndarray, " M"], Float[np.ndarray, " M"]]:
    """Of a long line, the least and the largest point of each of some thousand pieces,
    which look the same; of a short one, all."""
    if t.size <= POINTS:
        return t, x
    size = -(-2 * t.size // POINTS)
    rows = np.arange(-(-t.size // size) * size).clip(max=t.size - 1).reshape(-1, size)
    pieces = x[rows]
    least = np.where(np.isnan(pieces), np.inf, pieces).argmin(1)
    most = np.where(np.isnan(pieces), -np.inf, pieces).argmax(1)
    kept = rows[np.arange(rows.shape[0])[:, None], np.sort(np.stack([least, most], 1), 1)]
    kept = np.unique(np.concatenate([[0], kept.ravel(), [t.size - 1]]))
    return t[kept], x[kept]


def positive(x: Float[np.ndarray, " N"]) -> Float[np.ndarray, " N"]:
    """`x` with gaps where a logarithmic axis cannot show it."""
    return np.where((x > 0) & np.isfinite(x), x, np.nan)


def shade(axes, t: Float[np.ndarray, " N"], coasting: Bool[np.ndarray, " N"]) -> None:
    """Shade the intervals in which `coasting` is true."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], coasting, [False]])))
    spans = [(t[a], t[min(b, t.size - 1)]) for a, b in edges.reshape(-1, 2)]
    if spans:
        from matplotlib.collections import PolyCollection

        corners: Any = [[(a, 0.0), (a, 1.0), (b, 1.0), (b, 0.0)] for a, b in spans]
        place = axes.get_xaxis_transform()
        axes.add_collection(
            PolyCollection(corners, transform=place, **SHADE), autolim=False
        )
