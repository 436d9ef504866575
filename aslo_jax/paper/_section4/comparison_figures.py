"""The figures of the sampled comparison."""

import numpy as np

from ..._text import symbol
from ...plot._figure import Figure
from ...plot._style import STYLES
from .comparison_claims import best_differentiator
from .figures import TIME, key
from .records import INSTANTS
from .runs import Runs
from .tuning import ASLO, RATES, START_UP

# Beyond the four styles of the other figures, more of Okabe and Ito's colours.
COLORS = {
    "ASLO": "#0072B2",
    "ASLO, paper start": "#56B4E9",
    "ASLO, second order": "#0072B2",
    "A-ASLO": "#56B4E9",
    "extended Kalman": "black",
    "high gain, model": "#009E73",
    "high gain": "#D55E00",
    "super-twisting": "#CC79A7",
    "filtered derivative": "#E69F00",
}
DASHED = {"ASLO, paper start", "ASLO, second order", "high gain, model"}
WINDOW = 50  # samples of the moving rms


def _panels(runs: Runs) -> list[tuple[str, int, str]]:
    """Mechanism, coordinate and unit of each panel."""
    return [
        (name, j, unit)
        for name, compared in runs.compared.items()
        for j, unit in enumerate(compared.mechanism.units)
    ]


def _title(name: str, j: int) -> str:
    return f"{name}: {symbol(f'qdot{j + 1}')}"


def moving_rms(error: np.ndarray) -> np.ndarray:
    """The rms of each `WINDOW` samples, at their last one."""
    squares = np.concatenate([[0.0], np.cumsum(error**2)])
    mean = (squares[WINDOW:] - squares[:-WINDOW]) / WINDOW
    return np.sqrt(np.maximum(mean, 0.0))


def peers(runs: Runs, case: str = "16 bit") -> Figure:
    """The errors of the tuned contenders over time."""
    every = 10
    t = INSTANTS[WINDOW - 1 :: every]
    data, panels = {"t_s": t}, _panels(runs)
    for name, j, unit in panels:
        for contender, found in runs.compared[name].tuned[case].items():
            column = f"{name}_q{j + 1}dot_{key(contender)}_{unit.replace('/', '_per_')}"
            data[column] = moving_rms(found.first[:, j])[::every]

    def draw(figure):
        axes, legend = _axes(figure, len(panels), sharex=True, sharey=True)
        lines = []
        for ax, (name, j, unit) in zip(axes, panels, strict=True):
            lines = []
            for contender, found in runs.compared[name].tuned[case].items():
                style = {"linestyle": "--"} if contender in DASHED else {}
                error = moving_rms(found.first[:, j])[::every]
                color = COLORS[contender]
                lines += ax.semilogy(t, error, label=contender, color=color, **style)
            ax.set(title=_title(name, j), xlabel=TIME, ylabel=f"rms error ({unit})")
            ax.set(xlim=(0, t[-1]), ylim=(3e-8, 10))
            ax.tick_params(labelleft=True, labelbottom=True)
        legend.legend(handles=lines, loc="center")

    caption = (
        f"The tuned contenders on one record of validation, {case} encoders at 1 kHz: the "
        f"rms error of the last {WINDOW} ms of each velocity. Every estimate begins at "
        f"zero; gains are tuned for the errors after {START_UP:g} s, not for the start."
    )
    return Figure("peers", caption, data, draw, (7.2, 5.4))


