"""The work of the benchmark `pmsm`: a PMSM under field-oriented control by its measured
angle, its flux observed by the ASLO and the A-ASLO, its resistance and its magnet flux
another in each trajectory. The same modules for every engine of the library."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import aslo_jax as aslo
from aslo_jax.control import FieldOriented, MotorFeedback
from aslo_jax.disturbances import SampledNoise

from .loops import Work

INTERVAL = 1e-4  # s
RATE, GAIN, THRESHOLD = 30.0, 20.0, 1e-4  # rad/s of F, rad/s of the A-ASLO, the guard's
CURRENT_LIMIT, VOLTAGE_LIMIT = 2.3, 300.0  # A, V
LOAD, NOISE = 0.5, 10e-3  # N m; A, standard deviation of a sample


def load(t):
    return jnp.full_like(t, LOAD)


def reference(t):
    """The speed (mechanical rad/s) to follow."""
    return 20.0 + 5.0 * jnp.sin(t)


MOTOR = aslo.plants.PMSM.bmp0701f(load=load)


def measured(y, x, estimates):
    return MotorFeedback(y, MOTOR.pole_pairs * x.angle, x.speed)


def motor(sample) -> Any:
    resistance, magnet_flux, _ = sample
    where = lambda m: (m.resistance, m.magnet_flux)
    return eqx.tree_at(where, MOTOR, (resistance, magnet_flux))


def controller() -> FieldOriented:
    return FieldOriented(MOTOR, reference, CURRENT_LIMIT, VOLTAGE_LIMIT)


def observers(
    paper: bool = False, count: int | None = None, gains: Any = (RATE, GAIN)
) -> dict[str, aslo.AbstractObserver]:
    """The ASLO and the A-ASLO, as printed if `paper`; or `count` ASLO of other filters."""
    relation, guard = MOTOR.flux_relation(), aslo.Guard(THRESHOLD)

    def algebraic(rate):
        law = aslo.LowPass(rate)
        if paper:
            return aslo.AlgebraicObserver(relation, law, aslo.Repeat(), guard, "paper")
        return aslo.AlgebraicObserver(relation, law, guard=guard)

    if count is not None:
        return {f"ASLO {k}": algebraic((1.0 + 0.1 * k) * RATE) for k in range(count)}
    rate, gain = gains
    one = algebraic(rate)
    return {"ASLO": one, "A-ASLO": aslo.Asymptotic(one, gain)}


def make(sample, noisy: bool = False, **choice: Any) -> aslo.Experiment:
    """The sampled closed loop of one sample."""
    sensor = SampledNoise(NOISE, INTERVAL, sample[2]) if noisy else None
    return aslo.Experiment(
        motor(sample),
        controller(),
        observers(**choice),
        INTERVAL,
        feedback=measured,
        sensor=sensor,
    )


def keep(record):
    """True flux and estimates, each of shape `(2,)`, one below the other."""
    names = sorted(record.estimates, key=lambda name: (len(name), name))
    return jnp.stack([record.hidden, *(record.estimates[name].value for name in names)])


def samples(count: int):
    """Resistance (ohm), magnet flux (Wb) and key of each trajectory."""
    rng = np.random.default_rng(7)
    keys = jax.vmap(aslo.random.fold, (None, 0))(aslo.random.key(3), jnp.arange(count))
    resistance = 8.875 * rng.uniform(0.9, 1.1, count)
    return resistance, 0.2086 * rng.uniform(0.95, 1.05, count), keys


LOOP = Work(make, samples, keep, INTERVAL)
