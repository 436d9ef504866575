"""A generator of bad inputs for the command line: logs, machines, studies, options."""

import contextlib
import io
import math
import traceback
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import tomlkit
from bad_logs import NUMBERS, as_text, bad_log, damaged_log, motor_log
from test_study_config import SMALL

from aslo_jax.cli import main

MACHINE = """
[machine]
kind = "pmsm"
resistance = 2.8
inductance = 8e-3
magnet_flux = 0.175
pole_pairs = 4
inertia = 1e-3

[observer]
cutoff = 120.0
pll_bandwidth = 150.0
"""

MOTOR = MACHINE[: MACHINE.index("[observer]")]
# What a machine may say of its observer, beside the above.
OBSERVERS = {
    "lifted": """[observer]
kind = "lifted_kalman"
output_deviation = 0.01
input_deviation = 0.1
prior = 0.2
""",
    "adaptive": """[observer]
kind = "adaptive"
output_deviation = 0.01
input_deviation = 0.1
parameters = ["resistance", "magnet_flux"]
deviations = { resistance = 0.5, magnet_flux = 0.02 }
""",
    "scheduled": """[observer]
cutoff = { per_speed = 0.6, low = 8.0, high = 300.0 }
forgetting = { per_speed = 1.6, low = 8.0, high = 300.0, bandwidth = 50.0 }
""",
}
MODEL = """
import aslo_jax as aslo

motor = aslo.Model(
    f=lambda x, y, u, p: [(p["K"] * y[0] - p["b"] * x[0]) / p["J"]],
    g=lambda x, y, u, p: [(u[0] - p["R"] * y[0] - p["K"] * x[0]) / p["L"]],
    states={"speed": (-200, 200)},
    outputs={"u_beta": (-5, 5)},
    inputs={"u_alpha": (-12, 12)},
    parameters={"L": 4e-3, "R": 0.9, "K": 0.06, "J": 3e-4, "b": 2e-4},
)
"""
DERIVED = """
[machine]
kind = "derived"
model = "plant:motor"

[machine.parameters]
R = 1.1

[observer]
cutoff = 30.0
"""
# Each line of a model, and what it may be by mistake.
MODELS = [
    ("u[0]", "u[7]"),
    ('p["R"]', 'p["Q"]'),
    ('x[0]) / p["L"]', 'abs(x[0])) / p["L"]'),
    ('{"speed": (-200, 200)}', '{"speed": (200, -200)}'),
    ('{"speed": (-200, 200)}', '{"sp eed": (-1, 1)}'),
    ("4e-3", 'float("nan")'),
    ("4e-3", "0.0"),
    ("lambda x, y, u, p: [(u", "lambda x, y, u: [(u"),
    ("aslo.Model(", "dict("),
    ("import aslo_jax as aslo", "import nothing_like_this"),
    ("import aslo_jax as aslo", "raise KeyError(3)"),
    ("motor = ", "motor = ("),
    ("motor = ", "other = "),
]

VALUES = [
    -1,
    0,
    1,
    1e308,
    -1e308,
    1e-308,
    math.nan,
    math.inf,
    10**9,
    10**30,
    True,
    "text",
    "",
    "$x_1$",
    "../x",
    [],
    [1.0, 2.0],
    ["a"],
    {},
    {"kind": "wave"},
]


def bad_toml(random: np.random.Generator, text: str, path: Path) -> Path:
    """A file with one or two wrong keys, or that is no TOML."""
    document = tomlkit.parse(text)
    for _ in range(int(random.integers(1, 3))):
        table, name = _place(random, document)
        change = int(random.integers(4))
        if change == 0 and name in table:
            del table[name]
        elif change == 1:
            table[str(random.choice(["extra", "Resistance", "", "a b", "kind"]))] = 1.0
        else:
            table[name] = VALUES[int(random.integers(len(VALUES)))]
    content = tomlkit.dumps(document).encode()
    if random.integers(12) == 0:
        k = int(random.integers(len(content)))
        content = content[:k] + random.bytes(3) + content[k:]
    path.write_bytes(content)
    return path


