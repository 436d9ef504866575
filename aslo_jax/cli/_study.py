"""`aslo-jax study`: an experiment over thousands of samples of its parameters."""

import time
from collections.abc import Mapping
from contextlib import ExitStack
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from .._extras import require
from .._studies import NAMES
from ._options import QuietSummary, double_precision
from ._outputs import naming_full_disks, refuse_loop

if TYPE_CHECKING:
    from ..study._config import Configuration
    from ..study._sensitivity import Index

STORE = "study.zarr"


class Engine(StrEnum):
    """The engines of [`run_batch`][]."""

    auto = "auto"
    fused = "fused"
    scan = "scan"


HELP = f"""Run a study: many experiments that differ by a spread of their parameters and by
their noise, as CONFIG describes them, a TOML file or one of the ready-made
{", ".join(NAMES)}.

In the directory --out appear {STORE}, which xarray opens, with every metric, every
parameter and decimated errors, and report.html with its figures, also as PNG. The results
depend on the configuration, the number of samples and the seed only: not on --chunk,
--workers or --cluster, and not on whether the study was interrupted and resumed.
"""


def _verify(folder: Path | None) -> None:
    """Tell what is damaged in the results of a study, and exit: with 0 where nothing is."""
    if folder is None:
        return
    require("zarr", "study")
    from ..study._store import verify
    from ..study._verification import ranges

    store = folder / STORE if (folder / STORE).exists() else folder
    found = verify(store)
    typer.echo(f"{store}: {found}")
    if found.missing:
        typer.echo(f"not run yet, which --resume does: chunks {ranges(found.missing)}")
    if found:
        typer.echo("--resume --repair, with the study's settings, makes this again.")
        raise typer.Exit(1)
    raise typer.Exit


def study(
    config: Annotated[str, typer.Argument(help="A TOML file, or a ready-made name.")],
    samples: Annotated[int, typer.Option(min=1, help="How many experiments.")],
    out: Annotated[Path, typer.Option(help="Directory for the results; made if needed.")],
    seed: Annotated[int, typer.Option(min=0, help="Of everything that is random.")] = 0,
    resume: Annotated[
        bool, typer.Option("--resume", help="Go on with a study that was interrupted.")
    ] = False,
    repair: Annotated[
        bool,
        typer.Option("--repair", help="With --resume: run again what is damaged, too."),
    ] = False,
    verify: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            is_eager=True,
            callback=_verify,
            help="Tell what is damaged in the results in DIR, and exit; nothing is run.",
        ),
    ] = None,
    engine: Annotated[
        Engine, typer.Option(help="Compiled to machine code, or by XLA.")
    ] = Engine.auto,
    cluster: Annotated[
        str | None,
        typer.Option(
            metavar="ADDRESS",
            help="Run on the Dask cluster with this scheduler, which must reach --out "
            "under the same path.",
        ),
    ] = None,
    workers: Annotated[
        int | None,
        typer.Option(min=1, help="How many processes of this machine it runs on, by Dask."),
    ] = None,
    chunk: Annotated[
        int | None,
        typer.Option(
            min=1,
            help="Samples at a time, rounded up to a multiple of 256; by default 1024, or "
            "those of the study that is resumed.",
        ),
    ] = None,
    replay: Annotated[
        int | None,
        typer.Option(
            min=0,
            metavar="INDEX",
            help="Run that sample of the study again, and no other, and write every signal "
            "of it to sample_INDEX.csv in --out, with its figure.",
        ),
    ] = None,
    report: Annotated[
        bool, typer.Option(help="Write the report and its figures, at the end.")
    ] = True,
    sensitivity: Annotated[
        bool,
        typer.Option(
            "--sensitivity",
            help="Sobol indices of the rms error, in the terminal and in the report.",
        ),
    ] = False,
    quiet: QuietSummary = False,
) -> None:
    """Run a study; its help is [`HELP`][]."""
    del verify
    if repair and not resume:
        raise ValueError("--repair must go with --resume.")
    double_precision()
    from .. import random
    from ..study import open_study, run
    from ..study._cluster import local_cluster
    from ..study._config import read_configuration

    if cluster is not None and workers is not None:
        raise ValueError("--cluster and --workers exclude each other; give one of them.")
    if replay is not None and (resume or workers or cluster or sensitivity):
        raise ValueError(
            "--replay excludes --resume, --workers, --cluster and --sensitivity; leave "
            "them out."
        )
    refuse_loop(out)
    refuse_loop(Path(config))
    if out.exists() and not out.is_dir():
        raise ValueError(f"--out must be a directory, but {out} is a file.")
    wanted = ["zarr", "xarray", "tqdm", *(["jinja2", "matplotlib"] if report else [])]
    for package in [*wanted, *(["SALib"] if sensitivity else [])]:
        require(package, "study")
    configuration = read_configuration(config)
    if replay is not None:
        from ._sample_again import again

        settings = out, out / STORE, engine.value, report, quiet
        again(configuration, samples, seed, replay, *settings)
        return
    if sensitivity:
        _rms(configuration)
    begun = time.perf_counter()
    with ExitStack() as stack:
        stack.enter_context(naming_full_disks(out))
        client = None
        if workers is not None:
            client = stack.enter_context(local_cluster(workers))
        elif cluster is not None:
            distributed = require("dask.distributed", "study")
            client = stack.enter_context(distributed.Client(cluster))
        run(
            configuration.experiment,
            configuration.spread,
            samples=samples,
            key=random.key(seed),
            engine=engine.value,
            store=out / STORE,
            resume=resume,
            repair=repair,
            client=client,
            chunk=chunk,
            progress=not quiet,
            **configuration.settings,
        )
    spent = time.perf_counter() - begun
    if not quiet:
        _summary(configuration.title, open_study(out / STORE), spent)
    found = _influences(configuration, seed, engine, quiet) if sensitivity else None
    if report:
        page = _report(configuration, seed, out, found)
        if not quiet:
            typer.echo(f"{page}")


