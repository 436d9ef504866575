"""Datasheet values to the amplitude-invariant parameters of [`PMSM`][].

Datasheets differ in what they call a constant. Nothing is assumed here: each word that
changes the number is an argument without a default.

The equivalent star winding is meant throughout: with the magnet flux m (Wb) of a phase,
p pole pairs and mechanical speed w (rad/s), the phase voltage without current has the peak
`p m w` and the torque at the peak phase current I on the q axis is `3/2 p m I`. A
line-to-line voltage is sqrt(3) times a phase voltage, a peak sqrt(2) times an rms value.
"""

import math
from typing import TYPE_CHECKING, TypeVar

from ._checks import one_of
from ._choices import Amplitude, Between, Connection, Per, Speed

__all__ = [
    "MISTAKES",
    "RAD_PER_S_PER_KRPM",
    "Quantity",
    "agreed_flux",
    "emf_from_flux",
    "flux_from_emf",
    "flux_from_torque",
    "star_equivalent",
    "torque_from_flux",
]

if TYPE_CHECKING:
    import jax
    import numpy as np

    Quantity = TypeVar("Quantity", float, np.ndarray, jax.Array)
else:
    Quantity = TypeVar("Quantity")  # a number or an array

RAD_PER_S_PER_KRPM = 1000.0 * 2.0 * math.pi / 60.0

MISTAKES = {
    math.sqrt(2.0): "peak for rms",
    math.sqrt(3.0): "line-to-line for phase",
    math.sqrt(1.5): "line-to-line rms for phase peak",
    math.sqrt(6.0): "line-to-line peak for phase rms",
    1.5: "torque without the factor 3/2",
    RAD_PER_S_PER_KRPM: "V per krpm for V s/rad",
    1000.0: "per rpm for per krpm",
}


def _pole_pairs(pole_pairs: int) -> int:
    if pole_pairs < 1 or pole_pairs != int(pole_pairs):
        raise ValueError(
            "Argument `pole_pairs` must be a whole number from 1, half the number of "
            f"poles, but got {pole_pairs}."
        )
    return pole_pairs


def flux_from_emf(
    constant: Quantity,
    *,
    pole_pairs: int,
    amplitude: Amplitude,
    between: Between,
    per: Per,
    speed: Speed,
) -> Quantity:
    """The magnet flux (Wb) from a back-EMF constant Ke.

    - `constant`: Ke (V per `per`), a number or an array;
    - `pole_pairs`: half the number of poles;
    - `amplitude`: `"peak"` or `"rms"` volts;
    - `between`: `"lines"` or `"phase"`, the latter from a terminal to the star point. The
      voltage over one winding of a delta is the one between lines;
    - `per`: `"krpm"` or `"rad/s"`;
    - `speed`: `"mechanical"` or `"electrical"`.
    """
    one_of("amplitude", amplitude, Amplitude)
    one_of("between", between, Between)
    one_of("per", per, Per)
    one_of("speed", speed, Speed)
    volts = constant * (1.0 if amplitude == "peak" else 2**0.5)
    if between == "lines":
        volts = volts / math.sqrt(3.0)
    if per == "krpm":
        volts = volts / RAD_PER_S_PER_KRPM
    return volts / _pole_pairs(pole_pairs) if speed == "mechanical" else volts


def flux_from_torque(
    constant: Quantity, *, pole_pairs: int, amplitude: Amplitude
) -> Quantity:
    """The magnet flux (Wb) from a torque constant Kt.

    - `constant`: Kt (N m per ampere of line current), a number or an array;
    - `pole_pairs`: half the number of poles;
    - `amplitude`: `"peak"` or `"rms"` amperes.
    """
    one_of("amplitude", amplitude, Amplitude)
    per_peak = constant * (1.0 if amplitude == "peak" else math.sqrt(0.5))
    return per_peak / (1.5 * _pole_pairs(pole_pairs))


def star_equivalent(
    value: Quantity, *, between: Between, connection: Connection
) -> Quantity:
    """The resistance (ohm) or inductance (H) of a phase of the equivalent star.

    - `value` (ohm or H): what the datasheet says, a number or an array;
    - `between`: `"lines"`, as measured at two terminals, or `"phase"`, of one winding;
    - `connection`: `"star"` or `"delta"`. It does not matter between lines: half the value
      is right for both, an inductance between lines including the coupling of phases.
    """
    one_of("connection", connection, Connection)
    one_of("between", between, Between)
    if between == "lines":
        return value / 2.0
    return value if connection == "star" else value / 3.0


def emf_from_flux(
    flux: Quantity,
    *,
    pole_pairs: int,
    amplitude: Amplitude,
    between: Between,
    per: Per,
    speed: Speed,
) -> Quantity:
    """The back-EMF constant (V per `per`) that a datasheet would print for a magnet `flux`
    (Wb), a number or an array.

    - `pole_pairs`, `amplitude`, `between`, `per`, `speed`: the convention, as in
      [`flux_from_emf`][].
    """
    one = flux_from_emf(
        1.0,
        pole_pairs=pole_pairs,
        amplitude=amplitude,
        between=between,
        per=per,
        speed=speed,
    )
    return flux / one


def torque_from_flux(flux: Quantity, *, pole_pairs: int, amplitude: Amplitude) -> Quantity:
    """The torque constant (N m/A) that a datasheet would print for a magnet `flux` (Wb), a
    number or an array.

    - `pole_pairs`, `amplitude`: the convention, as in [`flux_from_torque`][].
    """
    return flux / flux_from_torque(1.0, pole_pairs=pole_pairs, amplitude=amplitude)


def agreed_flux(
    emf: float, torque: float, *, pole_pairs: int, tolerance: float = 0.08
) -> float:
    """One magnet flux (Wb) from `emf`, that of [`flux_from_emf`][], and `torque`, that of
    [`flux_from_torque`][], which must agree within the relative `tolerance`.

    Returns the one from the back-EMF, which is measured without current and so without
    saturation; torque constants at the rated current are often a few percent lower.
    `pole_pairs`, half the number of poles, serve to explain a ratio.

    **Raises:** `ValueError` where they differ by more, and names the convention that would
    explain their ratio.
    """
    ratio = emf / torque
    if abs(ratio - 1.0) <= tolerance:
        return emf
    larger, size = ("Ke", ratio) if ratio > 1.0 else ("Kt", 1.0 / ratio)
    causes = {float(_pole_pairs(pole_pairs)): "electrical for mechanical speed"} | MISTAKES
    near = {abs(math.log(size / factor)): cause for factor, cause in causes.items()}
    distance = min(near)
    reason = f"; a factor of that size comes from taking {near[distance]}"
    raise ValueError(
        f"Arguments `emf` and `torque` must agree, but Ke gives {emf:.4g} Wb and Kt "
        f"{torque:.4g} Wb, {larger} {size:.3g} times more"
        f"{reason if distance < 0.06 else ''}; check the conventions of the datasheet."
    )
