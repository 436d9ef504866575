"""Tune the contenders of a ready-made study alike: `python -m benchmarks.gains NAME`.

Every observer gets the same search: 24 sets of gains from a Sobol sequence, log-uniform
over a factor of 10 to either side of those in the file, then 24 over a factor of 2 about
the best. A set is judged by the median of the rms error over 64 samples, of another
seed than the study's. All sets run beside each other.
"""

import argparse
import copy
import dataclasses
import tomllib
from importlib.resources import files
from typing import Any, Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from scipy.stats import qmc

from aslo_jax.derivation import derive
from aslo_jax.engines import Runner
from aslo_jax.metrics import RMSError
from aslo_jax.observers import HighGain, ReducedLuenberger, SteadyStateKalman
from aslo_jax.plants import AbstractModelledPlant
from aslo_jax.study._config import NAMES, configure
from aslo_jax.study._spread import Sampler

GAINS = {
    "aslo": ("cutoff", "forgetting"),
    "a-aslo": ("cutoff", "gain"),
    "fo1": ("cutoff", "gain"),
    "fo2": ("gain",),
    "fo3": ("cutoff", "gain"),
    "luenberger": ("gain",),
    "kalman": ("process", "drift"),
    "high_gain": ("bandwidth",),
    "super_twisting": ("bound",),
    "filtered_derivative": ("cutoff",),
}
LINEAR = (HighGain, ReducedLuenberger, SteadyStateKalman)
BEARING = ("cutoff", "forgetting", "velocity_cutoff")
CANDIDATES, SAMPLES, SEED = 24, 64, 2_026
ABOVE = 1.05  # the slowest filter of a derived relation, for the search
# Of intensities, whose fourth root is a bandwidth, a wider search.
WIDER = {"process": 4.0, "drift": 4.0, "bound": 2.0}


def tuned(name: str) -> dict[str, dict[str, float]]:
    """The gains of every observer of the study `name`."""
    text = (files("aslo_jax.study") / "configs" / f"{name}.toml").read_text("utf-8")
    return searched(name, tomllib.loads(text))


def searched(name: str, content: dict[str, Any]) -> dict[str, dict[str, float]]:
    """The same of a study by its `content`, which is changed."""
    names = {
        observer: BEARING
        if name == "magnetic_bearing"
        else tuple(gain for gain in GAINS[table["kind"]] if gain in table)
        for observer, table in content["observers"].items()
        if table["kind"] in GAINS  # others have none
    }
    content["observers"] = {k: content["observers"][k] for k in names}
    search, floors = None, _floors(content)
    for span in (10.0, 2.0):
        candidates = {
            observer: _around(content["observers"][observer], gains, span, k, floors)
            for k, (observer, gains) in enumerate(names.items())
        }
        observers = [
            configure(_with(content, candidates, k)).experiment.observers
            for k in range(CANDIDATES)
        ]
        search = Search(content, observers[0]) if search is None else search
        found = search(observers)
        for observer, errors in found.items():
            best = int(np.argmin(errors))
            content["observers"][observer] |= candidates[observer][best]
            print(
                f"{name}, {observer}: {errors[0]:.4g} at first, {errors[best]:.4g} with "
                f"{candidates[observer][best]}",
                flush=True,
            )
    return content["observers"]


Engine = Literal["fused", "scan"]


