"""The report of a study: one page that stands alone, and its figures."""

import base64
import json
import pathlib
from collections.abc import Mapping, Sequence
from typing import Any

from ._extras import require
from .plot._figure import WIDTH, Figure
from .study import _formats as formats
from .study._bands import bands
from .study._sensitivity import Index
from .study._statistics import Interval
from .study._tables import (
    BOUND,
    PARAMETER,
    Table,
    label,
    metrics,
    names,
    parameters,
    proportions,
    table,
    unit,
)


def write_report(
    dataset: Any,
    folder: str | pathlib.Path,
    *,
    title: str = "",
    confidence: float = 0.95,
    influences: Mapping[str, Sequence[Index]] | None = None,
) -> pathlib.Path:
    """Write `report.html` and its figures as PNG to `folder`; returns the path of the page.

    - `dataset`: the `xarray.Dataset` of a study, from memory or a store. Metrics are read
      one at a time and trajectories in blocks of samples, so that a million samples fit;
    - `title` of the page, by default the observers' names;
    - `confidence` of every interval and test;
    - `influences`: what `influences` gives, for a table of them.

    The page needs no other file and no network. The same dataset gives the same bytes.

    **Raises:** `ValueError` for a dataset without a metric; `ImportError` naming the
    command that installs what is missing.
    """
    jinja2 = require("jinja2", "study")
    require("matplotlib", "study")
    numeric = metrics(dataset)
    if not numeric:
        raise ValueError(
            "Argument `dataset` must hold a metric, a variable over `sample` and "
            f"`observer`, but its variables are {list(map(str, dataset.data_vars))}."
        )
    folder = pathlib.Path(folder)
    seed = int(dataset.attrs.get("seed", 0))
    tables = [table(dataset, name, confidence, seed) for name in numeric]
    figures = _figures(dataset, tables)
    pictures = {figure.name: figure.render("png", "svg") for figure in figures}
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("aslo_jax.study"),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
    )
    environment.filters |= {
        name: getattr(formats, name) for name in ("number", "interval", "percent", "chance")
    }
    page = environment.get_template("report.html").render(
        title=title or f"Study of {_listed(names(dataset))}",
        samples=dataset.sizes["sample"],
        observers=names(dataset),
        level=f"{100.0 * confidence:g} %",
        tables=[_printed(table, len(names(dataset))) for table in tables],
        proportions=[
            (label(dataset[name]), rows)
            for name, rows in proportions(dataset, confidence).items()
        ],
        overrides="diverged" in dataset,
        figures={f.name: (f.caption, _embedded(pictures[f.name]["svg"])) for f in figures},
        bound=any(table.bound is not None for table in tables),
        facts=_facts(dataset),
        influences=_by_parameter(influences or {}),
        versions=_json(dataset.attrs.get("versions")) or {},
        configuration=_pretty(dataset.attrs.get("configuration")),
    )
    folder.mkdir(parents=True, exist_ok=True)
    for name, picture in pictures.items():
        _write(folder / f"{name}.png", picture["png"])
    _write(folder / "report.html", page.encode())
    return folder / "report.html"


