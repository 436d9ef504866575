"""The figures of section 3.1: the PMSM."""

import numpy as np

from ...plot._figure import Figure
from ...plot._style import BLACK, STYLES
from . import pmsm, settings as s
from .runs import Runs
from .settling import size

TIME = "time (s)"
ERROR = "flux error (Wb)"
SIZE = "size of the flux error (Wb)"
GREY = {"color": "0.6", "linewidth": 1.0}


def flux_errors(runs: Runs) -> Figure:
    """The five panels of 3.1.3, FO2 twice."""
    run, names = runs.closed, pmsm.PAPER
    titles = {
        "FO2, gamma 5": r"FO2, γ = 5 s⁻¹ Wb⁻²",
        "FO2, gamma 1000": r"FO2, γ = 1000 s⁻¹ Wb⁻²",
    }
    errors = {name: np.asarray(run.estimates[name].value - run.hidden) for name in names}
    data = {"t_s": np.asarray(run.t)}
    for name, error in errors.items():
        data |= {f"{key(name)}_{i + 1}_wb": error[:, i] for i in (0, 1)}

    def draw(figure):
        axes = figure.subplots(3, 2, sharey=True)
        lines = []
        for ax, name in zip(axes.flat, names, strict=True):
            lines = [
                ax.plot(run.t, errors[name][:, i], label=label, **STYLES[i])[0]
                for i, label in enumerate((r"α component", r"β component"))
            ]
            end = s.SPAN if name == "FO2, gamma 5" else 3.0
            ax.set(title=titles.get(name, name), xlim=(0, end), ylim=(-0.3, 0.3))
        peak = np.abs(errors["ASLO"][1:]).max()
        axes.flat[0].text(
            0.98,
            0.08,
            f"beyond the frame: up to {peak:.0f} Wb at 1 ms",
            transform=axes.flat[0].transAxes,
            ha="right",
            fontsize=8,
        )
        for ax in axes[:, 0]:
            ax.set_ylabel(ERROR)
        for ax in axes[-1]:
            ax.set_xlabel(TIME)
        axes[1, 1].set_xlabel(TIME)
        figure.legend(handles=lines, loc="outside lower center", ncols=2)

    caption = (
        "Flux errors of ASLO, A-ASLO, FO1, FO2 and FO3 as printed (lambda = gamma = 5, FO2 "
        "also with gamma = 1000), every filter and every estimate from zero: the paper's "
        "figure of 3.1.3. The PMSM of Table 1 follows 2 + 0.5 sin t rad/s under a load of "
        "3 + 0.5 sin 0.1t N m, from rest, under PI control with the measured angle. The "
        "panel of FO2 with gamma = 5 shows 10 s, the others 3 s."
    )
    return Figure("flux_errors", caption, data, draw, (7.2, 6.6))


def exact_start(runs: Runs) -> Figure:
    """The exact start and least squares beside the paper's start."""
    run = runs.closed
    shown = np.asarray(run.t) > 0  # at t = 0 there is no estimate yet
    t = np.asarray(run.t)[shown]
    names = (*pmsm.PAPER, *pmsm.EXACT)
    errors = {name: size(run, name)[shown] for name in names}
    data = {"t_s": t} | {f"{key(name)}_wb": error for name, error in errors.items()}

    def draw(figure):
        axes = figure.subplots(2, 2, sharex=True, sharey=True)
        for ax, name in zip(axes.flat, pmsm.EXACT, strict=True):
            printed = name.split(" exact")[0]
            ax.loglog(t, errors[printed], label=f"{printed}, printed start", **STYLES[1])
            for peer in ("FO1", "FO2, gamma 1000"):
                label = f"{peer} for comparison" if ax is axes.flat[0] else None
                style = "-" if peer == "FO1" else ":"
                ax.loglog(t, errors[peer], linestyle=style, label=label, **GREY)
            ax.loglog(t, errors[name], label=name, **STYLES[0])
            ax.set(title=name, xlim=(1e-3, s.SPAN), ylim=(1e-15, 1e3))
        for ax in axes[:, 0]:
            ax.set_ylabel(SIZE)
        for ax in axes[-1]:
            ax.set_xlabel(TIME)
        lines = [
            axes[0, 0].lines[0],
            axes[0, 0].lines[3],
            axes[0, 0].lines[1],
            axes[0, 0].lines[2],
        ]
        labels = [
            "printed start",
            "exact start",
            "FO1, printed",
            r"FO2, γ = 1000, printed",
        ]
        figure.legend(lines, labels, loc="outside lower center", ncols=4)

    first = 1e3 * errors["A-ASLO exact, least squares"][0]
    caption = (
        "The same run with the library's exact start (ours), from 1 ms on. Neither Repeat "
        "nor least squares has a transient: what is left is the tolerance of the solver. "
        "The A-ASLO starts at the first certified estimate; with least squares that one "
        f"still carries rounding, {first:.1g} mWb of it at 1 ms, which then decays with "
        "gamma."
    )
    return Figure("exact_start", caption, data, draw, (7.2, 5.4))


