"""Observers of a relation, with the box of each gain that is searched."""

from collections.abc import Callable
from typing import Any, NamedTuple

HIGHEST = 3000.0  # rad/s, of a schedule that follows the speed


class Contender(NamedTuple):
    """`filters(relation, *gains)` are the low-pass filter of an observer and that of its
    information, the box of each gain is searched in its logarithm; `bank`: the second is
    that of a further row instead."""

    filters: Callable[..., tuple[Any, ...]]
    gains: dict[str, tuple[float, float]]
    bank: bool = False


def constant(scale: float = 1.0) -> dict[str, Contender]:
    """Rates that do not vary, about `scale` (rad/s)."""
    import aslo_jax as aslo

    one = lambda relation, rate: (aslo.LowPass(rate),) * 2
    two = lambda relation, rate, other: (aslo.LowPass(rate), aslo.LowPass(other))
    box = lambda low, high: (low * scale, high * scale)
    cutoff = {"cutoff, rad/s": box(0.3, 1000.0)}
    return {
        "one rate": Contender(one, cutoff),
        "two rates": Contender(two, cutoff | {"forgetting, rad/s": box(0.3, 1000.0)}),
        "bank": Contender(two, cutoff | {"second, rad/s": box(0.3, 1000.0)}, bank=True),
    }


def scheduled(scale: float = 1.0) -> dict[str, Contender]:
    """Rates that follow the certificate, or the time since the start."""
    from aslo_jax import LowPass
    from aslo_jax.schedules import Certified, FastStart

    def certified(relation, low, high):
        return (LowPass(Certified(low, low + high)),) * 2

    def start(relation, low, gain):
        return (LowPass(FastStart(low, high=1e4 * scale, gain=gain)),) * 2

    low = {"low, rad/s": (0.3 * scale, 1000.0 * scale)}
    return {
        "by certificate": Contender(
            certified, low | {"further, rad/s": (0.3 * scale, 1000.0 * scale)}
        ),
        "from 1/t on": Contender(start, low | {"gain": (0.1, 10.0)}),
    }


def by_speed() -> dict[str, Contender]:
    """Rates that follow the speed at which the flux of a motor's magnet turns."""
    from aslo_jax import LowPass
    from aslo_jax.schedules import PerSpeed

    def rate(relation, per_speed, low):
        vector = lambda u, y, value: value - relation.inductance * y
        return LowPass(PerSpeed(per_speed, low, low + HIGHEST, vector=vector))

    def one(relation, per_speed, low):
        return (rate(relation, per_speed, low),) * 2

    def information(relation, cutoff, per_speed, low):
        return LowPass(cutoff), rate(relation, per_speed, low)

    def both(relation, slower, per_speed, low):
        own = rate(relation, per_speed * slower, low * slower)
        return own, rate(relation, per_speed, low)

    gains = {"per speed": (0.03, 10.0), "low, rad/s": (0.3, 100.0)}
    return {
        "by speed": Contender(one, gains),
        "information by speed": Contender(
            information, {"cutoff, rad/s": (0.1, 100.0)} | gains
        ),
        "both by speed": Contender(both, {"filter, over it": (0.01, 3.0)} | gains),
    }


def observer_of(contender: Contender, relation: Any, gains: Any, **settings: Any) -> Any:
    """The algebraic observer of a `relation`."""
    import aslo_jax as aslo

    filter, further = contender.filters(relation, *gains)
    completion = (
        aslo.FilterBank((further,)) if contender.bank else aslo.LeastSquares(further)
    )
    return aslo.AlgebraicObserver(relation, filter, completion, **settings)
