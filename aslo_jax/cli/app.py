"""The application: its commands, and what holds for all of them."""

import jax

from .._extras import missing

try:
    import typer
except ModuleNotFoundError as error:
    raise missing("typer", "cli") from error

from .estimate import estimate
from .paper import paper
from .sample import sample

app = typer.Typer(
    help="Differentiable state observers over recorded logs and the paper's experiments.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)


@app.callback()
def start() -> None:
    """Differentiable state observers over recorded logs and the paper's experiments."""
    jax.config.update("jax_enable_x64", True)


app.command()(estimate)
app.command()(sample)
app.command()(paper)
