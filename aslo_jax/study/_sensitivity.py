"""Which parameters a metric depends on: Sobol indices, and derivatives."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .. import random
from .._extras import require
from . import _statistics as statistics
from ._statistics import Interval


class Index(NamedTuple):
    """The part of a metric's variance over a spread that the parameter `name` brings about:
    `first` by itself, `total` with all that it does together with others. Rounding and
    chance can make an estimate negative."""

    name: str
    first: Interval
    total: Interval


class Slope(NamedTuple):
    """What a metric gains, to first order, when the parameter `name` grows by its standard
    deviation, in units of the metric: the `mean` over the points asked for, which keeps the
    sign, and the `rms`, which does not let opposite signs cancel."""

    name: str
    mean: Interval
    rms: Interval


def sobol_indices(
    evaluate: Callable[[Float[np.ndarray, "N d"]], Any],
    names: Sequence[str],
    base: int,
    *,
    key: random.KeyLike | None = None,
    confidence: float = 0.95,
) -> list[Index]:
    """The Sobol indices of a metric with respect to the parameters `names`, the largest
    total first, with bootstrap intervals.

    - `evaluate(u)`: the metric, shape `(N,)`, at points of the unit cube, shape `(N, d)`,
      one coordinate for each name: the quantiles of its distribution at u are the
      parameter. The same noise must be used at every point, or chance counts as a
      parameter that acts with all the others;
    - `base`: a power of two; there are `(d + 2) base` points;
    - `key`: of the points and the bootstrap, by default `jax.random.key(0)`; `confidence`:
      of the intervals, between 0 and 1.

    Parameters that are drawn together, as correlated ones are, share their variance: the
    indices are then those of the coordinates u.

    Source: Saltelli et al. 2010, doi:10.1016/j.cpc.2009.09.018, by the package SALib.

    **Raises:** `ValueError` for a metric that is not finite somewhere (take one that is, as
    the logarithm of one plus an error that is clipped), or the same everywhere.
    """
    if base < 2 or base & (base - 1):
        raise ValueError(f"Argument `base` must be a power of two, but got {base}.")
    seed = random.seed_of(key) % 2**32  # as many as SALib takes
    sample = require("SALib.sample.sobol", "study").sample
    analyze = require("SALib.analyze.sobol", "study").analyze
    d = len(names)
    problem = {"num_vars": d, "names": list(names), "bounds": [[0.0, 1.0]] * d}
    u = sample(problem, base, calc_second_order=False, seed=seed)
    # Scrambled points lie on a grid that holds zero, where quantiles may be infinite.
    metric = np.asarray(evaluate(np.clip(u, 2.0**-32, 1.0 - 2.0**-32)), float)
    _check(metric, u.shape[0])
    if np.ptp(metric) == 0.0:
        raise ValueError(
            "Argument `evaluate` must return a metric that varies, but it is "
            f"{metric[0]:.6g} everywhere."
        )
    found = analyze(
        problem, metric, calc_second_order=False, conf_level=confidence, seed=seed
    )
    parts = zip(
        names,
        _around(found["S1"], found["S1_conf"]),
        _around(found["ST"], found["ST_conf"]),
        strict=True,
    )
    return sorted((Index(*part) for part in parts), key=lambda index: -index.total.value)


def slopes(
    evaluate: Callable[[dict[str, Float[Array, " N"]]], Float[Array, " N"]],
    values: Mapping[str, Float[np.ndarray, " N"]],
    deviations: Mapping[str, float],
    *,
    key: random.KeyLike | None = None,
    confidence: float = 0.95,
) -> list[Slope]:
    """The derivative of a metric with respect to each parameter times its deviation, over
    N points, by forward differentiation, the largest rms first.

    - `evaluate(values)`: the metric of each point, shape `(N,)`, from the parameters by
      name, each of shape `(N,)`: a point must depend on its own values only. What
      [`run_batch`][] computes is of this kind, with either engine;
    - `values`: the points, drawn from the spread, say: a few dozen, since a derivative says
      more than a value; `deviations`: the standard deviation of each parameter;
    - `key`: of the bootstrap, by default `jax.random.key(0)`; `confidence`: of the
      intervals, between 0 and 1.

    **Raises:** `ValueError` for `deviations` of other names than `values`.
    """
    names = list(values)
    if set(names) != set(deviations):
        raise ValueError(
            "Argument `deviations` must have the names of `values`, "
            f"{sorted(names)}, but has {sorted(deviations)}."
        )
    points = {name: jnp.asarray(x, float) for name, x in values.items()}
    # One direction for each parameter, all lanes at once: no lane depends on another.
    size = {name: jnp.asarray(deviations[name], float) for name in names}
    directions = {
        name: size[name] * jnp.outer(jnp.arange(len(names)) == k, jnp.ones_like(x))
        for k, (name, x) in enumerate(points.items())
    }
    along = jax.vmap(lambda direction: jax.jvp(evaluate, (points,), (direction,))[1])
    found = np.asarray(along(directions))
    _check(found[0], next(iter(points.values())).size)
    table = [
        Slope(
            name,
            statistics.mean(row, confidence, key),
            statistics.rms(row, confidence, key),
        )
        for name, row in zip(names, found, strict=True)
    ]
    return sorted(table, key=lambda slope: -slope.rms.value)


def to_text(table: Sequence[Index | Slope]) -> str:
    """A table for the terminal: a line for each parameter, intervals in brackets."""
    columns = list(table[0]._fields)
    rows = [[row[0], *map(_printed, row[1:])] for row in table]
    widths = [max(map(len, column)) for column in zip(columns, *rows, strict=True)]
    lines = [
        "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True))
        for row in (columns, *rows)
    ]
    return "\n".join(line.rstrip() for line in lines)


def _printed(x: Interval) -> str:
    return f"{x.value:.3g} ({x.low:.3g} to {x.high:.3g})"


def _around(values: Any, halves: Any) -> list[Interval]:
    return [
        Interval(float(x), float(x - half), float(x + half))
        for x, half in zip(values, halves, strict=True)
    ]


def _check(metric: Float[np.ndarray, "..."], points: int) -> None:
    if metric.shape != (points,):
        raise ValueError(
            f"Argument `evaluate` must return the shape ({points},), one number for each "
            f"point, but returned {metric.shape}."
        )
    failing = int((~np.isfinite(metric)).sum())
    if failing:
        raise ValueError(
            "Argument `evaluate` must return finite numbers, but did not at "
            f"{failing} of {points} points; take a metric that diverging leaves finite."
        )
