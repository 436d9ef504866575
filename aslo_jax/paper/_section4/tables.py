"""How fast, how far off and how exact: the tables of the section."""

import numpy as np

from ..._simulate import Simulation
from .._report import Table
from .._settled import settled_text
from . import loops, settings as s
from .comparison_claims import best_differentiator, ratios
from .runs import Runs
from .tuning import ASLO, CONTENDERS, DIFFERENTIATORS, START_UP

TITLE = "Section 4 of the paper"


def settling(runs: Runs) -> Table:
    """The table `settling`: every observer of the continuous runs, by coordinate."""
    experiments = {
        "leg": (runs.leg, s.leg()),
        "ball and beam": (runs.ball, s.ball()),
        "leg, constant friction": (runs.constant, s.leg()),
        "leg, varying friction": (runs.varying, s.leg()),
    }
    rows = [
        row
        for name, (run, mechanism) in experiments.items()
        for observer in run.estimates
        for row in _rows(name, run, observer, mechanism.units)
    ]
    caption = (
        "The error of every velocity in the continuous closed loops, lambda = "
        f"{s.RATE:g} rad/s; the number of an A-ASLO is its gamma (rad/s), *paper* the "
        "start with every filter from zero. *Settled* is the time from which it stays "
        "below 5 % and 0.1 % of the largest size of the velocity, 0 where it is below at "
        "every instant after t = 0. *Peak* is the largest error from 1 ms on, *rms* and "
        f"*later peak* are over t in [{START_UP:g}, {s.SPAN:g}] s, *final* is the last "
        "error."
    )
    return Table("settling", f"{TITLE}: settling in continuous time", caption, rows)


def _rows(experiment: str, run: Simulation, observer: str, units) -> list[dict[str, str]]:
    error, t = np.abs(loops.error(run, observer)), np.asarray(run.t)
    later = t >= START_UP
    found = []
    for j, unit in enumerate(units):
        scale = np.abs(run.hidden[:, j]).max()
        begun = t[1:], error[1:, j]  # no estimate exists at t = 0 yet
        found.append(
            {
                "experiment": experiment,
                "observer": observer,
                "velocity": f"q{j + 1}'",
                "unit": unit,
                "size": f"{scale:.3g}",
                "settled_5_percent_s": settled_text(*begun, 0.05 * scale),
                "settled_0.1_percent_s": settled_text(*begun, 1e-3 * scale),
                "peak": f"{begun[1].max():.3g}",
                "rms": f"{np.sqrt(np.mean(error[later, j] ** 2)):.3g}",
                "later_peak": f"{error[later, j].max():.3g}",
                "final_error": f"{error[-1, j]:.3g}",
            }
        )
    return found


def contenders(runs: Runs) -> Table:
    """The table `contenders`: every contender in every case, by coordinate."""
    rows = []
    for mechanism, compared in runs.compared.items():
        for case, tuned in compared.tuned.items():
            for name, found in tuned.items():
                for j, unit in enumerate(compared.mechanism.units):
                    rows.append(
                        {
                            "mechanism": mechanism,
                            "case": case,
                            "contender": name,
                            "model": "yes" if CONTENDERS[name].model else "no",
                            "velocity": f"q{j + 1}'",
                            "unit": unit,
                            "gain": CONTENDERS[name].gain,
                            "value": f"{found.gains[j]:.3g}",
                            "settled_5_percent_s": f"{np.median(found.settled[:, j]):.3g}",
                            "rms": f"{found.total[j]:.3g}",
                            "peak": f"{found.peak[:, j].max():.3g}",
                            "final_error": f"{np.median(found.final[:, j]):.3g}",
                        }
                    )
    caption = (
        "Every contender, sampled at 1 kHz, with the gains found for it (rad/s; of "
        "super-twisting m/s^2 or rad/s^2), on the records of validation: *settled* and "
        f"*final* are medians over them, *rms* and *peak* are over t in [{START_UP:g}, "
        f"{s.INTERVAL * s.STEPS:g}] s of all of them."
    )
    return Table("contenders", f"{TITLE}: tuned contenders", caption, rows)


def comparison(runs: Runs) -> Table:
    """The table `comparison`: the rms errors beside each other."""
    rows = []
    for mechanism, compared in runs.compared.items():
        for case, tuned in compared.tuned.items():
            ratio = ratios(tuned)
            for j, unit in enumerate(compared.mechanism.units):
                best, _ = best_differentiator(tuned, j)
                row = {"mechanism": mechanism, "case": case, "velocity": f"q{j + 1}'"}
                row |= {"unit": unit}
                row |= {name: f"{e.total[j]:.3g}" for name, e in tuned.items()}
                row |= {"best differentiator": best}
                row |= {"ASLO over it": f"{ratio[j]:.2g}"}
                row |= {"ASLO is": "no worse" if ratio[j] <= 1.0 else "worse"}
                rows.append(row)
    caption = (
        "The rms error of every tuned contender on the records of validation, and that of "
        f"the {ASLO} over that of the best differentiator without a model "
        f"({', '.join(DIFFERENTIATORS)})."
    )
    return Table("comparison", f"{TITLE}: rms errors of tuned contenders", caption, rows)
