"""Records of the sampled closed loops: encoders, noise, and what is wrong in the model."""

import dataclasses
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ... import random
from ..._experiment import Experiment
from ...disturbances import Chain, Encoder, SampledNoise
from ...plants import AbstractMechanicalSystem, MechanicalState
from .._batch import sampled
from . import settings as s


class Case(NamedTuple):
    """What the contenders are given: encoders of `bits`, white noise of a standard
    deviation of `noise` (m or rad) per sample before them, and the true parameters, or all
    of them 5 % `wrong`."""

    bits: int
    noise: float = 0.0
    wrong: bool = False


CASES = {
    "12 bit": Case(12),
    "16 bit": Case(16),
    "16 bit, noise": Case(16, noise=1e-4),
    "16 bit, 5 % wrong": Case(16, wrong=True),
}
VALIDATION, TRAINING = 16, 8  # records of each case, from first states of their own


class Records(NamedTuple):
    """`u`, `y` and the true velocities, arrays of shape (cases, records, N, ...)."""

    u: Float[np.ndarray, "cases records N m"]
    y: Float[np.ndarray, "cases records N n"]
    velocity: Float[np.ndarray, "cases records N n"]


INSTANTS = s.INTERVAL * np.arange(s.STEPS + 1)


def record(mechanism: s.Mechanism) -> Records:
    """The records of every case; those of validation come first."""
    count = VALIDATION + TRAINING
    system, angles = mechanism.system, mechanism.system.angles

    def one(sample):
        number, position, velocity, resolution, deviation = sample
        key = random.fold(random.key(4), number)
        noise = SampledNoise(deviation, s.INTERVAL, key)
        return Experiment(
            system,
            mechanism.controller(system),
            {},
            s.INTERVAL,
            feedback=s.true_feedback,
            sensor=Chain(noise, Encoder(resolution, angles)),
            initial=MechanicalState(position, velocity),
        )

    cases = CASES.values()
    each = np.arange(count), *_starts(mechanism, count)
    starts = [np.tile(x, (len(cases), *[1] * (x.ndim - 1))) for x in each]
    resolution = np.array([resolutions(mechanism, case.bits) for case in cases])
    deviation = np.array([case.noise for case in cases])
    given = [np.repeat(x, count, axis=0) for x in (resolution, deviation)]
    kept = lambda record: (record.u, record.y, record.hidden)
    found = sampled(one, (*starts, *given), s.STEPS, kept)
    return Records(*(x.reshape(len(cases), count, *x.shape[1:]) for x in found))


def resolutions(mechanism: s.Mechanism, bits: int) -> tuple[float, ...]:
    """Of the encoder of each coordinate (m or rad)."""
    return tuple(span / 2**bits for span in mechanism.ranges)


def _starts(mechanism: s.Mechanism, count: int) -> tuple[np.ndarray, np.ndarray]:
    """First positions and velocities, each of shape (count, n), in a box about the
    mechanism's own: Sobol points, the first of them left out, a corner."""
    from scipy.stats import qmc

    n = mechanism.coordinates
    # A power of two, which Sobol's sequence is balanced for.
    power = int(np.ceil(np.log2(count + 1)))
    points = qmc.Sobol(2 * n, scramble=False).random_base2(power)[1 : count + 1]
    about = 2.0 * points - 1.0
    center, spread = mechanism.start, mechanism.spread
    first = np.concatenate([center.position, center.velocity])
    box = np.concatenate([spread.position, spread.velocity])
    position, velocity = np.split(first + about * box, [n], axis=1)
    return position, velocity


def assumed(mechanism: s.Mechanism, case: Case) -> AbstractMechanicalSystem:
    """The system that the contenders take for the true one."""
    directions = mechanism.parameters if case.wrong else {}
    return wrong(mechanism, directions)


def wrong(mechanism: s.Mechanism, directions: dict[str, int]) -> AbstractMechanicalSystem:
    """The system with parameters 5 % too large (+1) or too small (-1)."""
    system = mechanism.system
    changed = {
        name: getattr(system, name) * (1.0 + s.PARAMETER_ERROR * direction)
        for name, direction in directions.items()
    }
    return dataclasses.replace(system, **changed)
