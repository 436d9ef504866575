"""A leg and a ball on a beam, seen by encoders of two resolutions: the loops of one sample
and the observers.

Both follow references by controllers that know the true state, so that all observers see
the same motion; 1 kHz, 4 s, of which the last three count.
"""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

INTERVAL, STEPS, AFTER = 1e-3, 4000, 1.0  # s, intervals, s
BITS = (12, 16)
INPUT = 1e-6  # N, N m: the forces are known
# Relative errors of inertias and of friction that an observer is given.
WRONG = (
    (0.05, 0.0),
    (-0.05, 0.0),
    (0.2, 0.0),
    (-0.2, 0.0),
    (0.0, 0.3),
    (0.0, -0.3),
    (0.2, 0.3),
    (0.2, -0.3),
    (-0.2, 0.3),
    (-0.2, -0.3),
)


class Mechanism(NamedTuple):
    """A system; its controller that follows a reference of some phase; the lengths among
    its coordinates; where positions begin, and the deviations of velocities there; and
    which leaves are wrong: the first ones as inertias are, the last one is friction."""

    system: Any
    controller: Callable[[Any], Any]
    lengths: tuple[bool, ...]
    low: tuple[float, ...]
    high: tuple[float, ...]
    speed: tuple[float, ...]
    leaves: tuple[str, ...]


@functools.cache
def mechanisms() -> dict[str, Mechanism]:
    import jax.numpy as jnp

    from aslo_jax.control import BallBeamTracking, Tracking
    from aslo_jax.plants import BallBeam, RoboticLeg

    number = jnp.asarray
    leg = RoboticLeg(m1=number(2.0), m2=number(3.0), damping=number([2.0, 0.5, 0.3]))
    beam = BallBeam(length=number(1.0), damping=number([0.2, 0.4]))

    def of_leg(phase):
        def reference(t):
            return jnp.stack(
                [1.0 + 0.2 * jnp.sin(t + phase), 0.6 * jnp.sin(1.3 * t + 2.0 * phase)]
            )

        return Tracking(leg, reference, tracked=(0, 1), bandwidth=4.0)

    def of_beam(phase):
        return BallBeamTracking(beam, lambda t: 0.3 * jnp.sin(2.0 * t + phase))

    return {
        "leg": Mechanism(
            leg,
            of_leg,
            lengths=(True, False, False),
            low=(0.8, -0.5, -0.5),
            high=(1.2, 0.5, 0.5),
            speed=(0.2, 0.5, 0.5),
            leaves=("m1", "m2", "damping"),
        ),
        "ball and beam": Mechanism(
            beam,
            of_beam,
            lengths=(True, False),
            low=(-0.1, -0.1),
            high=(0.1, 0.1),
            speed=(0.1, 0.1),
            leaves=("length", "damping"),
        ),
    }


def regimes() -> dict[str, tuple[str, int]]:
    """The mechanism and the bits of each regime."""
    return {f"{name}, {bits} bits": (name, bits) for name in mechanisms() for bits in BITS}


def resolution(name: str, bits: int) -> Any:
    """The steps of the encoders: of a metre, and of a turn."""
    import numpy as np

    lengths = np.array(mechanisms()[name].lengths)
    return np.where(lengths, 1.0, 2.0 * np.pi) / 2.0**bits


def samples(
    name: str,
    seeds: Any,
    gains: Any = ((0.0,),),
    wrong: Any = ((0.0, 0.0),),
    fast: Any = 1.0,
) -> Any:
    """Every row of `gains`, shape `(trials, g)`, and every pair of `wrong` parameters, with
    every seed; the first velocities `fast` times those of the mechanism."""
    import jax.numpy as jnp
    import numpy as np

    of = mechanisms()[name]
    rng = np.random.default_rng(seeds[0])
    n = len(of.low)
    drawn = {
        "q": rng.uniform(of.low, of.high, (len(seeds), n)),
        "velocity": fast * np.array(of.speed) * rng.standard_normal((len(seeds), n)),
        "phase": rng.uniform(0.0, 2 * np.pi, len(seeds)),
    }
    rows = [(g, w) for g in np.asarray(gains) for w in np.asarray(wrong)]
    repeated = lambda x: jnp.repeat(jnp.asarray(np.array(x)), len(seeds), axis=0)
    tiled = lambda x: jnp.tile(jnp.asarray(x), (len(rows),) + (1,) * (np.ndim(x) - 1))
    return {k: tiled(x) for k, x in drawn.items()} | {
        "gains": repeated([g for g, _ in rows]),
        "wrong": repeated([w for _, w in rows]),
    }


def experiment(name: str, bits: int, observer: Any, sample: Any) -> Any:
    """The loop of a sample."""
    import dataclasses

    import jax.numpy as jnp

    import aslo_jax as aslo
    from aslo_jax.control import MechanicalFeedback
    from aslo_jax.disturbances import Quantisation
    from aslo_jax.plants import MechanicalState

    of = mechanisms()[name]
    none = (False,) * len(of.lengths)
    return aslo.Experiment(
        dataclasses.replace(of.system, angles=none),
        of.controller(sample["phase"]),
        {} if observer is None else {"o": observer},
        INTERVAL,
        feedback=lambda y, x, e: MechanicalFeedback(x.position, x.velocity),
        sensor=Quantisation(jnp.asarray(resolution(name, bits))),
        initial=MechanicalState(sample["q"], sample["velocity"]),
    )
