"""`aslo-jax estimate`: the observer of a machine over a recorded log."""

import enum
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import typer
import typer.core

from .._choices import MOST_SUBSTEPS
from .._extras import require
from ._options import (
    AngleColumn,
    AngleKind,
    Columns,
    FrameName,
    LogFile,
    MachineFile,
    MaxGap,
    MissingSamples,
    MostMissing,
    PowerInvariant,
    QuietSummary,
    RemoveOffset,
    double_precision,
    mapping,
    reading,
    refuse_rates,
    stated_rates,
)
from ._outputs import refuse_overlap, staged

HELP = """Estimate the states of a machine that no sensor measures over a recorded LOG.

Columns in: t (s); inputs, voltages (V) or forces (N, N m), each the mean over [t[k],
t[k+1]), zero where they are optional and missing; outputs, currents (A) or positions (m,
rad), sampled at t[k]; SI units throughout.

Columns out: t and what is estimated; certificate (dimensionless, small where that is not
observable); coasting (1 where the certificate is below the threshold and the estimate is
carried along its known derivative); of motors coasting_speed (1 also until a phase-locked
loop follows the angle, and where it does not); of a Kalman filter deviation_* (standard
deviation of what is estimated); and, where the log has truth, for scoring
only, error_* (estimate less truth). Angles are unwrapped. By the kind of machine:
"""


class Outliers(enum.StrEnum):
    """What becomes of samples that cannot be right."""

    drop = "drop"
    keep = "keep"


class Explained(typer.core.TyperCommand):
    """A command whose help ends with the columns of every kind of machine, which are read
    only for it."""

    def format_help(self, ctx: Any, formatter: Any) -> None:
        from ._columns import of_every_kind, written

        # Where the machines are imported, there may be kinds that the file does not know.
        known = "aslo_jax.machines" in sys.modules
        self.help = f"{HELP}\n{of_every_kind() if known else written()}\n"
        super().format_help(ctx, formatter)


def estimate(
    log: LogFile,
    machine: MachineFile,
    out: Annotated[Path, typer.Option(help="The table: .csv, .parquet or .npz.")],
    plot: Annotated[
        Path | None, typer.Option(help="A figure as well: .png, .pdf or .svg.")
    ] = None,
    column: Columns = None,
    frame: FrameName = "alpha-beta",
    angle: AngleColumn = None,
    angle_kind: AngleKind = None,
    power_invariant: PowerInvariant = False,
    missing: MissingSamples = "refuse",
    most_missing: MostMissing = 10,
    remove_offset: RemoveOffset = None,
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
            "machine's; by default 100, or more for a log that accelerates fast."
        ),
    ] = None,
    substeps: Annotated[
        int | None,
        typer.Option(
            min=1,
            max=MOST_SUBSTEPS,
            help="Steps per sampling interval, between which outputs are interpolated; by "
            "default 4, and 1 for a Kalman filter, which takes samples as they are.",
        ),
    ] = None,
    smooth: Annotated[
        bool,
        typer.Option(
            "--smooth",
            help="Each row from the whole log, later rows too; for an observer.kind of "
            '"lifted_kalman" or "adaptive".',
        ),
    ] = False,
    max_gap: MaxGap = None,
    voltage: Annotated[
        str,
        typer.Option(
            metavar="held|instant|delayed=N",
            help="What a row's inputs are: held over the interval that follows; those of "
            "its instant; late by N rows.",
        ),
    ] = "held",
    outliers: Annotated[
        Outliers,
        typer.Option(help="Samples that cannot be right: left out, or kept."),
    ] = Outliers.drop,
    json: Annotated[
        Path | None, typer.Option(help="The summary and all warnings, as JSON.")
    ] = None,
    truth: Annotated[
        bool, typer.Option(help="Read the truth columns, where there are any, and score.")
    ] = True,
    align: Annotated[
        bool,
        typer.Option(
            "--align",
            help="Take the bias of the angle, as an encoder that is mounted with an offset "
            "has it, from its error; it is stated in the summary.",
        ),
    ] = False,
    quiet: QuietSummary = False,
) -> None:
    """Estimate what no sensor of a machine measures over a LOG."""
    double_precision()
    from ..diagnosis import shift_of
    from ..logs import check_suffix
    from ..machines import read_machine
    from ._running import opened, tabulated, with_noise
    from ._smoothing import check_length, check_smoothing

    given = stated_rates(cutoff=cutoff, pll_bandwidth=pll_bandwidth)
    check_suffix(out)
    shift = shift_of(voltage)
    optional = {"--plot": plot, "--json": json}
    outputs = {"--out": out} | {name: path for name, path in optional.items() if path}
    refuse_overlap(outputs, {"the log": log, "the machine": machine})
    if plot:
        from ._figure import check_figure_suffix

        check_figure_suffix(plot)
        require("matplotlib", "cli,plot")
    description = read_machine(machine)
    refuse_rates(given, description, machine)
    steps = _substeps(substeps, description, machine)
    if smooth:
        check_smoothing(description, str(machine))
    with staged(*outputs.values()) as parts:
        reader, rates = opened(
            log,
            description,
            given,
            columns=mapping(column),
            truth=truth,
            max_gap=max_gap,
            **reading(
                frame,
                angle,
                angle_kind,
                power_invariant,
                missing,
                most_missing,
                description.pole_pairs,
                remove_offset,
            ),
        )
        if smooth:
            check_length(reader)
        filled, noise = with_noise(reader, description, shift)
        with _progress(reader.t.size, quiet) as progress:
            done = tabulated(
                reader,
                filled,
                rates,
                steps,
                parts[0],
                bool(plot),
                progress,
                align=align,
                shift=shift,
                keep_outliers=outliers == Outliers.keep,
                smoothed=smooth,
                noise=noise,
            )
        if plot:
            from ._figure import save_figure

            save_figure(parts[1], done.trace, done.summary, log.name)
        if json:
            from ._json_summary import write_json

            write_json(parts[-1], done)
    if not quiet:
        for line in done.summary.lines():
            typer.echo(line)
        for note in done.diagnosis.notes:
            typer.echo(note)
    for _, line, _ in done.findings():
        typer.echo(f"aslo-jax: warning: {line}", err=True)


def _substeps(given: int | None, description: Any, path: Path) -> int:
    from ..machines import MachineError
    from ..machines._lifted import is_lifted, kind_of

    if not is_lifted(description.observer):
        return 4 if given is None else given
    if given not in (None, 1):
        kind = kind_of(description.observer)
        raise MachineError(
            f'--substeps must be 1 for {path}, whose `observer.kind` is "{kind}": '
            "samples that are interpolated have no noise of their own."
        )
    return 1


@contextmanager
def _progress(rows: int, quiet: bool) -> Iterator[Callable[[int], object]]:
    """What is told of rows done: a bar on stderr for a log of more than one piece."""
    from ._table import PIECE

    if quiet or rows <= PIECE:
        yield lambda done: None
        return
    bar = require("tqdm", "cli").tqdm(total=rows - 1, unit=" rows", unit_scale=True)
    with bar:
        yield bar.update
