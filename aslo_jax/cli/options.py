"""Arguments and options that several commands take."""

from pathlib import Path
from typing import Annotated

import typer

LogFile = Annotated[Path, typer.Argument(help="The log: .csv, .parquet or .npz.")]
MachineFile = Annotated[Path, typer.Option(help="The machine, a TOML file.")]
BeforeAndAfter = Annotated[
    Path | None, typer.Option(help="A figure, before and after: .png, .pdf or .svg.")
]
Columns = Annotated[
    list[str] | None,
    typer.Option(
        metavar="NAME=COLUMN",
        help="What the log calls a column, for instance u_alpha=Ualpha; repeatable.",
    ),
]
MaxGap = Annotated[
    float | None,
    typer.Option(help="Longest interval allowed (s); by default ten median ones."),
]
QuietSummary = Annotated[
    bool, typer.Option("--quiet", "-q", help="Neither summary nor progress.")
]
QuietTable = Annotated[
    bool, typer.Option("--quiet", "-q", help="Neither table nor progress.")
]


def double_precision() -> None:
    """What every command computes in. JAX is imported here, and not before a command runs:
    help and a wrong option do without."""
    import jax

    jax.config.update("jax_enable_x64", True)


def mapping(options: list[str] | None) -> dict[str, str]:
    """The columns of `--column`, by name.

    **Raises:** `ValueError` for one that is not `NAME=COLUMN`, or given twice.
    """
    columns: dict[str, str] = {}
    for option in options or []:
        name, equals, actual = option.partition("=")
        if not (name and equals and actual):
            raise ValueError(
                f"--column must have the form NAME=COLUMN, for instance u_alpha=Ualpha, "
                f"but is {option!r}."
            )
        if name in columns:
            raise ValueError(
                f"--column gives `{name}` twice, {columns[name]} and {actual}; keep one."
            )
        columns[name] = actual
    return columns
