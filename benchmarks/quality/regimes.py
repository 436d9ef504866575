"""The motions in which the observers are judged, and the closed loop of one sample.

All are of one loop that is compiled once: a sample has the number of its regime. 10 mA and
0.1 V of noise on every sample at 10 kHz, 2 s, of which the second one counts.
"""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

INTERVAL, STEPS, AFTER = 1e-4, 20_000, 1.0  # s, intervals, s
CURRENT, VOLTAGE = 10e-3, 0.1  # A and V, standard deviations of a sample


class Regime(NamedTuple):
    """`speed(t)` (rad/s) and `load(t)` (N m) at time t (s). Where the motion has `begun`
    the current of the load flows from the first sample on, and else the loop begins without
    any; a begun motion whose speed changes begins anywhere between 2 and 14 s."""

    speed: Callable[[Any], Any]
    load: Callable[[Any], Any]
    begun: bool = False
    spread: bool = False


def regimes() -> dict[str, Regime]:
    import jax.numpy as jnp

    ramp = lambda t, a, b: jnp.clip((t - a) / (b - a), 0.0, 1.0)
    soft = lambda t, a, b: 1.0 - jnp.exp(-((jnp.maximum(t - a, 0.0) / b) ** 2))

    def reversal(t):
        slow = 60.0 - 59.7 * ramp(t, 1.2, 1.35) - 0.6 * ramp(t, 1.35, 1.65)
        return slow - 59.7 * ramp(t, 1.65, 1.8)

    slow = lambda t: 2.0 + 0.5 * jnp.sin(t)
    heavy = lambda t: 3.0 + 0.5 * jnp.sin(0.5 * t)
    light = lambda t: 0.5 + 0.0 * t
    return {
        "slow": Regime(slow, heavy),
        "slow, from mid-run": Regime(slow, heavy, begun=True, spread=True),
        "standstill to slow": Regime(
            lambda t: slow(t) * soft(t, 0.3, 0.3), lambda t: heavy(t) * soft(t, 0.0, 0.1)
        ),
        "75 rad/s": Regime(lambda t: 75.0 + 25.0 * jnp.sin(2.0 * t), light),
        "reversal": Regime(reversal, light),
        "constant 40 rad/s": Regime(lambda t: 40.0 + 0.0 * t, light, begun=True),
        "constant 2 rad/s": Regime(
            lambda t: 2.0 + 0.0 * t, lambda t: 3.0 + 0.0 * t, begun=True
        ),
    }


def samples(
    regime: str,
    seeds: Any,
    gains: Any = ((0.0,),),
    wrong: Any = ((0.0, 0.0),),
    among: dict[str, Regime] | None = None,
):
    """Every row of `gains`, shape `(trials, g)`, and every pair of `wrong` parameters, with
    every seed, of a regime `among` those of this module, or others."""
    import jax
    import jax.numpy as jnp
    import numpy as np

    import aslo_jax as aslo

    rng = np.random.default_rng(seeds[0])
    angle = rng.uniform(0.0, 2 * np.pi, len(seeds))
    among = regimes() if among is None else among
    which, begun = list(among).index(regime), among[regime]
    offset = rng.uniform(2.0, 14.0, len(seeds)) * begun.spread
    keys = jax.vmap(aslo.random.key)(jnp.asarray(list(seeds)))
    gains, wrong = np.asarray(gains), np.asarray(wrong)
    rows = [(g, w) for g in gains for w in wrong]
    times = len(rows)
    repeated = lambda x: jnp.repeat(jnp.asarray(np.array(x)), len(seeds), axis=0)
    tiled = lambda x: jnp.tile(jnp.asarray(x), (times,) + (1,) * (np.ndim(x) - 1))
    return {
        "gains": repeated([g for g, _ in rows]),
        "wrong": repeated([w for _, w in rows]),
        "angle": tiled(angle),
        "offset": tiled(offset),
        "key": jax.tree.map(tiled, keys),
        "regime": jnp.full(times * len(seeds), which),
        "begun": jnp.full(times * len(seeds), float(begun.begun)),
    }


@functools.cache
def _begun() -> Any:
    """The class of a controller, once its library may be imported."""
    from aslo_jax.control import AbstractController, FieldOriented
    from aslo_jax.control._field_oriented import CurrentState

    class Begun(AbstractController):
        """The `law` with its integrals as they are once a motion has `begun` (1, else 0)
        under a load of `torque` (N m)."""

        law: FieldOriented
        torque: Any
        begun: Any

        def init(self, fed):
            R = self.law.motor.resistance
            return CurrentState(self.torque, self.begun * R * fed.current)

        def vector_field(self, t, state, fed):
            return self.law.vector_field(t, state, fed)

        def __call__(self, t, state, fed):
            return self.law(t, state, fed)

    return Begun


def experiment(observer: Any, sample: Any, among: dict[str, Regime] | None = None) -> Any:
    """The closed loop of a sample, in a regime `among` those of this module, or others: its
    motor turns at an `angle` (rad) at the start."""
    import jax.numpy as jnp

    import aslo_jax as aslo
    from aslo_jax.control import FieldOriented, MotorFeedback
    from aslo_jax.disturbances import SampledNoise
    from aslo_jax.plants._machine import MachineState, direction

    every = list((regimes() if among is None else among).values())

    def chosen(which):
        def at(t):
            t = t + sample["offset"]
            values = [which(each)(t) for each in every]
            found = values[0]
            for k, value in enumerate(values):
                found = jnp.where(sample["regime"] == k, value, found)
            return found

        return at

    speed, load = chosen(lambda r: r.speed), chosen(lambda r: r.load)
    motor = aslo.plants.PMSM.bmp0701f(load=load)
    law = FieldOriented(motor, speed, 2.3, 400.0)

    n, key = motor.pole_pairs, sample["key"]
    axis = direction(n * sample["angle"])
    current = sample["begun"] * load(jnp.zeros(())) / law.torque_constant
    across = jnp.stack([-axis[1], axis[0]])
    flux = motor.magnet_flux * axis + motor.inductance * current * across
    start = jnp.asarray(speed(jnp.zeros(())), float)
    return aslo.Experiment(
        motor,
        _begun()(law, sample["begun"] * load(jnp.zeros(())), sample["begun"]),
        {} if observer is None else {"o": observer},
        INTERVAL,
        feedback=lambda y, x, e: MotorFeedback(y, n * x.angle, x.speed),
        sensor=SampledNoise(CURRENT, INTERVAL, key),
        input_sensor=SampledNoise(VOLTAGE, INTERVAL, key, 1),
        initial=MachineState(flux, start, sample["angle"]),
    )
