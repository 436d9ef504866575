"""The contenders on the sampled records, their gains found by one search on one budget."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..._completions import Repeat
from ..._filters import AbstractFilter, LowPass, second_order
from ..._structure import Structure, structure_of
from ..._typing import FilterStart
from ...observers import (
    AbstractObserver,
    AlgebraicObserver,
    Asymptotic,
    CoordinateVelocity,
    ExtendedKalman,
    FilteredDerivative,
    HighGain,
    MomentumRelation,
    SideBySide,
    SuperTwisting,
    Unwrapped,
    Velocities,
    VelocityObserver,
)
from ...plants import AbstractMechanicalSystem
from .._batch import by_logs
from . import settings as s
from .records import (
    CASES,
    INSTANTS,
    VALIDATION,
    Records,
    assumed,
    wrong,
)

ROUNDS, TRIALS = 4, 8  # a search over the whole box, then about its best point
START_UP = 1.0  # s; errors are measured from here on
POSITION_NOISE = 1e-12  # intensity (m^2 s or rad^2 s), about that of 16 bits at 1 kHz
BANDWIDTH, BOUND = (0.3, 1e3), (0.1, 300.0)  # rad/s; m/s^2 or rad/s^2

Make = Callable[
    [Float[Array, " n"], AbstractMechanicalSystem, Structure, Float[Array, " n"]],
    AbstractObserver,
]


class Contender(NamedTuple):
    """`make(gains, system, form, y)` is the observer, with one gain for each coordinate, in
    `box`, which is searched in its logarithm; `y` is the first measurement. `model`:
    whether it uses the system's."""

    make: Make
    gain: str
    model: bool
    box: tuple[float, float] = BANDWIDTH


def _algebraic(
    filter: Callable[..., AbstractFilter],
    smoothed: bool = False,
    start: FilterStart = "exact",
) -> Make:
    def make(gains, system, form, y):
        parts = []
        for j, gain in enumerate(gains):
            relation = MomentumRelation(system, j, form.friction[j], form.constant[j])
            observer = AlgebraicObserver(relation, filter(gain), Repeat(), start=start)
            whole = Asymptotic(observer, gain) if smoothed else observer
            parts.append(CoordinateVelocity(whole))
        return VelocityObserver(Velocities(tuple(parts), form.stages))

    return make


class _FilteredDerivatives(AbstractObserver):
    """A [`FilteredDerivative`][] with a rate (rad/s) for each coordinate."""

    rates: Float[Array, " n"]

    def equations(self, F, u, y):
        each = [
            FilteredDerivative(LowPass(rate)).equations(F.scope(f"q{j}"), u, y[j : j + 1])
            for j, rate in enumerate(self.rates)
        ]
        value = jnp.concatenate([e.value for e in each])
        return eqx.tree_at(lambda e: e.value, each[0], value)


def _extended_kalman(gains, system, form, y):
    # The steady gain depends on the ratio of the two intensities alone, w^4 here: of a
    # double integrator, w is the natural frequency of the filter (theory, section 2).
    acceleration = POSITION_NOISE * gains**4
    return ExtendedKalman.of_mechanical(
        system, acceleration, POSITION_NOISE, 1.0, initial=y
    )


ASLO, DIFFERENTIATORS = "ASLO", ("high gain", "super-twisting", "filtered derivative")
CONTENDERS = {
    ASLO: Contender(_algebraic(LowPass), "lambda", True),
    "ASLO, paper start": Contender(_algebraic(LowPass, start="paper"), "lambda", True),
    "ASLO, second order": Contender(_algebraic(second_order), "w0", True),
    "A-ASLO": Contender(_algebraic(LowPass, smoothed=True), "lambda = gamma", True),
    "extended Kalman": Contender(_extended_kalman, "(W/V)^(1/4)", True),
    "high gain, model": Contender(
        lambda gains, system, form, y: HighGain(gains, system), "w", True
    ),
    "high gain": Contender(lambda gains, system, form, y: HighGain(gains), "w", False),
    "super-twisting": Contender(
        lambda gains, system, form, y: SuperTwisting(gains), "L", False, BOUND
    ),
    "filtered derivative": Contender(
        lambda gains, system, form, y: _FilteredDerivatives(gains), "lambda", False
    ),
}