def _place(random, table: Any) -> tuple[Any, str]:
    """A key of a document, at any depth."""
    while True:
        if isinstance(table, list) and table:
            table = table[0]
            continue
        names = list(table)
        if not names:
            return table, "x"
        name = names[int(random.integers(len(names)))]
        inner = table[name]
        if isinstance(inner, dict | list) and len(inner) and random.integers(4):
            if isinstance(inner, list) and not isinstance(inner[0], dict):
                return table, name
            table = inner
            continue
        return table, name


OPTIONS: dict[str, list[str]] = {
    "--cutoff": [*NUMBERS, "text"],
    "--pll-bandwidth": [*NUMBERS, "1e5"],
    "--substeps": ["0", "-1", "2", "1.5", "1000000000"],
    "--max-gap": NUMBERS,
    "--frame": ["dq", "abc", "xyz", ""],
    "--angle": ["t", "nothing", "1/0", "__import__('os')"],
    "--angle-kind": ["electrical", "mechanical", "both"],
    "--missing": ["coast", "interpolate", "refuse", "nothing"],
    "--most-missing": ["0", "1", "-5", "x"],
    "--remove-offset": ["standstill", "periods", "all"],
    "--voltage": ["held", "instant", "delayed=1", "delayed=999", "delayed=x", "late"],
    "--outliers": ["drop", "keep", "maybe"],
    "--column": ["t=nothing", "t=u_alpha", "x", "=", "t=t*0", "t=t/0", "u_alpha=9**9**9"],
}


def bad_options(random: np.random.Generator) -> list[str]:
    found: list[str] = []
    for _ in range(int(random.integers(1, 4))):
        name = list(OPTIONS)[int(random.integers(len(OPTIONS)))]
        found += [name, str(random.choice(OPTIONS[name]))]
    return found


EXPORTS: dict[str, list[str]] = {
    "--target": ["c", "fmu4", "", "C"],
    "--interval": [*NUMBERS, "1e-4", "1e6"],
    "--dtype": ["float32", "float16", "double", ""],
    "--name": ["a b", "1a", "for", "main", "x" * 300, "", "µ", "double"],
    "--cutoff": [*NUMBERS, "text"],
    "--substeps": ["0", "-1", "2", "1.5", "1000000000"],
    "--missing": ["coast", "interpolate", "nothing"],
    "--fixed": ["all", "resistance", "nothing", ""],
    "--variable-interval": [],
}


def bad_export(random: np.random.Generator, machine: Path, out: Path) -> list[str]:
    found = ["export", str(machine), "--out", str(out)]
    if random.integers(2):
        found += ["--interval", "1e-4"]
    for _ in range(int(random.integers(0, 3))):
        name = list(EXPORTS)[int(random.integers(len(EXPORTS)))]
        found += [name, *([str(random.choice(EXPORTS[name]))] if EXPORTS[name] else [])]
    return found


def newer_case(random: np.random.Generator, folder: Path, log: Path) -> list[str]:
    """Kinds of observers, models of one's own, and programs for a drive."""
    machine, out = folder / "m.toml", folder / "out"
    kind = int(random.integers(6))
    text = MOTOR + OBSERVERS[str(random.choice(list(OBSERVERS)))]
    if kind == 5:
        before, after = MODELS[int(random.integers(len(MODELS)))]
        (folder / "plant.py").write_text(MODEL.replace(before, after))
        return ["derive", f"{folder / 'plant.py'}:motor", "--out", str(folder / "out.toml")]
    if kind == 4:
        (folder / "plant.py").write_text(MODEL)
        text = DERIVED
    elif kind == 3:
        machine.write_text(MACHINE)
        return bad_export(random, machine, out)
    bad_toml(random, text, machine)
    if random.integers(4) == 0:
        return bad_export(random, machine, out)
    table = folder / "out.csv"
    return ["estimate", str(log), "--machine", str(machine), "--out", str(table)]


