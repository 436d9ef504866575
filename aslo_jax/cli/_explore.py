"""`aslo-jax explore`: observers in a page of the browser."""

import threading
import webbrowser
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ._options import (
    AngleColumn,
    AngleKind,
    Columns,
    FrameName,
    PowerInvariant,
    double_precision,
    mapping,
    reading,
)

if TYPE_CHECKING:
    from ._explorer._session import Session

STORE = "study.zarr"


def explore(
    log_or_study: Annotated[
        Path | None,
        typer.Argument(
            metavar="[LOG|STUDY]",
            help="A log of one's own, with --machine, or the results of a study: the "
            "directory of its --out. Without, ready-made machines and mechanisms.",
        ),
    ] = None,
    machine: Annotated[
        Path | None, typer.Option(help="The machine of the LOG, a TOML file.")
    ] = None,
    port: Annotated[
        int, typer.Option(min=0, max=65535, help="Where to listen; a free one for 0.")
    ] = 0,
    browser: Annotated[bool, typer.Option(help="Open the page in the browser.")] = True,
    column: Columns = None,
    frame: FrameName = "alpha-beta",
    angle: AngleColumn = None,
    angle_kind: AngleKind = None,
    power_invariant: PowerInvariant = False,
) -> None:
    """Explore observers in the browser: gains, noise, wrong parameters on sliders, and what
    they do to the estimates.

    The page is served to this machine alone, and needs no network; Ctrl-C ends it.
    """
    from ._explorer._server import Server

    if machine is not None and log_or_study is None:
        raise ValueError("--machine is for a LOG; name one.")
    ready: Future[Session] = Future()
    if log_or_study is not None:
        options = column, frame, angle, angle_kind, power_invariant
        ready.set_result(_opened(log_or_study, machine, options))
    server = Server(port, ready.result)
    address = f"{server.origins[0]}/"
    typer.echo(f"{address}  (Ctrl-C ends)")
    if log_or_study is None:
        threading.Thread(target=_make, args=(ready,), daemon=True).start()
    else:
        threading.Thread(target=_warm, args=(ready.result(),), daemon=True).start()
    if browser:
        threading.Thread(target=_shown, args=(address,), daemon=True).start()
    with server:
        server.serve_forever()


def _shown(address: str) -> None:
    with suppress(webbrowser.Error, OSError):
        webbrowser.open(address)


def _make(ready: "Future[Session]") -> None:
    """The session of ready-made machines, while the browser loads the page."""
    try:
        double_precision()
        from ._explorer._session import Session

        session = Session()
    except BaseException as error:
        ready.set_exception(error)
        return
    ready.set_result(session)
    _warm(session)


def _warm(session: "Session") -> None:
    """Compile what the page will ask for first."""
    from ._explorer._state import State

    state = State(session.first)
    answers: list[tuple[str, Callable[[State], Any]]] = [("run", session.run)]
    if session.first != "results":
        answers.append(("band", session.band))
    for what, answer in answers:
        # What fails here fails again, and is told, when the page asks.
        with suppress(Exception), session.newest.turn("", what, 0):
            answer(state)


def _opened(path: Path, machine: Path | None, options: tuple[Any, ...]) -> "Session":
    """The session of a log, or of the results of a study."""
    from ._explorer._session import Session

    store = path / STORE if (path / STORE).exists() else path
    if store.is_dir():
        if machine is not None:
            raise ValueError(f"--machine is for a LOG, but {path} is a directory.")
        from .._extras import require

        require("zarr", "study")
        double_precision()
        from ._explorer._results import Results

        return Session(results=Results(store))
    if not path.exists():
        raise FileNotFoundError(f"{path} does not exist.")
    if machine is None:
        raise ValueError(
            f"give the machine of {path} with --machine, a TOML file; `aslo-jax sample` "
            "prints an example."
        )
    double_precision()
    from ..logs import LogReader
    from ..machines import read_machine
    from ._explorer._recorded import Recorded

    description = read_machine(machine)
    column, frame, angle, kind, power_invariant = options
    chain = reading(
        frame, angle, kind, power_invariant, "refuse", 10, description.pole_pairs
    )
    reader = LogReader(path, description.signals, columns=mapping(column), **chain)
    return Session(recorded=Recorded(reader, description, path.name))
