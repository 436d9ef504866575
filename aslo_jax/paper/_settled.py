"""When an error has settled."""

import numpy as np


def settled(t: np.ndarray, error: np.ndarray, limit: float) -> float:
    """The instant of `t` (s) from which the size of `error` stays at or below `limit`: 0
    where no instant is above it, infinite where the last one is."""
    above = np.flatnonzero(np.abs(error) > limit)
    if above.size == 0:
        return 0.0
    following = above[-1] + 1
    return float(t[following]) if following < t.size else np.inf


def settled_text(t: np.ndarray, error: np.ndarray, limit: float) -> str:
    """[`settled`][] with three digits; where the last instant is above, later than that."""
    time = settled(t, error, limit)
    return f"{time:.3g}" if np.isfinite(time) else f"> {t[-1]:.3g}"
