"""`aslo-jax estimate`: the observer of a machine over a recorded log."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import typer
import typer.core

from .._extras import require
from .options import (
    Columns,
    LogFile,
    MachineFile,
    MaxGap,
    QuietSummary,
    double_precision,
    mapping,
)
from .outputs import refuse_overlap, staged

HELP = """Estimate the states of a machine that no sensor measures over a recorded LOG.

Columns in: t (s); inputs, voltages (V) or forces (N, N m), each the mean over [t[k],
t[k+1]), zero where they are optional and missing; outputs, currents (A) or positions (m,
rad), sampled at t[k]; SI units throughout.

Columns out: t and what is estimated; certificate (dimensionless, small where that is not
observable); coasting (1 where the certificate is below the threshold and the estimate is
carried along its known derivative); of motors coasting_speed (1 also until a phase-locked
loop follows the angle, and where it does not); and, where the log has truth, for scoring
only, error_* (estimate less truth). Angles are unwrapped. By the kind of machine:
"""


class Explained(typer.core.TyperCommand):
    """A command whose help ends with the columns of every kind of machine, which are
    imported only for it."""

    def format_help(self, ctx: Any, formatter: Any) -> None:
        from .columns import of_every_kind

        self.help = f"{HELP}\n{of_every_kind()}\n"
        super().format_help(ctx, formatter)


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
            "machine's; by default 100, or more for a log that accelerates fast."
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
    """Estimate what no sensor of a machine measures over a LOG."""
    double_precision()
    from .._checks import positive
    from ..logs import check_suffix
    from ..machines import MachineError, read_machine
    from .running import opened, tabulated

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
        reader, rates = opened(
            log,
            description,
            given,
            columns=mapping(column),
            truth=truth,
            max_gap=max_gap,
        )
        with _progress(reader.t.size, quiet) as progress:
            done = tabulated(
                reader, description, rates, substeps, parts[0], bool(plot), progress
            )
        if plot:
            from .figure import save_figure

            save_figure(parts[1], done.trace, done.summary, log.name)
    if not quiet:
        for line in done.summary.lines():
            typer.echo(line)
    for line in done.warnings():
        typer.echo(f"aslo-jax: warning: {line}", err=True)


def _option(name: str) -> str:
    return "--" + name.replace("_", "-")


@contextmanager
def _progress(rows: int, quiet: bool) -> Iterator[Callable[[int], object]]:
    """What is told of rows done: a bar on stderr for a log of more than one piece."""
    from .table import PIECE

    if quiet or rows <= PIECE:
        yield lambda done: None
        return
    bar = require("tqdm", "cli").tqdm(total=rows - 1, unit=" rows", unit_scale=True)
    with bar:
        yield bar.update
