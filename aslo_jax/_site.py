"""The pages of the documentation that come with a wheel."""

import hashlib
import os
import tempfile
import zipfile
from pathlib import Path


def unpacked(packed: Path) -> Path:
    """The folder of the files of a zip, below the user's cache: unpacked the first time,
    and then found by what is in the zip.

    **Raises:** `OSError` where the cache cannot be written to.
    """
    digest = hashlib.sha256(packed.read_bytes()).hexdigest()[:16]
    folder = cache() / f"docs-{digest}"
    if folder.is_dir():
        return folder
    folder.parent.mkdir(parents=True, exist_ok=True)
    # Two processes may unpack at once: whoever is first has made the folder.
    with tempfile.TemporaryDirectory(dir=folder.parent, prefix=".docs-") as partial:
        with zipfile.ZipFile(packed) as archive:
            archive.extractall(Path(partial, "html"))
        try:
            Path(partial, "html").rename(folder)
        except OSError:
            if not folder.is_dir():
                raise
    return folder


def cache() -> Path:
    """The folder of what can be made again, by the convention of the system."""
    home = os.environ.get("XDG_CACHE_HOME") or os.environ.get("LOCALAPPDATA")
    return (Path(home) if home else Path.home() / ".cache") / "aslo_jax"