class Search:
    """The median rms error of many sets of gains, on the same `count` samples."""

    def __init__(
        self, content: dict[str, Any], like: Any, seed: int = SEED, count: int = SAMPLES
    ):
        found = configure(content)
        rms = content["metrics"]["rms"]
        self.scale = np.ones(len(found.entries)) if found.scale is None else found.scale
        self.sampler = Sampler(found.experiment, found.spread, seed, count)
        self.samples = self.sampler(np.arange(count), self.sampler.values(0, count))
        self.count = count
        # The matrix exponential is no straight line, which the fused engine needs where
        # its matrix differs between lanes.
        slow = [name for name, observer in like.items() if _is_linear(observer)]
        fast = [name for name in like if name not in slow]
        kinds: tuple[tuple[list[str], Engine], ...] = (fast, "fused"), (slow, "scan")
        self.runners = [
            (names, self._runner(names, like, found.steps, rms["after"], engine))
            for names, engine in kinds
            if names
        ]

    def _runner(
        self,
        names: list[str],
        like: Any,
        steps: int,
        after: float,
        engine: Engine,
    ) -> Runner:
        chosen = {name: like[name] for name in names}
        _, static = eqx.partition(chosen, eqx.is_inexact_array_like)

        def make(sample):
            observers = eqx.combine(sample["observers"], static)
            experiment = self.sampler.make(sample["sample"])
            return dataclasses.replace(experiment, observers=observers)

        one = jax.tree.map(lambda x: x[0], self._lanes([chosen]))
        metrics = {name: RMSError(name, after) for name in names}
        return Runner(make, one, steps, metrics=metrics, engine=engine)

    def _lanes(self, observers: list[Any]) -> Any:
        gains = [eqx.filter(each, eqx.is_inexact_array_like) for each in observers]

        def stacked(*leaves):
            return jnp.repeat(
                jnp.stack([jnp.asarray(x) for x in leaves]), self.count, axis=0
            )

        tiled = jax.tree.map(lambda x: jnp.concatenate([x] * len(observers)), self.samples)
        return {"observers": jax.tree.map(stacked, *gains), "sample": tiled}

    def __call__(self, observers: list[Any]) -> dict[str, np.ndarray]:
        return {name: np.median(x, axis=1) for name, x in self.errors(observers).items()}

    def errors(self, observers: list[Any]) -> dict[str, np.ndarray]:
        """The rms errors of every set, shape `(sets, count)`."""
        found = {}
        for names, runner in self.runners:
            chosen = [{name: each[name] for name in names} for each in observers]
            for name, x in runner(self._lanes(chosen)).metrics.items():
                rms = np.linalg.norm(np.asarray(x) / self.scale, axis=1)
                found[name] = np.where(np.isnan(rms), np.inf, rms).reshape(-1, self.count)
        return found


def _is_linear(observer: Any) -> bool:
    found = jax.tree.leaves(observer, is_leaf=lambda x: isinstance(x, LINEAR))
    return any(isinstance(x, LINEAR) for x in found)


def _floors(content: dict[str, Any]) -> dict[str, float]:
    """What gains must be above, of a plant that is a model."""
    plant = configure(copy.deepcopy(content)).experiment.plant
    if not isinstance(plant, AbstractModelledPlant):
        return {}
    slowest = ABOVE * derive(plant).slowest
    return {"cutoff": slowest, "forgetting": slowest}


def _around(
    table: dict[str, Any],
    gains: tuple[str, ...],
    span: float,
    seed: int,
    floors: dict[str, float],
) -> list[dict[str, float]]:
    """Sets of gains about those of a table, which come first."""
    u = 2.0 * qmc.Sobol(len(gains), rng=seed).random(32)[: CANDIDATES - 1] - 1.0
    sets = [{gain: float(table[gain]) for gain in gains}]
    for point in u:
        sets.append(
            {
                gain: max(
                    float(f"{table[gain] * span ** (WIDER.get(gain, 1.0) * x):.3g}"),
                    float(f"{floors.get(gain, 0.0):.3g}"),
                )
                for gain, x in zip(gains, point, strict=True)
            }
        )
    return sets


def _with(content: dict[str, Any], candidates: Any, k: int) -> dict[str, Any]:
    content = copy.deepcopy(content)
    for observer, sets in candidates.items():
        content["observers"][observer] |= sets[k]
    return content


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("name", choices=NAMES)
    jax.config.update("jax_enable_x64", True)
    for observer, table in tuned(parser.parse_args().name).items():
        print(observer, table)
