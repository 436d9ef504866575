"""One process at a time writes to the store of a study."""

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from .._interrupts import advice, discard, unfinished


@contextmanager
def locked(store: Path) -> Iterator[None]:
    """Within it, the `store` is this process's alone. The lock is the system's, on a file
    beside the store, so that it ends with the process however that ends. What an end by a
    signal would leave of a write is removed.

    **Raises:** `ValueError` where another process writes to the store.
    """
    made = [
        folder for folder in (store.parent, *store.parent.parents) if not folder.exists()
    ]
    store.parent.mkdir(parents=True, exist_ok=True)
    path = store.with_name(f".{store.name}.lock")
    file = _opened(path, store)

    def leave() -> None:
        discard(path)
        for folder in made:  # where nothing came to be in it
            with suppress(OSError):
                folder.rmdir()

    def clean() -> None:
        discard(partial(store))
        for rest in store.rglob("*.partial"):
            discard(rest)
        leave()

    def kept() -> str:
        return "what is done is kept, go on with --resume" if store.exists() else ""

    try:
        with unfinished(clean), advice(kept):
            yield
    finally:
        leave()
        os.close(file)


def partial(store: Path) -> Path:
    """Where a store is made, before it appears complete."""
    return store.with_name(f".{store.name}.partial")


def _opened(path: Path, store: Path) -> int:
    while True:
        file = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
        try:
            _lock(file)
        except BlockingIOError as error:
            os.close(file)
            raise ValueError(
                f"Another process writes a study to {store}; wait until it has ended, or "
                "choose another path."
            ) from error
        with suppress(FileNotFoundError):
            if os.path.samestat(os.fstat(file), path.stat()):
                return file
        os.close(file)  # of one that has just removed it


def _lock(file: int) -> None:
    """**Raises:** `BlockingIOError` where another process has it."""
    try:
        import fcntl
    except ModuleNotFoundError:  # Windows
        import msvcrt

        try:
            msvcrt.locking(file, msvcrt.LK_NBLCK, 1)  # pyright: ignore[reportAttributeAccessIssue]
        except OSError as error:
            raise BlockingIOError from error
        return
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise
    except OSError:  # a file system without locks
        return