def case(number: int, folder: Path) -> list[str]:
    """The arguments of one bad use of the command line, whose outputs are in `folder`."""
    random = np.random.default_rng(number)
    log, machine, study = folder / "log.csv", folder / "m.toml", folder / "s.toml"
    log.write_text("\n".join(",".join(row) for row in as_text(motor_log())))
    machine.write_text(MACHINE)
    study.write_text(SMALL)
    kind = int(random.integers(26))
    options: list[str] = []
    if kind < 9:
        log = bad_log(random, folder) if kind < 6 else damaged_log(random, folder)
        if random.integers(4) == 0:
            options = bad_options(random)
    elif kind < 13:
        machine = bad_toml(random, MACHINE, machine)
    elif kind < 16:
        options = bad_options(random)
    elif kind >= 20:
        return newer_case(random, folder, log)
    else:
        study = bad_toml(random, SMALL, study)
        out = str(folder / "out")
        return ["study", str(study), "--samples", "3", "--out", out, "-q", "--no-report"]
    out = folder / f"out{random.choice(['.csv', '.npz', '.parquet'])}"
    return ["estimate", str(log), "--machine", str(machine), "--out", str(out), *options]


def run(arguments: list[str]) -> tuple[Any, str, str]:
    """Exit code, stdout and stderr of the command line, or what it raised."""
    out, error = io.StringIO(), io.StringIO()
    code: Any = "returned"
    with (
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(error),
        warnings.catch_warnings(),
    ):
        warnings.simplefilter("error")
        try:
            main(arguments)
        except SystemExit as ended:
            code = ended.code or 0
        except BaseException:
            code = traceback.format_exc()
    return code, out.getvalue(), error.getvalue()


def faults(number: int, folder: Path) -> list[str]:
    """What is wrong in how the command line takes a bad input."""
    folder.mkdir(parents=True)
    arguments = case(number, folder)
    before = {p.name for p in folder.iterdir()}
    code, out, error = run(arguments)
    found = []
    if code not in (0, 1, 2):
        found.append(f"ends with {code}")
    if "Traceback" in out + error:
        found.append("prints a traceback")
    if code in (1, 2):
        lines = [x for x in error.splitlines() if not x.startswith("aslo-jax: warning:")]
        told = [x for x in lines if x.startswith("aslo-jax: error:")]
        if len(told) != 1 and not ("Usage" in error or "Invalid value" in error):
            found.append(f"does not say why in one line: {error[-400:]!r}")
        if len(error) > 4000:
            found.append(f"says {len(error)} characters")
        left = {p.name for p in folder.iterdir()} - before
        # A model's file is Python, which keeps what it compiles.
        hidden = any(p.name.startswith(".") for p in folder.rglob("*"))
        if hidden or left - {"out", "__pycache__"}:
            found.append(f"leaves {sorted(left)}")
    if code == 0 and arguments[0] == "estimate":
        found += _of_table(folder, error)
    if any(ord(c) < 32 and c not in "\n\t\r" for c in out + error):
        found.append("prints control characters")
    return [f"{number} {' '.join(arguments[3:])}: {each}" for each in found]


FINITE = ("flux_alpha", "flux_beta", "theta_electrical", "speed")


def _of_table(folder: Path, error: str) -> list[str]:
    """What is wrong with a table of estimates: numbers that are none where it does not say
    so."""
    from aslo_jax.logs._formats import open_source

    (path,) = (p for p in folder.iterdir() if p.stem == "out")
    source = open_source(path)
    offered = list(source.names)
    names = [n for n in FINITE if n in offered] + ["coasting"]
    table = {name: [] for name in names}
    for batch in source.batches(names, True):
        for name in names:
            table[name].append(np.asarray(batch[name], float))
    columns = {name: np.concatenate(x) for name, x in table.items()}
    trusted = columns["coasting"] == 0
    bad = [n for n in names[:-1] if not np.isfinite(columns[n][trusted]).all()]
    return [f"trusts what is not finite in {bad}"] if bad and "finite" not in error else []
