"""The observers of a leg and of a ball on a beam: search, judgement, wrong parameters, many
starts, bounds."""

import functools
import math
from collections.abc import Callable
from typing import Any

from .contenders import Contender
from .mechanisms import (
    AFTER,
    INPUT,
    INTERVAL,
    STEPS,
    WRONG,
    experiment,
    mechanisms,
    resolution,
    samples,
)
from .summary import summary

ROUNDS, TRIALS = 3, 16
TRAINING, VALIDATION, STARTS = range(1, 9), range(5000, 5200), range(20_000, 22_000)
FAST = 10.0  # the velocities of the starts, over those of the seeds
ALONE = range(7000, 7020)  # for each of the wrong parameters, of who holds them
BOUNDED = range(5000, 5016)
FORCE = 1.0  # N, N m: of forces in every interval that the model does not know
LOST = 0.5  # m/s and rad/s
COVERED = {2: 5.991, 3: 7.815}  # of chi squared with so many degrees of freedom, 95 %
PRIOR = [math.sqrt(sum(each[k] ** 2 for each in WRONG) / len(WRONG)) for k in (0, 1)]


def priors(name: str) -> dict[str, float]:
    """How well each leaf is known, relative."""
    *inertias, friction = mechanisms()[name].leaves
    return dict.fromkeys(inertias, PRIOR[0]) | {friction: PRIOR[1]}


def contenders(name: str, bits: int) -> dict[str, Contender]:
    """Each is made of the model that it is given, the first sample and its gains."""
    import jax.numpy as jnp
    import numpy as np

    import aslo_jax as aslo

    deviation = resolution(name, bits) / np.sqrt(12.0)
    form = aslo.structure_of(mechanisms()[name].system)
    n, leaves = len(deviation), mechanisms()[name].leaves
    rate, bound = {"cutoff, rad/s": (0.3, 300.0)}, {"bound": (0.3, 100.0)}

    def algebraic(model: Any, first: Any, rate: Any, gain: Any = None) -> Any:
        return aslo.velocity_observer(model, aslo.LowPass(rate), gain=gain, form=form)

    def kalman(model: Any, first: Any, process: Any) -> Any:
        intensity = jnp.asarray(deviation**2 * INTERVAL)
        return aslo.ExtendedKalman.of_mechanical(model, process, intensity, initial=first)

    def adaptive(model: Any, first: Any) -> Any:
        known = priors(name).items()
        deviations = tuple(share * getattr(model, leaf) for leaf, share in known)
        return aslo.AdaptiveVelocities(model, deviation, INPUT, leaves, deviations)

    return {
        "ASLO": Contender(algebraic, rate),
        "A-ASLO": Contender(algebraic, rate | {"gain, rad/s": (0.1, 300.0)}),
        "high gain": Contender(lambda model, first, rate: aslo.HighGain(rate, model), rate),
        "super-twisting": Contender(
            lambda model, first, bound: aslo.SuperTwisting(bound * jnp.ones(n)), bound
        ),
        "EKF": Contender(kalman, {"acceleration": (1e-16, 1e-2)}),
        "LiftedVelocities": Contender(
            lambda model, first: aslo.LiftedVelocities(model, deviation, INPUT),
            {},
            claims=True,
        ),
        "LiftedVelocities, forces": Contender(
            lambda model, first: aslo.LiftedVelocities(model, deviation, INPUT, FORCE),
            {},
            claims=True,
        ),
        "AdaptiveVelocities": Contender(adaptive, {}, claims=True, finds=True),
    }


def made(name: str, bits: int, make: Callable[..., Any], gains: int) -> Callable[..., Any]:
    """The loop of a sample with an observer that believes in wrong parameters."""
    import dataclasses

    import equinox as eqx
    import jax.numpy as jnp

    of = mechanisms()[name]
    *inertias, friction = of.leaves

    def loop(sample: Any) -> Any:
        off: dict[str, Any] = dict.fromkeys(inertias, sample["wrong"][0])
        # Of two masses one is too heavy and the other too light.
        off |= dict.fromkeys(inertias[1:], -sample["wrong"][0])
        off[friction] = sample["wrong"][1]
        model = dataclasses.replace(of.system, angles=(False,) * len(of.lengths))
        for leaf, share in off.items():
            at: Callable[[Any], Any] = lambda s, leaf=leaf: getattr(s, leaf)
            model = eqx.tree_at(at, model, (1.0 + share) * at(model))
        step = jnp.asarray(resolution(name, bits))
        first = jnp.round(sample["q"] / step) * step
        observer = make(model, first, *(sample["gains"][k] for k in range(gains)))
        return experiment(name, bits, observer, sample)

    return loop


