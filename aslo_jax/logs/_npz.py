"""NPZ files piece by piece: ZIP archives of which every member is a column, an NPY file.

`numpy.load` holds whole columns and `numpy.savez` whole tables; a log need not fit into
memory.
"""

import lzma
import shutil
import tempfile
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float
from numpy.lib import format as npy

CHUNK = 1 << 20  # bytes that are copied at a time
# What an archive raises that is damaged or, a RuntimeError, encrypted.
DAMAGED = (zipfile.BadZipFile, zlib.error, lzma.LZMAError, EOFError, RuntimeError)


@runtime_checkable
class Readable(Protocol):
    """A file; the member of an archive is one, but not an `IO`."""

    def read(self, size: int = -1, /) -> bytes: ...


class Member(NamedTuple):
    """What a column of an NPZ file holds."""

    shape: tuple[int, ...]
    dtype: np.dtype


@contextmanager
def opened(path: Path) -> Iterator[zipfile.ZipFile]:
    """The archive `path`.

    **Raises:** `ValueError` for a file that is no archive, or while it is read turns out to
    be damaged; `OSError` for one that cannot be opened.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            yield archive
    except DAMAGED as error:
        raise ValueError(str(error) or "it is cut off") from error


def names(archive: zipfile.ZipFile) -> list[str]:
    """The columns."""
    suffix = ".npy"
    return [n.removesuffix(suffix) for n in archive.namelist() if n.endswith(suffix)]


def member(archive: zipfile.ZipFile, name: str) -> Member:
    """Shape and type of a column.

    **Raises:** `ValueError` for one of Python objects, or that is no NPY file.
    """
    with archive.open(f"{name}.npy") as file:
        return _header(file)


def whole(archive: zipfile.ZipFile, name: str) -> np.ndarray:
    """A column at once, of any shape."""
    with archive.open(f"{name}.npy") as file:
        return npy.read_array(file, allow_pickle=False)


def batches(
    archive: zipfile.ZipFile, chosen: Mapping[str, str], rows: int
) -> Iterator[dict[str, Float[np.ndarray, " N"]]]:
    """The columns `chosen`, of one length and of numbers, as float64 by our names, at most
    `rows` rows at a time."""
    with ExitStack() as stack:
        files = {
            name: stack.enter_context(archive.open(f"{actual}.npy"))
            for name, actual in chosen.items()
        }
        headers = {name: _header(file) for name, file in files.items()}
        left = headers[next(iter(headers))].shape[0]
        while True:
            count = min(rows, left)
            yield {
                name: _numbers(file, headers[name].dtype, count)
                for name, file in files.items()
            }
            left -= count
            if not left:
                return


def _header(file: Readable) -> Member:
    read = {(1, 0): npy.read_array_header_1_0, (2, 0): npy.read_array_header_2_0}
    version = npy.read_magic(file)
    if version not in read:
        raise ValueError(f"it holds an array of the version {version}")
    shape, _, dtype = read[version](file)
    if dtype.hasobject:
        raise ValueError("it holds an array of Python objects")
    return Member(shape, dtype)


def _numbers(file: Readable, dtype: np.dtype, count: int) -> Float[np.ndarray, " N"]:
    content = file.read(count * dtype.itemsize)
    if len(content) < count * dtype.itemsize:
        raise EOFError
    return np.frombuffer(content, dtype).astype(float)


class NPZWriter:
    """The file `path`, written at the end from a temporary file for each column beside it,
    since a member says first how long it is. It has the bytes that `numpy.savez` gives the
    whole columns, but for the time of each member.

    **Raises:** `ValueError` for a piece of other columns, types or shapes than the first.
    """

    def __init__(self, path: Path):
        self._path = path
        self._columns: dict[str, Member] = {}
        self._files: dict[str, Any] = {}

    def write(self, columns: Mapping[str, np.ndarray]) -> None:
        """Append `columns`, each of shape `(N, ...)`."""
        arrays = {name: np.asanyarray(column) for name, column in columns.items()}
        if not self._files:
            for name, array in arrays.items():
                if not array.ndim or array.dtype.hasobject:
                    raise ValueError(
                        f"Column `{name}` must be an array of numbers of shape (N,), but "
                        f"has the shape {array.shape} and holds {array.dtype}."
                    )
                self._columns[name] = Member((0, *array.shape[1:]), array.dtype)
                file = tempfile.TemporaryFile(dir=self._path.parent)  # noqa: SIM115
                self._files[name] = file
        if arrays.keys() != self._columns.keys():
            raise ValueError(
                f"Every piece must have the columns {', '.join(self._columns)}, but one "
                f"has {', '.join(arrays)}."
            )
        for name, array in arrays.items():
            shape, dtype = self._columns[name]
            if array.dtype != dtype or array.shape[1:] != shape[1:]:
                raise ValueError(
                    f"Column `{name}` must hold {dtype} in every piece as in the first, "
                    f"in rows of one shape, but in one it holds {array.dtype} of shape "
                    f"{array.shape}."
                )
            self._columns[name] = Member((shape[0] + array.shape[0], *shape[1:]), dtype)
            self._files[name].write(np.ascontiguousarray(array).data)

    def close(self, complete: bool) -> None:
        """Write the file, where the table is `complete`, and drop what is temporary."""
        try:
            if complete:
                with zipfile.ZipFile(self._path, "w", zipfile.ZIP_STORED) as archive:
                    for name in self._columns:
                        self._add(archive, name)
        finally:
            for file in self._files.values():
                file.close()

    def _add(self, archive: zipfile.ZipFile, name: str) -> None:
        shape, dtype = self._columns[name]
        descr = npy.dtype_to_descr(dtype)
        header = {"descr": descr, "fortran_order": False, "shape": shape}
        with archive.open(f"{name}.npy", "w", force_zip64=True) as out:
            npy.write_array_header_1_0(out, header)
            file = self._files[name]
            file.seek(0)
            shutil.copyfileobj(file, out, CHUNK)
            # The space of it, before the next column takes its own.
            file.truncate(0)
