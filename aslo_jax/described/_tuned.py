"""The gains of a study's file, tuned for the samples that the file describes."""

import copy
import dataclasses
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .. import random
from .._experiment import Experiment
from .._typing import Engine
from ..engines import run_batch
from ..schema._toml_text import table_of
from ..study._config import Configuration, ConfigurationError, configure
from ..study._possible import refuse_impossible
from ..study._spread import Sampler
from ..tune import Fitted, fit
from ..tune.losses import MeanSquare

SPAN = 100.0  # bounds of a gain: that many times less and more than in the file
CHANGE = 1.25  # of a value, to see which leaves of an experiment it becomes


@dataclasses.dataclass(frozen=True)
class Tuned:
    """The gains of one observer.

    - `before`, `after`: by key, `cutoff` or `cutoff.per_speed`, in the units of the file;
    - `rms_before`, `rms_after`: the root of the mean square error over fresh samples, in
      the units of the estimate (divided by the file's `scale` where it has one);
    - `less`: by which share of it the mean square error is less after than before, (low,
      high) of its 95 % interval, from the differences sample by sample; NaN where a sample
      is not finite;
    - `improved`: whether that is beyond chance, so that the new gains are worth having;
    - `fitted`: how the search went.
    """

    before: dict[str, float]
    after: dict[str, float]
    rms_before: float
    rms_after: float
    less: tuple[float, float]
    improved: bool
    fitted: Fitted


def tune_study(
    content: Mapping[str, Any],
    gains: Sequence[str] = (),
    *,
    samples: int = 128,
    seed: int = 0,
    iterations: int = 40,
    after: float = 0.0,
    engine: Engine = "auto",
    threads: int | None = None,
    progress: Callable[[str], None] = lambda name: None,
    folder: Path = Path(),
) -> dict[str, Tuned]:
    """Tune the gains of every observer of a study's file, each on its own.

    - `content`: the file, as TOML gives it;
    - `gains`: `"NAME.key"` of those to tune, `"NAME.cutoff.low"` of a rate that follows the
      speed; by default every number of an observer that is a parameter of it as it stands,
      and `per_speed` of such rates;
    - `samples`: of the file's spread, drawn with `seed`, the same at every iteration; as
      many fresh ones judge the result;
    - `iterations`: of [`fit`][] at most; `after` (s): from when on errors count;
    - `progress(name)`: called before each observer;
    - `engine`, `threads`: of [`aslo_jax.run_batch`][];
    - `folder`: where the file lies, beside which it may name Python.

    The loss is the mean square error over time and samples.

    **Raises:** `ValueError` for a gain that is not there, or cannot be tuned by gradients,
    being no parameter of the observer but one of its design.
    """
    configuration = configure(content, folder)
    if not isinstance(configuration.experiment, Experiment):
        raise ConfigurationError(
            '`time` must be "sampled" for gains to be tuned, but is "continuous", where '
            "the fused engine has no derivatives."
        )
    keys = _keys(content, configuration, gains, folder)
    found = {}
    for name, named in keys.items():
        progress(name)
        found[name] = _tuned(
            configuration, content, name, named, samples, seed, iterations, after,
            engine, threads,
        )  # fmt: skip
    return found


def changed(
    content: Mapping[str, Any], values: Mapping[str, Mapping[str, Any]]
) -> dict[str, Any]:
    """The `content` of a file with new `values`, by table and key."""
    new = copy.deepcopy(dict(content))
    for table, items in values.items():
        table_of(new, table).update(items)
    return new


