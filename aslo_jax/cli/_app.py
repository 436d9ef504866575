"""The application: its commands, and what holds for all of them."""

from typing import Annotated

from .. import __version__
from .._extras import missing

try:
    import typer
except ModuleNotFoundError as error:
    raise missing("typer", "cli") from error

from ._calibrate import calibrate
from ._derive import derive
from ._docs import docs
from ._estimate import Explained, estimate
from ._explore import explore
from ._export import export
from ._paper import paper
from ._sample import sample
from ._study import HELP as STUDY_HELP, study
from ._tune import tune

app = typer.Typer(
    help="Differentiable state observers: recorded logs, studies, the paper's experiments.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)


def _version(wanted: bool | None) -> None:
    if wanted:
        typer.echo(f"aslo-jax {__version__}")
        raise typer.Exit


@app.callback()
def start(
    version: Annotated[
        bool | None,
        typer.Option(
            "--version", callback=_version, is_eager=True, help="The version, and exit."
        ),
    ] = None,
) -> None:
    """Differentiable state observers: recorded logs, studies, the paper's experiments."""


app.command(cls=Explained)(estimate)
app.command()(calibrate)
app.command()(tune)
app.command()(export)
app.command()(explore)
app.command()(derive)
app.command()(sample)
app.command()(paper)
app.command()(docs)
app.command(help=STUDY_HELP)(study)
