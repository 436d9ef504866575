"""Exported C, compiled and run."""

import ctypes
import functools
import importlib.util
import shutil
import subprocess
import sys
from pathlib import Path

import jax
import numpy as np
import pytest

import aslo_jax as aslo
from aslo_jax.export._harness import calls
from aslo_jax.export._traced import Traced

STRICT = [
    "-std=c99",
    "-Wall",
    "-Wextra",
    "-Werror",
    "-pedantic",
    "-Wconversion",
    "-Wdouble-promotion",
]

RUN = """
#include "{p}.h"

{calls}
int run(long rows, const double *in, double *out, const double *with);

int run(long rows, const double *in, double *out, const double *with)
{{
    long k;
    {p}_state state;
    {p}_output output;
    {parameters}
    (void)with;
    for (k = 0; k < rows; ++k) {{
        const int status = (k == 0) ? (int)start(&state, {own} in, &output)
                                    : (int)step(&state, {own} in + (k * {inputs}), &output);
        if (status != 0) {{
            return status;
        }}
        put(&output, out + (k * {outputs}));
    }}
    return 0;
}}
"""


@functools.cache
def compiler() -> tuple[str, ...]:
    """The system's, or else that of the ziglang wheel."""
    found = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
    if found:
        return (found,)
    if importlib.util.find_spec("ziglang"):
        return (sys.executable, "-m", "ziglang", "cc")
    pytest.skip("no C compiler, and no ziglang")


def compiled(folder: Path, name: str, *options: str, needs: tuple[str, ...] = ()) -> Path:
    """The object of a file of a folder; with `-shared` the library."""
    out = folder / f"{Path(name).stem}.o"
    strict = [] if name.endswith((".cpp", ".cc")) else STRICT
    done = subprocess.run(
        [*compiler(), *strict, *options, "-o", out, name, *needs],
        cwd=folder,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    return out


class Compiled:
    """The functions of an export as one on arrays: of every row the inputs and the outputs,
    entry by entry."""

    def __init__(self, exported: aslo.Exported, folder: Path, *options: str) -> None:
        self.exported, self.folder = exported, folder
        exported.write(folder)
        p, own = exported.prefix, bool(exported.parameters)
        size = lambda fields: sum(field.size for field in fields)
        self.outputs = size(exported.outputs)
        lines = []
        for field in exported.parameters:
            for k in range(field.size):
                place = f"[{k}]" if field.is_array else ""
                kind = "double" if field.dtype == np.float64 else "float"
                lines.append(
                    f"parameters.{field.name}{place} = ({kind})with[{len(lines)}];"
                )
        setting = (
            f"{p}_parameters parameters; {p}_defaults(&parameters); "
            f"if (with != NULL) {{ {' '.join(lines)} }}"
        )
        text = RUN.format(
            p=p,
            calls=calls(flat(exported), p),
            inputs=size(exported.inputs),
            outputs=self.outputs,
            own="&parameters, " if own else "",
            parameters=setting if own else "",
        )
        (folder / "run.c").write_text(text)
        options = options or ("-O1", "-fno-math-errno", "-ffp-contract=off")
        library = compiled(folder, "run.c", "-shared", "-fPIC", *options, needs=(f"{p}.c",))
        self.library = ctypes.CDLL(str(library))

    def status(self, rows: np.ndarray, parameters=None) -> tuple[int, np.ndarray]:
        rows = np.ascontiguousarray(rows, float)
        out = np.zeros((len(rows), self.outputs))
        pointer = lambda x: x.ctypes.data_as(ctypes.POINTER(ctypes.c_double))
        given = None if parameters is None else pointer(np.asarray(parameters, float))
        status = self.library.run(
            ctypes.c_long(len(rows)), pointer(rows), pointer(out), given
        )
        return status, out

    def __call__(self, rows: np.ndarray, parameters=None) -> np.ndarray:
        status, out = self.status(rows, parameters)
        assert status == 0
        return out


def flat(exported: aslo.Exported) -> Traced:
    """What the functions on arrays are written from."""
    first = [f for f in exported.inputs if f.name == "y" or f.name.startswith("y_")]
    return Traced(
        None,  # pyright: ignore[reportArgumentType]
        list(exported.parameters),
        list(exported.state),
        first,
        list(exported.inputs),
        list(exported.outputs),
        exported.interval,
    )


def columns(tree) -> np.ndarray:
    """The leaves of a tree with a leading axis, entry by entry."""
    leaves = [np.asarray(x, float) for x in jax.tree.leaves(tree)]
    return np.concatenate([x.reshape(len(x), -1) for x in leaves], axis=1)


def rows_of(u, y, dt=None) -> np.ndarray:
    """The inputs of steps from a log: with each y the u that was held before it."""
    late = jax.tree.map(lambda x: np.concatenate([0.0 * x[:1], x[:-1]]), u)
    found = {"u": late, "y": y}
    if dt is not None:
        found["dt"] = np.concatenate([[0.0], dt])
    return columns(found)


def error(found: np.ndarray, expected: np.ndarray) -> float:
    """The largest of a column over the largest of its signal."""
    size = np.max(np.abs(expected), axis=0)
    return float(np.max(np.abs(found - expected) / np.where(size > 0, size, 1.0)))
