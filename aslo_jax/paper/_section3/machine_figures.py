"""The figures of sections 3.2 and 3.3: the other machines."""

import numpy as np

from ...plot._figure import Figure
from ...plot._style import STYLES
from . import machines as m, settings as s
from .figures import SIZE, TIME, key
from .runs import Runs


def wrim(runs: Runs) -> Figure:
    """Both fluxes of the WRIM, and the inductance of Prop. 3."""
    run = runs.shorted
    shown = run.t > 0
    t = np.asarray(run.t)[shown]
    errors = {name: m.winding_error(run, name)[shown] for name in sorted(run.estimates)}
    depth = 30 * m.DEPTHS
    by_depth = {
        name: 100 * m.relative_by_depth(runs.modulation, name)
        for name in ("as printed", "corrected")
    }
    data: dict[str, np.ndarray] = {"t_s": t}
    data |= {f"{key(name)}_wb": error for name, error in errors.items()}

    def draw(figure):
        (stator, rotor), (flux, depths) = figure.subplots(2, 2)
        kinds = ("ASLO", "A-ASLO", "exact, least squares")
        lines = []
        for ax, winding in ((stator, "stator"), (rotor, "rotor")):
            for kind, i in zip(kinds, (1, 2, 0), strict=True):
                label = "ASLO, exact start, l. s." if i == 0 else f"{kind}, printed start"
                line = ax.loglog(t, errors[f"{winding}, {kind}"], label=label, **STYLES[i])
                lines += line if ax is rotor else []
            ax.set(title=f"{winding} flux", ylim=(1e-13, 1e3), xlim=(1e-3, 10))
            ax.set(xlabel=TIME, ylabel=SIZE)
        wrong = "with 1/Lₛ as printed, exact start, l. s."
        lines += rotor.loglog(t, errors["rotor, as printed"], label=wrong, **STYLES[3])
        for i, part in enumerate(m.WINDINGS.values()):
            size = np.linalg.norm(run.hidden[:, part], axis=1)
            name = tuple(m.WINDINGS)[i]
            flux.plot(run.t, size, label=f"{name} flux", **STYLES[i])
        flux.set(title="true fluxes, shorted rotor", xlabel=TIME, xlim=(0, 10))
        flux.set(ylabel="size of the flux (Wb)", ylim=(0, None))
        flux.legend(loc="lower right")
        for error, i in zip(by_depth.values(), (3, 0), strict=True):
            label = "1/Lₛ as printed" if i == 3 else "1/Lᵣ, corrected"
            depths.plot(depth, error, marker="o", markersize=3, label=label, **STYLES[i])
        depths.set(title="both windings fed", xlabel="modulation of the amplitudes (%)")
        depths.set_ylabel("largest rotor flux error,\nsettled (% of the flux)")
        depths.legend(loc="upper left")
        figure.legend(handles=lines, loc="outside lower center", ncols=2)

    caption = (
        "Both fluxes of the WRIM (L_s = 0.1 H, L_r = 0.3 H; ours, the paper has no "
        "figure). Above: shorted rotor, a supply of 20 V at 12 rad/s with its amplitude "
        "modulated by 30 %, from 1 ms on; with 1/L_s in the rotor's relation, as Prop. 3 "
        "is printed, the rotor flux is never found. Below: the sizes of the true fluxes, "
        "and the error of the rotor flux with both windings fed, which grows with the "
        "modulation and is nothing where every amplitude is constant."
    )
    return Figure("wrim", caption, data, draw, (7.2, 6.2))


