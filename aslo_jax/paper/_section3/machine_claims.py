"""Claims of the paper's sections 3.2 and 3.3: Prop. 3, O6, O7, O8, and the bearing."""

import jax
import numpy as np

from ..._simulate import Simulation
from ...observers import rotor_angle
from .._claims import Above, Below, Claim
from . import machines as m, settings as s
from .runs import Runs
from .settling import size

PRINTED_INDUCTANCE = "w_k4 to w_k6 have 1/L_s for both windings."
SETTLED = "largest error of the rotor flux over the largest one, t in [5, 10] s"
OWN = "the relation of each winding holds with its own inductance L_k"


def windings(shorted: Simulation) -> list[Claim]:
    """Prop. 3, from the machine with a shorted rotor."""
    place, law = "3.2.2, Prop. 3", "The ASLO is the flux of stator and rotor"
    ends = [m.winding_error(shorted, f"{w}, ASLO")[-1] for w in m.WINDINGS]
    exact = [
        m.winding_error(shorted, f"{w}, exact, {c}")[shorted.t > 9e-3].max()
        for w in m.WINDINGS
        for c in ("Repeat", "least squares")
    ]
    flux = np.linalg.norm(shorted.hidden[:, 2:], axis=1)
    late = shorted.t > 5.0
    wrong = m.winding_error(shorted, "rotor, as printed")[late].max() / flux[late].max()
    slip = 12.0 - 2.0 * float(shorted.x.speed[late].mean())
    return [
        Claim(
            "WRIM, convergence",
            place,
            f"{law}, shorted rotor, modulated supply.",
            "larger error of the two fluxes after 10 s, with L_k, filters from zero",
            float(max(ends)),
            "Wb",
            Below(1e-8),
        ),
        Claim(
            "WRIM, exact start",
            place,
            f"{law}, for all t > 0.",
            "largest error for t >= 10 ms, with L_k, exact start",
            float(max(exact)),
            "Wb",
            Below(1e-6),
        ),
        Claim(
            "WRIM, L_s, shorted rotor",
            place,
            PRINTED_INDUCTANCE,
            f"{SETTLED}, supply modulated by 30 %",
            float(wrong),
            "",
            Below(1e-6),
            Above(0.05),
            OWN,
            "The rotor's flux hardly turns in its own frame, at the slip of about "
            f"{slip:.1g} rad/s, so that a small term left out of its relation weighs "
            "heavily.",
        ),
    ]


def inductance(modulation: Simulation) -> list[Claim]:
    """Prop. 3 with either inductance, from the machine with both windings fed."""
    place = "3.2.2, Prop. 3"
    by_depth = {
        name: m.relative_by_depth(modulation, name) for name in modulation.estimates
    }
    return [
        Claim(
            "WRIM, L_s, both windings fed",
            place,
            PRINTED_INDUCTANCE,
            f"{SETTLED}, L_s = 0.1 H, L_r = 0.3 H, amplitudes modulated by 30 %",
            float(by_depth["as printed"][-1]),
            "",
            Below(1e-6),
            Above(0.05),
            OWN,
            f"From {by_depth['as printed'][1]:.2g} at a tenth of that modulation to this.",
        ),
        Claim(
            "WRIM, L_k",
            f"ours, on {place}",
            "With L_k the relation holds, however the amplitudes vary.",
            f"{SETTLED}, worst modulation up to 30 %",
            float(by_depth["corrected"].max()),
            "",
            Below(1e-9),
        ),
        Claim(
            "WRIM, L_s, constant amplitudes",
            f"ours, on {place}",
            "Where every amplitude is constant the wrong inductance does not show.",
            SETTLED,
            float(by_depth["as printed"][0]),
            "",
            Below(1e-9),
        ),
    ]


def stepper(run: Simulation) -> list[Claim]:
    """O6."""
    scale = np.linalg.norm(run.hidden, axis=1).max()
    return [
        Claim(
            "stepper",
            "3.3, O6",
            "The PM stepper motor fulfils the requirements.",
            "largest error over the largest flux for t >= 0.1 s, exact start",
            float(size(run, "ASLO exact")[run.t > 0.09].max() / scale),
            "",
            Below(1e-8),
            remark="Filters from zero: "
            f"{size(run, 'ASLO')[-1] / scale:.0e} after {run.t[-1]:g} s.",
        )
    ]


