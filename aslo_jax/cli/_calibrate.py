"""`aslo-jax calibrate`: parameters of a machine from a recorded log without truth."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

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
    QuietTable,
    RemoveOffset,
    double_precision,
    mapping,
    reading,
)
from ._outputs import refuse_overlap, staged

if TYPE_CHECKING:
    from ..logs import Log
    from ..machines import AbstractDescription
    from ..tune import Calibration


def calibrate(
    log: LogFile,
    machine: MachineFile,
    out: Annotated[Path, typer.Option(help="The machine with what was found: .toml.")],
    plot: Annotated[
        Path | None,
        typer.Option(
            help="A figure: parameters with intervals, the profile of the likelihood over "
            "each, residuals before and after, and the spectrum of what is left: .png, "
            ".pdf or .svg."
        ),
    ] = None,
    parameter: Annotated[
        list[str] | None,
        typer.Option(
            help="A key of [machine] to be found; repeatable. By default all that the "
            "observer depends on."
        ),
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
            help="Cutoff (rad/s) of the algebraic observer that starts the search."
        ),
    ] = None,
    fit: Annotated[
        list[str] | None,
        typer.Option(
            metavar="ERROR",
            help="Errors of the record to be found as well, one or several with commas: "
            "offset (of the outputs), input_offset, gain, dead_time, delay.",
        ),
    ] = None,
    resolution: Annotated[
        float,
        typer.Option(
            help="A parameter is determined where the half width of its interval is less "
            "than this share of it."
        ),
    ] = 0.01,
    max_gap: MaxGap = None,
    json: Annotated[
        Path | None,
        typer.Option(help="All that was found, and every warning, for programs: .json."),
    ] = None,
    quiet: QuietTable = False,
) -> None:
    """Find the parameters of a machine from a LOG without ground truth.

    The columns of the log are those of `aslo-jax estimate`; truth is not read. The
    parameters start from the machine's file and may be a factor of two off. What the log
    does not determine is named, with its interval, and stays as it is in the file. The new
    file differs from the old one in the values that were found; comments and settings stay.
    Errors of the record that the log shows are named, and with --fit found.
    """
    double_precision()
    from .._checks import positive
    from ..described import calibrate_machine, calibrated_text, values_of
    from ..logs import read_log
    from ..machines import read_machine
    from ..tune._calibration.result import UNSETTLED
    from ._calibrated import as_json, check_calibrated, warnings

    positive("--resolution", resolution)
    if cutoff is not None:
        positive("--cutoff", cutoff, "rad/s")
    if out.suffix.lower() != ".toml":
        raise ValueError(f"--out must be a .toml file, but is {out}.")
    outputs = {"--out": out} | ({"--plot": plot} if plot else {})
    outputs |= {"--json": json} if json else {}
    refuse_overlap(outputs, {"the log": log, "the machine": machine})
    if plot:
        from ._figure import check_figure_suffix

        check_figure_suffix(plot)
        require("matplotlib", "cli,plot")
    description = read_machine(machine)
    with staged(*outputs.values()) as parts:
        columns = mapping(column)
        recorded = read_log(
            log,
            description.signals,
            columns=columns,
            truth=False,
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
        found = calibrate_machine(
            description,
            recorded,
            parameter or (),
            cutoff=cutoff,
            resolution=resolution,
            fit=[name for text in fit or [] for name in text.split(",") if name],
            progress=(lambda text: None)
            if quiet
            else (lambda text: typer.echo(text, err=True)),
        )
        if found.reason == UNSETTLED:
            raise ValueError(
                f"No calibration: the search has not settled in {found.rounds} rounds, and "
                "nothing is written; find fewer parameters (option --parameter), or record "
                "a run in which speed and currents vary."
            )
        values = values_of(description, found)
        text = calibrated_text(machine.read_text(encoding="utf-8"), values)
        parts[0].write_text(text, encoding="utf-8")
        check_calibrated(description, read_machine(parts[0]), recorded, found)
        if plot:
            after = read_machine(parts[0])
            _draw(parts[1], log.name, recorded, description, after, found)
        warned = warnings(found)
        if json:
            parts[-1].write_text(as_json(found, values, warned), encoding="utf-8")
    for warning in warned:
        typer.echo(f"aslo-jax: warning: {warning['message']}", err=True)
    if quiet:
        return
    typer.echo(str(found))
    typer.echo(
        f"{found.reason[0].upper()}{found.reason[1:]} after {found.rounds} rounds; noise "
        f"of the outputs {', '.join(f'{x:.2g}' for x in found.output_noise)}; correlation "
        f"of prediction errors {found.correlation:.2g}, near 0 where the model is right"
    )
    unknown = [name for name in found.after if not found.determined(name)]
    if unknown:
        typer.echo(f"unchanged in {out}: {', '.join(unknown)}")
        typer.echo(
            "what determines them: direct current, torque and speed that vary, or a "
            "standstill with current besides; --resolution takes wider intervals"
        )


def _draw(
    path: Path,
    title: str,
    log: "Log",
    before: "AbstractDescription",
    after: "AbstractDescription",
    found: "Calibration",
) -> None:
    """What was found, and how far estimates are from their relation before and after."""
    from ..plot._commands import calibrated_figure
    from . import _table as table
    from ._calibrated import electrical_frequency, units_of

    residuals, columns = {}, {}
    for label, machine in (("before", before), ("after", after)):
        columns = table.estimate_log(log, machine, machine.rates(log))
        residuals[label] = machine.residuals(columns, log)
    calibrated_figure(
        found,
        log.t,
        residuals,
        before.residual,
        f"{before.title}: calibration from {title}",
        units_of(before, found),
        electrical_frequency(after, columns),
    ).savefig(path)
