"""The figures of the paper's section 2, and some of ours beside them."""

import math

import numpy as np

from ..._text import symbol
from ...plot._figure import Figure
from ...plot._style import BLACK, STYLES
from .._linear import realisation
from . import experiments as s
from .runs import Runs
from .systems import V, W, kalman_variance, printed_variance, variances

ERROR = "error of x₂ (m/s)"
TIME = "time (s)"


def transients(runs: Runs) -> Figure:
    """Figure 1."""
    t = np.asarray(runs.transients.t)[0]
    by_rate, by_gain = runs.transients, runs.gains
    fixed_gain = rf"(b) A-ASLO, γ = {s.GAIN:g} rad/s"
    fixed_rate = rf"(c) A-ASLO, λ = {s.RATE_1C:g} rad/s"
    panels = [
        ("(a) ASLO", s.error(by_rate, "ASLO"), "lambda", s.RATES),
        (fixed_gain, s.error(by_rate, "A-ASLO"), "lambda", s.RATES),
        (fixed_rate, s.error(by_gain, "A-ASLO"), "gamma", s.GAINS),
        ("(d) Luenberger", s.error(by_rate, "Luenberger"), "gamma_L", s.RATES),
    ]
    data = {"t_s": t}
    for title, errors, gain, values in panels:
        panel, observer = title[1], title[4:].split(",")[0]
        for value, error in zip(values, errors[..., 0], strict=True):
            data[f"{panel}_{_key(observer)}_{gain.lower()}_{value:g}_m_per_s"] = error

    def draw(figure):
        axes = figure.subplots(2, 2, sharex=True, sharey=True)
        for ax, (title, errors, gain, values) in zip(axes.flat, panels, strict=True):
            for style, value, error in zip(STYLES, values, errors[..., 0], strict=True):
                name = symbol(gain).replace(" ", "_")
                ax.plot(t, error, label=f"{name} = {value:g} rad/s", **style)
            ax.set(title=title, xlim=(0, 5))
            ax.legend(loc="lower right")
        for ax in axes[:, 0]:
            ax.set_ylabel(ERROR)
        for ax in axes[-1]:
            ax.set_xlabel(TIME)

    caption = (
        "Transients of the three observers from zero, u = cos(0.02 t), x(0) = (0, 0.1): "
        "the paper's figure 1. Only lambda = 2.5 and gamma = 2 are printed; the other "
        "gains are ours."
    )
    return Figure("figure1", caption, data, draw)


def noise(runs: Runs) -> Figure:
    """Figure 2."""
    batch, names = runs.noise, ("ASLO", "A-ASLO")
    shown = batch.t[0] <= 20.0
    t = batch.t[0][shown]
    errors = {name: s.error(batch, name)[0, shown, 0] for name in names}
    observers = s.three(runs.printed)
    deviation = {
        name: math.sqrt(realisation(observers[name]).variance(s.INTENSITY, 0.0))
        for name in names
    }
    data = {"t_s": t, "u_seen_m_per_s2": np.asarray(batch.u)[0, shown]}
    data |= {f"{_key(name)}_m_per_s": errors[name] for name in names}

    def draw(figure):
        axes = figure.subplots(2, 1, sharex=True, sharey=True)
        for ax, name, style in zip(axes, names, STYLES, strict=False):
            color, two = style["color"], 2 * deviation[name]
            band = f"±2 standard deviations in theory, ±{two:.3f} m/s"
            ax.axhspan(-two, two, color=color, alpha=0.15, linewidth=0, label=band)
            ax.plot(t, errors[name], color=color, linewidth=0.9)
            ax.set(title=name, ylabel=ERROR, xlim=(0, 20), ylim=(-0.12, 0.1))
            ax.legend(loc="lower right")
        axes[-1].set_xlabel(TIME)

    caption = (
        "White noise on the u that the observers see, two-sided intensity "
        f"{s.INTENSITY:g} m^2/s^3, held for {s.INTERVAL:g} s; lambda = 3, gamma = 2: the "
        "paper's figure 2 (its noise is not printed). One realisation, every fourth "
        "instant; the Luenberger observer's error is the ASLO's."
    )
    return Figure("figure2", caption, data, draw)


def parasitics(runs: Runs) -> Figure:
    """Figure 3."""
    t, names = np.asarray(runs.parasitics.t)[0], ("ASLO", "A-ASLO")
    errors = {name: s.error(runs.parasitics, name)[..., 0] for name in names}
    data = {"t_s": t}
    for name in names:
        for tau, error in zip(s.LAGS, errors[name], strict=True):
            data[f"{_key(name)}_tau_{tau:g}_s_m_per_s"] = error

    def draw(figure):
        axes = figure.subplots(2, 2, sharey="row")
        for (early, late), name in zip(axes.T, names, strict=True):
            for style, tau, error in zip(STYLES, s.LAGS, errors[name], strict=True):
                early.plot(t, error, label=f"τ = {tau:g} s", **style)
                late.plot(t, error, **style)
            early.set(title=name, xlim=(0, 8))
            late.set(title=f"{name}, slow part", xlim=(8, t[-1]), ylim=(-0.02, 0.002))
            late.set_xlabel(TIME)
        axes[0, 1].legend()
        for ax in axes[:, 0]:
            ax.set_ylabel(ERROR)

    caption = (
        "Parasitic dynamics tau u' = -u + v, u(0) = 0, between the v that the observers "
        "see and the plant; lambda = 3, gamma = 2: the paper's figure 3, and below it the "
        "slow part up to a quarter period of v. Both errors follow v', the A-ASLO's 2.5 "
        "times as far."
    )
    return Figure("figure3", caption, data, draw)


