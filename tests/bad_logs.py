"""A generator of bad logs for the command line."""

import contextlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.io

NUMBERS = ["nan", "inf", "-inf", "1e308", "-1", "0", "1e-320", "-0.0", "1e400", "0x10"]
CELLS = [
    *NUMBERS,
    "",
    "abc",
    "1,5",
    "1.2.3",
    "--",
    "NaN ",
    "1e",
    "\x00",
    "١",
    "1_000",
    '"1"',
]


def motor_log(rows: int = 400) -> dict[str, np.ndarray]:
    """A right log of the motor above: steady currents, exact mean voltages."""
    R, L, m, h, speed = 2.8, 8e-3, 0.175, 1e-4, 300.0
    t = h * np.arange(rows + 1)
    circle = lambda a: np.stack([np.cos(a), np.sin(a)])
    i = lambda t: 2.5 * circle(speed * t + 1.7)
    flux = m * circle(speed * t) + L * i(t)
    mean = (i(t[:-1]) + 4.0 * i(t[:-1] + 0.5 * h) + i(t[1:])) / 6.0
    u, y = R * mean + np.diff(flux, axis=1) / h, i(t[:-1])
    names = ("t", "u_alpha", "u_beta", "i_alpha", "i_beta")
    return dict(zip(names, (t[:-1], *u, *y), strict=True))


def as_text(columns: dict[str, np.ndarray]) -> list[list[str]]:
    rows = np.stack(list(columns.values()), axis=1)
    return [list(columns), *([f"{x:.9g}" for x in row] for row in rows)]


# Changes of a table of cells, the header first: `change(random, cells)`.


def _cell(random, cells):
    row = cells[int(random.integers(0, len(cells)))]
    j = int(random.integers(0, len(row) + 1))
    row[j : j + 1] = [str(random.choice(CELLS))]


def _column_of(random, cells):
    j, value = int(random.integers(0, len(cells[0]))), str(random.choice(CELLS))
    for row in cells[1:]:
        row[j : j + 1] = [value]


def _scaled(random, cells):
    j = int(random.integers(0, len(cells[0])))
    factor = float(random.choice([0.0, -1.0, 1e-300, 1e300, 1e9, 1e-9, 1e3, 57.3]))
    for row in cells[1:]:
        with contextlib.suppress(ValueError, IndexError):
            row[j] = f"{factor * float(row[j]):.9g}"


def _renamed(random, cells):
    j = int(random.integers(0, len(cells[0])))
    names = ["t", "time [ms]", "u_beta", "", "i_d", "θ", "x" * 5000, "=1+1", "t\x1b[31m"]
    cells[0][j] = str(random.choice(names))


def _dropped(random, cells):
    j = int(random.integers(0, len(cells[0])))
    for row in cells:
        del row[j : j + 1]


def _ragged(random, cells):
    row = cells[int(random.integers(0, len(cells)))]
    if random.integers(2):
        row.append("1.0")
    elif row:
        row.pop()


def _short(random, cells):
    del cells[int(random.choice([0, 1, 2, 3, 5, 9])) :]


def _shuffled(random, cells):
    body = cells[1:]
    random.shuffle(body)
    cells[1:] = body


def _repeated(random, cells):
    k = int(random.integers(0, len(cells)))
    cells[k:k] = [list(cells[k]) for _ in range(int(random.choice([1, 30])))]


def _lost(random, cells):
    k = int(random.integers(1, max(len(cells), 2)))
    del cells[k : k + int(random.choice([1, 5, 200]))]


CELLWISE: list[Callable] = [
    _cell,
    _column_of,
    _scaled,
    _renamed,
    _dropped,
    _ragged,
    _short,
    _shuffled,
    _repeated,
    _lost,
]


def bad_log(random: np.random.Generator, folder: Path) -> Path:
    """A log with one to three faults, in a format or in what claims to be one."""
    cells = as_text(motor_log())
    for _ in range(int(random.integers(1, 4))):
        if cells and cells[0]:
            CELLWISE[int(random.integers(len(CELLWISE)))](random, cells)
    between = str(random.choice([",", ",", ",", ";", "\t", " ", "|"]))
    end = str(random.choice(["\n", "\n", "\r\n", "\r"]))
    content = end.join(between.join(row) for row in cells).encode("utf-8", "surrogatepass")
    fault = int(random.integers(12))
    if fault == 0:
        content = content[: int(random.integers(len(content) + 1))]
    elif fault == 1:
        content = b"\xef\xbb\xbf" + content
    elif fault == 2:
        content = content.decode().encode("utf-16")
    elif fault == 3:
        noise = bytearray(content)
        for k in random.integers(0, max(len(noise), 1), 20):
            if noise:
                noise[int(k)] = int(random.integers(256))
        content = bytes(noise)
    elif fault == 4:
        content = b"# a comment\n% another\n\n" + content
    suffix = str(
        random.choice(
            [".csv"] * 12 + [".txt", ".npz", ".parquet", ".mat", ".tdms", ".gz", ""]
        )
    )
    path = folder / f"log{suffix}"
    path.write_bytes(content)
    return path


def damaged_log(random: np.random.Generator, folder: Path) -> Path:
    """A log in a binary format, whole but for a few bytes, a cut, or its types."""
    columns: dict[str, Any] = dict(motor_log())
    name = list(columns)[int(random.integers(len(columns)))]
    odd = [
        columns[name].astype(np.float32),
        columns[name] > 0,
        columns[name] + 1j,
        columns[name][:, None],
        columns[name][:-1],
        np.array(["a"] * 400),
        np.array(["2020-01-01"] * 400, "datetime64[s]"),
        np.float64(3.0),
        np.full(400, np.nan),
        np.ma.masked_less(columns[name], 0.0),
    ]
    if random.integers(2):
        columns[name] = odd[int(random.integers(len(odd)))]
    kind = int(random.integers(3))
    path = folder / ("log.npz", "log.mat", "log.parquet")[kind]
    if kind == 0:
        np.savez(path, **columns)
    elif kind == 1:
        columns = {k: v for k, v in columns.items() if np.asarray(v).dtype.kind != "M"}
        scipy.io.savemat(path, {"log": columns} if random.integers(2) else columns)
    else:
        pyarrow = pytest.importorskip("pyarrow")
        parquet = pytest.importorskip("pyarrow.parquet")
        flat = {k: np.ravel(np.asarray(v)) for k, v in columns.items()}
        rows = min(x.size for x in flat.values())
        flat = {
            k: x[:rows].real if x.dtype.kind == "c" else x[:rows] for k, x in flat.items()
        }
        parquet.write_table(pyarrow.table(flat), path)
    content = bytearray(path.read_bytes())
    damage = int(random.integers(4))
    if damage == 0:
        for k in random.integers(0, len(content), int(random.choice([1, 3, 40]))):
            content[int(k)] ^= 1 << int(random.integers(8))
    elif damage == 1:
        del content[int(random.integers(len(content))) :]
    path.write_bytes(bytes(content))
    return path
