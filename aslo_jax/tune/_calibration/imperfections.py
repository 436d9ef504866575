"""What a supply and sensors make of a log: offsets, a gain, a dead time, a delay."""

from collections.abc import Iterator
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..._checks import real
from ...plants import MagneticBearing, Stepper
from .parameters import Parameters
from .whiten import Signals

# The phases of a star from its stationary, amplitude-invariant frame.
STAR = np.array([[1.0, 0.0], [-0.5, 0.75**0.5], [-0.5, -(0.75**0.5)]])


class Imperfections(eqx.Module):
    """The errors of a record, all of them zero (the gain one) in a perfect one. Called with
    a log it gives the signals that the machine has seen.

    - `output_offset`: what the sensors show of nothing (A), shape `(p,)`;
    - `input_offset`: what the supply gives beyond what is recorded (V), shape `(m,)`;
    - `gain`: of the supply, what it gives over what is recorded, dimensionless;
    - `dead_time`: the voltage of a phase (V) that an inverter's dead time takes away in the
      direction of its current; the whole of it above some `threshold` (A) of current,
      `tanh(i / threshold)` of it about zero;
    - `delay`: how late the inputs stand in the record (samples); a fraction is read off
      the curve through the samples (Catmull, Rom, 1974), whose slope has no jumps. Were an
      input held that turns by an angle a in a sample, this is a^2/8 of it too much at half
      a sample, and right at whole ones.
    """

    output_offset: Float[Array, " p"] = eqx.field(converter=real)
    input_offset: Float[Array, " m"] = eqx.field(converter=real)
    gain: Float[Array, ""] = eqx.field(converter=real)
    dead_time: Float[Array, ""] = eqx.field(converter=real)
    delay: Float[Array, ""] = eqx.field(converter=real)
    threshold: Float[Array, ""] = eqx.field(converter=real)
    star: bool = eqx.field(static=True)

    def __call__(self, signals: Signals) -> Signals:
        h, u, y = signals
        y = y - self.output_offset
        u = self.gain * _between(u, self.delay)[0] + self.input_offset
        if u.shape[1] == y.shape[1]:
            u = u - self.dead_time * self._direction(y)
        return Signals(h, u, y)

    def slopes(self, signals: Signals) -> Iterator[tuple[str, int, Any, Any]]:
        """Of a log, by NumPy: every field, each of its entries, and the slopes of the u and
        the y that the machine has seen in it."""
        this: Any = jax.tree.map(np.asarray, self)
        u, y = (np.asarray(x, float) for x in signals[1:])
        delayed, later = _between(u, this.delay)
        none, seen = np.zeros(u.shape), y - this.output_offset
        dead = u.shape[1] == y.shape[1]
        for j, row in enumerate(np.eye(y.shape[1])):
            moved = np.broadcast_to(-row, y.shape)
            turned = -this.dead_time * this._turned(seen, moved, 0.0) if dead else none
            yield "output_offset", j, turned, moved
        still = np.zeros(y.shape)
        for j, row in enumerate(np.eye(u.shape[1])):
            yield "input_offset", j, np.broadcast_to(row, u.shape), still
        yield "gain", 0, delayed, still
        yield "delay", 0, this.gain * later, still
        yield "dead_time", 0, -this._direction(seen) if dead else none, still
        turned = -this.dead_time * this._turned(seen, still, 1.0) if dead else none
        yield "threshold", 0, turned, still

    def _direction(self, y: Any) -> Any:
        """The direction of the currents of all phases, in the frame of the inputs."""
        xp = np if isinstance(y, np.ndarray) else jnp
        if not self.star:
            return xp.tanh(y / self.threshold)
        pairs = y.reshape(y.shape[0], -1, 2)
        phases = xp.tanh(pairs @ STAR.T / self.threshold)
        return (2.0 / 3.0 * phases @ STAR).reshape(y.shape)

    def _turned(self, y: Any, moved: Any, wider: float) -> Any:
        """How the direction changes where the currents are `moved`, and the threshold is
        `wider`."""
        shape = (y.shape[0], -1, 2) if self.star else y.shape
        y, moved = y.reshape(shape), moved.reshape(shape)
        y, moved = (y @ STAR.T, moved @ STAR.T) if self.star else (y, moved)
        change = moved / self.threshold - y * wider / self.threshold**2
        change = change * (1.0 - np.tanh(y / self.threshold) ** 2)
        return (2.0 / 3.0 * change @ STAR).reshape(len(y), -1) if self.star else change