def reversal(runs: Runs) -> Figure:
    """The speed 2 sin t under noise."""
    run, names = runs.reversal, tuple(pmsm.REVERSAL)
    labels = {
        "Repeat, no guard": r"Repeat, λ = 5 rad/s, no guard",
        "Repeat": r"Repeat, λ = 5 rad/s",
        "least squares": r"least squares, λ = 5 rad/s",
        "least squares, lambda 50": r"least squares, λ = 50 rad/s",
    }
    data = {"t_s": run.t, "speed_rad_per_s": run.speed, "delta_a2": run.delta}
    for name in names:
        data[f"{key(name)}_error_wb"] = run.error[name]
        data[f"{key(name)}_certificate_1"] = run.certificate[name]
        data[f"{key(name)}_coasts_1"] = run.coasting[name].astype(float)
    guarded = names[1:]

    def draw(figure):
        axes = figure.subplots(4, 1, sharex=True, height_ratios=(1, 2, 1.6, 0.7))
        speed, error, certificate, coasting = axes
        speed.plot(run.t, run.speed, color="black", linewidth=1.0)
        speed.set_ylabel("speed\n(rad/s)")
        delta = speed.twinx()
        delta.plot(run.t, run.delta, linewidth=1.0, **_plain(STYLES[3]))
        delta.set_ylabel("Δ (A²)", color=STYLES[3]["color"])
        delta.grid(visible=False)
        bound = 1.1 * np.abs(run.delta).max()
        delta.set_ylim(-bound, bound)
        speed.set_ylim(-2.4, 2.4)
        lines = []
        for name, style in zip(names, (GREY, *STYLES), strict=False):
            lines += error.semilogy(
                run.t, run.error[name], label=labels[name], **_thin(style)
            )
        error.axhline(s.MAGNET, color="black", linestyle=(0, (4, 2)), linewidth=0.8)
        error.text(7.95, 1.2 * s.MAGNET, "magnet flux", ha="right", fontsize=8)
        error.set(ylim=(1e-5, 1e2))
        error.set_ylabel("size of the\nflux error (Wb)")
        for i, (name, style) in enumerate(zip(guarded, STYLES, strict=False)):
            certificate.semilogy(run.t, run.certificate[name], **_thin(style))
            coasting.fill_between(
                run.t, i - 0.35, i + 0.35, run.coasting[name], color=style["color"]
            )
        certificate.axhline(s.THRESHOLD, **(BLACK | {"linewidth": 0.8}))
        certificate.text(1.05, 0.3 * s.THRESHOLD, "threshold of the guard", fontsize=8)
        certificate.set(ylim=(1e-7, 2))
        certificate.set_ylabel("certificate (1)")
        coasting.set_yticks(range(3), ["Repeat", "l. s., 5", "l. s., 50"], fontsize=7)
        coasting.grid(visible=False, axis="y")
        coasting.set(ylim=(2.6, -0.6), xlim=(0, s.REVERSAL_SPAN), xlabel=TIME)
        coasting.set_ylabel("coasts")
        figure.legend(handles=lines, loc="outside lower center", ncols=2)

    caption = (
        "The speed 2 sin t rad/s under the paper's load, sampled at 10 kHz, with noise of "
        "10 mA and 0.1 V (ours): per millisecond, the largest flux error and the least "
        "certificate, and whether the estimate coasts on the known derivative because the "
        f"certificate is below {s.THRESHOLD:g}. Delta changes its sign at each reversal; "
        "least squares with lambda = 5 carries its information over it and does not coast "
        "after the first sample."
    )
    return Figure("reversal", caption, data, draw, (7.2, 7.4))


def key(name: str) -> str:
    """A name for columns."""
    for old, new in ((",", ""), ("-", "_"), (" ", "_")):
        name = name.lower().replace(old, new)
    return name


def _thin(style: dict) -> dict:
    return style | {"linewidth": 1.0}


def _plain(style: dict) -> dict:
    return {"color": style["color"]}
