"""The page of the command line: options from the program, output from running it."""

import importlib
import inspect
import re
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any, get_args, get_type_hints

from . import ROOT

PAGE = ROOT / "docs" / "commands.md"

MODEL = """\
import aslo_jax as aslo

drive = aslo.Model(
    f=lambda x, y, u, p: [(p["K"] * y[0] - p["load"]) / p["J"]],  # speed'
    g=lambda x, y, u, p: [(u[0] - p["R"] * y[0] - p["K"] * x[0]) / p["L"]],  # current'
    states={"speed": (-200, 200)},
    outputs={"current": (-5, 5)},
    inputs={"voltage": (-12, 12)},
    parameters={"L": 4e-3, "R": 0.9, "K": 0.06, "J": 3e-4, "load": 0.03},
    unknown=["load"],
)
"""

# Run in this order, in one folder, where `model.py` is; shown under the command.
RUN: dict[str, tuple[str, ...]] = {
    "sample": ("sample", "sample --kind drive"),
    "estimate": ("estimate pmsm_log.csv --machine motor.toml --out estimate.csv",),
    "derive": ("derive model.py:drive",),
    "export": ("export motor.toml --target c --cutoff 150 --interval 2e-4 --out firmware",),
    "study": ("study double_integrator --samples 500 --seed 1 --out study",),
}
# What another machine or another day has otherwise.
MASKED = ((re.compile(r"[\d.e+]+ s, [\d.e+]+ trajectory-steps per second"), "..."),)


def written(outputs: dict[str, str] | None = None) -> str:
    """The page; `outputs` of its commands, which are run where they are not given."""
    typer = importlib.import_module("typer.main")
    app = importlib.import_module("aslo_jax.cli._app").app
    group = typer.get_command(app)
    outputs = _outputs() if outputs is None else outputs
    lines = [
        "# Command line",
        "",
        f"{group.help} `aslo-jax COMMAND --help` says the same in the terminal. Exit",
        "codes: 0, 2 for an argument or an input that is refused, 1 for anything else that",
        "fails, 130 and 143 for an interrupt and a request to end. This page is made from",
        "the program by `python -m website commands`, its outputs by running it.",
    ]
    for name, command in group.commands.items():
        lines += ["", f"## {name}", "", *_paragraphs(command.help or "")]
        hints = get_type_hints(inspect.unwrap(command.callback))
        rows = [
            _row(each, hints.get(each.name))
            for each in command.params
            if each.name != "help"
        ]
        lines += ["", "| | default | |", "| --- | --- | --- |", *filter(None, rows)]
        for line in RUN.get(name, ()):
            lines += ["", f"```console\n$ aslo-jax {line}\n{outputs[line]}```"]
        if name == "derive":
            lines += ["", f"with `model.py`:\n\n```python\n{MODEL}```"]
    return "\n".join(lines) + "\n"


def _paragraphs(text: str) -> list[str]:
    """Without the breaks of the source's lines."""
    parts = re.split(r"\n\s*\n", text.strip())
    return "\n\n".join(" ".join(each.split()) for each in parts).split("\n")


def _row(of: Any, annotation: Any) -> str:
    """A line of the table for an argument or an option, which takes an `annotation`."""
    said = " ".join((getattr(of, "help", "") or "").split()).replace("|", "\\|")
    if not of.opts[0].startswith("-"):
        name = of.metavar or of.name.upper()
        name = f"`{name}`".replace("|", "\\|")
    else:
        name = ", ".join(f"`{each}`" for each in of.opts)
        name += "".join(f" / `{each}`" for each in of.secondary_opts)
        if not of.is_flag:
            kind = of.metavar or _kind(annotation)
            name += f" `{kind}`".replace("|", "\\|") if kind else ""
    default = "required" if of.required else ""
    plain = of.default is not None and not callable(of.default)
    if plain and not of.required and (not of.is_flag or of.secondary_opts):
        default = f"`{of.opts[0] if of.is_flag else of.default}`"
    return f"| {name} | {default} | {said} |"


def _kind(annotation: Any) -> str:
    """`PATH` of `Path | None`, `FLOAT` of `list[float]`."""
    if annotation in (Path, int, float):
        return annotation.__name__.upper()
    return next(filter(None, map(_kind, get_args(annotation))), "")


def _outputs() -> dict[str, str]:
    """What every command prints, by the command."""
    found = {}
    with tempfile.TemporaryDirectory() as folder:
        Path(folder, "model.py").write_text(MODEL, "utf-8")
        for line in (line for lines in RUN.values() for line in lines):
            made = subprocess.run(
                [sys.executable, "-m", "aslo_jax", *line.split()],
                cwd=folder,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                text=True,
                check=True,
            )
            text = made.stdout
            for pattern, instead in MASKED:
                text = pattern.sub(instead, text)
            found[line] = text.lstrip("\n")
    return found
