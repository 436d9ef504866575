"""`aslo-jax estimate`: the flux observer over a recorded log."""

import math
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from .._extras import require
from ..logs import Log, check_suffix, read_log, write_table
from ..machine import Machine, read_machine
from . import flux
from .outputs import refuse_overlap, staged


def estimate(
    log: Annotated[Path, typer.Argument(help="The log: .csv, .parquet or .npz.")],
    machine: Annotated[Path, typer.Option(help="The motor, a TOML file.")],
    out: Annotated[Path, typer.Option(help="The table: .csv, .parquet or .npz.")],
    plot: Annotated[
        Path | None, typer.Option(help="A figure as well: .png, .pdf or .svg.")
    ] = None,
    column: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME=COLUMN",
            help="What the log calls a column, for instance u_alpha=Ualpha; repeatable.",
        ),
    ] = None,
    cutoff: Annotated[
        float | None,
        typer.Option(
            help="Cutoff of the filter (rad/s), in place of the machine's. By default the "
            "log's typical electrical speed over sqrt(3)."
        ),
    ] = None,
    pll_bandwidth: Annotated[
        float | None,
        typer.Option(
            help="Bandwidth of the phase-locked loop (rad/s), in place of the machine's; "
            "100 by default."
        ),
    ] = None,
    substeps: Annotated[
        int,
        typer.Option(
            min=1,
            help="Steps per sampling interval, between which currents are interpolated.",
        ),
    ] = 4,
    max_gap: Annotated[
        float | None,
        typer.Option(help="Longest interval allowed (s); by default ten median ones."),
    ] = None,
    truth: Annotated[
        bool, typer.Option(help="Read the truth columns, where there are any, and score.")
    ] = True,
    quiet: Annotated[
        bool, typer.Option("--quiet", "-q", help="Neither summary nor progress.")
    ] = False,
) -> None:
    """Estimate flux, angle and speed of a PMSM over a recorded LOG.

    Columns in: t (s); u_alpha, u_beta (V), the mean over [t[k], t[k+1]); i_alpha, i_beta
    (A), sampled at t[k]; stationary frame, amplitude-invariant. Truth, for scoring only:
    flux_alpha, flux_beta (Wb), theta_electrical (rad), omega_mechanical (rad/s).

    Columns out: t; flux_alpha, flux_beta (Wb); theta_electrical (rad, unwrapped);
    omega_electrical (rad/s); certificate (dimensionless, small where the flux is not
    observable); coasting (1 where it is below the threshold and the flux is carried along
    u - R i); and, where there is truth, error_* (estimate less truth).
    """
    for name, value in {
        "--cutoff": cutoff,
        "--pll-bandwidth": pll_bandwidth,
        "--max-gap": max_gap,
    }.items():
        _positive(name, value)
    check_suffix(out)
    outputs = {"--out": out} | ({"--plot": plot} if plot else {})
    refuse_overlap(outputs, {"the log": log, "the machine": machine})
    if plot:
        from .figure import check_figure_suffix

        check_figure_suffix(plot)
        require("matplotlib", "cli,plot")
    description = read_machine(machine)
    with staged(*outputs.values()) as parts:
        recorded = read_log(
            log, columns=_mapping(column or []), truth=truth, max_gap=max_gap
        )
        settings = flux.choose(recorded, description, cutoff, pll_bandwidth, substeps)
        with _progress(recorded.t.size, quiet) as progress:
            result = flux.estimate_flux(recorded, description, settings, progress)
        write_table(parts[0], result.columns)
        if plot:
            from .figure import save_figure

            save_figure(parts[1], result, recorded, description, log.name)
    if not quiet:
        for line in _summary(log, recorded, description, result):
            typer.echo(line)
    if result.start is None:
        typer.echo(
            "aslo-jax: warning: no estimate is certified in this log, the flux is not "
            "observable in it: does the motor turn?",
            err=True,
        )


def _positive(name: str, value: float | None) -> None:
    if value is not None and not value > 0:
        raise ValueError(f"{name} must be positive, but is {value:g}.")
    if value is not None and name != "--max-gap" and math.isinf(value):
        raise ValueError(f"{name} must be finite, but is {value:g}.")


def _mapping(options: list[str]) -> dict[str, str]:
    columns: dict[str, str] = {}
    for option in options:
        name, equals, actual = option.partition("=")
        if not (name and equals and actual):
            raise ValueError(
                f"--column must have the form NAME=COLUMN, for instance u_alpha=Ualpha, "
                f"but is {option!r}."
            )
        if name in columns:
            raise ValueError(
                f"--column gives `{name}` twice, {columns[name]} and {actual}; keep one."
            )
        columns[name] = actual
    return columns


@contextmanager
def _progress(rows: int, quiet: bool) -> Iterator:
    """What is told of rows done: a bar on stderr for a log of more than one piece."""
    if quiet or rows <= flux.PIECE:
        yield lambda done: None
        return
    bar = require("tqdm", "cli").tqdm(total=rows - 1, unit=" rows", unit_scale=True)
    with bar:
        yield bar.update


def _summary(path: Path, log: Log, machine: Machine, result: flux.Result) -> Iterator[str]:
    t, used, observer = log.t, result.settings, machine.observer
    yield (
        f"{path.name}: {t.size} rows, {t[-1] - t[0]:.6g} s, median interval "
        f"{1e3 * np.median(np.diff(t)):.4g} ms"
    )
    chosen = ""
    if used.speed is not None:
        chosen = f" (for the log's electrical speed of {used.speed:.4g} rad/s)"
    yield (
        f"observer: {observer.completion}, cutoff {used.cutoff:.4g} rad/s{chosen}, "
        f"{observer.start} start"
        + ("" if observer.gain is None else f", A-ASLO gain {observer.gain:g} rad/s")
        + f", threshold {used.threshold:g}, {used.substeps} substep"
        + ("s" if used.substeps > 1 else "")
        + f"; loop {used.pll_bandwidth:.4g} rad/s"
    )
    coasting = result.columns["coasting"]
    yield f"coasting: {100 * coasting.mean():.3g} % of the rows ({coasting.sum()})"
    yield from _score(log, result)


def _score(log: Log, result: flux.Result) -> Iterator[str]:
    rows = flux.settled(result)
    errors = {k: v[rows] for k, v in result.columns.items() if k.startswith("error_")}
    if not errors or not rows.any():
        return
    yield f"against the truth columns, from {result.columns['t'][rows][0]:.6g} s on:"
    relative = flux.relative_flux_error(result, log)
    if relative is not None:
        part = relative[rows]
        yield f"  flux   relative error, median {np.median(part):.2g}, max {part.max():.2g}"
    if "error_theta_electrical" in errors:
        rms = np.degrees(_rms(errors["error_theta_electrical"]))
        yield f"  angle  error, rms {rms:.2g} electrical degrees"
    if "error_omega_electrical" in errors:
        rms = _rms(errors["error_omega_electrical"])
        yield f"  speed  error, rms {rms:.2g} rad/s (electrical)"


def _rms(x: np.ndarray) -> float:
    return float(np.sqrt(np.mean(x**2)))
