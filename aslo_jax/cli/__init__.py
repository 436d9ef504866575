"""The command line, `aslo-jax`."""

import gc
import os
import sys
from collections.abc import Sequence

from .._extras import missing
from .._interrupts import ended_by_signals


def main(arguments: Sequence[str] | None = None) -> None:
    """Run `aslo-jax` with `arguments`, by default those of the process, and exit.

    The exit code is 0 on success, 2 for an argument or an input that is refused, 1 for
    anything that fails otherwise (a missing package, a disk that is full), 130 and 143 for
    an interrupt (SIGINT) and a request to terminate (SIGTERM), which end it within a second
    and leave nothing behind that is not complete."""
    with ended_by_signals(restored=arguments is not None):
        if "numpy" not in sys.modules:
            _one_thread_of_linear_algebra()
        _run(arguments)


def _one_thread_of_linear_algebra() -> None:
    """Keep NumPy's linear algebra, which reads its number of threads as it loads, to one:
    our matrices have a few columns, and after each of them a second thread spins while it
    waits for the next, up to a third of the processor time of a long log."""
    for name in ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")


def _run(arguments: Sequence[str] | None) -> None:
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
        print(f"aslo-jax: error: {_on_one_line(str(error))}", file=sys.stderr)
        refused = isinstance(error, ValueError | FileNotFoundError)
        raise SystemExit(2 if refused else 1) from None
    except (MemoryError, RecursionError) as error:
        said = _on_one_line(str(error)) or "there is not enough memory"
        print(f"aslo-jax: error: {said}", file=sys.stderr)
        raise SystemExit(1) from None
    except KeyboardInterrupt:  # raised, since a signal raises nothing here
        print("aslo-jax: interrupted", file=sys.stderr)
        raise SystemExit(130) from None
    finally:
        gc.set_threshold(*usual)


LONGEST = 1000  # characters of a message


def _on_one_line(text: str) -> str:
    """A message with what moves a cursor escaped, its middle left out if it is long."""
    text = " ".join(text.split())
    text = "".join(c if c.isprintable() else ascii(c)[1:-1] for c in text)
    return text if len(text) <= LONGEST else f"{text[: LONGEST - 200]} ... {text[-195:]}"
