"""How well a relation tells its x, on signals as the ranges of a model suggest."""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from .._filters import LowPass
from .._replay import replay
from ..observers import AlgebraicObserver
from .model import Model
from .plant import ModelPlant

SAMPLES = 2000
PERIODS = 20.0  # of the cutoff, in the record
WAVES = 4  # of an input
STRAY = 3.0  # ranges that a simulated output may be away from the middle of its own
NOISE = 1e-3  # of the range of an output
USELESS = 1e-10  # the certificate of a relation that noise of 1e-5 spoils
STEPS = 4  # of the simulation, in a sample


@dataclasses.dataclass(frozen=True)
class Certificate:
    """What a relation is worth on simulated signals.

    - `value`: the median certificate of the second half of the record, with a low-pass
      filter of `cutoff` (rad/s); `noise`: by how much of the typical size of an entry of
      the relation's x noise of a thousandth of the range on every output moves it, rms, the
      worst entry; `simulated`: whether the outputs were those of the model, or as free as
      the inputs.
    """

    value: float
    cutoff: float
    noise: float
    simulated: bool

    @property
    def useless(self) -> bool:
        """Whether noise of a hundred-thousandth of the signals is too much."""
        return not self.value > USELESS

    def __str__(self) -> str:
        word = "useless" if self.useless else "good" if self.noise < 0.1 else "sensitive"
        of = "the model's outputs" if self.simulated else "outputs as free as the inputs"
        return (
            f"certificate {self.value:.2g} at a cutoff of {self.cutoff:.4g} rad/s, on {of}; "
            f"0.1 % of noise moves an estimate by {100 * self.noise:.2g} %: {word}"
        )


def certificate(
    relation: Any, model: Model, slowest: float, cutoff: float | None, seed: int
) -> Certificate:
    """On waves within the ranges of the inputs, and the outputs that these make."""
    rng = np.random.default_rng(seed)
    if cutoff is None:
        cutoff = max(1.5 * slowest, _fastest(model))
    t = np.linspace(0.0, PERIODS / cutoff, SAMPLES)
    u = _waves(rng, model.inputs, cutoff, t)
    y = _simulated(model, t, u)
    simulated = y is not None
    if y is None:
        y = _waves(rng, model.outputs, cutoff, t)
    spans = np.array([high - low for low, high in model.outputs.values()])
    noisy = y + NOISE * spans * rng.normal(size=y.shape)
    observer = AlgebraicObserver(relation, LowPass(cutoff), guard=None)
    run = jax.vmap(lambda y: replay(observer, jnp.asarray(t), jnp.asarray(u), y))
    found = run(jnp.stack([jnp.asarray(y), jnp.asarray(noisy)]))
    late = slice(SAMPLES // 2, None)
    value = float(np.median(np.asarray(found.certificate)[0, late]))
    clean, moved = np.asarray(found.value)[:, late]
    size = np.sqrt(np.mean(clean**2, axis=0))
    change = np.sqrt(np.median((moved - clean) ** 2, axis=0))
    worst = float(np.max(change / np.maximum(size, 1e-300)))
    return Certificate(value, cutoff, worst, simulated)


def _fastest(model: Model) -> float:
    """A rate at which outputs change, by their rates over their ranges; one where no rate
    is known."""
    rng = np.random.default_rng(0)

    def points(ranges: Any) -> Float[np.ndarray, "N n"]:
        return np.array([rng.uniform(*pair, 64) for pair in ranges.values()]).reshape(-1, 64).T

    groups = [points(g) for g in (model.ranges, model.outputs, model.inputs)]
    p = jnp.asarray(model.values())
    rates = jax.vmap(lambda x, y, u: model.measured_rates(x, y, u, p))(
        *map(jnp.asarray, groups)
    )
    spans = [high - low for low, high in model.outputs.values()]
    found = [float(np.sqrt(np.mean(r**2))) / spans[k] for k, r in rates.items()]
    return max([*found, 1.0]) if found else 10.0


def _waves(rng: Any, ranges: Any, cutoff: float, t: np.ndarray) -> np.ndarray:
    """Sums of waves about the middle of the ranges, shape `(N, m)`."""
    columns = []
    for low, high in ranges.values():
        phases = 2 * np.pi * rng.random(WAVES)
        speeds = cutoff * rng.uniform(0.1, 0.7, WAVES)
        wave = np.sin(np.outer(t, speeds) + phases).sum(axis=1) / WAVES
        columns.append(0.5 * (low + high) + 0.5 * (high - low) * wave)
    return np.stack(columns, axis=1) if columns else np.zeros((t.size, 0))


def _simulated(model: Model, t: np.ndarray, u: np.ndarray) -> np.ndarray | None:
    """The outputs of the model, shape `(N, p)`; `None` where it does not give them, or they
    leave their ranges by far."""
    plant, h = ModelPlant(model), float(t[1] - t[0]) / STEPS
    middles = np.array([0.5 * (a + b) for a, b in model.ranges.values()])
    halves = np.array([0.5 * (b - a) for a, b in model.ranges.values()])
    count = middles.size
    start = jnp.asarray(plant.initial()).at[:count].add(0.25 * jnp.asarray(halves))

    def step(s: Any, held: Any) -> Any:
        f = lambda s: plant.vector_field(jnp.zeros(()), s, held)
        old = s
        for _ in range(STEPS):
            a = f(s)
            b = f(s + 0.5 * h * a)
            c = f(s + 0.5 * h * b)
            s = s + h / 6 * (a + 2 * b + 2 * c + f(s + h * c))
        return s, old[count:]

    try:
        y = np.asarray(jax.lax.scan(step, start, jnp.asarray(u))[1])
    except ValueError:  # a rate is missing
        return None
    low, high = np.array(list(model.outputs.values()), float).T
    away = np.abs(y - 0.5 * (low + high)) / (0.5 * (high - low))
    return y if np.isfinite(y).all() and away.max() < STRAY else None
