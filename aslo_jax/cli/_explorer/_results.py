"""The results of a study: errors over time, metrics of all samples, one sample again."""

import json
from pathlib import Path
from typing import Any

import numpy as np

from ...study import open_study
from ...study._bands import bands
from ...study._tables import is_flag, label, magnitude, metrics, names, parameters, unit
from ._panels import packed
from ._scene import Scene, scene_of
from ._state import State, StateError

SHARES = np.linspace(0.0, 1.0, 201)  # of the samples, at which a metric is drawn
DOTS = 2000  # samples that are drawn against a parameter, at most
LEAST = 1e-300  # what a logarithm is taken of


class Results:
    """The store of a study at `path`, opened.

    - `dataset`; `content`: of its file; `scene`: the same for simulation, `None` where its
      kind of machine cannot be explored, and `why`.

    **Raises:** `ValueError` where there is no study, or none of its samples is done.
    """

    def __init__(self, path: Path) -> None:
        self.dataset = open_study(path)
        self.name = path.parent.name if path.name == "study.zarr" else path.name
        self.content = json.loads(self.dataset.attrs["configuration"])
        self.scene: Scene | None = None
        self.why = ""
        try:
            if "machine" not in self.content:
                raise ValueError("it was not made from a file of `aslo-jax study`.")
            self.scene = scene_of(_without_none(self.content))
        except ValueError as error:
            self.why = f"The samples of this study cannot be run here: {error}"
        self.title = self.content.get("title", self.name)

    def drawn(self, parameter: str | None = None) -> dict[str, Any]:
        """Panels for the page, against that `parameter`, by default the first.

        **Raises:** [`StateError`][] for a parameter that is not there.
        """
        data, observers = self.dataset, names(self.dataset)
        panels, every = [], metrics(data)
        if "error" in data:
            found = bands(data["error"])
            t = packed(data["time"].values)
            lines = [
                {
                    "observer": name,
                    "x": t,
                    "values": packed(band.median),
                    "low": packed(band.low),
                    "high": packed(band.high),
                }
                for name, band in found.items()
            ]
            label_ = unit(data["error"])
            panels.append(
                _panel("error", "error, norm: median, 5 to 95 %", label_, "t (s)", lines)
            )
        sizes = {m: {o: magnitude(data, m, o) for o in observers} for m in every}
        shares = packed(100.0 * SHARES)
        for metric, each in sizes.items():
            lines = [
                {"observer": o, "x": shares, "values": packed(_quantiles(x))}
                for o, x in each.items()
            ]
            title = f"{label(data[metric])} of all samples"
            about = "share of samples (%)"
            panels.append(_panel(metric, title, unit(data[metric]), about, lines))
        given = [name.removeprefix("parameter_") for name in parameters(data)]
        if parameter is not None and parameter not in given:
            raise StateError(
                f"`parameter` must be one of {', '.join(given)}, but is {parameter[:60]!r}."
            )
        if given and every:
            chosen = parameter or given[0]
            variable = data[f"parameter_{chosen}"]
            stride = slice(None, None, max(1, -(-variable.size // DOTS)))
            lines = [
                {
                    "observer": o,
                    "x": packed(variable.values[stride]),
                    "values": packed(x[stride]),
                    "dots": True,
                }
                for o, x in sizes[every[0]].items()
            ]
            about = f"{label(variable)} ({unit(variable)})".replace(" ()", "")
            title = f"{label(data[every[0]])} against {chosen}"
            first = unit(data[every[0]])
            panels.append(_panel("scatter", title, first, about, lines))
        return {
            "panels": panels,
            "table": _table(sizes, observers),
            "parameters": given,
            "samples": int(data.sizes["sample"]),
            "notes": [f"{data.sizes['sample']:,} samples", *([self.why] * bool(self.why))],
            "flags": [n for n in data.data_vars if is_flag(data[n])],
        }

    def sample(self, index: int) -> tuple[State, list[str]]:
        """A sample as a state of the simulation, but for its noise, and what of it no knob
        says.

        **Raises:** [`StateError`][] for one that is not there, or cannot be run.
        """
        if self.scene is None:
            raise StateError(self.why)
        count = int(self.dataset.sizes["sample"])
        if not 0 <= index < count:
            raise StateError(f"`sample` must be from 0 to {count - 1}, but is {index}.")
        shown = State("study")
        known = {knob.key: knob for knob in self.scene.knobs(shown)}
        values: dict[str, float | str] = {}
        left = []
        for name, where, relative in _places(self.content):
            value = float(self.dataset[f"parameter_{name}"][index])
            key = _key(where, relative)
            knob = known.get(key)
            if knob is None:
                left.append(f"{name} = {value:.4g}")
                continue
            if key.startswith("error."):
                value -= 1.0
            elif relative:
                value *= float(knob.default)
            low = 0.0 if knob.scale == "zero-log" else knob.low
            values[key] = within = float(np.clip(value, low, knob.high))
            if abs(within - value) > 1e-9 * abs(value):
                left.append(f"{name} = {value:.4g}, beyond its slider")
        return State("study", values=values), left


def _table(sizes: dict[str, Any], observers: list[str]) -> list[dict[str, Any]]:
    rows = []
    for observer in observers:
        row: dict[str, Any] = {"observer": observer}
        for metric, each in sizes.items():
            x = each[observer]
            finite = x[np.isfinite(x)]
            row[metric] = {
                "median": float(f"{np.median(finite):.4g}") if finite.size else None,
                "worst": int(np.argmax(np.where(np.isnan(x), np.inf, x))),
            }
        rows.append(row)
    return rows


def _quantiles(x: np.ndarray) -> np.ndarray:
    """The values at `SHARES` of the samples."""
    ordered = np.sort(np.where(np.isnan(x), np.inf, x))
    places = np.round(SHARES * (ordered.size - 1)).astype(int)
    return np.maximum(ordered[places], LEAST)


def _panel(
    key: str, title: str, unit_: str, about: str, lines: list[Any]
) -> dict[str, Any]:
    return {
        "id": key,
        "title": title,
        "unit": unit_,
        "about": about,
        "lines": lines,
        "wraps": False,
        "log": True,
    }


def _places(content: dict[str, Any]) -> list[tuple[str, str, bool]]:
    """Name, path and whether it is relative, of every number of a study's spread."""
    found = []
    for name, item in content.get("spread", {}).items():
        wheres = item["where"]
        single = isinstance(wheres, str)
        given = item.get("names")
        names_ = [name] if single else given or [f"{name}_{k}" for k in range(len(wheres))]
        wheres = [wheres] if single else wheres
        found += [
            (n, w, bool(item.get("relative"))) for n, w in zip(names_, wheres, strict=True)
        ]
    return found


def _key(where: str, relative: bool) -> str:
    """The knob that moves what a path of the experiment names."""
    first, _, rest = where.partition(".")
    if first == "plant" and relative:
        return f"error.{rest}"
    if first == "plant" or first == "initial":
        return f"machine.{rest}" if first == "plant" else f"machine.initial.{rest}"
    if first == "controller":
        return f"control.{rest}"
    return f"noise.{first}" if rest.endswith("deviation") else where


def _without_none(content: Any) -> Any:
    """A table as a file has it: without what is not given."""
    if isinstance(content, dict):
        return {k: _without_none(v) for k, v in content.items() if v is not None}
    return [_without_none(x) for x in content] if isinstance(content, list) else content