@functools.cache
def runner(name: str, bits: int, who: str) -> Any:
    """That of one observer, compiled once for all samples."""
    import jax
    import jax.numpy as jnp

    from aslo_jax._small import solve_definite
    from aslo_jax.engines import Runner
    from aslo_jax.metrics import Diverged, RMSError
    from aslo_jax.metrics._functions import Final, Mean

    contender = contenders(name, bits)[who]
    n, gains = len(mechanisms()[name].lengths), len(contender.gains)

    def squared(record: Any) -> Any:
        """The squared error in units of the claimed covariance."""
        estimate = record.estimates["o"]
        error = estimate.value - record.hidden
        return jnp.sum(error * solve_definite(estimate.covariance, error)[0])

    metrics: dict[str, Any] = {
        "rms": RMSError("o", AFTER, norm=True),
        "diverged": Diverged("o", LOST, AFTER),
        "flagged": Final(lambda record: record.estimates["o"].coasting),
    }
    if contender.claims:
        inside = lambda record: jnp.where(squared(record) < COVERED[n], 1.0, 0.0)
        metrics["normalised"] = Mean(lambda record: squared(record) / n, AFTER)
        metrics["covered"] = Mean(inside, AFTER)
    if contender.finds:
        found: Callable[[Any], Any] = lambda record: record.estimates["o"].parameters
        metrics["parameters"] = Final(found)
    one = samples(name, range(1), [[0.0] * max(gains, 1)])
    make = made(name, bits, contender.make, gains)
    return Runner(make, jax.tree.map(lambda x: x[0], one), STEPS, metrics=metrics)


def run(name: str, bits: int, who: str, *of: Any, **settings: Any) -> dict[str, Any]:
    import numpy as np

    metrics = runner(name, bits, who)(samples(name, *of, **settings)).metrics
    return {k: np.asarray(v) for k, v in metrics.items()}


def tuned(name: str, bits: int, who: str, contender: Contender) -> Any:
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
        rms = run(name, bits, who, TRAINING, np.exp(trials))["rms"].reshape(TRIALS, -1)
        score = np.sqrt(np.mean(np.where(np.isfinite(rms), rms, 1e6) ** 2, axis=1))
        if score.min() < least:
            best, least = trials[score.argmin()], float(score.min())
    return np.exp(best)[None]


def judged(name: str, bits: int, who: str, contender: Contender) -> dict[str, Any]:
    """Tuned on the training seeds; with exact parameters judged on others, from many fast
    starts, and with wrong parameters."""
    import numpy as np

    gains = tuned(name, bits, who, contender)
    exact = run(name, bits, who, VALIDATION, gains)
    starts = run(name, bits, who, STARTS, gains, fast=FAST)
    seeds = VALIDATION if contender.finds else ALONE
    wrong = run(name, bits, who, seeds, gains, WRONG)
    found = summary(contender, gains, exact, starts, wrong, len(WRONG))
    found["engine"] = runner(name, bits, who).engine
    if contender.finds:
        system = mechanisms()[name].system
        leaves = [np.ravel(getattr(system, leaf)) for leaf in priors(name)]
        off = wrong["parameters"] / np.concatenate(leaves) - 1.0
        found["parameters"] = np.sqrt(np.mean(off**2, axis=0)).tolist()
    return found


def bounds(name: str, bits: int) -> dict[str, float]:
    """The Cramér-Rao bounds for those who know the parameters exactly or as they are wrong,
    for white noise of the variance of the rounding."""
    import jax.numpy as jnp

    from aslo_jax.plants import MechanicalState
    from aslo_jax.study._bound import cramer_rao

    noise = resolution(name, bits) / 12.0**0.5
    prior = MechanicalState(jnp.asarray(noise), jnp.full(len(noise), 10.0))
    make = lambda sample: experiment(name, bits, None, sample)
    each = samples(name, BOUNDED)
    known = cramer_rao(make, each, STEPS, prior=prior, noise=noise)
    unknown = cramer_rao(make, each, STEPS, prior=prior, noise=noise, unknown=priors(name))
    return {"known": known.rms(AFTER).value, "unknown": unknown.rms(AFTER).value}
