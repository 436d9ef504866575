"""A module as C."""

import dataclasses
import re
from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from .. import __version__
from .._checks import positive
from .._citation import described, made_of
from .._typing import Missing, PyTree
from .._written import write_files
from ._blocks import Block, Chain, block_of
from ._fields import RESERVED, Field
from ._fmu import write_fmu
from ._harness import harness, is_held
from ._header import CONTROL, SAMPLING, header, top, wrapped
from ._readme import readme
from ._source import Source, source
from ._traced import Traced, traced
from ._vectors import Vectors, excited, recorded

__all__ = ["Chain", "Exported", "export_c"]

PREFIX = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,30}")
DTYPES = ("float32", "float64")


@dataclasses.dataclass(frozen=True)
class Exported:
    """The C of a module: what [`export_c`][] returns.

    - `files`: their texts, by name;
    - `prefix` of every symbol, `dtype` of its numbers, `interval` (s) or `None`;
    - `parameters`, `state`, `inputs` and `outputs`: the members of the structs and what a
      step takes, each with `name`, `shape`, `dtype`, `origin` in the library and `default`;
    - `operations` of a step, of which so many, `of_parameters`, follow from the parameters
      alone; a product and a sum count as two;
    - `notes` and `columns`: as they were given;
    - `state_bytes`, without padding, and `automatic_bytes`: of the variables of a step,
      which is at most what it takes of the stack besides calls.
    """

    files: dict[str, str]
    prefix: str
    dtype: str
    interval: float | None
    parameters: tuple[Field, ...]
    state: tuple[Field, ...]
    inputs: tuple[Field, ...]
    outputs: tuple[Field, ...]
    operations: int
    of_parameters: int
    state_bytes: int
    automatic_bytes: int
    notes: dict[str, str]
    columns: dict[str, tuple[str, ...]]

    def write(self, out: Path | str) -> list[Path]:
        """Write the files into the folder `out`, which is made: their paths."""
        return write_files(Path(out), {k: text.encode() for k, text in self.files.items()})

    def write_fmu(
        self, path: Path | str, version: int = 3, platforms: Sequence[str] = ()
    ) -> Path:
        """Write an FMU of `version` 2 or 3 for co-simulation, around this C: its sources,
        and a binary for this platform by the system's C compiler or the ziglang wheel.
        For further `platforms`, by their names in FMI 3, such as `"x86_64-windows"`, that
        wheel is needed.

        The step at the time t takes the inputs of t, and the u of the step before, which
        was held until t: what it puts out at the end of a communication step is what is
        known at its beginning. Parameters are tunable; the state is got, set and
        serialised as bytes.

        **Raises:** `ValueError` for another version or an unknown platform; `OSError`
        without a compiler."""
        if version not in (2, 3):
            raise ValueError(f"Argument `version` must be 2 or 3, but got {version!r}.")
        names = {f.name for f in self.inputs if not is_held(f)} - (
            {"dt"} if self.interval is None else set()
        )
        fields = {
            "inputs": self.inputs,
            "first": tuple(f for f in self.inputs if f.name in names),
            "outputs": self.outputs,
            "parameters": self.parameters,
        }
        path = Path(path)
        write_fmu(
            path,
            version,
            self.files,
            self.prefix,
            self.interval,
            fields,
            self.columns,
            self.notes,
            platforms,
        )
        return path