def _figures(dataset: Any, tables: list[Table]) -> list[Figure]:
    from .plot import _studies

    caption = (
        "Each metric over the samples. Dot: median; bar: 5 to 95 %; tick: worst sample; "
        "arrow: infinite, since samples diverged or never settled."
    )
    if any(table.bound is not None for table in tables):
        caption += (
            " Dashed: Cramér-Rao bound on the rms over samples, which is the diamond."
        )
    rows = len(tables) if len(tables) == 1 else -(-len(tables) // 2)
    size = WIDTH, rows * (0.9 + 0.24 * len(names(dataset)))
    draw = lambda canvas: _studies.metrics_figure(tables, canvas)
    found = [Figure("metrics", caption, {}, draw, size, None)]
    if "error" in dataset:
        found.append(_band_figure(dataset))
    spread = {}
    for name in parameters(dataset):
        variable = dataset[name]
        if variable.ndim == 1:
            printed = label(variable).removeprefix(PARAMETER.replace("_", " "))
            units = f" ({unit(variable)})" if unit(variable) else ""
            spread[printed + units] = variable.values.astype(float)
    if spread:
        caption = "How the spread parameters are distributed over the samples."
        size = WIDTH, 0.2 + 1.55 * -(-len(spread) // min(4, max(2, len(spread))))
        draw = lambda canvas: _studies.parameters_figure(spread, canvas)
        found.append(Figure("parameters", caption, {}, draw, size, None))
    return found


def _band_figure(dataset: Any) -> Figure:
    from .plot import _studies

    found = bands(dataset["error"])
    bound = dataset[BOUND].values if BOUND in dataset else None
    settings = {"unit": unit(dataset["error"]), "bound": bound}
    draw = lambda canvas: _studies.bands(
        found, dataset.time.values, figure=canvas, **settings
    )
    dashed = "" if bound is None else " Dashed: Cramér-Rao bound on the rms over samples."
    caption = (
        "The norm of the estimation error over time. Thick line: median over the samples; "
        "band: 5 to 95 %; thin line: worst sample, where it is finite; grey: the medians "
        f"of the other observers.{dashed}"
    )
    return Figure(
        "error", caption, {}, draw, (WIDTH, 0.5 + 1.75 * -(-len(found) // 3)), None
    )


def _printed(table: Table, observers: int) -> dict[str, Any]:
    """A metric as the template prints it."""
    exponent = formats.exponent_of([s.median.value for s in table.summaries.values()])
    parts = [formats.power(exponent)] if exponent else []
    units = " ".join(parts + ([table.unit] if table.unit else []))
    return {
        "name": table.name,
        "label": table.label,
        "units": units,
        "scale": 10.0**exponent,
        "rows": [(place, table.summaries[place.observer]) for place in table.places],
        "comparisons": table.comparisons,
        "bound": table.bound,
        "verdict": _verdict(table, 10.0**exponent, units),
        "failures": any(s.failures for s in table.summaries.values()),
        "below": next(iter(table.summaries.values())).below,
    }


def _verdict(table: Table, scale: float, units: str) -> str:
    """The ranking in a sentence or two."""
    best = table.places[0]
    equal = [place.observer for place in table.places if place.rank == best.rank]
    rest = [place for place in table.places if place.rank > best.rank]
    value = formats.number(best.median.value / scale)
    median = f"{value}{'×' if scale != 1.0 else ' '}{units}".rstrip()
    ends = formats.interval(best.median, scale)
    if len(table.places) == 1:
        text = f"{best.observer} has the median {median} ({ends})."
    elif len(equal) == 1:
        text = f"{best.observer} is best, with the median {median} ({ends})."
    else:
        text = (
            f"{_listed(equal)} are best and cannot be told apart; {best.observer} has the "
            f"median {median} ({ends})."
        )
    if rest:
        text += f" {_next(rest[0].observer, rest[0].ratio, best.observer)}"
    failing = [f"{s.failures} of {o}" for o, s in table.summaries.items() if s.failures]
    if failing:
        samples = table.summaries[best.observer].samples
        text += f" Not finite in {_listed(failing)}, out of {samples} samples each."
    rms = table.summaries[best.observer].rms
    if table.bound and rms.value < float("inf"):
        ratio = Interval(*(x / table.bound for x in rms))
        text += (
            f" The rms of {best.observer} over the samples is "
            f"{formats.number(ratio.value)} times the Cramér-Rao bound "
            f"({formats.interval(ratio)})."
        )
    if table.bound and table.unknown:
        text += (
            " Without the parameters that are spread in the machine the bound is "
            f"{formats.number(table.unknown / table.bound)} times as large."
        )
    return text


def _next(observer: str, ratio: Interval, best: str) -> str:
    if ratio.value == float("inf"):
        return f"{observer}, the next, is infinitely worse in most samples."
    if ratio.value == 1.0:
        return f"{observer}, the next, is worse in some samples, not in the median one."
    return (
        f"{observer}, the next, has {formats.number(ratio.value)} times the value of "
        f"{best} in the median sample ({formats.interval(ratio)})."
    )


def _by_parameter(
    influences: Mapping[str, Sequence[Index]],
) -> dict[str, dict[str, Index]]:
    """The index of each observer, by parameter."""
    found: dict[str, dict[str, Index]] = {}
    for observer, indices in influences.items():
        for index in indices:
            found.setdefault(index.name.replace("_", " "), {})[observer] = index
    return found


def _facts(dataset: Any) -> dict[str, str]:
    """What identifies the study."""
    attributes = dataset.attrs
    facts = {
        "samples": str(dataset.sizes["sample"]),
        "observers": ", ".join(names(dataset)),
    }
    if "steps" in attributes and "interval" in attributes:
        steps, interval = int(attributes["steps"]), float(attributes["interval"])
        facts["horizon"] = f"{steps * interval:.6g} s in {steps} steps of {interval:.6g} s"
    for name in ("seed", "engine", "design"):
        if name in attributes:
            facts[name] = str(attributes[name])
    return facts


def _listed(words: list[str]) -> str:
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}"


def _embedded(svg: bytes) -> str:
    return f"data:image/svg+xml;base64,{base64.b64encode(svg).decode()}"


def _json(text: Any) -> Any:
    try:
        return json.loads(text) if isinstance(text, str) else text
    except json.JSONDecodeError:
        return None


def _pretty(text: Any) -> str:
    found = _json(text)
    return str(text or "") if found is None else json.dumps(found, indent=2)


def _write(path: pathlib.Path, content: bytes) -> None:
    """Whole, or not at all."""
    partial = path.with_name(f".{path.name}.partial")
    partial.write_bytes(content)
    partial.replace(path)
