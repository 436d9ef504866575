"""`aslo-jax derive`: the observer of a model of one's own."""

from pathlib import Path
from typing import Annotated

import typer

from ._options import double_precision
from ._outputs import staged


def derive(
    model: Annotated[
        str,
        typer.Argument(
            metavar="MODEL.py:NAME",
            help="An `aslo_jax.Model` or a mechanical system, or what returns one; the "
            "file is run.",
        ),
    ],
    out: Annotated[
        Path | None,
        typer.Option(
            help="Machine to write; by default NAME.toml beside MODEL.py.",
        ),
    ] = None,
) -> None:
    """Derive the observer of what a model does not measure, and write a machine for it:
    derive motor.py:model, then estimate LOG --machine model.toml.

    It prints what the relation tells of, whether it is proved, and the slowest filter; or
    why there is none, by the line, and what to measure besides. A machine that exists is
    left alone and reported as an error.
    """
    file, _, name = model.rpartition(":")
    path = Path(file)
    if not (file and name) or path.suffix != ".py":
        raise ValueError(
            f"Argument MODEL.py:NAME must be a file of Python and a name in it, for "
            f"instance motor.py:model, but is {model!r}."
        )
    if not path.is_file():
        raise FileNotFoundError(f"{path} does not exist.")
    target = path.with_name(f"{name}.toml") if out is None else out
    if target.exists():
        raise ValueError(f"{target} exists; remove it or choose another with --out.")
    if target.resolve().parent != path.resolve().parent:
        raise ValueError(
            f"--out must lie beside {path}, which the machine names, but is {target}."
        )
    double_precision()
    from .. import derivation
    from ..machines import load_derivable
    from ..plants import AbstractMechanicalSystem

    place = f"{path.stem}:{name}"
    loaded = load_derivable(place, path.parent)
    if isinstance(loaded, AbstractMechanicalSystem):
        typer.echo(str(derivation.derive(loaded)))
        text = f'[machine]\nkind = "mechanical"\nsystem = "{place}"\n'
    else:
        derived = derivation.derive(loaded)
        typer.echo(f"{derived}\n{derived.certificate()}")
        if not derived.states:
            raise ValueError("No state alone can be taken from this relation.")
        text = f'[machine]\nkind = "derived"\nmodel = "{place}"\n'
    with staged(target) as (part,):
        part.write_text(text, "utf-8")
    typer.echo(f"machine: {target}")
