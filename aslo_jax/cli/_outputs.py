"""Outputs that appear complete or not at all."""

import errno
import os
import signal
import stat
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from .._interrupts import armed, committing, discard, unfinished


@contextmanager
def staged(*targets: Path) -> Iterator[list[Path]]:
    """Gives a temporary file beside each target, with its suffix, to be written within the
    context, and renames them all when it ends without an error.

    On an error, an interrupt or a request to terminate, the temporary files are removed
    and the targets stay as they were."""
    reals = [_checked(target) for target in targets]
    named = ", ".join(str(target) for target in targets)
    parts = [p.with_name(f".{p.stem}.{os.getpid()}.part{p.suffix}") for p in reals]
    remove = lambda: [discard(part) for part in parts]
    with _terminate_as_exit(), unfinished(remove):
        try:
            for part, target in zip(parts, targets, strict=True):
                try:
                    part.open("xb").close()
                except OSError as error:
                    raise OSError(f"cannot write {target}: {error.strerror}") from error
            with naming_full_disks(named):
                yield parts
            for part, real in zip(parts, reals, strict=True):
                if real.exists():
                    part.chmod(stat.S_IMODE(real.stat().st_mode))
            with committing():
                for part, real in zip(parts, reals, strict=True):
                    part.replace(real)
        finally:
            for part in parts:
                part.unlink(missing_ok=True)


def refuse_overlap(outputs: dict[str, Path], inputs: dict[str, Path]) -> None:
    """Refuse an output that would overwrite an input or another output."""
    for path in (*inputs.values(), *outputs.values()):
        refuse_loop(path)
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


def refuse_loop(path: Path) -> None:
    """Refuse a path whose symbolic links lead back to themselves."""
    try:
        path.stat()
    except OSError as error:
        if error.errno == errno.ELOOP:
            raise ValueError(
                f"{path} cannot be followed: its symbolic links go round in a loop."
            ) from error


@contextmanager
def naming_full_disks(target: object) -> Iterator[None]:
    """Names the `target` where there is no room to write it."""
    try:
        yield
    except OSError as error:
        text = str(error).lower()  # of pyarrow, too, which gives no number
        full = error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
        if full or any(each in text for each in ("no space left", "file too large")):
            reason = error.strerror or str(error)
            raise OSError(f"cannot write {target}: {reason}") from error
        raise


def _checked(target: Path) -> Path:
    refuse_loop(target)
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
    if armed() or threading.current_thread() is not threading.main_thread():
        yield
        return

    def leave(number: int, frame: object) -> None:
        raise SystemExit(128 + number)

    previous = signal.signal(signal.SIGTERM, leave)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, previous)
