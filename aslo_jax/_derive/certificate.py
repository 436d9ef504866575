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

SAMPLES = 2000
PERIODS = 20.0  # of the cutoff, in the record
WAVES = 4  # of an input
STRAY = 3.0  # ranges that a simulated output may be away from the middle of its own
NOISE = 1e-3  # of the range of an output
USELESS = 1e-10  # the certificate of a relation that noise of 1e-5 spoils
STEPS = 4  # of the simulation, in a sample
NEWTON = 4  # steps to an output that an equation gives


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
            f"certificate {self.value:.2g} at a cutoff of {self.cutoff:.4g} rad/s, on "
            f"{of}; "
            f"0.1 % of noise moves an estimate by {100 * self.noise:.2g} %: {word}"
        )


def certificate(
    relation: Any, model: Model, slowest: float, cutoff: float | None, seed: int
) -> Certificate:
    """On waves within the ranges of the inputs, and the outputs that these make."""
    rng = np.random.default_rng(seed)
    if cutoff is None:
        cutoff = typical_cutoff(model, slowest)
    t = np.linspace(0.0, PERIODS / cutoff, SAMPLES)
    u = _waves(rng, model.inputs, cutoff, t)
    y = _simulated(model, t, u)
    simulated = y is not None
    if y is None:
        y = _waves(rng, model.outputs, cutoff, t)
    t, u = t[: len(y)], u[: len(y)]
    spans = np.array([high - low for low, high in model.outputs.values()])
    noisy = y + NOISE * spans * rng.normal(size=y.shape)
    observer = AlgebraicObserver(relation, LowPass(cutoff), guard=None)
    run = jax.vmap(lambda y: replay(observer, jnp.asarray(t), jnp.asarray(u), y))
    found = run(jnp.stack([jnp.asarray(y), jnp.asarray(noisy)]))
    late = slice(len(y) // 2, None)
    value = float(np.median(np.asarray(found.certificate)[0, late]))
    clean, moved = np.asarray(found.value)[:, late]
    size = np.sqrt(np.mean(clean**2, axis=0))
    change = np.sqrt(np.median((moved - clean) ** 2, axis=0))
    worst = float(np.max(change / np.maximum(size, 1e-300)))
    return Certificate(value, cutoff, worst, simulated)


def typical_cutoff(model: Model, slowest: float) -> float:
    """A cutoff (rad/s) where no log says more: above `slowest`, and as fast as outputs
    change on the ranges of the model."""
    return max(1.5 * slowest, _fastest(model))


def _fastest(model: Model) -> float:
    """A rate at which outputs change, or where none of these is known states: that of each
    over its range, rms, the largest."""
    rng = np.random.default_rng(0)

    def points(ranges: Any) -> Float[np.ndarray, "N n"]:
        drawn = [rng.uniform(low, high, 64) for low, high in ranges.values()]
        return np.array(drawn).reshape(-1, 64).T

    groups = [points(g) for g in (model.ranges, model.outputs, model.inputs)]
    p = jnp.asarray(model.values())
    signals = tuple(map(jnp.asarray, groups))
    rates = jax.vmap(lambda x, y, u: model.measured_rates(x, y, u, p))(*signals)
    ranges = list(model.outputs.values())
    if not rates:
        rates = dict(enumerate(jax.vmap(lambda x, y, u: model.rates(x, y, u, p))(*signals)))
        ranges = list(model.ranges.values())
    spans = [high - low for low, high in ranges]
    return max(float(np.sqrt(np.mean(r**2))) / spans[k] for k, r in rates.items())


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
    """The outputs of the model, shape `(K, p)`, until they or the states leave their ranges
    by far; `None` where the model does not give them."""
    n, h = len(model.ranges), float(t[1] - t[0]) / STEPS
    p = jnp.asarray(model.values())
    ranges = [*model.ranges.values(), *model.outputs.values()]
    low, high = np.array(ranges, float).T
    middle, half = jnp.asarray(0.5 * (low + high)), jnp.asarray(0.5 * (high - low))
    moving = tuple(jax.eval_shape(model.measured_rates, *_split(middle, u[0], n), p))
    fixed = jnp.array([k for k in range(high.size - n) if k not in moving], int)
    given = jnp.stack([*model.equations(*_split(middle, u[0], n), p), jnp.zeros(())])
    if fixed.size > given.size - 1:
        return None

    def consistent(s: Any, held: Any) -> Any:
        """With the outputs that have no rate from the equations."""
        if not fixed.size:
            return s
        x, y, held = _split(s, held, n)
        for _ in range(NEWTON):
            h = lambda v, y=y: jnp.stack(model.equations(x, y.at[fixed].set(v), held, p))
            slope = jax.jacfwd(h)(y[fixed])
            y = y.at[fixed].add(-jnp.linalg.lstsq(slope, h(y[fixed]))[0])
        return jnp.concatenate([x, y])

    def slope(s: Any, held: Any) -> Any:
        signals = *_split(consistent(s, held), held, n), p
        rates = model.measured_rates(*signals)
        zero = jnp.zeros(())
        outputs = [rates.get(k, zero) for k in range(high.size - n)]
        return jnp.stack([*model.rates(*signals), *outputs])

    def step(s: Any, held: Any) -> Any:
        f = lambda s: slope(s, held)
        old = consistent(s, held)
        for _ in range(STEPS):
            a = f(s)
            b = f(s + 0.5 * h * a)
            c = f(s + 0.5 * h * b)
            s = s + h / 6 * (a + 2 * b + 2 * c + f(s + h * c))
        return s, old

    start = middle.at[:n].add(0.25 * half[:n])
    _, s = jax.lax.scan(step, start, jnp.asarray(u))
    away = jnp.abs(s - middle) / half
    good = np.asarray(jnp.all(jnp.isfinite(s) & (away < STRAY), axis=1))
    count = int(np.argmin(good)) if not good.all() else good.size
    return np.asarray(s)[:count, n:] if count > SAMPLES // 10 else None


def _split(s: Any, u: Any, n: int) -> tuple[Any, Any, Any]:
    return s[:n], s[n:], jnp.asarray(u)
