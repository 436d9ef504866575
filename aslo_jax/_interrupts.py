"""The end of a command that is interrupted (SIGINT) or asked to terminate (SIGTERM).

Python runs a handler between two instructions of the main thread. During a second of XLA's
compiler it runs none; one that raises inside an import leaves a traceback, and inside a
destructor nothing at all. So a signal goes by a pipe to a thread, which removes what is
unfinished, says so in one line, and ends the process; the handler only holds the main
thread meanwhile, so that it makes nothing new.

Nothing heavy is imported here: this comes before everything else.
"""

import os
import shutil
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

SIGNALS = {signal.SIGINT: "interrupted", signal.SIGTERM: "terminated"}
HOLD = 0.2  # seconds that the thread waits for the main thread to stop
LATEST = 0.8  # seconds until the process ends, whatever happens

_unfinished: dict[object, Callable[[], object]] = {}
_advice: list[Callable[[], str]] = []
_armed = threading.Event()
_held = threading.Event()
_committing = threading.Event()
_received: list[int] = []
_last = threading.Lock()


def armed() -> bool:
    """Whether signals end this process as they do a command."""
    return _armed.is_set()


@contextmanager
def ended_by_signals(*, restored: bool) -> Iterator[None]:
    """Within it, SIGINT and SIGTERM end the process with 130 and 143, one line on stderr,
    and without what is [`unfinished`][]; afterwards too, unless handlers are `restored`."""
    if threading.current_thread() is not threading.main_thread() or armed():
        yield
        return
    reader, writer = os.pipe()
    if os.name == "posix":
        os.set_blocking(writer, False)
    before = {number: signal.getsignal(number) for number in SIGNALS}
    previous = signal.set_wakeup_fd(writer, warn_on_full_buffer=False)
    for number in SIGNALS:
        if before[number] is not signal.SIG_IGN:  # as of a job in the background
            signal.signal(number, _hold)
    _armed.set()
    watch = threading.Thread(target=_watch, args=(reader,), name="signals", daemon=True)
    watch.start()
    try:
        yield
    finally:
        if restored:
            for number, handler in before.items():
                signal.signal(number, handler)
            signal.set_wakeup_fd(previous)
            os.close(writer)  # which ends the thread
            watch.join()
            _armed.clear()


@contextmanager
def unfinished(remove: Callable[[], object]) -> Iterator[None]:
    """Within it, an end by a signal calls `remove`."""
    key = object()
    _unfinished[key] = remove
    try:
        yield
    finally:
        _unfinished.pop(key, None)


@contextmanager
def advice(text: Callable[[], str]) -> Iterator[None]:
    """Within it, the line of an end by a signal closes with `text()`."""
    _advice.append(text)
    try:
        yield
    finally:
        _advice.remove(text)


@contextmanager
def committing() -> Iterator[None]:
    """Within it, a moment at most, an end by a signal waits."""
    _committing.set()
    try:
        yield
    finally:
        _committing.clear()
        if _received:
            _hold(_received[0], None)


def discard(path: Path) -> None:
    """Remove a file or a folder, if it is there and can be removed."""
    if path.is_dir():
        shutil.rmtree(path, ignore_errors=True)
    else:
        with suppress(OSError):
            path.unlink(missing_ok=True)


def _hold(number: int, frame: object) -> None:
    """In the main thread."""
    _received.append(number)
    if _committing.is_set():
        return
    _held.set()
    time.sleep(LATEST)
    _leave(number)  # the thread is gone, at the end of the interpreter


def _watch(reader: int) -> None:
    while received := os.read(reader, 1):
        if received[0] in SIGNALS and signal.getsignal(received[0]) is _hold:
            until = time.monotonic() + LATEST
            _held.wait(HOLD)
            while _committing.is_set() and time.monotonic() < until:
                time.sleep(0.001)
            _leave(received[0])
    os.close(reader)


def _leave(number: int) -> None:
    with _last:  # never released
        for remove in list(_unfinished.values()):
            with suppress(Exception):
                remove()
        said = ["aslo-jax", SIGNALS[signal.Signals(number)]]
        said += [text for text in (each() for each in _advice) if text]
        with suppress(OSError):
            os.write(2, f"{_end_of_bar()}{': '.join(said)}\n".encode())
        os._exit(128 + number)


def _end_of_bar() -> str:
    """What ends the line of a progress bar."""
    bars = getattr(getattr(sys.modules.get("tqdm"), "tqdm", None), "_instances", ())
    return "\n" if len(bars) else ""
