"""`aslo-jax sample`: a log and its motor, or a machine of any kind, to start from."""

from contextlib import ExitStack
from importlib.resources import files
from pathlib import Path
from typing import Annotated

import typer

from .._studies import NAMES as STUDIES, ready_made
from ._outputs import staged

NAMES = ("pmsm_log.csv", "motor.toml", "README.md")


def sample(
    out: Annotated[
        Path, typer.Option(help="Directory to write to; it must exist.")
    ] = Path(),
    kind: Annotated[
        str | None,
        typer.Option(help="Print a machine of this kind as TOML instead, write nothing."),
    ] = None,
    study: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help=f"Print the file of a ready-made study instead: {', '.join(STUDIES)}.",
        ),
    ] = None,
) -> None:
    """Write a sample: pmsm_log.csv, motor.toml and a README.md that describes them; or,
    with --kind, print an example of a machine: sample --kind wrim > machine.toml; with
    --study, the file of a study that comes with the library: sample --study pmsm > my.toml.

    Files that exist are left alone and reported as an error.
    """
    if kind is not None and study is not None:
        raise ValueError("--kind and --study exclude each other; give one of them.")
    if study is not None:
        if study not in STUDIES:
            names = ", ".join(STUDIES)
            raise ValueError(f"--study must be one of {names}, but is `{study}`.")
        typer.echo(ready_made(study), nl=False)
        return
    if kind is not None:
        from ..machines import template

        typer.echo(template(kind), nl=False)
        return
    targets = [out / name for name in NAMES]
    for target in targets:
        if target.exists():
            raise ValueError(f"{target} exists; remove it or choose another directory.")
    with ExitStack() as stack:
        for part, name in zip(stack.enter_context(staged(*targets)), NAMES, strict=True):
            part.write_bytes((files("aslo_jax") / "data" / name).read_bytes())
    for target in targets:
        typer.echo(target)
