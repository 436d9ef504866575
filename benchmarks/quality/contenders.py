"""The observers, with the box of each gain that is searched."""

from collections.abc import Callable
from typing import Any, NamedTuple

from .regimes import CURRENT, INTERVAL, VOLTAGE


class Contender(NamedTuple):
    """`make(relation, *gains)` is the observer; the box of each gain is searched in its
    logarithm. `claims`: its estimate has a covariance; `finds`: and the parameters."""

    make: Callable[..., Any]
    gains: dict[str, tuple[float, float]]
    claims: bool = False
    finds: bool = False


def contenders() -> dict[str, Contender]:
    import aslo_jax as aslo

    def one(relation, rate):
        return aslo.AlgebraicObserver(relation, aslo.LowPass(rate))

    def two(relation, rate, forgetting):
        completion = aslo.LeastSquares(aslo.LowPass(forgetting))
        return aslo.AlgebraicObserver(relation, aslo.LowPass(rate), completion)

    def around(x):
        return 1e-2 * x, 1e2 * x

    rate = {"cutoff, rad/s": (0.5, 500.0)}
    kalman = {
        "voltage, V^2 s": around(VOLTAGE**2 * INTERVAL),
        "acceleration, rad^2/s^3": (1e-1, 1e7),
        "current, A^2 s": around(CURRENT**2 * INTERVAL),
    }
    return {
        "ASLO": Contender(one, rate),
        "ASLO, two rates": Contender(
            two, {"cutoff, rad/s": (0.1, 5000.0), "forgetting, rad/s": (0.3, 500.0)}
        ),
        "FO1": Contender(
            lambda relation, rate, gain: aslo.FO1(relation, aslo.LowPass(rate), gain),
            rate | {"gain, s/Wb^2": (1e-2, 1e4)},
        ),
        "EKF": Contender(
            lambda relation, v, a, c: aslo.ExtendedKalman.of_pmsm(relation, v, a, c), kalman
        ),
        "Lifted": Contender(
            lambda relation: aslo.Lifted(relation, CURRENT, VOLTAGE), {}, claims=True
        ),
        "Adaptive": Contender(
            lambda relation: aslo.Adaptive(relation, CURRENT, VOLTAGE),
            {},
            claims=True,
            finds=True,
        ),
    }
