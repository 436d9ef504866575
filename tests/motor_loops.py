"""A motor under speed control, for the engines."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import aslo_jax as aslo
from aslo_jax.control import FieldOriented, MotorFeedback
from aslo_jax.disturbances import SampledNoise

MOTOR = aslo.plants.PMSM.bmp0701f()


def speed(t):
    return 20.0 + 5.0 * jnp.sin(t)


def measured(y, x, estimates):
    return MotorFeedback(y, MOTOR.pole_pairs * x.angle, x.speed)


def motor_loop(sample, noisy=False, interval=1e-4, initial=None):
    """A PMSM under speed control, its resistance and the observers' rates given."""
    resistance, rate, gain, key = sample
    motor = eqx.tree_at(lambda m: m.resistance, MOTOR, resistance)
    relation = MOTOR.flux_relation()
    flux = aslo.AlgebraicObserver(relation, aslo.LowPass(rate), guard=aslo.Guard(1e-4))
    return aslo.Experiment(
        motor,
        FieldOriented(MOTOR, speed, 2.3),
        {"flux": flux, "smooth": aslo.Asymptotic(flux, gain)},
        interval,
        feedback=measured,
        sensor=SampledNoise(0.01, interval, key) if noisy else None,
        initial=initial,
    )


def samples(count):
    keys = jax.vmap(aslo.random.key)(jnp.arange(count))
    spread = jnp.asarray(np.random.default_rng(2).uniform(0.9, 1.1, (3, count)))
    return 8.875 * spread[0], 30.0 * spread[1], 20.0 * spread[2], keys