def _between(u: Any, delay: Any) -> tuple[Any, Any]:
    """The curve through the samples `u`, `delay` samples after each, and its slope."""
    xp = np if isinstance(u, np.ndarray) and isinstance(delay, np.ndarray) else jnp
    rows, last = np.arange(u.shape[0]), u.shape[0] - 1
    # Beyond the ends the samples stay as they are: a first one that is far from the next,
    # as of a loop that begins, says nothing of what came before it.
    u = xp.concatenate([u[:1], u, u[-1:]])
    place = rows + delay
    inside = (place > 0.0) & (place < last)
    place = xp.where(inside, place, xp.where(place <= 0.0, 0.0, last))
    left = xp.clip(xp.floor(place).astype(int), 0, last - 1)
    s = (place - left)[:, None]
    before, here, there, after = (u[left + k] for k in range(4))
    outer = (1.0 - s) * before + s * after
    inner = (2.0 + 2.0 * s - 3.0 * s**2) * (1.0 - s) * here
    inner = inner + (1.0 + 4.0 * s - 3.0 * s**2) * s * there
    value = 0.5 * (inner - s * (1.0 - s) * outer)
    slope = (9.0 * s**2 - 10.0 * s) * here + (1.0 + 8.0 * s - 9.0 * s**2) * there
    slope = slope - (1.0 - 2.0 * s) * outer - s * (1.0 - s) * (after - before)
    return value, 0.5 * slope * inside[:, None]


# By the name that is asked for, the fields that are fitted.
FITS = {
    "offset": "output_offset",
    "output_offset": "output_offset",
    "input_offset": "input_offset",
    "gain": "gain",
    "dead_time": "dead_time",
    "threshold": "threshold",
    "delay": "delay",
}


class Recorded(eqx.Module):
    """A model and the errors of the record that it is compared with."""

    model: Any
    imperfections: Imperfections


def perfect(model: Any, signals: Signals) -> Imperfections:
    """No error, for a log of `model`; the threshold of a dead time is a fiftieth of the
    currents' rms."""
    m, p = signals.u.shape[1], signals.y.shape[1]
    size = np.sqrt(np.mean(np.asarray(signals.y) ** 2))
    star = m == p and m % 2 == 0 and not isinstance(model, Stepper | MagneticBearing)
    return Imperfections(
        jnp.zeros(p),
        jnp.zeros(m),
        1.0,
        0.0,
        0.0,
        max(0.02 * float(size), 1e-12),
        star,
    )


def _places(parameters: Parameters) -> dict[str, int]:
    """Where in `q` the errors of a [`Recorded`][] begin, by name."""
    leaves, structure = jax.tree.flatten(parameters.model)
    numbered = jax.tree.unflatten(structure, range(len(leaves))).imperfections
    sizes = [np.size(leaves[k]) for k in parameters.leaves]
    begins = dict(zip(parameters.leaves, np.cumsum([0, *sizes[:-1]]), strict=True))
    named = ((name, begins.get(getattr(numbered, name))) for name in vars(numbered))
    return {name: int(begin) for name, begin in named if begin is not None}


def seen(
    parameters: Parameters, signals: Signals, q: Float[np.ndarray, " k"]
) -> tuple[Signals, Float[np.ndarray, "k N m"], Float[np.ndarray, "k N p"]]:
    """What the machine has seen of a log, by NumPy, with the `parameters` of a
    [`Recorded`][] at `q`, and the slopes of u and y in q."""
    recorded: Recorded = parameters.place(np.asarray(q, float))
    numeric: Any = jax.tree.map(np.asarray, recorded.imperfections)
    h, u, y = (np.asarray(x, float) for x in signals)
    whole: Any = signals._replace(h=h, u=u, y=y)
    begins = _places(parameters)
    rate = parameters.rates(np.asarray(q, float))
    du, dy = (np.zeros((len(rate), *x.shape)) for x in whole[1:])
    if begins:
        for name, j, of_u, of_y in recorded.imperfections.slopes(whole):
            if name in begins:
                k = begins[name] + j
                du[k], dy[k] = rate[k] * of_u, rate[k] * of_y
    return numeric(whole), du, dy


class Sight:
    """What the machine has seen of a log ([`seen`][]), kept while the errors of the record
    stay as they are: a search moves the other parameters far more often."""

    def __init__(self, parameters: Parameters, signals: Signals) -> None:
        self.parameters, self.signals = parameters, signals
        errors = parameters.model.imperfections
        places = [
            begin + np.arange(np.size(getattr(errors, name)))
            for name, begin in _places(parameters).items()
        ]
        self._errors = np.concatenate([np.zeros(0, int), *places])
        self._last: tuple[bytes, Any] = b"", None

    def __call__(
        self, q: Float[np.ndarray, " k"]
    ) -> tuple[Signals, Float[np.ndarray, "k N m"], Float[np.ndarray, "k N p"]]:
        """At `q`; not to be written to."""
        key = np.asarray(q, float)[self._errors].tobytes()
        if self._last[1] is None or self._last[0] != key:
            self._last = key, seen(self.parameters, self.signals, q)
        return self._last[1]


def sizes_of(signals: Signals) -> dict[str, float]:
    """What each of the errors is counted in: the rms of a signal, or three samples."""
    u, y = (float(np.sqrt(np.mean(np.asarray(x) ** 2))) for x in (signals.u, signals.y))
    return {
        "output_offset": y,
        "input_offset": u,
        "dead_time": u,
        "delay": 3.0,
    }


def fitted(name: str) -> str:
    """The field of `Imperfections` that the name of a fit stands for."""
    if name not in FITS:
        known = ", ".join((*FITS, "encoder_offset"))
        raise ValueError(
            f"Argument `fit` (option --fit) must be of {known}, but got `{name}`."
        )
    return FITS[name]
