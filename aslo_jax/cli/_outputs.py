"""Outputs that appear complete or not at all."""

import os
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def staged(*targets: Path) -> Iterator[list[Path]]:
    """Gives a temporary file beside each target, with its suffix, to be written within the
    context, and renames them all when it ends without an error.

    On an error, an interrupt or a request to terminate, the temporary files are removed
    and the targets stay as they were."""
    reals = [_checked(target) for target in targets]
    parts = [p.with_name(f".{p.stem}.{os.getpid()}.part{p.suffix}") for p in reals]
    with _terminate_as_exit():
        try:
            for part, target in zip(parts, targets, strict=True):
                try:
                    part.open("xb").close()
                except OSError as error:
                    raise OSError(f"cannot write {target}: {error.strerror}") from error
            yield parts
            for part, real in zip(parts, reals, strict=True):
                part.replace(real)
        finally:
            for part in parts:
                part.unlink(missing_ok=True)


def refuse_overlap(outputs: dict[str, Path], inputs: dict[str, Path]) -> None:
    """Refuse an output that would overwrite an input or another output."""
    seen = {name: path.resolve() for name, path in inputs.items()}
    for name, path in outputs.items():
        for other, taken in seen.items():
            same = path.resolve() == taken
            if path.exists() and taken.exists():
                same = same or path.samefile(taken)
            if same:
                raise ValueError(
                    f"{name} would overwrite {other}, {path}; choose another file."
                )
        seen[name] = path.resolve()


def _checked(target: Path) -> Path:
    real = target.resolve()  # a link is written through, not replaced
    if real.is_dir():
        raise ValueError(f"cannot write {target}: it is a directory; name a file in it.")
    if not real.parent.is_dir():
        raise ValueError(
            f"cannot write {target}: the directory {real.parent} does not exist; create it."
        )
    return real


@contextmanager
def _terminate_as_exit() -> Iterator[None]:
    """Turns SIGTERM into SystemExit, so that clean-up runs."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def leave(number: int, frame: object) -> None:
        raise SystemExit(128 + number)

    previous = signal.signal(signal.SIGTERM, leave)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, previous)
