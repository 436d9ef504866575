"""Whether estimated velocities lead along the positions that were measured."""

import numpy as np
from jaxtyping import Bool, Float

from ._value import Diagnosis, Finding

WINDOW = 100  # rows over which way and velocity are compared
UNEXPLAINED = 0.5  # of the way: an error above which the log does not fit
NOISY = 10.0  # times the noise of the position, below which nothing is said


class Motion:
    """The difference of `q[k] - q[k - 100]` and the integral of a velocity, over a log that
    comes piece by piece. An observer finds the velocity from the acceleration equation:
    where the inputs do not explain the positions, it does not lead along them.

    - `name`: of the velocity.
    """

    def __init__(self, name: str):
        self.name = name
        self._error, self._way, self._noise = 0.0, 0.0, 0.0
        self._rows, self._triples = 0, 0

    def add(
        self,
        t: Float[np.ndarray, " N"],
        q: Float[np.ndarray, " N"],
        velocity: Float[np.ndarray, " N"],
        trusted: Bool[np.ndarray, " N"],
    ) -> None:
        """The next piece: position (m, rad), velocity, and whether that is certified."""
        window = min(WINDOW, t.size // 2)
        if window < 10 or not np.isfinite(q).all():
            return
        steps = np.diff(t) * 0.5 * (velocity[1:] + velocity[:-1])
        led = np.concatenate([[0.0], np.cumsum(steps)])
        back = lambda x, rows: x[window:] - x[window - rows : x.size - rows]
        doubtful = np.concatenate([[0], np.cumsum(~trusted)])
        whole = doubtful[window + 1 :] == doubtful[: -window - 1]
        ways = [np.abs(back(q, window // k)) for k in (1, 2, 4)]
        error = (back(q, window) - back(led, window))[whole]
        self._error += float(np.sum(error**2))
        self._way += float(np.sum(np.max(ways, axis=0)[whole] ** 2))
        self._rows += int(whole.sum())
        curves = q[3:] - 3.0 * q[2:-1] + 3.0 * q[1:-2] - q[:-3]
        self._noise += float(np.sum(curves**2)) / 20.0
        self._triples += curves.size

    def diagnosis(self) -> Diagnosis:
        """A warning where the inputs do not explain the positions."""
        if not self._rows:
            return Diagnosis()
        error = (self._error / self._rows) ** 0.5
        way = (self._way / self._rows) ** 0.5
        noise = (self._noise / max(self._triples, 1)) ** 0.5
        figures = {f"unexplained_{self.name}": error / way if way > 0 else 0.0}
        if error <= UNEXPLAINED * way or error <= NOISY * noise:
            return Diagnosis(figures=figures)
        times = error / way if way > 0 else np.inf
        message = (
            f"the inputs do not explain the positions: {self.name} leads away from them by "
            f"{times:.2g} times their way in {WINDOW} rows; check unit, sign and timing of "
            "the inputs, the inertia, friction and input matrix, and whether forces act "
            "that are not in the log; a higher --cutoff trusts the equation less"
        )
        return Diagnosis((Finding("unexplained_motion", message),), figures)
