"""The flux of a motor over a wide range of speed, in a reversal, and from standstill."""

import functools
from typing import Any, NamedTuple

from ..quality.regimes import INTERVAL, Regime, experiment, regimes, samples
from .contenders import Contender, by_speed, constant, observer_of, scheduled
from .search import tuned

POLE_PAIRS = 5
SLOWEST, FASTEST = 2.0, 1000.0  # rad/s, electrical
SHARES = 10  # of a case, of equal duration
TRAINING, VALIDATION, BOUNDED = range(1, 5), range(5000, 5200), range(5000, 5008)


class Case(NamedTuple):
    """A motion of which what comes after `after` (s) counts; it has so many intervals."""

    regime: Regime
    after: float
    steps: int


@functools.cache
def cases() -> dict[str, Case]:
    import jax.numpy as jnp

    dwell, ramp = 2.0, 10.0
    growth = jnp.log(FASTEST / SLOWEST) / ramp

    def drive(t):
        past = jnp.clip(t - dwell, 0.0, ramp)
        return SLOWEST / POLE_PAIRS * jnp.exp(growth * past)

    load = lambda t: 0.5 + 0.0 * t
    others = regimes()
    two = round(2.0 / INTERVAL)
    # The ramp takes equal times for equal shares of the logarithm of the speed.
    return {
        "drive": Case(
            Regime(drive, load, begun=True), dwell, round((dwell + ramp) / INTERVAL)
        ),
        "reversal": Case(others["reversal"], 1.0, two),
        "standstill": Case(others["standstill to slow"], 0.4, two),
    }


def contenders() -> dict[str, Contender]:
    return constant() | scheduled() | by_speed()


@functools.cache
def runner(case: str, who: str) -> Any:
    """The mean squared error in each share of a case."""
    import jax
    import jax.numpy as jnp

    import aslo_jax as aslo
    from aslo_jax.engines import Runner
    from aslo_jax.metrics._functions import Mean

    contender, chosen = contenders()[who], cases()[case]
    among = {case: chosen.regime}
    relation = aslo.plants.PMSM.bmp0701f().flux_relation()
    width = (INTERVAL * chosen.steps - chosen.after) / SHARES

    def make(sample):
        gains = [sample["gains"][k] for k in range(len(contender.gains))]
        observer = observer_of(contender, relation, gains, guard=aslo.Guard(1e-6))
        return experiment(observer, sample, among)

    def squared(record):
        error = jnp.sum((record.estimates["o"].value - record.hidden) ** 2)
        share = jnp.clip(jnp.floor((record.t - chosen.after) / width), 0.0, SHARES - 1.0)
        return jnp.where(share == jnp.arange(SHARES), SHARES * error, 0.0)

    one = samples(case, range(1), [[1.0] * len(contender.gains)], among=among)
    return Runner(
        make,
        jax.tree.map(lambda x: x[0], one),
        chosen.steps,
        metrics={"squared": Mean(squared, chosen.after)},
    )


def squares(case: str, who: str, seeds: Any, gains: Any) -> Any:
    """The mean squared errors (Wb^2), shape `(trials, seeds, shares)`."""
    import numpy as np

    among = {case: cases()[case].regime}
    every = samples(case, seeds, gains, among=among)
    found = np.asarray(runner(case, who)(every).metrics["squared"])
    return found.reshape(len(gains), len(seeds), SHARES)


def judged(case: str, who: str) -> dict[str, Any]:
    """Gains of the training seeds, and the rms errors (Wb) of each share on others."""
    import numpy as np

    contender = contenders()[who]
    gains = tuned(
        contender.gains, lambda g: np.mean(squares(case, who, TRAINING, g), axis=(1, 2))
    )
    found = squares(case, who, VALIDATION, gains)[0]
    return {
        "gains": dict(zip(contender.gains, gains[0].tolist(), strict=True)),
        "rms": float(np.sqrt(found.mean())),
        "shares": np.sqrt(found.mean(0)).tolist(),
        "each": np.sqrt(found.mean(1)).tolist(),
    }


def bound(case: str) -> list[float]:
    """The Cramér-Rao bounds (Wb) of each share, for one who knows no torque."""
    import jax.numpy as jnp
    import numpy as np

    from aslo_jax.plants._machine import MachineState
    from aslo_jax.study._bound import cramer_rao

    chosen, number = cases()[case], jnp.asarray
    among = {case: chosen.regime}
    least = cramer_rao(
        lambda sample: experiment(None, sample, among),
        samples(case, BOUNDED, among=among),
        chosen.steps,
        prior=MachineState(jnp.full(2, 0.2), number(100.0), number(3.0)),
        process=MachineState(jnp.zeros(2), number(1e4), number(0.0)),
    )
    squared = least.norm[least.t >= chosen.after] ** 2
    return [float(np.sqrt(x.mean())) for x in np.array_split(squared, SHARES)]