def angle(run: Simulation, printed: s.Printed) -> list[Claim]:
    """O7, from the closed loop."""
    plant = s.motor()
    L, n = float(plant.inductance), plant.pole_pairs
    later = run.t > 9e-3
    flux, current = (
        run.estimates["ASLO exact, least squares"].value[later],
        run.y[later],
    )
    period = 2 * np.pi / n
    true = run.x.angle[later]

    def off(found):
        return np.abs((found - true + period / 2) % period - period / 2)

    by_arctan = off(printed.angle(flux, current, L, n))
    angle_of = jax.jit(lambda flux, current: rotor_angle(flux, current, L, n))
    by_atan2 = off(np.asarray(angle_of(flux, current)))
    electrical = n * true
    magnet = s.MAGNET * np.stack([np.cos(electrical), np.sin(electrical)], axis=1)
    direct = run.estimates["angle"].value[later] - magnet
    return [
        Claim(
            "angle, arctan",
            "3.3, O7",
            "theta = arctan((L y2 - phi2)/(L y1 - phi1))/n_p.",
            "share of the instants at which it is off by pi/n_p",
            float(np.mean(by_arctan > period / 4)),
            "",
            Below(0.01),
            Above(0.3),
            "atan2(phi2 - L y2, phi1 - L y1)/n_p, known up to 2 pi/n_p",
            "The quotient of the arctangent forgets the common sign.",
        ),
        Claim(
            "angle, atan2",
            "ours, on 3.3, O7",
            "theta = atan2(phi2 - L y2, phi1 - L y1)/n_p, up to its period 2 pi/n_p.",
            "largest error for t >= 10 ms, least squares, exact start",
            float(by_atan2.max()),
            "rad",
            Below(1e-7),
        ),
        Claim(
            "angle, directly",
            "3.3, O7",
            "It is possible to design an ASLO directly for the angle.",
            "largest error of m (cos, sin) for t >= 10 ms, least squares, exact start",
            float(np.linalg.norm(direct, axis=1).max()),
            "Wb",
            Below(1e-7),
        ),
    ]


def interior(run: m.Salient) -> list[Claim]:
    """O8."""
    settled = run.t > 0.8
    last = "largest error for t in [0.8, 1.2] s over the magnet flux, all initial angles"
    worst = run.dropped[-1, :, settled].max() / s.MAGNET
    return [
        Claim(
            "interior PMSM, d(t) dropped",
            "3.3, O8",
            "The perturbation d(t) of the relation is small and can be neglected.",
            f"{last}, Lq/Ld = 3, current 1 + sin 9t A",
            float(worst),
            "",
            Below(0.01),
            remark="It grows with the saliency and with the ripple of the d current, and "
            "is nothing where the ripple is on the q axis alone.",
        ),
        Claim(
            "interior PMSM, no saliency",
            "ours, on 3.3, O8",
            "Without saliency, or without ripple of the d current, nothing is neglected.",
            f"{last}, Lq/Ld = 1",
            float(run.dropped[0, :, settled].max() / s.MAGNET),
            "",
            Below(1e-7),
        ),
        Claim(
            "interior PMSM, self-consistent",
            "ours, on 3.3, O8",
            "With the d current of its own estimate the observer neglects nothing.",
            f"{last}, Lq/Ld from 1 to 3",
            float(run.consistent[..., settled].max() / s.MAGNET),
            "",
            Below(1e-7),
            remark="From no flux at every angle tried; there is no proof. It needs the "
            "magnet flux and Ld - Lq, which the form with d(t) dropped does not.",
        ),
    ]


def bearing(run: Simulation) -> list[Claim]:
    """The bearing that the conclusions announce."""
    later = run.t > 0.019
    error = np.abs(run.estimates["least squares"].value - run.hidden)[later].max(axis=0)
    relative = error / np.abs(run.hidden).max(axis=0)
    parts = (
        ("fluxes", float(relative[:2].max())),
        ("position", float(relative[2])),
        ("velocity", float(relative[3])),
    )
    return [
        Claim(
            f"bearing, {name}",
            "5",
            "The ASLO has been applied to active magnetic bearings.",
            f"largest error of the {name} over the largest size for t >= 20 ms, from "
            "currents and voltages, exact start",
            value,
            "",
            Below(1e-6),
        )
        for name, value in parts
    ]


def claims(runs: Runs) -> list[Claim]:
    """Those of every machine but the surface-mounted PMSM."""
    return [
        *windings(runs.shorted),
        *inductance(runs.modulation),
        *stepper(runs.stepper),
        *angle(runs.closed, runs.printed),
        *interior(runs.salient),
        *bearing(runs.bearing),
    ]
