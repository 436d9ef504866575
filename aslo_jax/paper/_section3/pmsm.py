"""The experiments of section 3.1: the surface-mounted PMSM under closed-loop control.

The controller is the field-oriented PI control of the library with the measured angle, in
continuous time. The torque has the factor 3/2 of the amplitude-invariant convention: with
the torque as printed the paper's load takes more current than its motor has.
"""

import dataclasses
from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ... import random
from ..._completions import LeastSquares
from ..._experiment import Experiment
from ..._filters import LowPass
from ..._module import Module
from ..._realise import Pass
from ..._relations import swap
from ..._simulate import Simulation, simulate
from ..._typing import FilterStart
from ...control import FieldOriented, MotorFeedback
from ...disturbances import SampledNoise
from ...observers import AbstractObserver, AlgebraicMagnet, Estimate
from ...plants import PMSM, FluxRelation, MachineState
from .._batch import batch, sampled, solved, tight
from . import settings as s
from .prescribed import PrescribedMachine

STEADY_SPEEDS = (0.0, 0.1, 1.0, 2.0, 4.0, -2.0)  # of the steady runs (rad/s)
FO1_GAINS = tuple(10.0**k for k in range(-2, 9))  # of FO1 when sampled (s/Wb^2)
PAPER = ("ASLO", "A-ASLO", "FO1", "FO2, gamma 5", "FO2, gamma 1000", "FO3")
EXACT = tuple(
    f"{name} exact, {completion}"
    for name in ("ASLO", "A-ASLO")
    for completion in ("Repeat", "least squares")
)


class Determinant(AbstractObserver):
    """Prop. 2's `Delta` (A^2) and the integral of its square (A^4 s), as a state."""

    relation: FluxRelation
    start: FilterStart

    def equations(self, F: Pass, u: Array, y: Array) -> Estimate:
        F = F.using(LowPass(s.RATE), self.start)
        row = self.relation(u, y).row(F.scope("row"))
        second = swap(F.scope("repeat1"), row)
        delta = row.r[0] * second.r[1] - row.r[1] * second.r[0]
        integral = F.state("integral", jnp.zeros_like(delta), delta**2)
        value = jnp.stack([delta, integral])
        return Estimate(value, jnp.ones_like(delta), jnp.asarray(False))


def observers(printed: s.Printed) -> dict[str, AbstractObserver]:
    """Everything that runs beside the closed loop."""
    relation, zero = s.motor().flux_relation(), np.zeros(2)
    without = FluxRelation(relation.resistance, relation.inductance)
    completions = {"Repeat": None, "least squares": LeastSquares()}
    exact = {"start": "exact"}
    return {
        "ASLO": printed.aslo(relation),
        "A-ASLO": printed.a_aslo(relation, initial=zero),
        "FO1": printed.fo1(relation),
        "FO2, gamma 5": printed.fo2(relation),
        "FO2, gamma 1000": printed.fo2(relation, s.LARGE_GAIN),
        "FO3": printed.fo3(relation),
        **{
            f"ASLO exact, {name}": printed.aslo(relation, **exact, completion=completion)
            for name, completion in completions.items()
        },
        **{
            f"A-ASLO exact, {name}": printed.a_aslo(
                relation, **exact, completion=completion
            )
            for name, completion in completions.items()
        },
        "ASLO without m": printed.aslo(without, **exact),
        "FO3 exact": printed.fo3(relation, **exact),
        "A-ASLO slow": printed.a_aslo(relation, s.SLOW, initial=zero),
        "A-ASLO fast": printed.a_aslo(relation, s.FAST, initial=zero),
        "A-ASLO fast, exact": printed.a_aslo(relation, s.FAST, initial=zero, **exact),
        "angle": AlgebraicMagnet(relation, LowPass(s.RATE)),
        "Delta": Determinant(relation, "paper"),
        "Delta exact": Determinant(relation, "exact"),
    }


def control(
    plant: PMSM, reference: Callable[[Float[Array, ""]], Float[Array, ""]]
) -> FieldOriented:
    """The PI controllers of 3.1.3."""
    return FieldOriented(plant, reference, s.CURRENT_LIMIT)


def encoder(y: Array, x: MachineState, estimates: dict) -> MotorFeedback:
    """The measured angle and speed."""
    del estimates
    return MotorFeedback(y, s.motor().pole_pairs * x.angle, x.speed)


def closed_loop(beside: dict[str, AbstractObserver], t1: float = s.SPAN) -> Simulation:
    """3.1.3: from rest, without current, at angle zero, to `t1` (s); the observers of
    `beside`, by name."""
    plant = s.motor()
    coarse = np.arange(1, round(100 * (t1 - 1.0)) + 1) * 1e-2
    ts = np.append(np.arange(1001) * 1e-3, 1.0 + coarse)
    return solved(
        lambda: simulate(
            plant,
            control(plant, s.reference),
            beside,
            t1=t1,
            ts=ts,
            feedback=encoder,
            **tight(),
        )
    )