def tuned(runs: Runs) -> Figure:
    """The rms error of every contender in every case."""
    panels = _panels(runs)
    first = next(iter(runs.compared.values())).tuned
    cases, names = list(first), list(first[next(iter(first))])
    data = {"contender_index": np.arange(len(names), dtype=float)}
    for name, j, unit in panels:
        for case in cases:
            column = f"{name}_q{j + 1}dot_{_case(case)}_rms_{unit.replace('/', '_per_')}"
            found = runs.compared[name].tuned[case]
            data[column] = np.array([each.total[j] for each in found.values()])

    def draw(figure):
        axes, legend = _axes(figure, len(panels), sharey=True)
        marks = ("s", "o", "^", "D")
        lines = []
        for k, (ax, (name, j, unit)) in enumerate(zip(axes, panels, strict=True)):
            lines = []
            rows = -np.arange(len(names))
            for mark, case, style in zip(marks, cases, STYLES, strict=True):
                found = runs.compared[name].tuned[case]
                rms = [each.total[j] for each in found.values()]
                color = style["color"]
                # The last case is the second one without a model: around it.
                size = {"markersize": 9, "fillstyle": "none"} if mark == "D" else {}
                lines += ax.semilogx(rms, rows, mark, color=color, label=case, **size)
            ax.set_yticks(rows, list(names))
            ax.tick_params(labelleft=k % 3 == 0)
            ax.set(title=_title(name, j), xlabel=f"rms error ({unit})", xlim=(3e-7, 1e-1))
            ax.set_xticks([1e-6, 1e-4, 1e-2])
        legend.legend(handles=lines, loc="center")

    order = ", ".join(f"{k} {name}" for k, name in enumerate(names))
    caption = (
        "The rms error of every velocity, each contender with its gains tuned by the same "
        "search on the same budget, on records of validation with other first states: "
        "encoders of 12 and 16 bit, white noise of 1e-4 m and rad before one of 16 bit, "
        "and all parameters of the model 5 % wrong, which the last three contenders, that "
        "use no model, do not feel. "
        f"In the data contenders are numbered: {order}."
    )
    return Figure("tuned", caption, data, draw, (7.2, 5.0))


def _case(case: str) -> str:
    return case.replace(" % ", "_percent_").replace(", ", "_").replace(" ", "_")


def model_errors(runs: Runs) -> Figure:
    """What a wrong parameter costs, over the rate of the filter."""
    panels, data = _panels(runs), {"lambda_rad_per_s": RATES}
    for name, j, unit in panels:
        for parameter, rms in runs.compared[name].swept.items():
            column = f"{name}_q{j + 1}dot_{parameter}_wrong_{unit.replace('/', '_per_')}"
            data[column] = rms[:, j]

    def draw(figure):
        axes, legend = _axes(figure, len(panels), sharex=True, sharey=True)
        lines: dict = {}
        for ax, (name, j, unit) in zip(axes, panels, strict=True):
            compared = runs.compared[name]
            for k, (parameter, rms) in enumerate(compared.swept.items()):
                (line,) = ax.loglog(RATES, rms[:, j], **STYLES[k])
                label = "nothing wrong" if k == 0 else f"{name}: {parameter} wrong"
                lines.setdefault(k, (line, []))[1].append(label)
            _, error = best_differentiator(compared.tuned["16 bit"], j)
            line = ax.axhline(error, color="0.4", linewidth=1.0)
            lines.setdefault(-1, (line, ["best tuned differentiator"]))
            ax.set(title=_title(name, j), ylabel=f"rms error ({unit})", ylim=(2e-6, 0.2))
            ax.set_xlabel(r"λ (rad/s)")
            ax.tick_params(labelleft=True, labelbottom=True)
        handles = [line for line, _ in lines.values()]
        labels = ["\n".join(dict.fromkeys(words)) for _, words in lines.values()]
        legend.legend(handles, labels, loc="center")

    caption = (
        f"The rms error of the {ASLO} over its rate lambda, 16 bit encoders, with one "
        "parameter of its model 5 % too large: a slow filter trusts the model, a fast one "
        "the encoder. These are the records of the search; the line is the best tuned "
        "differentiator without a model, on those of validation."
    )
    return Figure("model_errors", caption, data, draw, (7.2, 5.2))


def _axes(figure, count: int, **shared):
    """`count` panels in rows of three, and one more for the legend."""
    axes = figure.subplots(-(-(count + 1) // 3), 3, **shared).ravel()
    for ax in axes[count:]:
        ax.set_axis_off()
    return axes[:count], axes[count]
