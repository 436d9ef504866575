"""`aslo-jax tune`: the gains of a study's observers, tuned by gradients."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

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
    config: Annotated[Path, typer.Argument(help="A study's file: .toml.")],
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
            help="Calibrate the machine and the noise of its sensor from this log first, "
            "of any format that `aslo-jax estimate` reads."
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
    quiet: QuietTable = False,
) -> None:
    """Tune the gains of the observers of a study.

    Each observer is tuned on its own, for the least mean square error over samples of the
    study's spread; fresh samples judge the result. The new file differs from the old one in
    the values that were found; comments and settings stay.
    """
    double_precision()
    from ..described import calibrate_study, changed, machine_of, tune_study
    from ..logs import read_log
    from ..schema import read_toml
    from ..schema._toml_text import rewritten
    from ..study._config import configure

    if out.suffix.lower() != ".toml":
        raise ValueError(f"--out must be a .toml file, but is {out}.")
    outputs = {"--out": out} | ({"--plot": plot} if plot else {})
    inputs = {"the study": config} | ({"the log": log} if log else {})
    refuse_overlap(outputs, inputs)
    if plot:
        from ._figure import check_figure_suffix

        check_figure_suffix(plot)
        require("matplotlib", "cli,plot")
    say = (lambda text: None) if quiet else (lambda text: typer.echo(text, err=True))
    with staged(*outputs.values()) as parts:
        content = read_toml(config)
        text = config.read_text(encoding="utf-8")
        configure(content)
        values: dict = {}
        if log is not None:
            signals = machine_of(content).signals
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
            found, values = calibrate_study(content, recorded, progress=say)
            content = changed(content, values)
            if not quiet:
                typer.echo(str(found))
        tuned = tune_study(
            content,
            gain or (),
            samples=samples,
            seed=seed,
            iterations=iterations,
            after=after,
            progress=lambda name: say(f"tuning {name}"),
        )
        for name, each in tuned.items():
            rounded = {k: float(f"{v:.7g}") for k, v in each.after.items()}
            values[f"observers.{name}"] = rounded
        parts[0].write_text(rewritten(text, values), encoding="utf-8")
        if plot:
            _draw(parts[1], content["title"], tuned)
    if not quiet:
        _print(tuned)


def _print(tuned: "dict[str, Tuned]") -> None:
    for name, each in tuned.items():
        gains = ", ".join(
            f"{key} {each.before[key]:.4g} to {each.after[key]:.4g}" for key in each.before
        )
        typer.echo(
            f"{name}: {gains}; rms error of fresh samples {each.rms_before:.4g} to "
            f"{each.rms_after:.4g}, {compared(each.rms_before, each.rms_after)} "
            f"({each.fitted.stopped})"
        )


def compared(before: float, after: float) -> str:
    """Two errors over fresh samples, in words."""
    if after < before:
        return f"{before / after:.3g} times less"
    return "no less: more --samples may find better gains"


def _draw(path: Path, title: str, tuned: "dict[str, Tuned]") -> None:
    """The rms errors over fresh samples, before and after."""
    from ..plot._commands import tuned_figure

    errors = {name: (each.rms_before, each.rms_after) for name, each in tuned.items()}
    tuned_figure(errors, title).savefig(path)