def exact_start(runs: Runs) -> Figure:
    """The printed start against the exact one."""
    t = np.asarray(runs.transients.t)[0]
    names = ("ASLO", "ASLO exact", "A-ASLO", "A-ASLO exact")
    errors = {name: s.error(runs.transients, name)[..., 0] for name in names}
    data = {"t_s": t}
    for name in names:
        for rate, error in zip(s.RATES, errors[name], strict=True):
            data[f"{_key(name)}_lambda_{rate:g}_m_per_s"] = error
    later = t > 0  # at t = 0 the exact estimate is 0/0

    def draw(figure):
        left, right = figure.subplots(1, 2)
        lines = []
        for i, (style, rate) in enumerate(zip(STYLES, s.RATES, strict=True)):
            left.semilogy(t, np.abs(errors["ASLO"][i]), **style)
            label = rf"printed start, λ = {rate:g} rad/s"
            lines += right.plot(t, errors["A-ASLO"][i], label=label, **style)
        largest = np.abs(errors["ASLO exact"]).max(axis=0)
        left.semilogy(t[later], largest[later], color="black", linewidth=0.8)
        left.text(0.15, 2e-9, "exact start", fontsize=8)
        left.set(title="ASLO", xlim=(0, 5), ylim=(1e-12, 1), xlabel=TIME)
        left.set_ylabel("size of the " + ERROR)
        label = r"exact start, the same for every λ"
        lines += right.plot(t, errors["A-ASLO exact"][0], label=label, **BLACK)
        right.set(title=rf"A-ASLO, γ = {s.GAIN:g} rad/s", xlim=(0, 5), xlabel=TIME)
        right.set_ylabel(ERROR)
        figure.legend(handles=lines, loc="outside lower center", ncols=2)

    caption = (
        "The library's exact start against the printed one (ours). The exact ASLO has no "
        "transient for any t > 0, only the tolerance of the solver (shown: the largest "
        "over lambda); the exact A-ASLO decays as exp(-gamma t) for every lambda, as "
        "Cor. 1 claims."
    )
    return Figure("exact_start", caption, data, draw, (7.2, 4.2))


def input_bias(runs: Runs) -> Figure:
    """O4's second claim."""
    run = runs.scenarios["input bias"]
    labels = {
        "ASLO": "ASLO",
        "A-ASLO": "A-ASLO",
        "Luenberger": "Luenberger (on the ASLO)",
        "bias-rejecting": "ASLO, bias-rejecting filter",
    }
    data = {"t_s": np.asarray(run.t)}
    data |= {f"{_key(name)}_m_per_s": s.error(run, name)[:, 0] for name in labels}

    def draw(figure):
        ax = figure.subplots()
        for style, (name, label) in zip(STYLES, labels.items(), strict=True):
            wide = {"linewidth": 4.0, "alpha": 0.5} if name == "ASLO" else {}
            ax.plot(run.t, s.error(run, name)[:, 0], label=label, **style, **wide)
        ax.set(xlabel=TIME, ylabel=ERROR, xlim=(0, 6))
        figure.legend(loc="outside lower center", ncols=2)

    caption = (
        f"A bias of {s.BIAS:g} m/s^2 on the u that the observers see (O4; ours): an error "
        "stays, in the Luenberger observer the same as in the ASLO; a filter with "
        "F'(0) = 0 removes it."
    )
    return Figure("input_bias", caption, data, draw, (5.4, 3.8))


def noise_variance(runs: Runs) -> Figure:
    """The footnote of 2.3: the first-order filter against a second-order one."""
    gains = np.geomspace(1.0, 15.0, 41)
    variance, least = variances(runs.printed, gains), kalman_variance()
    data = {
        "gain_rad_per_s": gains,
        "a_aslo_variance_m2_per_s2": variance,
        "second_order_variance_m2_per_s2": np.full_like(gains, least),
    }
    optimum = (5 * W / (3 * V)) ** 0.25
    best = printed_variance(optimum, optimum)

    def draw(figure):
        ax = figure.subplots()
        first = r"A-ASLO, first-order filter, λ = γ"
        ax.loglog(gains, variance, label=first, **STYLES[0])
        second = rf"ASLO, second-order filter (Kalman): {least:.4f} (m/s)²"
        ax.axhline(least, label=second, **STYLES[1])
        ax.plot(optimum, best, "o", color=STYLES[0]["color"])
        ax.annotate(
            rf"{optimum:.3f} rad/s, {best:.4f} (m/s)²",
            (optimum, best),
            (optimum, 1.1),
            ha="center",
            arrowprops={"arrowstyle": "-", "color": "0.5"},
        )
        for axis, ticks in ((ax.xaxis, (1, 2, 5, 10)), (ax.yaxis, (0.4, 1, 2, 5))):
            axis.set_ticks(ticks, [f"{x:g}" for x in ticks])
            axis.set_ticks([], minor=True)
        ax.set(xlabel="gain (rad/s)", ylim=(0.35, 10))
        ax.set_ylabel("variance of the error ((m/s)²)")
        ax.legend(loc="upper left")

    caption = (
        "Variance of the error under white noise W = 1 m^2/s^3 on u and V = 0.01 m^2 s on "
        "y, from Lyapunov's equation (ours, on the footnote of 2.3): the first-order "
        "A-ASLO, and the ASLO with the second-order filter that makes it the Kalman filter."
    )
    return Figure("noise_variance", caption, data, draw, (5.4, 3.4))


def _key(name: str) -> str:
    return name.lower().replace("-", "_").replace(" ", "_")
