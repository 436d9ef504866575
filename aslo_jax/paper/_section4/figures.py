"""The figures of the continuous runs: identities, Prop. 4 as printed, friction."""

import numpy as np

from ..._simulate import Simulation
from ..._text import symbol
from ...plot._figure import Figure
from ...plot._style import STYLES
from . import loops, settings as s
from .runs import Runs

TIME = "time (s)"
SIZE = "largest error of a velocity\n(m/s, rad/s)"


def key(name: str) -> str:
    """A name of a column."""
    for mark, word in ((", ", "_"), (" ", "_"), ("-", "_"), ("'", "dot"), ("/", "_over_")):
        name = name.replace(mark, word)
    return name.replace(".", "").replace("[", "").replace("]", "").lower()


def identities(runs: Runs) -> Figure:
    """Exact and printed start of ASLO and A-ASLO, for both mechanisms."""
    panels = {
        "leg": (runs.leg, "Prop. 4, corrected"),
        "ball and beam": (runs.ball, "Prop. 5"),
    }
    slow, fast = s.GAINS
    data: dict[str, np.ndarray] = {"t_s": np.asarray(runs.leg.t)[1:]}
    for name, (run, proposition) in panels.items():
        for observer in (proposition, *(n for n in run.estimates if "ASLO" in n)):
            column = f"{key(name)}_{key(observer)}_m_or_rad_per_s"
            data[column] = loops.size(run, observer)[1:]

    def draw(figure):
        lines = []
        for row, (name, (run, proposition)) in zip(
            figure.subplots(2, 2, sharex=True, sharey=True), panels.items(), strict=True
        ):
            plotted = (
                (row[0], proposition, "proposition, filters from zero", STYLES[1]),
                (row[0], "ASLO, exact", "ASLO, exact start", STYLES[0]),
                (row[1], f"A-ASLO {slow:g}, paper", _label(slow, "paper"), STYLES[3]),
                (row[1], f"A-ASLO {fast:g}, paper", _label(fast, "paper"), STYLES[1]),
                (row[1], f"A-ASLO {slow:g}, exact", _label(slow, "exact"), STYLES[2]),
                (row[1], f"A-ASLO {fast:g}, exact", _label(fast, "exact"), STYLES[0]),
            )
            for ax, observer, label, style in plotted:
                size = np.maximum(loops.size(run, observer)[1:], 1e-17)
                line = ax.semilogy(run.t[1:], size, label=label, **style)
                lines += line if run is runs.leg else []
            row[0].set(title=f"{name}: ASLO", ylabel=SIZE)
            row[1].set(title=f"{name}: A-ASLO", xlim=(0, 6), ylim=(1e-16, 20))
            for ax in row:
                ax.tick_params(labelleft=True)
        for ax in figure.axes[2:]:
            ax.set_xlabel(TIME)
        figure.legend(handles=lines, loc="outside lower center", ncols=2)

    caption = (
        "The largest error of a velocity in closed loop, lambda = 5 rad/s, from 1 ms on "
        "(ours; the paper has no figure). With the filters from zero Prop. 4, corrected, "
        "and Prop. 5 have a transient of rate lambda; with the exact start there is none, "
        "only the tolerance of the solver. The A-ASLO decays at min(gamma, lambda) with "
        "the printed start, and at gamma with the exact one."
    )
    return Figure("identities", caption, data, draw, (7.2, 6.0))


def _label(gain: float, start: str) -> str:
    words = {"paper": "filters from zero", "exact": "exact start"}
    return rf"A-ASLO, γ = {gain:g} rad/s, {words[start]}"


def proposition4(runs: Runs) -> Figure:
    """Prop. 4 as printed, and corrected."""
    run, data = runs.leg, {"t_s": np.asarray(runs.leg.t)}
    observers = {
        "Prop. 4": "as printed",
        "Prop. 4, F[1/z1]": "with F[1/z₁]",
        "Prop. 4, corrected": "with F[1/z₁] and −F[u₂]/(m₂λ)",
    }
    units = s.leg().units
    for name in observers:
        for j, unit in enumerate(units):
            column = f"{key(name)}_q{j + 1}dot_{unit.replace('/', '_per_')}"
            data[column] = loops.error(run, name)[:, j]

    def draw(figure):
        axes = figure.subplots(1, 3, sharex=True)
        lines = []
        for j, (ax, unit) in enumerate(zip(axes, units, strict=True)):
            styles = (STYLES[1], STYLES[2], STYLES[0])
            for style, (name, label) in zip(styles, observers.items(), strict=True):
                wide = {"linewidth": 4.0, "alpha": 0.5} if name.endswith("]") else {}
                error = loops.error(run, name)[:, j]
                line = ax.plot(run.t, error, label=label, **(style | wide))
                lines += line if j == 0 else []
            ax.set(xlabel=TIME, ylabel=f"error of {symbol(f'qdot{j + 1}')} ({unit})")
            ax.set(xlim=(0, s.SPAN), ylim=(-0.6, 1.2))
        figure.legend(handles=lines, loc="outside lower center", ncols=3)

    caption = (
        "Prop. 4 (ours; the paper has no figure), filters from zero, lambda = 5 rad/s. As "
        "printed no velocity is found: the second has F[z1] in place of F[1/z1] in its "
        "denominator, the first is found from it, and the third has the wrong sign of "
        "F[u2]/(m2 lambda). The transient begins at up to 5 m/s, outside the panel."
    )
    return Figure("proposition4", caption, data, draw, (7.2, 3.3))


def friction(runs: Runs) -> Figure:
    """Friction in its two forms, and left out."""
    panels: dict[str, tuple[Simulation, dict[str, str]]] = {
        f"constant friction, {s.FRICTION:g}": (
            runs.constant,
            {"integrated": "constant, integrated", "left out": "left out"},
        ),
        "friction that varies with q₁": (
            runs.varying,
            {"bounded": "varying, bounded form", "left out": "left out"},
        ),
    }
    data = {"t_s": np.asarray(runs.constant.t)[1:]}
    for kind, (run, labels) in zip(("constant", "varying"), panels.values(), strict=True):
        for name in labels:
            data[f"{kind}_{key(name)}_m_or_rad_per_s"] = loops.size(run, name)[1:]

    def draw(figure):
        axes = figure.subplots(1, 2, sharey=True)
        for ax, (title, (run, labels)) in zip(axes, panels.items(), strict=True):
            for style, (name, label) in zip(STYLES, labels.items(), strict=False):
                size = np.maximum(loops.size(run, name)[1:], 1e-17)
                ax.semilogy(run.t[1:], size, label=label, **style)
            ax.set(title=title, xlabel=TIME, xlim=(0, s.SPAN), ylim=(1e-16, 10))
            ax.legend(loc="center right")
        axes[0].set_ylabel(SIZE)

    caption = (
        "The robotic leg with friction (ours), exact start, lambda = 5 rad/s, from 1 ms "
        "on: constant friction is integrated, friction that varies with the length of the "
        "leg is taken up in the bounded form, both to rounding; left out, either leaves an "
        "error of some 1e-2."
    )
    return Figure("friction", caption, data, draw, (7.2, 3.2))
