"""`aslo-jax calibrate`: parameters of a machine from a recorded log without truth."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

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
            "offset (of the outputs), input_offset, gain, dead_time, threshold (of a dead "
            "time), delay, encoder_offset (of a log in dq); by default "
            "those of the machine's file, calibration.fit.",
        ),
    ] = None,
    resolution: Annotated[
        float | None,
        typer.Option(
            help="A parameter is determined where the half width of its interval is less "
            "than this share of it, by default 0.01 or what the machine's file has."
        ),
    ] = None,
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
    from ..described import calibrate_machine, calibrated_text, parameters_of, values_of
    from ..logs import read_log
    from ..machines import read_machine
    from ..tune._calibration.problem import Unobservable
    from ..tune._calibration.result import UNSETTLED
    from ..tune._calibration.start import Turned
    from . import _calibrated as report

    given: dict[str, Any] = {"cutoff": cutoff, "resolution": resolution}
    given = {name: value for name, value in given.items() if value is not None}
    for name, value in given.items():
        positive(f"--{name}", value, "rad/s" if name == "cutoff" else "")
    if fit is not None:
        given["fit"] = [name for text in fit for name in text.split(",") if name]
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
    names = parameters_of(description, parameter or ())
    chain = {
        "columns": mapping(column),
        "max_gap": max_gap,
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
    }
    say = (lambda text: None) if quiet else (lambda text: typer.echo(text, err=True))
    text = machine.read_text(encoding="utf-8")
    with staged(*outputs.values()) as parts:
        recorded = read_log(log, description.signals, truth=False, **chain)
        first = said = report.verdict(log, description, **chain)
        found, values, after = None, {}, description
        if why := report.other_units(said):
            say(f"no search: {why}")
        else:
            try:
                found = calibrate_machine(
                    description, recorded, names, progress=say, **given
                )
            except Unobservable as error:
                why = str(error)
                said.append({"kind": "nothing_determined", "message": why, "rows": []})
            except Turned as error:
                raise ValueError(report.turned(str(error), said)) from None
        if found is not None and found.reason == UNSETTLED:
            also = "".join(
                f"; estimate says of the log: {each['message']}" for each in said
            )
            raise ValueError(
                f"No calibration: the search has not settled in {found.rounds} rounds, and "
                "nothing is written; find fewer parameters (option --parameter), or record "
                f"a run in which speed and currents vary{also}."
            )
        if found is not None:
            values = values_of(description, found)
        parts[0].write_text(calibrated_text(text, values, description), encoding="utf-8")
        if found is not None and values:
            after = read_machine(parts[0])
            report.check_calibrated(description, after, recorded, found)
            said = report.verdict(log, after, **chain)
            said += report.taken_up(first, said)
        warned = said if found is None else report.warnings(found, said, description)
        if plot:
            _draw(parts[1], log.name, recorded, description, after, found)
        if json and found is None:
            content = report.nothing_as_json(description, names, why, warned)
            parts[-1].write_text(content, encoding="utf-8")
        elif json and found is not None:
            parts[-1].write_text(report.as_json(found, values, warned), encoding="utf-8")
    for warning in warned:
        typer.echo(f"aslo-jax: warning: {warning['message']}", err=True)
    if quiet:
        return
    if found is None:
        typer.echo(f"unchanged in {out}: {', '.join(names)}")
        return
    for line in report.summary(found, description, out):
        typer.echo(line)


def _draw(
    path: Path,
    title: str,
    log: "Log",
    before: "AbstractDescription",
    after: "AbstractDescription",
    found: "Calibration | None",
) -> None:
    """What was found, if anything was, and what estimates leave before and after."""
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
        {} if found is None else units_of(before, found),
        electrical_frequency(after, columns),
    ).savefig(path)
