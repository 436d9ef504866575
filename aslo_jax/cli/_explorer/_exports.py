"""What can be taken from the explorer: files that give the same elsewhere."""

import io
import tempfile
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import tomlkit

from ... import __version__
from ...logs import Log
from ...machines import AbstractDescription
from .._export import exported_machine
from ._panels import Result
from ._scene import Moved

LOG, MACHINE = "explored.csv", "explored.toml"


def machine_text(machine: AbstractDescription, substeps: int, about: str) -> str:
    """The description of a machine and its observer as TOML, with the command that gives
    the estimate that was seen."""
    content = {
        "machine": machine.machine.model_dump(exclude_none=True),
        "observer": _stated(machine.observer),
    }
    return (
        f"# {about}\n# aslo-jax estimate {LOG} --machine {MACHINE} --substeps {substeps} "
        f"--out estimate.csv\n{tomlkit.dumps(content)}"
    )


def _stated(observer: Any) -> dict[str, Any]:
    """The keys that are not at their default."""
    return observer.model_dump(exclude_none=True, exclude_defaults=True)


def log_text(log: Log, machine: AbstractDescription) -> str:
    """A log as CSV, every digit of it."""
    of = machine.signals
    names = (*of.inputs, *of.optional)[: log.u.shape[1]]
    columns = {"t": log.t} | dict(zip(names, log.u.T, strict=True))
    columns |= dict(zip(of.outputs, log.y.T, strict=True)) | log.truth
    return csv_text(columns)


def estimates_text(result: Result) -> str:
    """The tables of all observers side by side as CSV."""
    columns: dict[str, np.ndarray] = {"t": result.log.t}
    for name, table in result.columns.items():
        for column, values in table.items():
            if column != "t":
                columns[f"{column} ({name.replace(',', '')})"] = values
    return csv_text(columns | result.machine.truth(result.log))


def csv_text(columns: Mapping[str, np.ndarray]) -> str:
    """Columns as CSV; numbers are read back as they are."""
    header = ",".join(columns)
    rows = zip(*(x.tolist() for x in columns.values()), strict=True)
    lines = (",".join(map(repr, row)) for row in rows)
    return "\n".join([header, *lines, ""])


def python_text(machine: AbstractDescription, substeps: int, about: str) -> str:
    """A program that estimates the same from the exported log and description."""
    names = ", ".join(f"{q.columns[0]!r}" for q in machine.quantities[:1])
    return f'''"""{about}

Beside it: {LOG} and {MACHINE}, exported from the same page. aslo_jax {__version__}."""

from pathlib import Path

import jax
import numpy as np

import aslo_jax as aslo
from aslo_jax.logs import read_log
from aslo_jax.machines import read_machine

jax.config.update("jax_enable_x64", True)
here = Path(__file__).parent
machine = read_machine(here / "{MACHINE}")
log = read_log(here / "{LOG}", machine.signals)
observer = machine.state_observer(machine.rates(log))
estimate = aslo.replay(observer, log.t, log.u, log.y, substeps={substeps})
columns, truth = machine.columns(estimate, log), machine.truth(log)
for name in [{names}]:
    print(name, "at the end:", columns[name][-1])
    if name in truth:
        late = slice(len(log.t) // 2, None)
        error = columns[name][late] - truth[name][late]
        print("rms error of the second half:", np.sqrt(np.mean(error**2)))
'''


def c_archive(machine: AbstractDescription, interval: float, substeps: int) -> bytes:
    """The C of an observer, of a constant `interval` (s), as a zip."""
    interval = float(f"{interval:.9g}")
    command = (
        f"aslo-jax export {MACHINE} --interval {interval!r} --substeps {substeps} "
        "--prefix explored --out ."
    )
    exported = exported_machine(
        machine,
        Path(MACHINE),
        {},
        interval=interval,
        dtype="float64",
        prefix="explored",
        substeps=substeps,
        missing="refuse",
        fixed=(),
        command=command,
    )
    archive = io.BytesIO()
    with tempfile.TemporaryDirectory() as folder, zipfile.ZipFile(archive, "w") as zipped:
        for path in exported.write(folder):
            # Without the time, so that the same is the same.
            about = zipfile.ZipInfo(path.name)
            about.compress_type = zipfile.ZIP_DEFLATED
            zipped.writestr(about, path.read_bytes())
    return archive.getvalue()


def study_content(moved: Moved, tolerance: float) -> dict[str, Any]:
    """The study of a band: the content of a state, whose plant has the errors and the
    relative tolerances of it."""
    content = _plain(moved.content)
    spread: dict[str, Any] = {}
    taken: set[str] = set()
    for name, item in content.get("spread", {}).items():
        if not item.get("relative"):
            continue
        single = isinstance(item["where"], str)
        wheres = [item["where"]] if single else item["where"]
        factors = [1.0 + moved.errors.get(w.removeprefix("plant."), 0.0) for w in wheres]
        new = _moved_item(item, factors[0] if single else factors, tolerance)
        if new is not None:
            spread[name] = new
            taken |= set(wheres)
    for key, error in moved.errors.items():
        if error and f"plant.{key}" not in taken:
            spread[f"error_{key}"] = {
                "where": f"plant.{key}",
                "distribution": "discrete",
                "values": [1.0 + error],
                "relative": True,
            }
    content["spread"] = spread
    return content


def _moved_item(item: dict[str, Any], factor: Any, tolerance: float) -> Any:
    """A relative distribution times `factor`, and `tolerance` times as wide."""
    if tolerance == 0.0:
        return None
    about = lambda x, f: f * (1.0 + tolerance * (x - 1.0))
    new = dict(item)
    if item["distribution"] == "correlated":
        new["mean"] = [about(x, f) for x, f in zip(item["mean"], factor, strict=True)]
        pairs = zip(item["deviation"], factor, strict=True)
        new["deviation"] = [tolerance * f * x for x, f in pairs]
        return new
    for key in ("mean", "low", "high", "median"):
        if key in item:
            new[key] = about(item[key], factor)
    if "deviation" in item:
        shared = 1.0 if item["distribution"] == "log-normal" else factor
        new["deviation"] = tolerance * shared * item["deviation"]
    if "values" in item:
        new["values"] = [about(x, factor) for x in item["values"]]
    return new


def study_text(moved: Moved, tolerance: float, about: str) -> str:
    """The same as a file for `aslo-jax study`."""
    command = "aslo-jax study explored-study.toml --samples 256 --out study"
    return f"# {about}\n# {command}\n{tomlkit.dumps(study_content(moved, tolerance))}"


def _plain(content: Any) -> Any:
    """A copy of a table without what is not given, and with lists for tuples."""
    if isinstance(content, Mapping):
        return {k: _plain(v) for k, v in content.items() if v is not None}
    return [_plain(x) for x in content] if isinstance(content, list | tuple) else content
