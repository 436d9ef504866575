"""`aslo-jax tune`: the gains of a study's observers, tuned by gradients."""

import math
from collections.abc import Iterator, Mapping, Sequence
from json import dumps
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from .._extras import require
from ._options import (
    AngleColumn,
    AngleKind,
    BeforeAndAfter,
    Columns,
    FrameName,
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
    from ..described import Tuned


def tune(
    config: Annotated[str, typer.Argument(help="A study's file, or a ready-made name.")],
    out: Annotated[Path, typer.Option(help="The file with the tuned gains: .toml.")],
    plot: BeforeAndAfter = None,
    gain: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME.KEY",
            help="A gain to tune, for instance ASLO.cutoff; repeatable. By default every "
            "number of an observer.",
        ),
    ] = None,
    log: Annotated[
        Path | None,
        typer.Option(
            help="Take the machine, the noise of its sensor, and of a motor speed and load "
            "from this log first, of any format that `aslo-jax estimate` reads."
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
    max_gap: MaxGap = None,
    samples: Annotated[int, typer.Option(min=1, help="Of the file's spread.")] = 128,
    seed: Annotated[int, typer.Option(min=0, help="Of everything that is random.")] = 0,
    iterations: Annotated[int, typer.Option(min=1, help="Of each search at most.")] = 40,
    after: Annotated[
        float, typer.Option(min=0.0, help="From when on errors count (s).")
    ] = 0.0,
    json: Annotated[
        Path | None,
        typer.Option(
            help="The gains, before and after, and every warning, for programs: .json."
        ),
    ] = None,
    quiet: QuietTable = False,
) -> None:
    """Tune the gains of the observers of a study.

    Each observer is tuned on its own, for the least mean square error over samples of the
    study's spread. Fresh samples judge the result: gains are written where these improve
    by more than chance may give. The new file differs from the old one in the values that
    were found; comments and settings stay.
    """
    double_precision()
    from ..described import by_table, calibrate_study, changed, machine_of, tune_study
    from ..logs import read_log
    from ..schema._toml_text import rewritten, rounded
    from ..study._config import read_study
    from ._calibrated import warnings

    if out.suffix.lower() != ".toml":
        raise ValueError(f"--out must be a .toml file, but is {out}.")
    outputs = {"--out": out} | ({"--plot": plot} if plot else {})
    outputs |= {"--json": json} if json else {}
    inputs = {"the study": Path(config)} | ({"the log": log} if log else {})
    refuse_overlap(outputs, inputs)
    if plot:
        from ._figure import check_figure_suffix

        check_figure_suffix(plot)
        require("matplotlib", "cli,plot")
    say = (lambda text: None) if quiet else (lambda text: typer.echo(text, err=True))
    with staged(*outputs.values()) as parts:
        text, content, _ = read_study(config)
        folder = Path(config).parent
        values: dict = {}
        warned: list[dict[str, Any]] = []
        if log is not None:
            described = machine_of(content, folder)
            signals = described.signals
            recorded = read_log(
                log,
                signals,
                columns=mapping(column),
                truth=False,
                max_gap=max_gap,
                **reading(
                    frame,
                    angle,
                    angle_kind,
                    power_invariant,
                    missing,
                    most_missing,
                    content["machine"].get("pole_pairs"),
                    remove_offset,
                ),
            )
            found, values = calibrate_study(content, recorded, folder=folder, progress=say)
            content = changed(content, values)
            warned += warnings(found, (), described)
            if not quiet:
                typer.echo(str(found))
                for line in _operated(values):
                    typer.echo(line)
        tuned = tune_study(
            content,
            gain or (),
            samples=samples,
            seed=seed,
            iterations=iterations,
            after=after,
            progress=lambda name: say(f"tuning {name}"),
            folder=folder,
        )
        for name, each in tuned.items():
            if each.improved:
                new = {k: rounded(v) for k, v in each.after.items()}
                values |= by_table(name, new)
            else:
                message = f"{name}: {judged(each)}"
                warned.append({"kind": "no_improvement", "message": message, "rows": []})
        parts[0].write_text(rewritten(text, values), encoding="utf-8")
        if plot:
            _draw(parts[1], content["title"], tuned)
        if json:
            parts[-1].write_text(_as_json(tuned, warned), encoding="utf-8")
    for warning in warned:
        typer.echo(f"aslo-jax: warning: {warning['message']}", err=True)
    if not quiet:
        _print(tuned)


def _operated(values: "Mapping[str, Mapping[str, Any]]") -> Iterator[str]:
    """What was taken from the log besides the parameters."""
    reference = values.get("control.reference", {})
    load = values.get("machine.load") or values.get("machine", {}).get("load", {})
    if reference:
        swing = reference.get("amplitude")
        varied = "" if swing is None else f", varying by {swing:.4g} rad/s"
        yield f"speed of the log: {reference['offset']:.4g} rad/s, mechanical{varied}"
    if load:
        yield f"load of the log: {load['offset']:.4g} N m"


def _print(tuned: "dict[str, Tuned]") -> None:
    for name, each in tuned.items():
        gains = ", ".join(
            f"{key} {each.before[key]:.4g} to {each.after[key]:.4g}" for key in each.before
        )
        typer.echo(
            f"{name}: {gains}; rms error of fresh samples {each.rms_before:.4g} to "
            f"{each.rms_after:.4g}, {judged(each)} ({each.fitted.stopped})"
        )


def judged(each: "Tuned") -> str:
    """What fresh samples say of tuned gains, in words."""
    low, high = (100 * x for x in each.less)
    known = f" ({low:.3g} to {high:.3g} %, 95 % interval)" if math.isfinite(low) else ""
    if each.improved:
        return f"their mean square is less{known}"
    if not math.isfinite(each.rms_after):
        return "which is not finite in every sample: the gains are not written"
    return (
        f"no improvement beyond chance of their mean square{known}: the gains are not "
        "written; more --samples may find better ones"
    )


def _as_json(tuned: "dict[str, Tuned]", warned: "Sequence[Mapping[str, Any]]") -> str:
    """Gains in the units of the file; null for what there is not."""
    gains = {
        f"{name}.{key}": {
            "before": before,
            "after": each.after[key],
            "written": each.improved,
            "less": [x if math.isfinite(x) else None for x in each.less],
        }
        for name, each in tuned.items()
        for key, before in each.before.items()
    }
    return dumps({"gains": gains, "warnings": list(warned)}, indent=2) + "\n"


def _draw(path: Path, title: str, tuned: "dict[str, Tuned]") -> None:
    """The rms errors over fresh samples, before and after."""
    from ..plot._commands import tuned_figure

    errors = {name: (each.rms_before, each.rms_after) for name, each in tuned.items()}
    tuned_figure(errors, title).savefig(path)
