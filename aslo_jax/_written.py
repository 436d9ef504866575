"""Files that appear complete or not at all, several at once."""

import os
import stat
from collections.abc import Mapping
from pathlib import Path

from ._interrupts import committing, discard, unfinished


def write_files(folder: Path, contents: Mapping[str, bytes]) -> list[Path]:
    """Write the `contents`, by name, into the `folder`, which is made: the paths. None of
    them is there before all are written, also where a signal ends the process. A file that
    is replaced keeps its mode, and a link is written through.

    **Raises:** `OSError` where there is no room, naming the file."""
    folder.mkdir(parents=True, exist_ok=True)
    reals = {name: (folder / name).resolve() for name in contents}
    parts = {
        name: p.with_name(f".{p.name}.{os.getpid()}.part") for name, p in reals.items()
    }

    def remove() -> None:
        for part in parts.values():
            discard(part)

    with unfinished(remove):
        try:
            for name, content in contents.items():
                try:
                    parts[name].write_bytes(content)
                except OSError as error:
                    reason = error.strerror or str(error)
                    raise OSError(f"cannot write {folder / name}: {reason}") from error
                if reals[name].exists():
                    parts[name].chmod(stat.S_IMODE(reals[name].stat().st_mode))
            with committing():
                for name, part in parts.items():
                    part.replace(reals[name])
        finally:
            remove()
    return [folder / name for name in contents]
