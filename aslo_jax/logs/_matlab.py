"""MATLAB files: up to version 7 by SciPy, 7.3, which is HDF5, by h5py.

Fields of structs, nested as they may be, are columns called `log.current.alpha`. A struct
with the fields `Time` and `Data`, or `time` and `signals.values`, as Simulink writes it, is
one column with a clock of its own. An object of a class, such as a `timeseries`, is stored
in a format that MathWorks keeps to itself, and is refused by name.
"""

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from .._extras import require
from ._error import LogError
from ._source import Source, of_arrays

OBJECT = (
    "is an object of the class {}, which only MATLAB reads; save its numbers, for instance "
    "with log = struct('Time', {}.Time, 'Data', {}.Data) for a timeseries"
)
HDF5 = b"\x89HDF\r\n\x1a\n"
SIGNATURE_AT = 512  # in a MATLAB 7.3 file the text comes first


def read_matlab(path: Path) -> Source:
    """The numeric arrays of a MATLAB file, whose instants are compared where a column has a
    clock of its own."""
    with path.open("rb") as file:
        start = file.read(SIGNATURE_AT + len(HDF5))
    unusable: dict[str, str] = {}
    if HDF5 in (start[: len(HDF5)], start[SIGNATURE_AT:]):
        found = list(_of_hdf5(path, unusable))
    else:
        found = list(_of_mat(path, unusable))
    arrays, clocks = _series(dict(found))
    return of_arrays(path, arrays, unusable=unusable, clocks=clocks)


def _of_mat(path: Path, unusable: dict[str, str]) -> Iterator[tuple[str, np.ndarray]]:
    from scipy.io import loadmat
    from scipy.io.matlab import MatlabFunction, MatlabOpaque, mat_struct

    def leaves(name: str, value: Any) -> Iterator[tuple[str, np.ndarray]]:
        if isinstance(value, (MatlabOpaque, MatlabFunction)):
            kind = _class_of(value)
            unusable[name] = OBJECT.format(kind, name, name)
        elif isinstance(value, mat_struct):
            for field in vars(value)["_fieldnames"]:
                yield from leaves(f"{name}.{field}", getattr(value, field))
        elif isinstance(value, np.ndarray) and value.dtype == object:
            for k, each in enumerate(value.flat):
                yield from leaves(f"{name}({k + 1})", each)
        elif isinstance(value, (np.ndarray, np.generic, int, float)):
            yield name, _squeezed(np.asarray(value))

    try:
        content = loadmat(path, struct_as_record=False, squeeze_me=True)
    except Exception as error:  # zlib, struct and scipy each have their own
        raise LogError(f"{path} is not a readable MATLAB file: {error}") from error
    for name, value in content.items():
        if name == "None":  # an object without a variable's name
            unusable["(an object)"] = OBJECT.format(_class_of(value), "ts", "ts")
        elif not name.startswith("__"):
            yield from leaves(name, value)


def _class_of(value: Any) -> str:
    for field in ("s2", "_Class"):
        try:
            found = np.asarray(value[field]).reshape(-1)[0]
            return found.decode() if isinstance(found, bytes) else str(found)
        except (ValueError, IndexError, KeyError, TypeError):
            continue
    return "unknown to this reader"


def _of_hdf5(path: Path, unusable: dict[str, str]) -> Iterator[tuple[str, np.ndarray]]:
    h5py = require("h5py", "matlab")

    def leaves(name: str, item: Any) -> Iterator[tuple[str, np.ndarray]]:
        kind = item.attrs.get("MATLAB_class", b"")
        kind = kind.decode() if isinstance(kind, bytes) else str(kind)
        if "MATLAB_object_decode" in item.attrs and kind != "function_handle":
            unusable[name] = OBJECT.format(kind or "unknown", name, name)
        elif isinstance(item, h5py.Group):
            for field in item:
                yield from leaves(f"{name}.{field}", item[field])
        elif "MATLAB_empty" in item.attrs or kind == "char":
            return
        elif item.dtype == h5py.ref_dtype:
            references = item[()].reshape(-1)
            for k, reference in enumerate(references):
                numbered = name if len(references) == 1 else f"{name}({k + 1})"
                yield from leaves(numbered, item.file[reference])
        elif item.dtype.kind in "iufb":
            yield name, _squeezed(item[()].T)  # stored by columns
        else:
            unusable[name] = (
                f"holds {item.dtype}, but it must hold real numbers; convert it"
            )

    try:
        with h5py.File(path, "r") as file:
            for name in file:
                if not name.startswith("#"):
                    yield from leaves(name, file[name])
    except OSError as error:
        raise LogError(f"{path} is not a readable MATLAB 7.3 file: {error}") from error


def _squeezed(array: np.ndarray) -> np.ndarray:
    """A row or a column of MATLAB as a vector."""
    return array.reshape(-1) if array.ndim == 2 and 1 in array.shape else np.squeeze(array)


def _series(
    arrays: dict[str, np.ndarray],
) -> tuple[dict[str, np.ndarray], dict[str, str]]:
    """Structs with instants and values as one column each, and the clocks of columns; of
    equal instants the first are kept."""
    found, clocks = dict(arrays), dict[str, str]()
    instants: dict[str, str] = {}  # the first of equal ones, by name
    for name, x in arrays.items():
        if name.rpartition(".")[2].lower() in ("t", "time") and x.ndim == 1:
            same = (k for k in instants.values() if np.array_equal(arrays[k], x))
            instants[name] = next(same, name)
    for name, first in instants.items():
        stem = name.rpartition(".")[0]
        values = [other for other in arrays if stem and _is_value(stem, other)]
        for other in values:
            label = stem if len(values) == 1 else other
            x, rows = found.pop(other), arrays[name].size
            found[label] = x.T if x.ndim == 2 and x.shape[0] != rows == x.shape[1] else x
            count = found[label].shape[1] if x.ndim == 2 else 0
            clocks |= dict.fromkeys(
                [label, *(f"{label}[{k}]" for k in range(count))], first
            )
        clocks[name] = first
        if first != name and values:
            del found[name]
    return found, clocks


def _is_value(stem: str, name: str) -> bool:
    """Whether `name` is that of the values of a struct `stem` with instants."""
    rest = name.removeprefix(f"{stem}.")
    return rest in ("Data", "data", "values") or bool(
        re.fullmatch(r"signals(\(\d+\))?\.values", rest)
    )
