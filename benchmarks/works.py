"""The work of the benchmark `systems`: other plants than the motor's, each observed by an
ASLO and an A-ASLO, with parameters that differ from trajectory to trajectory."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import aslo_jax as aslo
from aslo_jax.control import BallBeamTracking, MechanicalFeedback, OpenLoop
from aslo_jax.disturbances import SampledNoise
from aslo_jax.plants import MechanicalState

from .loops import Work

RATE, GAIN = 30.0, 20.0  # rad/s, of the filters and of the A-ASLO


def _keys(count: int):
    return jax.vmap(aslo.random.fold, (None, 0))(aslo.random.key(5), jnp.arange(count))


def _sensor(noisy: bool, deviation: float, interval: float, key):
    return SampledNoise(deviation, interval, key) if noisy else None


def _pair(observer: aslo.AlgebraicObserver) -> dict[str, aslo.AbstractObserver]:
    return {"ASLO": observer, "A-ASLO": aslo.Asymptotic(observer, GAIN)}


# ---- the double integrator -----------------------------------------------------------


class Push(eqx.Module):
    """An acceleration (m/s^2) of `size` and `frequency` (rad/s)."""

    size: jax.Array
    frequency: jax.Array

    def __call__(self, t):
        return self.size * jnp.cos(self.frequency * t)


def double_integrator(sample, noisy: bool = False) -> aslo.Experiment:
    size, speed, key = sample
    plant = aslo.plants.IntegratorChain(2)
    observer = aslo.AlgebraicObserver(
        plant.relation(), aslo.LowPass(RATE), guard=aslo.Guard(1e-3)
    )
    return aslo.Experiment(
        plant,
        OpenLoop(Push(size, jnp.asarray(2.0))),
        _pair(observer),
        1e-3,
        sensor=_sensor(noisy, 1e-3, 1e-3, key),
        initial=jnp.stack([jnp.zeros_like(speed), speed]),
    )


def accelerations(count: int):
    """Size of the acceleration (m/s^2), first speed (m/s), key."""
    rng = np.random.default_rng(11)
    return rng.uniform(0.5, 1.5, count), rng.uniform(-0.2, 0.2, count), _keys(count)


# ---- the wound-rotor induction machine -----------------------------------------------


MACHINE = aslo.plants.WRIM(
    stator_resistance=1.3,
    rotor_resistance=0.7,
    stator_inductance=0.10,
    rotor_inductance=0.14,
    mutual_inductance=0.11,
    pole_pairs=2,
    inertia=0.02,
    friction=2e-3,
)


def supply(t):
    """50 V at 50 Hz."""
    return 50.0 * jnp.stack([jnp.cos(314.0 * t), jnp.sin(314.0 * t)])


def wrim(sample, noisy: bool = False) -> aslo.Experiment:
    stator, rotor, key = sample
    where: Any = lambda m: (m.stator_resistance, m.rotor_resistance)
    machine = eqx.tree_at(where, MACHINE, (stator, rotor))
    guard = aslo.Guard(1e-4)
    observers = {}
    for winding in ("stator", "rotor"):
        relation = MACHINE.flux_relation(winding)
        one = aslo.AlgebraicObserver(relation, aslo.LowPass(3.0 * RATE), guard=guard)
        observers |= {f"{winding}, {name}": o for name, o in _pair(one).items()}
    return aslo.Experiment(
        machine, OpenLoop(supply), observers, 1e-4, sensor=_sensor(noisy, 0.01, 1e-4, key)
    )


def resistances(count: int):
    """Of stator and rotor (ohm); key."""
    rng = np.random.default_rng(12)
    spread = rng.uniform(0.98, 1.02, (2, count))
    return 1.3 * spread[0], 0.7 * spread[1], _keys(count)


def both_windings(record):
    value = lambda name: jnp.concatenate(
        [record.estimates[f"{winding}, {name}"].value for winding in ("stator", "rotor")]
    )
    return jnp.stack([record.hidden, value("ASLO"), value("A-ASLO")])


# ---- the ball and beam ---------------------------------------------------------------


BEAM = aslo.plants.BallBeam(length=jnp.asarray(1.2))
FORM = aslo.structure_of(BEAM)


def roll(t):
    """The position (m) of the ball to follow."""
    return 0.3 * jnp.sin(0.5 * t)


def moving(y, x, estimates):
    return MechanicalFeedback(x.position, x.velocity)


def ball_and_beam(sample, noisy: bool = False) -> aslo.Experiment:
    length, start, key = sample
    observer = aslo.velocity_observer(BEAM, aslo.LowPass(RATE), form=FORM)
    smooth = aslo.velocity_observer(BEAM, aslo.LowPass(RATE), gain=GAIN, form=FORM)
    return aslo.Experiment(
        eqx.tree_at(lambda b: b.length, BEAM, length),
        BallBeamTracking(BEAM, roll),
        {"ASLO": observer, "A-ASLO": smooth},
        1e-3,
        feedback=moving,
        sensor=_sensor(noisy, 1e-4, 1e-3, key),
        initial=MechanicalState(
            jnp.stack([start, 0.3 + 0.0 * start]), jnp.asarray([-0.2, 0.6])
        ),
    )


def beams(count: int):
    """Length of the beam (m), first position of the ball (m), key."""
    rng = np.random.default_rng(13)
    return rng.uniform(1.15, 1.25, count), rng.uniform(0.05, 0.15, count), _keys(count)


def in_turn(record):
    names = ("ASLO", "A-ASLO")
    return jnp.stack([record.hidden, *(record.estimates[n].value for n in names)])


WORKS = {
    "double integrator": Work(double_integrator, accelerations, in_turn, 1e-3),
    "WRIM": Work(wrim, resistances, both_windings, 1e-4),
    "ball and beam": Work(ball_and_beam, beams, in_turn, 1e-3),
}
