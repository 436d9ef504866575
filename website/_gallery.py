"""The gallery: short scripts, each with a picture and a number.

A script of `docs/gallery` begins with a docstring, its title and a paragraph, and leaves

- `headline`: what was measured, the number and its unit;
- `figure`: of matplotlib; and, for a picture that moves, `draw(frame)`, which changes it,
  and `frames`, how many there are.

`python -m website gallery` runs them and stores the pictures beside them, and the numbers
in `headlines.json`, with the digest of the code that gave them.
"""

import ast
import hashlib
import importlib
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from . import ROOT
from ._pictures import moving, still

FOLDER = ROOT / "docs" / "gallery"
RECORD = FOLDER / "headlines.json"
SECTIONS: dict[str, tuple[str, ...]] = {
    "The paper": (
        "exact_start",
        "flux_vector",
        "double_integrator",
        "flux_observers",
        "leg",
        "ball_beam",
    ),
    "Motors": (
        "reversal",
        "sensorless_start",
        "wound_rotor",
        "interior",
        "resistance",
        "adaptive",
        "calibration",
        "speed_schedule",
        "smoothing",
        "holes",
    ),
    "Mechanisms and bearings": ("turntable", "levitation", "encoder"),
    "Derived observers": ("dc_motor", "boost", "battery"),
    "Design": (
        "design_chart",
        "notch",
        "sampling",
        "tuning",
        "study",
        "trajectories",
    ),
}


@dataclass(frozen=True)
class Shown:
    """What a script has left: `quantity`, `value` and `unit` of its number; `picture`, the
    content of the file `name`."""

    quantity: str
    value: float
    unit: str
    name: str
    picture: bytes


def scripts() -> list[Path]:
    """In the order of the gallery."""
    return [FOLDER / f"{name}.py" for names in SECTIONS.values() for name in names]


def run(script: Path) -> Shown:
    """Run a script in this process, and render its picture."""
    matplotlib = importlib.import_module("matplotlib")
    style = importlib.import_module("aslo_jax.plot._style")
    colors = importlib.import_module("cycler").cycler(color=style.COLORS)
    settings = {"text.parse_math": True, "axes.prop_cycle": colors}
    namespace: dict[str, Any] = {"__name__": "__main__"}
    with matplotlib.rc_context(style.SETTINGS | settings):
        exec(compile(script.read_text("utf-8"), script, "exec"), namespace)
        quantity, value, unit = namespace["headline"]
        if "frames" in namespace:
            content = moving(namespace["figure"], namespace["draw"], namespace["frames"])
            kind = "gif"
        else:
            content, kind = still(namespace["figure"]), "png"
    return Shown(quantity, float(value), unit, f"{script.stem}.{kind}", content)


def record(names: list[str]) -> None:
    """Run the scripts with these names, by default all, and store what they give."""
    stored = stored_headlines()
    for script in scripts():
        if names and script.stem not in names:
            continue
        found = run(script)
        (FOLDER / found.name).write_bytes(found.picture)
        stored[script.stem] = {
            "quantity": found.quantity,
            "value": float(f"{found.value:.4g}"),
            "unit": found.unit,
            "picture": found.name,
            "script": digest(script),
        }
        kept = {each.stem: stored[each.stem] for each in scripts() if each.stem in stored}
        RECORD.write_text(json.dumps(kept, indent=1) + "\n", "utf-8")
        print(f"{script.stem}: {found.quantity} {found.value:.4g} {found.unit}")
    (FOLDER / "README.md").write_text(overview(".py"), "utf-8")


def stored_headlines() -> dict[str, dict[str, Any]]:
    """What `record` has stored, by the script's name."""
    return json.loads(RECORD.read_text("utf-8")) if RECORD.exists() else {}


def digest(script: Path) -> str:
    """Of the code of a script, without its text."""
    return hashlib.sha256(told(script)[2].encode()).hexdigest()[:16]


def told(script: Path) -> tuple[str, str, str]:
    """Title, paragraph and code of a script."""
    code = script.read_text("utf-8")
    tree = ast.parse(code)
    title, _, text = (ast.get_docstring(tree) or "").partition("\n\n")
    rest = code.splitlines()[tree.body[0].end_lineno or 0 :]
    return title.rstrip("."), text, "\n".join(rest).strip("\n")


def headline(name: str) -> str:
    """The number of a script in words."""
    told = stored_headlines()[name]
    return f"{told['quantity']}: {told['value']:g} {told['unit']}".rstrip()


def overview(suffix: str) -> str:
    """A page with all pictures; `suffix` of what their titles lead to. That of the site,
    `".md"`, has them side by side."""
    side_by_side = suffix == ".md"
    lines = [
        "# Gallery",
        "",
        "Each picture is drawn by the short script behind it, which needs the extra `all`. "
        "The tests run the scripts and hold the numbers.",
    ]
    for section, names in SECTIONS.items():
        lines += ["", f"## {section}"]
        lines += ["", '<div class="gallery" markdown="1">'] if side_by_side else []
        for name in names:
            title, _, _ = told(FOLDER / f"{name}.py")
            picture = stored_headlines()[name]["picture"]
            heading = f"[{title}]({name}{suffix})"
            lines += [
                "",
                *(['<div markdown="1">', ""] if side_by_side else []),
                f"**{heading}**" if side_by_side else f"### {heading}",
                "",
                f"[![{title}]({picture})]({name}{suffix})",
                "",
                f"{headline(name)}.",
                *(["", "</div>"] if side_by_side else []),
            ]
        lines += ["", "</div>"] if side_by_side else []
    return "\n".join(lines) + "\n"


def gallery_pages() -> dict[str, str | bytes]:
    """A page for each script, the pictures and an index, by their paths."""
    found: dict[str, str | bytes] = {"gallery/index.md": overview(".md")}
    for script in scripts():
        title, text, code = told(script)
        picture = stored_headlines()[script.stem]["picture"]
        found[f"gallery/{picture}"] = (FOLDER / picture).read_bytes()
        lines = [
            f"# {title}",
            text,
            f"![{title}]({picture})",
            f"**{headline(script.stem)}.**",
            f"```python\n{code}\n```",
            "`figure.savefig(...)` writes the picture; the script is "
            f"`docs/gallery/{script.name}`.",
        ]
        found[f"gallery/{script.stem}.md"] = "\n\n".join(lines) + "\n"
    return found
