"""The command line, `aslo-jax`."""

import gc
import sys
from collections.abc import Sequence

from .._extras import missing


def main(arguments: Sequence[str] | None = None) -> None:
    """Run `aslo-jax` with `arguments`, by default those of the process, and exit.

    The exit code is 0 on success, 2 for an argument or an input that is refused, 1 for
    anything that fails otherwise (a missing package, a disk that is full)."""
    # A command makes objects by the million, few of them in cycles: with the usual
    # threshold the collector looks at all of JAX again and again, 0.15 s of an estimate
    # with a figure.
    usual = gc.get_threshold()
    gc.set_threshold(max(100_000, usual[0]), *usual[1:])
    try:
        from ._app import app

        app(args=None if arguments is None else list(arguments), prog_name="aslo-jax")
    except (ImportError, OSError, ValueError) as error:
        if isinstance(error, ModuleNotFoundError) and error.name == "pydantic":
            error = missing("pydantic", "cli")  # typer needs it, too, to read arguments
        message = " ".join(str(error).split())
        print(f"aslo-jax: error: {message}", file=sys.stderr)
        refused = isinstance(error, ValueError | FileNotFoundError)
        raise SystemExit(2 if refused else 1) from None
    finally:
        gc.set_threshold(*usual)
