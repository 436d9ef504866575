"""The formats that a log may have, by the suffix of its file."""

from pathlib import Path

from ._csv import read_text
from ._error import LogError
from ._matlab import read_matlab
from ._ros import METADATA, read_bag
from ._source import Source, read_npz, read_parquet
from ._tdms import read_tdms

READERS = {
    ".csv": read_text,
    ".txt": read_text,
    ".tsv": read_text,
    ".dat": read_text,
    ".parquet": read_parquet,
    ".npz": read_npz,
    ".mat": read_matlab,
    ".tdms": read_tdms,
    ".bag": read_bag,
    ".mcap": read_bag,
    ".db3": read_bag,
}
COMPRESSED = (".csv", ".txt", ".tsv", ".dat", "")


def open_source(path: Path) -> Source:
    """The columns of the file `path`.

    **Raises:** `LogError` for a format that is not known, `OSError` for a file that cannot
    be opened."""
    if not path.exists():
        raise FileNotFoundError(f"{path} does not exist.")
    if path.is_dir():
        if (path / METADATA).exists():
            return read_bag(path)
        raise LogError(
            f"{path} is a directory, but a log is a file, or a ROS 2 bag with {METADATA}."
        )
    suffix = path.suffix.lower()
    if suffix == ".gz" and path.with_suffix("").suffix.lower() in COMPRESSED:
        return read_text(path)
    if suffix not in READERS:
        raise LogError(
            f"{path} has the suffix {path.suffix!r}, but a log is one of "
            f"{', '.join(READERS)}, or a text file in .gz."
        )
    return READERS[suffix](path)