def by_table(name: str, values: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """New `values` of the observer `name` by their keys, by table of the file and key."""
    found: dict[str, dict[str, Any]] = {}
    for key, value in values.items():
        inner, _, last = key.rpartition(".")
        table = f"observers.{name}.{inner}" if inner else f"observers.{name}"
        found.setdefault(table, {})[last] = value
    return found


def _numbers(table: Mapping[str, Any], *, every: bool) -> dict[str, float]:
    """The numbers of an observer's table by key, with those of its rates that follow the
    speed: all of them, or `per_speed` alone."""
    found = {}
    for key, value in table.items():
        if _is_number(value):
            found[key] = value
        elif isinstance(value, Mapping):
            own = value if every else {k: v for k, v in value.items() if k == "per_speed"}
            found |= {f"{key}.{k}": v for k, v in own.items() if _is_number(v)}
    return found


def _bounds(key: str, numbers: Mapping[str, float]) -> tuple[float, float]:
    """Of a gain: the limits of a rate stay the right way round."""
    low, high = numbers[key] / SPAN, numbers[key] * SPAN
    rate, _, last = key.rpartition(".")
    ends = [numbers[k] for k in (f"{rate}.low", f"{rate}.high") if k in numbers]
    if last in ("low", "high") and len(ends) == 2:
        between = float(np.sqrt(np.prod(ends)))
        return (low, between) if last == "low" else (between, high)
    return low, high


def _keys(
    content: Mapping[str, Any],
    configuration: Configuration,
    gains: Sequence[str],
    folder: Path,
) -> dict[str, dict[str, list[int]]]:
    """By observer and key the places of its leaves that hold the value of the key."""
    asked: dict[str, list[str]] = {}
    numbers = {
        f"{name}.{key}": (name, key)
        for name, table in content["observers"].items()
        for key in _numbers(table, every=True)
    }
    for gain in gains:
        if gain not in numbers:
            raise ValueError(
                f"Argument `gains` must name a number of an observer, one of "
                f"{', '.join(numbers)}, but got {gain!r}."
            )
        name, key = numbers[gain]
        asked.setdefault(name, []).append(key)
    keys: dict[str, dict[str, list[int]]] = {}
    for name, table in content["observers"].items():
        if gains and name not in asked:
            continue
        for key in asked.get(name, list(_numbers(table, every=False))):
            places = _places(content, configuration, name, key, folder)
            if places:
                keys.setdefault(name, {})[key] = places
            elif gains:
                raise ValueError(
                    "Argument `gains` must name parameters of an observer, but "
                    f"{name}.{key} is one of its design, which has no gradient here; "
                    "choose it by a study."
                )
    if not keys:
        raise ValueError("The file must have an observer with a gain to be tuned.")
    return keys


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _places(
    content: Mapping[str, Any],
    configuration: Configuration,
    name: str,
    key: str,
    folder: Path,
) -> list[int]:
    """Of the leaves of an observer that are the value of a key, and no other leaf depends
    on it."""
    value = _numbers(content["observers"][name], every=True)[key]
    try:
        other = configure(changed(content, by_table(name, {key: CHANGE * value})), folder)
    except ConfigurationError:
        return []
    old, new = (
        jax.tree.leaves(c.experiment.observers[name]) for c in (configuration, other)
    )
    moved = [k for k, (a, b) in enumerate(zip(old, new, strict=True)) if np.any(a != b)]
    right = [np.all(old[k] == value) and np.all(new[k] == CHANGE * value) for k in moved]
    return moved if all(right) else []


def _tuned(
    configuration, content, name, places, samples, seed, iterations, after, engine, threads
) -> Tuned:
    loop = _alone(configuration, name)
    sampler = Sampler(loop, configuration.spread, seed, 2 * samples)
    refuse_impossible(sampler, 2 * samples)
    both = sampler(np.arange(2 * samples), sampler.values(0, 2 * samples))
    halves = [jax.tree.map(lambda x, k=k: x[k * samples :][:samples], both) for k in (0, 1)]
    key = random.key(seed)
    scale = 1.0 if configuration.scale is None else configuration.scale
    metrics = {"cost": MeanSquare(name, after, scale)}

    def costs(gains: dict[str, Float[Array, ""]], at: Array) -> Float[Array, " samples"]:
        # Training samples at the key of the search, fresh ones at any other.
        first = jnp.all(at == key)
        batch = jax.tree.map(lambda a, b: jnp.where(first, a, b), *halves)
        wide = jax.tree.map(lambda g: jnp.broadcast_to(g, (samples,)), gains)

        def make(sample):
            return _placed(sampler.make(sample[0]), name, places, sample[1])

        found = run_batch(
            make, (batch, wide), configuration.steps, metrics=metrics, engine=engine,
            threads=threads,
        )  # fmt: skip
        return found.metrics["cost"]

    loss = lambda gains, at: jnp.mean(costs(gains, at))
    numbers = _numbers(content["observers"][name], every=True)
    before = {k: float(numbers[k]) for k in places}
    start = {k: jnp.asarray(v) for k, v in before.items()}
    fitted = fit(
        start,
        loss,
        where=lambda gains: [gains[k] for k in before],
        key=key,
        bounds=[_bounds(k, numbers) for k in before],
        iterations=iterations,
        mode="forward",
    )
    fresh, judged = random.fold(key, 1), jax.jit(costs)
    old, new = (np.asarray(judged(gains, fresh)) for gains in (start, fitted.tree))
    less, improved = compared(old, new)
    return Tuned(
        before,
        {k: float(v) for k, v in zip(before, fitted.parameters, strict=True)},
        float(np.sqrt(np.mean(old))),
        float(np.sqrt(np.mean(new))),
        less,
        improved,
        fitted,
    )


def compared(
    before: Float[np.ndarray, " n"], after: Float[np.ndarray, " n"]
) -> tuple[tuple[float, float], bool]:
    """The 95 % interval of the share by which a mean of costs is less after a change, and
    whether it is beyond chance.

    - `before`, `after`, shape `(n,)`: the costs of the same samples.

    Student's interval of the mean of paired differences. Samples that were not finite
    before, and all are after, are an improvement whatever the numbers."""
    import scipy.stats  # heavy to import, and needed here only

    nothing = (np.nan, np.nan)
    if not np.isfinite(after).all():
        return nothing, False
    if not np.isfinite(before).all():
        return nothing, True
    if before.size < 2 or not np.mean(before) > 0:
        return nothing, False
    less = (before - after) / np.mean(before)
    half = scipy.stats.t.ppf(0.975, less.size - 1) * scipy.stats.sem(less)
    low, high = float(np.mean(less) - half), float(np.mean(less) + half)
    return (low, high), low > 0


def _alone(configuration: Configuration, name: str) -> Experiment:
    """The experiment with one observer, unless the spread reaches for others."""
    loop = configuration.experiment
    assert isinstance(loop, Experiment)
    wheres = [p.where for p in configuration.spread.parameters.values()]
    if any("observers" in str(where) for where in wheres):
        return loop
    only = {name: loop.observers[name]}
    return eqx.tree_at(lambda e: e.observers, loop, only, is_leaf=lambda x: x is None)


def _placed(
    loop: Any, name: str, places: Mapping[str, list[int]], gains: Mapping[str, Any]
) -> Experiment:
    leaves, tree = jax.tree.flatten(loop.observers[name])
    for key, found in places.items():
        for k in found:
            like = jnp.asarray(leaves[k])
            leaves[k] = jnp.broadcast_to(gains[key].astype(like.dtype), like.shape)
    observers = loop.observers | {name: jax.tree.unflatten(tree, leaves)}
    return eqx.tree_at(lambda e: e.observers, loop, observers)
