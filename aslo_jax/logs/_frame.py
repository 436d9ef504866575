"""Logs in other frames than the stationary one."""

import dataclasses
import re

import numpy as np

from .._frames import POWER, clarke, inverse_park
from ._error import Columns, LogError
from ._names import ELECTRICAL, MECHANICAL, says
from ._signals import Signals
from ._units import split_unit

FRAMES = ("alpha-beta", "dq", "abc")
KINDS = ("electrical", "mechanical")
ANGLE = "angle"  # our name of the column that turns the frame
COMPONENTS = {"alpha-beta": ("alpha", "beta"), "dq": ("d", "q"), "abc": ("a", "b", "c")}


@dataclasses.dataclass(frozen=True)
class Frame:
    """The frame of the two-phase quantities of a log (those with the names `*_alpha` and
    `*_beta`; of the rotor of an induction machine they stay in the rotor's frame).

    - `name`: `"alpha-beta"`; `"dq"`, whose columns `*_d` and `*_q` are turned by the angle
      of their own row; or `"abc"`, phases `*_a`, `*_b`, `*_c`, of which the last may be
      missing where the three sum to zero;
    - `angle`: the column of the angle of the d axis, by default one whose name says so;
    - `angle_kind`: `"electrical"`, or `"mechanical"` with `pole_pairs`; by default
      electrical, but an angle whose name says that it is mechanical is refused then;
    - `power_invariant`: whether alpha, beta, d and q are sqrt(3/2) times the
      amplitude-invariant ones.

    **Raises:** [`LogError`][] for another name or kind of angle, for settings that do not
    belong to the frame or to the signals, and for an angle that may be of either kind.
    """

    name: str = "alpha-beta"
    angle: str | None = None
    angle_kind: str | None = None
    pole_pairs: int | None = None
    power_invariant: bool = False

    def __post_init__(self) -> None:
        if self.name not in FRAMES:
            raise LogError(
                f"Argument `frame` (option --frame) must be one of {', '.join(FRAMES)}, "
                f"but is {self.name!r}."
            )
        if self.angle_kind not in (None, *KINDS):
            raise LogError(
                "Argument `angle_kind` (option --angle-kind) must be electrical or "
                f"mechanical, but is {self.angle_kind!r}."
            )
        for given, option in ((self.angle, "--angle"), (self.angle_kind, "--angle-kind")):
            if given is not None and self.name != "dq":
                raise LogError(
                    f"{option} is the angle that a frame has turned by, but the frame is "
                    f"{self.name}; add --frame dq."
                )
        if self.power_invariant and self.name == "abc":
            raise LogError(
                "--power-invariant is for components alpha, beta, d and q, but the frame "
                "is abc, and phases are what they are; remove it."
            )
        if self.angle_kind == "mechanical" and not self.pole_pairs:
            raise LogError(
                "a mechanical angle needs the number of pole pairs, which this machine "
                "does not have; give the electrical angle (in Python, `pole_pairs=`)."
            )

    def signals(self, signals: Signals) -> Signals:
        """The columns that a log in this frame has in place of `signals`."""
        if self.name == "alpha-beta":
            return signals
        if not any(_turned(name) for name in signals.inputs + signals.outputs):
            raise LogError(
                f"--frame {self.name} is for columns alpha and beta, but this machine has "
                f"{', '.join(signals.inputs + signals.outputs)}; remove it."
            )
        here = lambda names: tuple(new for name in names for new in self.named(name))
        thirds = [
            name for name in here(signals.inputs + signals.outputs) if name[-2:] == "_c"
        ]
        first = lambda names: tuple(name for name in here(names) if name not in thirds)
        fluxes = tuple(n for n in here(signals.truth) if n not in signals.truth)
        return dataclasses.replace(
            signals,
            inputs=first(signals.inputs) + ((ANGLE,) if self.name == "dq" else ()),
            outputs=first(signals.outputs),
            optional=first(signals.optional),
            truth=(*signals.truth, *thirds, *(fluxes if self.name == "dq" else ())),
        )

    def named(self, name: str) -> tuple[str, ...]:
        """The columns here in place of one that ends in alpha; none for one in beta."""
        stem = _turned(name)
        if not stem:
            return (name,)
        if name.endswith("_beta"):
            return ()
        return tuple(f"{stem}_{end}" for end in COMPONENTS[self.name])

    def check_angle(self, label: str) -> None:
        """Refuse an angle whose name says that it is not what it is taken for."""
        name, _ = split_unit(label)
        if self.angle_kind is None and says(name, MECHANICAL):
            raise LogError(
                f"the angle `{label}` may be mechanical, as its name says, or electrical, "
                "which is the default; say which: --angle-kind mechanical or --angle-kind "
                "electrical (in Python, `angle_kind=` of `Frame`)."
            )

    @property
    def scale(self) -> float:
        """What turns an electrical angle out of the column of the angle."""
        return float(self.pole_pairs or 1) if self.angle_kind == "mechanical" else 1.0

    def stationary(self, columns: Columns) -> Columns:
        """The columns of this frame as alpha and beta, amplitude-invariant, and the angle
        as the electrical one; others as they are."""
        if self.name == "alpha-beta" and not self.power_invariant:
            return columns
        found = dict(columns)
        angle = found.get(ANGLE)
        if angle is not None:
            angle = found[ANGLE] = self.scale * angle
        ends = COMPONENTS[self.name]
        stems = [
            name.rpartition("_")[0] for name in columns if name.endswith("_" + ends[0])
        ]
        for stem in stems if self.name != "alpha-beta" else ():
            names = [f"{stem}_{end}" for end in ends if f"{stem}_{end}" in columns]
            if len(names) < 2:  # one component of a truth is of no use
                continue
            vector = np.stack([found.pop(name) for name in names], axis=1)
            if self.name == "abc":
                vector = clarke(vector)
            else:
                assert angle is not None
                vector = inverse_park(vector, angle)
            found[f"{stem}_alpha"], found[f"{stem}_beta"] = vector.T
        if self.power_invariant:
            for name in filter(lambda name: re.search("_(alpha|beta)$", name), found):
                found[name] = found[name] / POWER
        return found

    def said(self, label: str, step: float) -> str:
        """What was done, in words; nothing in the stationary frame itself.

        - `label`: the column of the angle;
        - `step`: the largest change of the electrical angle from row to row (rad).
        """
        divided = "power-invariant, divided by sqrt(3/2)"
        factor = f"; {divided}" if self.power_invariant else ""
        if self.name == "abc":
            return "phases a, b, c, by Clarke's transformation"
        if self.name != "dq":
            return f"alpha and beta, {divided}" if factor else ""
        which = self.angle_kind or (
            "electrical"
            if says(split_unit(label)[0], ELECTRICAL)
            else "taken as electrical; else --angle-kind mechanical"
        )
        by = f", times {self.pole_pairs} pole pairs" if self.scale != 1.0 else ""
        return (
            f"dq, turned by each row's own angle `{label}` ({which}{by}); the mean over an "
            "interval of a voltage that is constant in dq is half a step further on, here "
            f"up to {0.5 * step:.3g} rad ({np.degrees(0.5 * step):.2g} degrees){factor}"
        )


def _turned(name: str) -> str:
    """The stem of a column that has an alpha or a beta and is not of a rotor, or
    nothing."""
    found = re.fullmatch(r"(\w+)_(alpha|beta)", name)
    return found[1] if found and not found[1].endswith("_r") else ""