def export_c(
    observer: Any,
    *,
    interval: float | None,
    u: PyTree | None = None,
    y: PyTree | None = None,
    dtype: str = "float64",
    prefix: str = "observer",
    substeps: int = 1,
    missing: Missing = "refuse",
    fixed: Collection[str] = (),
    outputs: Callable[[Any], PyTree] | None = None,
    notes: Mapping[str, str] | None = None,
    columns: Mapping[str, Sequence[str]] | None = None,
    log: tuple[Any, PyTree, PyTree] | None = None,
    command: str = "aslo_jax.export_c(...)",
) -> Exported:
    """A module as C99 that needs no library, allocates nothing and keeps nothing outside of
    its state: what the fused engine takes, in the same operations.

    **Arguments:**

    - `observer`: an observer, a filter, a controller, or a [`Chain`][] of an observer and a
      controller, a user's own included;
    - `interval`: from step to step (s), or `None` for one that each step is given;
    - `u`, `y`: examples of the input and the measurement, arrays or trees of them of which
      the shape matters; not needed where the observer declares its signals. A filter is
      given `y`, a controller what it is fed;
    - `dtype`: `"float64"`, or `"float32"` for a processor that has no more;
    - `prefix` of every symbol and of the files: letters, digits and `_`;
    - `substeps`: as in [`replay`][];
    - `missing`: `"refuse"` for a step that returns a status and changes nothing where an
      input is not finite; `"coast"` for one that takes such a sample as missing, as
      [`AbstractObserver.step`][] does, which is longer;
    - `fixed`: parameters that become constants, by their names in C, or `"all"`: what
      follows from them alone is computed now;
    - `outputs`: makes the tree that is put out from what the observer estimates, by default
      all of it;
    - `notes`: a unit or a frame for members of the structs, by name, for their comments;
    - `columns`: the names of the columns of a CSV file that hold the entries of an input or
      an output, by its name; by default `u_0` and so on;
    - `log`: t, u and y, as of [`replay`][], from which the vectors of the test are taken,
      the first 200 rows; by default slow sinusoids;
    - `command`: what the header says that made it.

    **Returns:** an [`Exported`][]: a header and a source, a test with recorded vectors, a
    filter of CSV files, a Makefile, a CMakeLists.txt and a README. The same text from run
    to run.

    **Raises:** [`NotFusible`][] with the user's line for what the engine does not take;
    `ValueError` for another argument that does not suit.
    """
    if dtype not in DTYPES:
        raise ValueError(
            f"Argument `dtype` must be one of {', '.join(DTYPES)}, but got {dtype!r}."
        )
    if not PREFIX.fullmatch(prefix) or prefix in RESERVED:
        raise ValueError(
            "Argument `prefix` must begin with a letter, have at most 31 letters, digits "
            f"or `_`, and be no word of C, but got {prefix!r}."
        )
    if missing not in ("refuse", "coast"):
        raise ValueError(
            'Argument `missing` must be "refuse" or "coast", since a step cannot look '
            f"ahead, but got {missing!r}."
        )
    if interval is not None:
        positive("interval", interval, "s")
        interval = float(interval)
    block = block_of(
        observer,
        {"u": u, "y": y},
        substeps=substeps,
        coasts=missing == "coast",
        outputs=outputs,
    )
    kind, refuses = np.dtype(dtype), missing == "refuse"
    made = traced(block, kind, interval, fixed)
    code = source(made, prefix, refuses, top(prefix))
    notes, columns = notes or {}, columns or {}
    vectors = _vectors(block, made, kind, interval, log)
    above = _above(observer, block, made, code, prefix, command)
    files = {
        f"{prefix}.h": wrapped(header(made, prefix, above, notes, refuses)),
        f"{prefix}.c": wrapped(code.text),
        **harness(made, prefix, vectors, columns),
        "README.md": readme(made, prefix, above, notes, columns),
    }
    size = sum(f.size * f.dtype.itemsize for f in made.state) + 1
    return Exported(
        files,
        prefix,
        dtype,
        interval,
        *(tuple(x) for x in (made.parameters, made.state, made.inputs, made.outputs)),
        operations=code.operations,
        of_parameters=code.of_parameters,
        state_bytes=size,
        automatic_bytes=code.automatic,
        notes=dict(notes),
        columns={name: tuple(names) for name, names in columns.items()},
    )


def _vectors(
    block: Block, made: Traced, dtype: np.dtype, interval: float | None, log: Any
) -> Vectors:
    signals = excited(block, interval) if log is None else recorded(block, interval, log)
    return Vectors.of(block, signals, made, dtype)


def _above(
    observer: Any, block: Block, made: Traced, code: Source, prefix: str, command: str
) -> list[str]:
    size = sum(f.size * f.dtype.itemsize for f in made.state) + 1
    convention = SAMPLING if "u" in block.inputs else CONTROL
    every = (
        "dt seconds, an argument of a step"
        if made.interval is None
        else f"{made.interval!r} s"
    )
    return [
        f"{prefix}.h: made by aslo_jax {__version__}; make it again rather than change it.",
        f"  {command}",
        "What it is made of:",
        *dict.fromkeys(map(described, made_of(observer))),
        "SI units; angles in radians; alpha-beta quantities amplitude-invariant, in the "
        "stationary frame, unless a comment says otherwise.",
        f"Sampled every {every}. {convention}",
        f"A step takes {code.operations} operations in {made.dtype.name}, of which "
        f"{code.of_parameters} follow from the parameters alone (a product and a sum are "
        f"two). State: {size} bytes and padding. Stack: at most {code.automatic} bytes of "
        "automatic variables. Nothing is allocated, nothing is kept outside of the state, "
        "and no library is needed.",
    ]