class Tuned(NamedTuple):
    """A contender in one case: its `gains`, shape (n,), and on each record of validation
    its rms and largest error after the start-up and its last error, shape (records, n), the
    `settled` time (s) of the last error above 5 % of the largest velocity, and the errors
    of the first record, shape (N, n)."""

    gains: np.ndarray
    rms: np.ndarray
    peak: np.ndarray
    final: np.ndarray
    settled: np.ndarray
    first: np.ndarray

    @property
    def total(self) -> np.ndarray:
        """The rms error over all records, shape (n,)."""
        return np.sqrt(np.mean(self.rms**2, axis=0))


Gains = dict[str, np.ndarray]  # by contender
Replay = Callable[..., dict[str, np.ndarray]]
LATER = INSTANTS >= START_UP


def replayer(mechanism: s.Mechanism, contenders: dict[str, Contender]) -> Replay:
    """From gains of every contender, shape (lanes, n), as many systems, and u, y and true
    velocities of as many records, to the errors of each, shape (lanes, N, n). All run
    beside each other in one loop, compiled once, since there are as many trials on the
    records of training as records of validation."""
    form, angles = structure_of(mechanism.system), mechanism.system.angles

    def make(sample, y):
        gains, system = sample
        each = {k: c.make(gains[k], system, form, y) for k, c in contenders.items()}
        return Unwrapped(SideBySide(each), angles)

    values = by_logs(make, s.INTERVAL)

    def run(gains, system, u, y, velocity):
        found = values((gains, system), u, y)
        return {name: value - velocity for name, value in found.items()}

    return run


def _rms(errors) -> np.ndarray:
    return np.sqrt(np.mean(np.asarray(errors)[:, LATER] ** 2, axis=1))


def evaluate(
    run: Replay, gains: Gains, system, records: tuple[np.ndarray, ...]
) -> dict[str, np.ndarray]:
    """The rms error of each of the `gains` of every contender, shape (trials, n), over the
    given records."""
    count, trials = records[0].shape[0], len(next(iter(gains.values())))
    lanes = {name: np.repeat(each, count, axis=0) for name, each in gains.items()}
    copies = tuple(np.tile(x, (trials, 1, 1)) for x in records)
    errors = run(lanes, copied(system, trials * count), *copies)

    def over_records(error):
        rms = _rms(error).reshape(trials, count, -1)
        return np.sqrt(np.mean(rms**2, axis=1))

    return {name: over_records(error) for name, error in errors.items()}


def copied(system: AbstractMechanicalSystem, count: int) -> AbstractMechanicalSystem:
    """`count` of the same system, as one batch."""
    return jax.tree.map(lambda x: np.broadcast_to(x, (count, *x.shape)), system)


def search(
    run: Replay, boxes: dict[str, tuple[float, float]], system, training
) -> dict[str, np.ndarray]:
    """Of every contender the gain of each coordinate with the least rms error in training:
    Sobol points of its box, then as many of a box half as wide about the best of each
    coordinate, which is one of them, and so on. Only the last round counts: what is best
    in a coordinate depends on the other gains, which are then near their last values."""
    from scipy.stats import qmc

    n = training[1].shape[-1]
    ends = {name: np.log(box) for name, box in boxes.items()}
    best = {name: np.full(n, 0.5 * (low + high)) for name, (low, high) in ends.items()}
    sobol = qmc.Sobol(n, scramble=False).random(TRIALS)
    for k in range(ROUNDS):
        trials = {}
        for name, (low, high) in ends.items():
            half = 0.5 * (high - low) * 0.5**k
            trials[name] = np.clip(best[name] + half * (2.0 * sobol - 1.0), low, high)
        gains = {name: np.exp(each) for name, each in trials.items()}
        for name, rms in evaluate(run, gains, system, training).items():
            rms = np.where(np.isfinite(rms), rms, np.inf)
            best[name] = trials[name][rms.argmin(axis=0), np.arange(n)]
    return {name: np.exp(each) for name, each in best.items()}


