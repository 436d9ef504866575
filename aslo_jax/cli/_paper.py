"""`aslo-jax paper`: the paper's figures and tables as experiments."""

import importlib
from pathlib import Path
from typing import Annotated

import typer

from ._options import double_precision


def paper(
    section: Annotated[
        str, typer.Option(metavar="2|3|4|all", help="Section of the paper, or all.")
    ],
    out: Annotated[Path, typer.Option(help="Directory for figures and tables.")],
) -> None:
    """Reproduce the figures and tables of a section of the paper."""
    double_precision()
    number = int(section) if section.isdecimal() else section
    importlib.import_module("aslo_jax.paper").run(number, out)
