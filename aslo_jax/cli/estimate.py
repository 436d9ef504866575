"""`aslo-jax estimate`: the observer of a machine over a recorded log."""

import textwrap
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from .._checks import positive
from .._extras import require
from ..logs import Log, check_suffix, read_log, write_table
from ..machines import KINDS, AbstractDescription, MachineError, Quantity, read_machine
from . import table
from .options import Columns, LogFile, MachineFile, MaxGap, QuietSummary, mapping
from .outputs import refuse_overlap, staged


def _columns() -> str:
    """The columns of every kind, those alike together."""
    kinds: dict[tuple[str, ...], list[str]] = {}
    for name, kind in KINDS.items():
        signals, suffixes = kind.layout.signals, kind.layout.suffixes()
        units = [f"{', '.join(q.columns)} ({q.unit})" for q in kind.layout.quantities]
        guards = [f"{n}{s}" for n in ("certificate", "coasting") for s in suffixes]
        optional = f"; optionally {', '.join(signals.optional)}" if signals.optional else ""
        lines = (
            f"in: {', '.join(signals.required)}{optional}",
            f"out: t, {', '.join([*units, *guards])}",
            f"truth: {', '.join(signals.truth)}",
            f"note: {signals.note}",
        )
        kinds.setdefault(lines, []).append(name)
    texts = []
    for lines, names in kinds.items():
        indented = [
            textwrap.fill(line, 76, initial_indent="  ", subsequent_indent="      ")
            for line in lines
        ]
        texts.append("\n".join(["\b", f"{', '.join(names)}", *indented]))
    return "\n\n".join(texts)


HELP = f"""Estimate the states of a machine that no sensor measures over a recorded LOG.

Columns in: t (s); inputs, voltages (V) or forces (N, N m), each the mean over [t[k],
t[k+1]), zero where they are optional and missing; outputs, currents (A) or positions (m,
rad), sampled at t[k]; SI units throughout.

Columns out: t and what is estimated; certificate (dimensionless, small where that is not
observable); coasting (1 where the certificate is below the threshold and the estimate is
carried along its known derivative); and, where the log has truth, for scoring only, error_*
(estimate less truth). Angles are unwrapped. By the kind of machine:

{_columns()}
"""


def estimate(
    log: LogFile,
    machine: MachineFile,
    out: Annotated[Path, typer.Option(help="The table: .csv, .parquet or .npz.")],
    plot: Annotated[
        Path | None, typer.Option(help="A figure as well: .png, .pdf or .svg.")
    ] = None,
    column: Columns = None,
    cutoff: Annotated[
        float | None,
        typer.Option(
            help="Cutoff of the filter (rad/s), in place of the machine's; by default "
            "chosen for the log, and stated in the summary."
        ),
    ] = None,
    pll_bandwidth: Annotated[
        float | None,
        typer.Option(
            help="Bandwidth of the phase-locked loop (rad/s) of a motor, in place of the "
            "machine's; 100 by default."
        ),
    ] = None,
    substeps: Annotated[
        int,
        typer.Option(
            min=1,
            help="Steps per sampling interval, between which outputs are interpolated.",
        ),
    ] = 4,
    max_gap: MaxGap = None,
    truth: Annotated[
        bool, typer.Option(help="Read the truth columns, where there are any, and score.")
    ] = True,
    quiet: QuietSummary = False,
) -> None:
    """Estimate the states of a machine over a log; its help is [`HELP`][]."""
    given = {"cutoff": cutoff, "pll_bandwidth": pll_bandwidth}
    given = {name: value for name, value in given.items() if value is not None}
    for name, value in given.items():
        positive(_option(name), value, "rad/s")
    check_suffix(out)
    outputs = {"--out": out} | ({"--plot": plot} if plot else {})
    refuse_overlap(outputs, {"the log": log, "the machine": machine})
    if plot:
        from .figure import check_figure_suffix

        check_figure_suffix(plot)
        require("matplotlib", "cli,plot")
    description = read_machine(machine)
    for name in given:
        if name in description.refused:
            raise MachineError(
                f"{_option(name)} is not for {machine}, whose kind is "
                f'"{description.kind}": {description.refused[name]}.'
            )
    with staged(*outputs.values()) as parts:
        recorded = read_log(
            log,
            description.signals,
            columns=mapping(column),
            truth=truth,
            max_gap=max_gap,
        )
        rates = description.rates(recorded, given)
        with _progress(recorded.t.size, quiet) as progress:
            result = table.estimate_log(recorded, description, rates, substeps, progress)
        write_table(parts[0], result.columns)
        if plot:
            from .figure import save_figure

            save_figure(parts[1], result, recorded, description, log.name)
    if not quiet:
        for line in _summary(log, recorded, description, result):
            typer.echo(line)
    for line in _warnings(recorded, description, result):
        typer.echo(f"aslo-jax: warning: {line}", err=True)


