"""The command line, `aslo-jax`."""

import sys
from collections.abc import Sequence

from .._extras import missing


def main(arguments: Sequence[str] | None = None) -> None:
    """Run `aslo-jax` with `arguments`, by default those of the process, and exit.

    The exit code is 0 on success, 2 for an argument or an input that is refused, 1 for
    anything that fails otherwise (a missing package, a disk that is full)."""
    try:
        from .app import app

        app(args=None if arguments is None else list(arguments), prog_name="aslo-jax")
    except (ImportError, OSError, ValueError) as error:
        if isinstance(error, ModuleNotFoundError) and error.name == "pydantic":
            error = missing("pydantic", "cli")  # typer needs it, too, to read arguments
        message = " ".join(str(error).split())
        print(f"aslo-jax: error: {message}", file=sys.stderr)
        refused = isinstance(error, ValueError | FileNotFoundError)
        raise SystemExit(2 if refused else 1) from None
