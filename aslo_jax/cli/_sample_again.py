"""`aslo-jax study --replay`: one sample of a study with all that happens in it."""

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import typer

from .. import random
from .._typing import Engine
from ..logs import write_table
from ..plot._figure import WIDTH, Figure
from ..study import open_study
from ..study._rerun import Rerun, rerun
from ._outputs import staged

if TYPE_CHECKING:
    from ..study._config import Configuration


def again(
    configuration: "Configuration",
    samples: int,
    seed: int,
    index: int,
    out: Path,
    store: Path,
    engine: Engine,
    drawn: bool,
    quiet: bool,
) -> None:
    """Run the sample `index` again, write its signals and, if it is to be `drawn`, the
    figure of its errors to `out`, and print what is known of it unless `quiet`. Settings
    of another study than that in `store`, if there is one, are refused."""
    if store.exists():
        _refuse_another(store, configuration, samples, seed)
    found = rerun(
        configuration.experiment,
        configuration.spread,
        samples=samples,
        key=random.key(seed),
        index=index,
        metrics=configuration.metrics,
        steps=configuration.steps,
        engine=engine,
    )
    out.mkdir(parents=True, exist_ok=True)
    table, picture = out / f"sample_{index}.csv", out / f"sample_{index}.png"
    with staged(table, *([picture] if drawn else [])) as parts:
        write_table(parts[0], _columns(found, configuration))
        if drawn:
            parts[1].write_bytes(_figure(found, configuration).png())
    if not quiet:
        _print(found, configuration)
        typer.echo(f"{table}" + (f", {picture}" if drawn else ""))


def _refuse_another(
    store: Path, configuration: "Configuration", samples: int, seed: int
) -> None:
    """Refuse settings that are not those of the study in `store`."""
    about = open_study(store).attrs
    content = json.loads(json.dumps(configuration.content))
    for name, theirs, ours in (
        ("--samples", about["samples"], samples),
        ("--seed", int(about["seed"]), seed),
        ("configuration", json.loads(about["configuration"]), content),
    ):
        if theirs != ours:
            option = name.startswith("-")
            what = f"{name} {theirs}, not {ours}" if option else f"another {name}"
            raise ValueError(
                f"{store} is a study of {what}, whose samples are others; give its "
                "settings, or another --out."
            )


def _columns(found: Rerun, configuration: "Configuration") -> dict[str, np.ndarray]:
    entries = [name.replace(" ", "_") for name in configuration.entries]
    frame = found.simulation.to_dataframe(names=entries)
    columns = {"t": frame.index.to_numpy()}
    for name in frame.columns:
        column = frame[name].to_numpy()
        columns[str(name)] = column.astype(np.uint8) if column.dtype == bool else column
    return columns


def _figure(found: Rerun, configuration: "Configuration") -> Figure:
    from ..plot import error

    unit = configuration.units["error"] if configuration.scale is None else ""
    draw = lambda canvas: error(found.simulation, unit=unit, figure=canvas)
    return Figure(f"sample_{found.sample}", "", {}, draw, (WIDTH, 3.6), None)


def _print(found: Rerun, configuration: "Configuration") -> None:
    typer.echo(f"{configuration.title}: sample {found.sample}")
    for name, value in found.parameters.items():
        typer.echo(f"  {name} = {value:.6g}{_unit(configuration, f'parameter_{name}')}")
    for name, each in found.metrics.items():
        typer.echo(f"{name}{_unit(configuration, name, ' ({})')}:")
        for observer, values in each.items():
            numbers = ", ".join(f"{float(x):.3g}" for x in np.reshape(values, -1))
            typer.echo(f"  {observer}: {numbers}")


def _unit(configuration: "Configuration", name: str, form: str = " {}") -> str:
    unit: Any = configuration.units.get(name, "")
    return "" if unit in ("", "1") else form.format(unit)