def _option(name: str) -> str:
    return "--" + name.replace("_", "-")


@contextmanager
def _progress(rows: int, quiet: bool) -> Iterator:
    """What is told of rows done: a bar on stderr for a log of more than one piece."""
    if quiet or rows <= table.PIECE:
        yield lambda done: None
        return
    bar = require("tqdm", "cli").tqdm(total=rows - 1, unit=" rows", unit_scale=True)
    with bar:
        yield bar.update


def _summary(
    path: Path, log: Log, machine: AbstractDescription, result: table.Result
) -> Iterator[str]:
    t, settings, signals = log.t, machine.observer, machine.signals
    yield (
        f"{path.name}: {t.size} rows, {t[-1] - t[0]:.6g} s, median interval "
        f"{1e3 * np.median(np.diff(t)):.4g} ms"
    )
    if log.u.shape[1] == len(signals.inputs) and signals.optional:
        yield f"not in the log, taken as zero: {', '.join(signals.optional)}"
    names = [getattr(settings, key, "") for key in ("saliency", "completion")]
    yield (
        f"observer for {machine.kind}: {', '.join(filter(None, names))}, "
        f"{getattr(settings, 'start', 'exact')} start, threshold {settings.threshold:g}, "
        f"{result.substeps} substep" + ("s" if result.substeps > 1 else "")
    )
    for name, (rate, reason) in result.rates.items():
        yield f"  {name} {rate:.4g} rad/s" + (f" ({reason})" if reason else "")
    for suffix in machine.suffixes():
        rows = result.columns[f"coasting{suffix}"]
        yield f"coasting{suffix}: {100 * rows.mean():.3g} % of the rows ({rows.sum()})"
    residuals = {} if result.truth else machine.residuals(result.columns, log)
    if result.truth:
        yield "against the truth columns:"
    elif residuals:
        yield f"consistency, {machine.residual}:"
    for quantity in machine.quantities:
        rows = result.settled(quantity.suffix)
        if rows.any():
            for text in _score(quantity, result, rows, residuals):
                yield f"  {quantity.name}, from {t[rows][0]:.6g} s on: {text}"


def _score(
    quantity: Quantity, result: table.Result, rows: np.ndarray, residuals: table.Columns
) -> Iterator[str]:
    errors = result.relative_error(quantity)
    if quantity.name in residuals:
        part = residuals[quantity.name][rows]
        yield f"median {np.median(part):.2g}, max {part.max():.2g}"
    elif errors is not None and len(quantity.columns) > 1:
        part = errors[rows]
        yield f"relative error, median {np.median(part):.2g}, max {part.max():.2g}"
    elif errors is not None:
        name = next(iter(quantity.columns))
        rms = _rms(result.columns[f"error_{name}"][rows])
        if quantity.angle:
            yield f"error, rms {np.degrees(rms):.2g} electrical degrees"
        else:
            size = _rms(result.truth[name][rows])
            yield f"error, rms {rms:.2g} {quantity.unit} (of {size:.3g})"


def _rms(x: np.ndarray) -> float:
    return float(np.sqrt(np.mean(x**2)))


def _warnings(
    log: Log, machine: AbstractDescription, result: table.Result
) -> Iterator[str]:
    interval = float(np.median(np.diff(log.t)))
    sampled = f"{1.0 / interval:.4g} rows a second"
    if interval > machine.longest_interval:
        yield (
            f"the log has {sampled}, which is slow for this kind of machine: is `t` in "
            "seconds, not milliseconds?"
        )
    for suffix in machine.suffixes():
        share = float(np.mean(result.columns[f"coasting{suffix}"]))
        which = " and ".join(q.name for q in machine.quantities if q.suffix == suffix)
        checks = (
            f"{machine.motion} Check too that `t` is in seconds ({sampled}), the "
            f"parameters, and the cutoff, which may be far from the frequencies of the log."
        )
        if result.start(suffix) is None:
            yield (
                f"no estimate is certified in this log, {which} cannot be observed in it: "
                f"{checks}"
            )
        elif share > 0.5:
            yield f"{100 * share:.3g} % of the rows coast ({which}): {checks}"
