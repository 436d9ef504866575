"""What a report says of each metric, read from the dataset of a study."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from .. import random
from ._comparison import Comparison, Place, compare, ranking
from ._statistics import Interval, Summary, proportion, summarise

PARAMETER = "parameter_"
BOUND = "cramer_rao"


class Table(NamedTuple):
    """One metric: its `name` in the dataset, a `label` and the `unit`; the `summaries` by
    observer, the `places` of the ranking and the `comparisons` behind it; the Cramer-Rao
    `bound` on the rms over samples, or `None`; that for observers that do not know the
    parameters that are spread, `unknown`, or `None`."""

    name: str
    label: str
    unit: str
    summaries: Mapping[str, Summary]
    places: list[Place]
    comparisons: list[Comparison]
    bound: float | None
    unknown: float | None = None


def table(dataset: Any, name: str, confidence: float, seed: int = 0) -> Table:
    """The metric `name` of a dataset, over all samples and observers."""
    values = {observer: magnitude(dataset, name, observer) for observer in names(dataset)}
    comparisons = compare(values, confidence)
    bound = dataset.get(f"{BOUND}_{name}")
    return Table(
        name,
        label(dataset[name]) + _entries(dataset[name]),
        "" if _scale(dataset[name]) is not None else unit(dataset[name]),
        {o: summarise(x, confidence, random.key(seed)) for o, x in values.items()},
        ranking(values, confidence, comparisons),
        comparisons,
        None if bound is None else float(bound),
        None if bound is None else bound.attrs.get("unknown"),
    )


def metrics(dataset: Any) -> list[str]:
    """The names of the metrics that are numbers: the variables over `sample` and `observer`
    that have no `time` and are not yes or no."""
    return [name for name in _of_samples(dataset) if not is_flag(dataset[name])]


def proportions(dataset: Any, confidence: float) -> Mapping[str, Mapping[str, Interval]]:
    """How often each yes-or-no metric is true, by name and observer."""
    return {
        name: {
            str(observer): proportion(int(flags.sum()), flags.size, confidence)
            for observer in names(dataset)
            for flags in [dataset[name].sel(observer=observer).values.astype(bool)]
        }
        for name in _of_samples(dataset)
        if is_flag(dataset[name])
    }


def parameters(dataset: Any) -> list[str]:
    """The names of the variables that hold the spread parameters."""
    return [str(n) for n in dataset.data_vars if str(n).startswith(PARAMETER)]


def names(dataset: Any) -> list[str]:
    """The observers."""
    return [str(name) for name in dataset.observer.values]


def magnitude(dataset: Any, name: str, observer: str) -> Float[np.ndarray, " N"]:
    """The magnitude of a metric in each sample, the Euclidean norm over its entries where
    it has some, each over its scale where the study has one; infinite where the sample
    diverged, whatever the metric says then."""
    x = np.asarray(dataset[name].sel(observer=observer).values, float)
    if x.ndim > 1:
        x = x.reshape(x.shape[0], -1)
        # Observers may have fewer entries than others; what none of the samples fills is
        # not there, unless nothing is.
        filled = ~np.isnan(x).all(0)
        scale = _scale(dataset[name])
        x = x if scale is None else x / scale
        x = x[:, filled] if filled.any() else x
        x = np.sqrt(np.sum(x * x, 1))
    x = np.abs(x)
    if "diverged" in dataset and name != "diverged":
        flags = dataset["diverged"].sel(observer=observer).values.astype(bool)
        x = np.where(flags, np.inf, x)
    return x


def label(variable: Any) -> str:
    """How a variable is called in print."""
    return str(variable.attrs.get("long_name", variable.name)).replace("_", " ")


def unit(variable: Any) -> str:
    """The unit of a variable, empty where it has none."""
    found = str(variable.attrs.get("units", ""))
    return "" if found == "1" else found


def _of_samples(dataset: Any) -> list[str]:
    return [
        str(name)
        for name, variable in dataset.data_vars.items()
        if {"sample", "observer"} <= set(variable.dims) and "time" not in variable.dims
    ]


def _scale(variable: Any) -> Float[np.ndarray, " n"] | None:
    """What each entry of a metric is divided by."""
    found = variable.attrs.get("scale")
    return None if found is None else np.asarray(found, float)


def _entries(variable: Any) -> str:
    """What a label says of a metric that has several numbers per sample."""
    others = set(variable.dims) - {"sample", "observer"}
    several = any(variable.sizes[dimension] > 1 for dimension in others)
    if _scale(variable) is not None:
        return ", norm of the entries over their scales"
    return ", norm of the entries" if several else ""


def is_flag(variable: Any) -> bool:
    """Whether a metric says yes or no."""
    return variable.dtype == bool or variable.name == "diverged"