def tune(
    mechanism: s.Mechanism,
    contenders: dict[str, Contender],
    run: Replay,
    records: Records,
) -> dict[str, dict[str, Tuned]]:
    """By case, the contenders, tuned and validated."""
    systems = [assumed(mechanism, case) for case in CASES.values()]
    boxes = {name: each.box for name, each in contenders.items()}
    gains = [
        search(run, boxes, system, training(records, i)) for i, system in enumerate(systems)
    ]
    held_out = tuple(x[:, :VALIDATION].reshape(-1, *x.shape[2:]) for x in records)
    each = [copied(system, VALIDATION) for system in systems]
    batch = jax.tree.map(lambda *x: np.concatenate(x), *each)
    found = {name: np.stack([case[name] for case in gains]) for name in contenders}
    lanes = {name: np.repeat(x, VALIDATION, axis=0) for name, x in found.items()}
    errors = run(lanes, batch, *held_out)
    largest = np.abs(held_out[2]).max(axis=(0, 1))

    def tuned(name, i):
        within = slice(i * VALIDATION, (i + 1) * VALIDATION)
        return _tuned(found[name][i], errors[name][within], largest)

    return {
        case: {name: tuned(name, i) for name in contenders} for i, case in enumerate(CASES)
    }


def training(records: Records, case: int) -> tuple[np.ndarray, ...]:
    """u, y and the true velocities of the records of training."""
    return tuple(x[case, VALIDATION:] for x in records)


def _tuned(gains, errors, largest) -> Tuned:
    size = np.abs(errors)
    last = np.where(size > 0.05 * largest, INSTANTS[:, None], 0.0).max(axis=1)
    peak, final = size[:, LATER].max(axis=1), size[:, -1]
    return Tuned(gains, _rms(errors), peak, final, last, errors[0])


class Comparison(NamedTuple):
    """The contenders on the records of one mechanism: `tuned` by case, then by contender;
    `swept`, the rms error of the ASLO at each of `RATES` in training with 16 bit, shape
    (rates, n), by what is 5 % too large in its model."""

    mechanism: s.Mechanism
    tuned: dict[str, dict[str, Tuned]]
    swept: dict[str, np.ndarray]


RATES = np.geomspace(0.5, 500.0, 3 * TRIALS)


def compare(
    mechanism: s.Mechanism, contenders: dict[str, Contender], records: Records
) -> Comparison:
    """Every contender in every case."""
    run = replayer(mechanism, contenders)
    tuned = tune(mechanism, contenders, run, records)
    off = {"nothing": {}} | {name: {name: 1} for name in mechanism.parameters}
    swept = {
        name: sweep(tuple(contenders), run, wrong(mechanism, parameters), records)
        for name, parameters in off.items()
    }
    return Comparison(mechanism, tuned, swept)


def sweep(names: Sequence[str], run: Replay, system, records: Records) -> np.ndarray:
    """The rms error of the ASLO at each of `RATES`, the same for every coordinate, shape
    (rates, n). The other contenders of the loop, by their `names`, run along."""
    plain = training(records, tuple(CASES).index("16 bit"))
    gains = np.repeat(RATES[:, None], plain[1].shape[-1], axis=1)
    pieces = [
        evaluate(run, dict.fromkeys(names, g), system, plain)[ASLO]
        for g in np.split(gains, 3)
    ]
    return np.concatenate(pieces)
