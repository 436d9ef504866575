"""Truth of a motor that is in another unit, or of other pole pairs, than its log says."""

import dataclasses

import numpy as np
from jaxtyping import Float

from ._value import Diagnosis, Finding

MOST = 100_000  # rows that are looked at
NEAR = 0.03  # relative, of a ratio and what it is taken for
RIGHT = 0.1  # of a ratio that is of no concern
SPREAD = 0.25  # relative: ratios that spread further tell nothing
TURN = 1.0  # rad over which angles are compared


@dataclasses.dataclass
class Truth:
    """How many times faster the truth of an angle, or of a speed, goes than its estimate.

    - `name`: of its column; `angle`: whether it is an angle (rad) or a speed (rad/s);
    - `pole_pairs` of the machine; `mechanical`: whether the log has the mechanical one.
    """

    name: str
    angle: bool
    pole_pairs: int
    mechanical: bool

    def __post_init__(self):
        self._ratios: list[np.ndarray] = []
        self._rows = 0

    def add(
        self, estimate: Float[np.ndarray, " N"], truth: Float[np.ndarray, " N"]
    ) -> None:
        """The next piece, certified rows alone."""
        there = np.isfinite(estimate) & np.isfinite(truth)
        estimate, truth = estimate[there], truth[there]
        if self._rows >= MOST or estimate.size < 32:
            return
        self._rows += estimate.size
        if self.angle:
            step = float(np.median(np.abs(np.diff(estimate))))
            lag = int(np.clip(TURN / max(step, 1e-9), 1, estimate.size // 4))
            estimate, truth = estimate[lag:] - estimate[:-lag], truth[lag:] - truth[:-lag]
        moves = np.abs(estimate) > 0.3 * np.nanmax(np.abs(estimate))
        if moves.any():
            self._ratios.append(truth[moves] / estimate[moves])

    def diagnosis(self) -> Diagnosis:
        """A warning where truth and estimate differ by a factor that has a name."""
        if not self._ratios:
            return Diagnosis()
        low, ratio, high = np.nanquantile(np.concatenate(self._ratios), [0.25, 0.5, 0.75])
        sure = high - low <= SPREAD * abs(ratio) and np.isfinite(ratio)
        if not sure or abs(ratio - 1.0) < RIGHT:
            return Diagnosis()
        message = f"the truth `{self.name}` goes {ratio:.4g} times as fast as its estimate"
        cause = self._cause(float(ratio))
        kind, told = cause if cause else ("truth_scale", "check its unit")
        return Diagnosis((Finding(kind, f"{message}: {told}"),))

    def _cause(self, ratio: float) -> tuple[str, str] | None:
        near = lambda x: abs(ratio / x - 1.0) < NEAR
        if near(180.0 / np.pi):
            return "truth_unit", "it is in degrees; say so in its name, `[deg]`"
        if not self.angle and near(30.0 / np.pi):
            return "truth_unit", "it is in rpm, not in rad/s; say so in its name, `[rpm]`"
        if not self.angle and near(0.5 / np.pi):
            return "truth_unit", "it is in turns a second; multiply it by 2 pi"
        if near(-1.0):
            return "truth_sign", "it turns the other way; turn its sign, or swap two phases"
        p = self.pole_pairs
        if self.mechanical:
            pairs = p / ratio
            if round(pairs) >= 1 and abs(pairs / round(pairs) - 1.0) < NEAR:
                return (
                    "pole_pairs",
                    f"the machine seems to have {round(pairs)} pole pairs rather than {p}",
                )
        elif p > 1 and near(1.0 / p):
            return (
                "truth_mechanical",
                "it is the mechanical one; call it theta_mechanical or omega_mechanical",
            )
        return None