def _report(
    configuration: "Configuration", seed: int, out: Path, influences: Any = None
) -> Path:
    """Write the report, with the bound where there is one."""
    # Not for those who do not want one: scipy.stats is slow to import.
    from .._report import write_report
    from ..study import open_study
    from ..study._reference import with_reference

    dataset = open_study(out / STORE)
    # A store has no order of its own; the file's is the one of importance.
    first = list(configuration.metrics)
    dataset = dataset[first + [x for x in dataset.data_vars if x not in first]]
    dataset = with_reference(dataset, configuration, seed)
    return write_report(dataset, out, title=configuration.title, influences=influences)


def _rms(configuration: "Configuration") -> str:
    """The metric that sensitivity is told of: the first rms error."""
    tables = configuration.content["metrics"]
    for name, table in tables.items():
        if table["kind"] == "rms":
            return name
    raise ValueError(
        '--sensitivity needs a metric of the kind "rms", but the study has '
        f"{', '.join(tables)}."
    )


def _influences(
    configuration: "Configuration", seed: int, engine: Engine, quiet: bool
) -> "Mapping[str, list[Index]]":
    """The indices of every observer, printed unless `quiet`."""
    from .. import random
    from ..study._influence import influences
    from ..study._sensitivity import to_text

    found = influences(
        configuration.experiment,
        configuration.spread,
        configuration.metrics[_rms(configuration)],
        configuration.steps,
        scale=configuration.scale,
        key=random.key(seed),
        engine=engine.value,
    )
    for observer, table in found.items():
        if not quiet:
            typer.echo(f"{observer}, Sobol indices of the logarithm of the rms error:")
            typer.echo(to_text(table))
    return found


def _summary(title: str, dataset, spent: float) -> None:
    """Medians of every metric by observer, for a first look."""
    steps = dataset.sizes["sample"] * dataset.attrs["steps"]
    typer.echo(
        f"{title}: {dataset.sizes['sample']} samples of {dataset.attrs['steps']} steps, "
        f"{spent:.3g} s, {steps / spent:.3g} trajectory-steps per second, "
        f"engine {dataset.attrs['engine']}"
    )
    for name, variable in dataset.data_vars.items():
        if "observer" not in variable.dims or "time" in variable.dims:
            continue
        unit = variable.attrs["units"]
        typer.echo(f"{name}{f' ({unit})' if unit not in ('', '1') else ''}, median:")
        for observer in dataset["observer"].values:
            middle = variable.sel(observer=observer).astype(float).median("sample")
            numbers = ", ".join(f"{float(x):.3g}" for x in middle.values.reshape(-1))
            typer.echo(f"  {observer}: {numbers}{_worst(dataset, str(name), observer)}")


def _worst(dataset: Any, name: str, observer: Any) -> str:
    """Where the metric is worst, which --replay shows."""
    from ..study._statistics import judged
    from ..study._tables import is_flag, magnitude

    if is_flag(dataset[name]):
        return ""
    sizes = judged(magnitude(dataset, name, observer))
    alike = sizes.max() == sizes.min()
    return "" if alike else f"; worst in sample {int(sizes.argmax())}"
