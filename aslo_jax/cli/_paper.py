"""`aslo-jax paper`: the paper's figures and tables as experiments."""

import importlib
from pathlib import Path
from typing import Annotated

import typer

from ._options import double_precision


def paper(
    section: Annotated[int, typer.Option(help="Section of the paper, for instance 2.")],
    out: Annotated[Path, typer.Option(help="Directory for figures and tables.")],
) -> None:
    """Reproduce the figures and tables of a section of the paper."""
    double_precision()
    importlib.import_module("aslo_jax.paper").run(section, out)
