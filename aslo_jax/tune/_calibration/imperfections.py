"""What a supply and sensors make of a log: offsets, a gain, a dead time, a delay."""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..._checks import real
from ...plants import MagneticBearing, Stepper
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
        u = self.gain * _between(jnp.asarray(u), self.delay) + self.input_offset
        if u.shape[1] == y.shape[1]:
            u = u - self.dead_time * self._direction(y)
        return Signals(h, u, y)

    def _direction(self, y: Float[Array, "N p"]) -> Float[Array, "N m"]:
        """The direction of the currents of all phases, in the frame of the inputs."""
        if not self.star:
            return jnp.tanh(y / self.threshold)
        pairs = y.reshape(y.shape[0], -1, 2)
        phases = jnp.tanh(pairs @ STAR.T / self.threshold)
        return (2.0 / 3.0 * phases @ STAR).reshape(y.shape)


def _between(u: Float[Array, "N m"], delay: Float[Array, ""]) -> Float[Array, "N m"]:
    """The curve through the samples `u`, `delay` samples after each."""
    rows = jnp.arange(u.shape[0])
    place = jnp.clip(rows + delay, 0.0, rows[-1])
    left = jnp.clip(jnp.floor(place).astype(int), 0, rows.size - 2)
    s = (place - left)[:, None]
    before, after = u[jnp.maximum(left - 1, 0)], u[jnp.minimum(left + 2, rows[-1])]
    outer = (1.0 - s) * before + s * after
    inner = (2.0 + 2.0 * s - 3.0 * s**2) * (1.0 - s) * u[left]
    inner += (1.0 + 4.0 * s - 3.0 * s**2) * s * u[left + 1]
    return 0.5 * (inner - s * (1.0 - s) * outer)


# By the name that is asked for, the fields that are fitted.
FITS = {
    "offset": "output_offset",
    "output_offset": "output_offset",
    "input_offset": "input_offset",
    "gain": "gain",
    "dead_time": "dead_time",
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
        jnp.zeros(p), jnp.zeros(m), 1.0, 0.0, 0.0, max(0.02 * float(size), 1e-12), star
    )


def sizes_of(signals: Signals) -> dict[str, float]:
    """What each of the errors is counted in: the rms of a signal, or three samples."""
    u, y = (float(np.sqrt(np.mean(np.asarray(x) ** 2))) for x in (signals.u, signals.y))
    return {"output_offset": y, "input_offset": u, "dead_time": u, "delay": 3.0}


def fitted(name: str) -> str:
    """The field of [`Imperfections`][] that the name of a fit stands for."""
    if name not in FITS:
        raise ValueError(
            f"Argument `fit` (option --fit) must be of {', '.join(FITS)}, but got `{name}`."
        )
    return FITS[name]