def interior_pmsm(runs: Runs) -> Figure:
    """Both forms of the interior PMSM's relation, over saliency and initial angle."""
    run = runs.salient
    windows = {"steady": run.t >= 0.8, "peak": run.t >= 0.2}
    forms = {"without the d current": run.dropped, "self-consistent": run.consistent}
    bands = {
        (form, window): errors[..., within].max(axis=-1)
        for form, errors in forms.items()
        for window, within in windows.items()
    }
    ways = {"min": np.min, "median": np.median, "max": np.max}
    data = {"lq_over_ld_1": m.RATIOS}
    for (form, window), errors in bands.items():
        for way, reduce in ways.items():
            column = f"{key(form)}_{window}_{way}_wb"
            data[column] = reduce(errors, axis=1)

    def draw(figure):
        steady, peak = figure.subplots(1, 2)
        titles = ("largest error, 0.8 to 1.2 s", "largest error, 0.2 to 1.2 s")
        unit = 1e3  # mWb per Wb
        for ax, window, title in zip((steady, peak), windows, titles, strict=True):
            for i, form in enumerate(forms):
                low, middle, high = (
                    unit * f(bands[form, window], axis=1) for f in ways.values()
                )
                color = STYLES[i]["color"]
                ax.fill_between(m.RATIOS, low, high, color=color, alpha=0.2, linewidth=0)
                label = f"({'ab'[i]}) {form}, median of the angles"
                ax.plot(m.RATIOS, middle, ".", color=color)
                ax.plot(m.RATIOS, middle, label=label, **STYLES[i])
            ax.axhline(0.01 * unit * s.MAGNET, color="0.5", linewidth=0.8)
            ax.set(title=title, xlim=(1, 3), xlabel="L_q / L_d (1)")
            ax.set_ylabel("size of the flux error (mWb)")
        steady.set(ylim=(-0.1, 2.6))
        peak.set(ylim=(1e-6, 30), yscale="log")
        for ax, height in ((steady, 1.04), (peak, 1.4)):
            above = height * 0.01 * unit * s.MAGNET
            ax.text(2.95, above, "1 % of the magnet flux", ha="right")
        handles, _ = steady.get_legend_handles_labels()
        figure.legend(handles=handles, loc="outside lower center", ncols=2)

    caption = (
        "An interior PMSM at 150 rad/s (electrical), current 1 + sin 9t A at any angle "
        "from the d axis (ours, on O8): the flux error of (a) the relation without the d "
        "current, which needs no magnet flux, and (b) the one with the d current of its "
        "own estimate, from no flux. Bands run from the least to the largest of 24 initial "
        "angles, lines are their medians. At two of the angles the ripple is on the q axis "
        "alone, and (a) is exact; (b) is at the tolerance of the solver once it has "
        "converged."
    )
    return Figure("interior_pmsm", caption, data, draw, (7.2, 4.0))


def bearing(runs: Runs) -> Figure:
    """Fluxes, position and velocity of the bearing."""
    run = runs.bearing
    names = ("Repeat", "least squares")
    truth = {
        "fluxes": (run.hidden[:, :2], 1e3, "mWb"),
        "position": (run.hidden[:, 2:3], 1e3, "mm"),
        "velocity": (run.hidden[:, 3:], 1e3, "mm/s"),
    }
    parts = (slice(0, 2), slice(2, 3), slice(3, 4))
    units = ("wb", "m", "m_per_s")
    errors = {
        (name, quantity): np.linalg.norm(
            (run.estimates[name].value - run.hidden)[:, part], axis=1
        )
        for name in names
        for quantity, part in zip(truth, parts, strict=True)
    }
    data = {"t_s": run.t, "current_1_a": run.y[:, 0], "current_2_a": run.y[:, 1]}
    for quantity, unit in zip(truth, units, strict=True):
        value = truth[quantity][0]
        for i in range(value.shape[1]):
            suffix = f"_{i + 1}" if value.shape[1] > 1 else ""
            data[f"{quantity}{suffix}_{unit}"] = value[:, i]
        for name in names:
            data[f"{key(name)}_{quantity}_error_{unit}"] = errors[name, quantity]
    shown = run.t > 0

    def draw(figure):
        axes = figure.subplots(3, 2, sharex="col")
        for (left, right), quantity in zip(axes, truth, strict=True):
            value, scale, unit = truth[quantity]
            for i in range(value.shape[1]):
                left.plot(run.t, scale * value[:, i], **STYLES[i])
            left.set_ylabel(f"{quantity} ({unit})")
            for name, i in zip(names, (1, 0), strict=True):
                error = errors[name, quantity][shown]
                right.loglog(run.t[shown], scale * error, label=name, **STYLES[i])
            right.set_ylabel(f"error ({unit})")
        axes[0, 0].set(title="true", xlim=(0, run.t[-1]))
        axes[0, 1].set(title="size of the error", xlim=(run.t[1], run.t[-1]))
        lines = [*axes[0, 0].lines, *axes[0, 1].lines]
        labels = ["true, coil 1", "true, coil 2", "error, Repeat", "error, least squares"]
        figure.legend(lines, labels, loc="outside lower center", ncols=4)
        for ax in axes[-1]:
            ax.set_xlabel(TIME)

    caption = (
        "A magnetic bearing of two coils in a test motion (ours; the paper's conclusions "
        "announce the machine): both fluxes, the position and the velocity of the body "
        "from voltages and currents alone, exact start. The velocity needs certified "
        "fluxes and begins some milliseconds after them; then every error is at the "
        "tolerance of the solver."
    )
    return Figure("bearing", caption, data, draw, (7.2, 5.6))
