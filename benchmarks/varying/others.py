"""The velocities of the leg, and the states of the magnetic bearing, in the loops of their
ready-made studies."""

import functools
import tomllib
from importlib.resources import files
from typing import Any

from .contenders import Contender, constant, observer_of, scheduled
from .search import tuned

# By the name of the study: about which rate (rad/s) is searched.
SYSTEMS = {"robotic_leg": 10.0, "magnetic_bearing": 100.0}
TRAINING, VALIDATION = (2026, 32), (4711, 200)  # seed and number of the samples


def contenders(system: str) -> dict[str, Contender]:
    every = constant(SYSTEMS[system]) | scheduled(SYSTEMS[system])
    if system == "robotic_leg":  # one unknown: no further row is needed, or weighted
        del every["two rates"], every["bank"]
    return every


@functools.cache
def _content(system: str) -> dict[str, Any]:
    text = files("aslo_jax.study") / "configs" / f"{system}.toml"
    return tomllib.loads(text.read_text("utf-8"))


def made(system: str, contender: Contender, gains: Any) -> Any:
    """The observer of a plant as the study's file has it."""
    import aslo_jax as aslo
    from aslo_jax.study._config import configure

    plant: Any = configure(_content(system)).experiment.plant
    if system == "robotic_leg":
        return aslo.velocity_observer(plant, contender.filters(plant, *gains)[0])
    flux = observer_of(contender, plant.flux_relation(), gains, guard=aslo.Guard(5e-5))
    return aslo.BearingObserver(flux, aslo.LowPass(2300.0))


@functools.cache
def _search(system: str, who: str, seed: int, count: int) -> Any:
    from ..gains import Search

    contender = contenders(system)[who]
    middle = [(low * high) ** 0.5 for low, high in contender.gains.values()]
    like = {"o": made(system, contender, middle)}
    return Search(_content(system), like, seed, count)


def errors(system: str, who: str, seed: int, count: int, gains: Any) -> Any:
    """The rms errors over the scale of the study, shape `(trials, count)`."""
    contender = contenders(system)[who]
    observers = [{"o": made(system, contender, row)} for row in gains.tolist()]
    return _search(system, who, seed, count).errors(observers)["o"]


def judged(system: str, who: str) -> dict[str, Any]:
    """Gains of the training samples, and the rms errors on others."""
    import numpy as np

    contender = contenders(system)[who]
    score = lambda g: np.median(errors(system, who, *TRAINING, g), axis=1)
    gains = tuned(contender.gains, score)
    found = errors(system, who, *VALIDATION, gains)[0]
    return {
        "gains": dict(zip(contender.gains, gains[0].tolist(), strict=True)),
        "median": float(np.median(found)),
        "each": found.tolist(),
    }