class Turning(Module):
    """A motor with `pole_pairs` at a steady mechanical `speed` (rad/s), under a current of
    1 A on the torque axis."""

    speed: Float[Array, ""]
    pole_pairs: int = eqx.field(static=True)

    def angle(self, t: Float[Array, ""]) -> Float[Array, ""]:
        """Mechanical (rad)."""
        return self.speed * t + 0.06

    def current(self, t: Float[Array, ""]) -> Float[Array, " 2"]:
        """Of the windings (A)."""
        electrical = self.pole_pairs * self.angle(t)
        return jnp.stack([-jnp.sin(electrical), jnp.cos(electrical)])


def steady(printed: s.Printed) -> Simulation:
    """A steady current of 1 A on the torque axis at a steady speed for 8 s, batched over
    `STEADY_SPEEDS`. The exact start; the first guess is no flux."""
    plant = PMSM.bmp0701f()
    relation, n = plant.flux_relation(), plant.pole_pairs
    exact = {"start": "exact"}
    beside = {
        "Delta": Determinant(relation, "exact"),
        "Repeat": printed.aslo(relation, **exact),
        "least squares": printed.aslo(relation, **exact, completion=LeastSquares()),
    }

    def one(speed):
        motor = Turning(speed, n)
        motion = PrescribedMachine(plant, motor.angle, motor.current)
        ts = np.linspace(0.0, 8.0, 81)
        return simulate(motion, motion.voltage, beside, t1=8.0, ts=ts, **tight())

    return batch(one, jnp.array(STEADY_SPEEDS))


REVERSAL = {
    "Repeat, no guard": (s.RATE, None),
    "Repeat": (s.RATE, s.THRESHOLD),
    "least squares": (s.RATE, s.THRESHOLD),
    "least squares, lambda 50": (s.QUICK, s.THRESHOLD),
}


class Reversal(NamedTuple):
    """A reversal, per millisecond: the largest error of the flux (Wb) and the least
    certificate within it, and whether the estimate coasts at all, by observer; `speed`
    (rad/s), `delta` (A^2) at its beginning, `t` (s)."""

    t: np.ndarray
    speed: np.ndarray
    delta: np.ndarray
    error: dict[str, np.ndarray]
    certificate: dict[str, np.ndarray]
    coasting: dict[str, np.ndarray]


def reversal(printed: s.Printed) -> Reversal:
    """The speed 2 sin t in a loop sampled at 10 kHz, with noise on what everyone sees."""
    plant = s.motor()
    relation = plant.flux_relation()
    beside: dict[str, AbstractObserver] = {"Delta": Determinant(relation, "exact")}
    for name, (rate, threshold) in REVERSAL.items():
        completion = LeastSquares() if name.startswith("least") else None
        observer = printed.aslo(relation, rate, "exact", completion, threshold)
        if threshold is None:
            observer = dataclasses.replace(observer, guard=None)
        beside[name] = observer
    steps, block = round(s.REVERSAL_SPAN / s.INTERVAL), 10

    def loop(seed):
        key = random.key(seed)
        return Experiment(
            plant,
            control(plant, s.reversing),
            beside,
            s.INTERVAL,
            feedback=encoder,
            sensor=SampledNoise(s.CURRENT_NOISE, s.INTERVAL, key),
            input_sensor=SampledNoise(s.VOLTAGE_NOISE, s.INTERVAL, key, 1),
            plant_steps=2,
        )

    def kept(record):
        each = {name: record.estimates[name] for name in REVERSAL}
        size = lambda e: jnp.linalg.norm(e.value - record.hidden)
        return (
            record.t,
            record.x.speed,
            record.estimates["Delta"].value[0],
            {name: size(e) for name, e in each.items()},
            {name: e.certificate for name, e in each.items()},
            {name: jnp.asarray(e.coasting) for name, e in each.items()},
        )

    record = sampled(loop, np.array([3]), steps, kept)
    found = jax.tree.map(lambda x: x[0, :-1].reshape(-1, block), record)
    t, speed, delta, error, certificate, coasting = found
    return Reversal(
        t[:, 0],
        speed[:, 0],
        delta[:, 0],
        {name: error[name].max(axis=1) for name in REVERSAL},
        {name: certificate[name].min(axis=1) for name in REVERSAL},
        {name: coasting[name].any(axis=1) for name in REVERSAL},
    )


def fo1_growth(printed: s.Printed) -> np.ndarray:
    """FO1 in a loop sampled at 5 kHz for a second: the last error over the first one, for
    each of `FO1_GAINS`."""
    plant = s.motor()

    def loop(gain):
        observer = printed.fo1(plant.flux_relation(), gain)
        return Experiment(
            plant,
            control(plant, s.reference),
            {"FO1": observer},
            2e-4,
            feedback=encoder,
            plant_steps=4,
        )

    def error(record):
        return jnp.linalg.norm(record.estimates["FO1"].value - record.hidden)

    size = sampled(loop, np.array(FO1_GAINS), 5000, error, every=5000)
    return size[:, -1] / size[:, 0]


def current_needed(torque: float, torque_factor: float) -> float:
    """The current on the torque axis (A) that gives `torque` (N m)."""

    @jax.jit
    def each(factor):
        plant = PMSM.bmp0701f(torque_factor=factor)
        x = plant.initial()
        flux = x.flux + plant.inductance * jnp.array([0.0, 1.0])
        return plant.torque(MachineState(flux, x.speed, x.angle))

    return torque / float(each(torque_factor))
