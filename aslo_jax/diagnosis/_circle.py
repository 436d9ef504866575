"""The equation of a turning flux: its tip, less what the current links, is on a circle."""

import dataclasses
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from jaxtyping import Complex, Float

if TYPE_CHECKING:
    from ..logs import Frame

PHASES = np.exp(2j * np.pi / 3.0 * np.arange(3))


@dataclasses.dataclass(frozen=True)
class Circle:
    """`|phi - L i| = radius + saliency i_d` with `phi' = u - R i`, in complex numbers
    alpha + j beta; i_d is the current along `phi - L i`.

    - `quantity`: the name of what is estimated with it;
    - `resistance` (ohm), `inductance` (H);
    - `radius` (Wb): that of a magnet; or the factor (H) of the length of the current in the
      columns `other` of y, where they are given; `None` where it is unknown;
    - `resistance_name`, `inductance_name`, `radius_name`, in words, and `radius_unit`;
    - `saliency` (H): Ld - Lq;
    - `inputs`, `outputs`: its columns of u and y, alpha and beta;
    - `phases`: 3, or 2 for a machine that has two windings of its own;
    - `symbols`: our names of voltages and currents; `labels`: what a log calls them, by
      default the same, and `angle` its column that the frame turns by;
    - `frame`: that of the log, `"alpha-beta"`, `"dq"` or `"abc"`; of dq, `pole_pairs` of
      the machine, where they are known, and whether the angle is the `mechanical` one.
    """

    quantity: str
    resistance: float
    inductance: float
    radius: float | None
    resistance_name: str = "resistance"
    inductance_name: str = "inductance"
    radius_name: str = "magnet flux"
    radius_unit: str = "Wb"
    saliency: float = 0.0
    inputs: tuple[int, int] = (0, 1)
    outputs: tuple[int, int] = (0, 1)
    other: tuple[int, int] | None = None
    phases: Literal[2, 3] = 3
    symbols: tuple[str, ...] = ("u_alpha", "u_beta", "i_alpha", "i_beta")
    labels: tuple[str, ...] = ()
    frame: Literal["alpha-beta", "dq", "abc"] = "alpha-beta"
    angle: str = "angle"
    pole_pairs: int | None = None
    mechanical: bool = False

    def read_from(self, frame: "Frame", labels: Mapping[str, str]) -> "Circle":
        """The same of a log in a `frame` of its own, which calls our columns by
        `labels`."""
        symbols = [new for name in self.symbols for new in frame.named(name)]
        symbols = [name for name in symbols if name in labels or name[-2:] != "_c"]
        changes: dict[str, Any] = {"symbols": tuple(symbols)}
        changes["labels"] = tuple(labels.get(name, name) for name in symbols)
        # The rotor of an induction machine is not turned.
        if symbols != list(self.symbols):
            changes |= {"frame": frame.name, "pole_pairs": frame.pole_pairs}
            changes["angle"] = labels.get("angle", "angle")
            changes["mechanical"] = frame.angle_kind == "mechanical"
        return dataclasses.replace(self, **changes)

    def signals(
        self, u: Float[np.ndarray, "N m"], y: Float[np.ndarray, "N n"]
    ) -> tuple[
        Complex[np.ndarray, " N"], Complex[np.ndarray, " N"], Float[np.ndarray, " N"]
    ]:
        """Voltage (V) and current (A) of a log, and what the radius follows: 1 or a
        current (A). An input that is not there is zero."""
        columns = lambda x, pair: x[:, pair[0]] + 1j * x[:, pair[1]]
        current = columns(y, self.outputs)
        there = max(self.inputs) < u.shape[1]
        voltage = columns(u, self.inputs) if there else np.zeros_like(current)
        radius = np.ones(y.shape[0])
        if self.other is not None:
            radius = np.abs(columns(y, self.other))
        return voltage, current, radius

    def dead(self, y: Complex[np.ndarray, " N"]) -> Complex[np.ndarray, " N"]:
        """The direction in which dead time acts against the currents `y`: what one volt of
        it takes off the voltage (dimensionless)."""
        if self.phases == 2:
            return np.sign(np.real(y)) + 1j * np.sign(np.imag(y))
        signs = np.sign(np.real(y[:, None] * PHASES.conj()))
        return 2.0 / 3.0 * signs @ PHASES
