"""The runs: search, judgement, wrong parameters, many starts, bounds."""

import functools
import math
from typing import Any

from .contenders import Contender, contenders
from .regimes import AFTER, INTERVAL, STEPS, experiment, samples
from .summary import summary

SIZE = 0.2086  # Wb
ROUNDS, TRIALS = 4, 16
TRAINING, VALIDATION, STARTS = range(1, 9), range(5000, 5200), range(20_000, 22_000)
ALONE = range(7000, 7020)  # for each of the wrong parameters, of who holds them
FOUND = STARTS[: len(STARTS) // 10]  # for each of the wrong parameters, of who finds them
# Relative errors of the resistance and the magnet flux that an observer is given.
WRONG = (
    (0.05, 0.0),
    (-0.05, 0.0),
    (0.2, 0.0),
    (-0.2, 0.0),
    (0.0, 0.03),
    (0.0, -0.03),
    (0.2, 0.03),
    (0.2, -0.03),
    (-0.2, 0.03),
    (-0.2, -0.03),
)
# What is known before of those who are wrong in this way: the root mean square.
PRIOR = {
    name: math.sqrt(sum(each[k] ** 2 for each in WRONG) / len(WRONG))
    for k, name in enumerate(("resistance", "magnet_flux"))
}
LOST, LAST = 10e-3, 0.5  # Wb and s: a failure, unflagged at the end
COVERED = 5.991  # of chi squared with two degrees of freedom, 95 %


@functools.cache
def runner(who: str) -> Any:
    """That of one observer, compiled once for all regimes and gains."""
    import jax
    import jax.numpy as jnp

    import aslo_jax as aslo
    from aslo_jax.engines import Runner
    from aslo_jax.metrics import Diverged, RMSError
    from aslo_jax.metrics._functions import Mean

    contender, true = contenders()[who], aslo.plants.PMSM.bmp0701f()
    gains = len(contender.gains)

    def make(sample):
        R, m = (1.0 + sample["wrong"][k] for k in (0, 1))
        relation = aslo.plants.FluxRelation(
            R * true.resistance, true.inductance, m * true.magnet_flux
        )
        each = [sample["gains"][k] for k in range(gains)]
        return experiment(contender.make(relation, *each), sample)

    def squared(record):
        """The squared error in units of the claimed covariance."""
        estimate = record.estimates["o"]
        (a, b), P = estimate.value - record.hidden, estimate.covariance
        square = P[1, 1] * a * a - 2.0 * P[0, 1] * a * b + P[0, 0] * b * b
        return square / (P[0, 0] * P[1, 1] - P[0, 1] ** 2)

    def lost(record):
        estimate = record.estimates["o"]
        far = jnp.sum((estimate.value - record.hidden) ** 2) > LOST**2
        return jnp.where(far & ~estimate.coasting, 1.0, 0.0)

    last = jnp.asarray(INTERVAL * STEPS - LAST)
    metrics: dict[str, Any] = {
        "rms": RMSError("o", AFTER, norm=True),
        "diverged": Diverged("o", 0.5 * SIZE, AFTER),
        "lost": Mean(lost, last),
        "flagged": Mean(lambda r: jnp.where(r.estimates["o"].coasting, 1.0, 0.0), last),
    }
    if contender.claims:
        inside = lambda record: jnp.where(squared(record) < COVERED, 1.0, 0.0)
        metrics["normalised"] = Mean(lambda record: 0.5 * squared(record), AFTER)
        metrics["covered"] = Mean(inside, AFTER)
    if contender.finds:
        holds = lambda record: jnp.where(record.estimates["o"].held, 1.0, 0.0)
        metrics["held"] = Mean(holds, last)
    one = samples("slow", range(1), [[0.0] * max(gains, 1)])
    return Runner(make, jax.tree.map(lambda x: x[0], one), STEPS, metrics=metrics)


def run(who: str, *of: Any) -> dict[str, Any]:
    import numpy as np

    return {k: np.asarray(v) for k, v in runner(who)(samples(*of)).metrics.items()}


def tuned(regime: str, who: str, contender: Contender) -> Any:
    """The gains that are best on the training seeds, shape `(1, g)`."""
    import numpy as np
    from scipy.stats import qmc

    count = len(contender.gains)
    if not count:
        return np.zeros((1, 1))
    low, high = np.log(np.array(list(contender.gains.values()))).T
    best, least = 0.5 * (low + high), math.inf
    for k in range(ROUNDS):
        half = 0.5 * (high - low) * 0.25**k
        sobol = qmc.Sobol(count, scramble=False).random(TRIALS)
        trials = np.clip(best + half * (2.0 * sobol - 1.0), low, high)
        rms = run(who, regime, TRAINING, np.exp(trials))["rms"].reshape(TRIALS, -1)
        score = np.sqrt(np.mean(np.where(np.isfinite(rms), rms, 1e6) ** 2, axis=1))
        if score.min() < least:
            best, least = trials[score.argmin()], float(score.min())
    return np.exp(best)[None]


def judged(regime: str, who: str, contender: Contender) -> dict[str, Any]:
    """Tuned on the training seeds; with exact parameters judged on others, from many
    starts, and with wrong parameters."""
    gains = tuned(regime, who, contender)
    exact = run(who, regime, VALIDATION, gains)
    if contender.finds:  # the starts are those with wrong parameters
        wrong = starts = run(who, regime, FOUND, gains, WRONG)
    else:
        wrong = run(who, regime, ALONE, gains, WRONG)
        starts = run(who, regime, STARTS, gains)
    found = summary(contender, gains, exact, starts, wrong, len(WRONG))
    found["lost"] = int((wrong["lost"] > 0).sum())
    found["engine"] = runner(who).engine
    if contender.finds:
        found["held"] = int((wrong["held"] > 0).sum())
    return found


def bounds(regime: str) -> dict[str, float]:
    """The Cramér-Rao bounds (Wb) for those who know no torque, and resistance and magnet
    flux exactly or as they are wrong; and of the resistance at the end, relative."""
    import jax.numpy as jnp
    import numpy as np

    from aslo_jax.plants._machine import MachineState
    from aslo_jax.study._bound import cramer_rao

    number = jnp.asarray
    settings: Any = dict(
        prior=MachineState(jnp.full(2, 0.2), number(100.0), number(3.0)),
        process=MachineState(jnp.zeros(2), number(1e4), number(0.0)),
    )
    make = lambda sample: experiment(None, sample)
    # Of the very runs that are judged: how much a run tells depends on where it begins.
    exact, wrong = samples(regime, VALIDATION), samples(regime, FOUND)
    known = cramer_rao(make, exact, STEPS, **settings)
    unknown = cramer_rao(make, wrong, STEPS, unknown=PRIOR, **settings)
    resistance = unknown.parameters["resistance"][:, -1]
    return {
        "known": known.rms(AFTER).value,
        "unknown": unknown.rms(AFTER).value,
        "resistance": float(np.sqrt(resistance.mean())),
    }
