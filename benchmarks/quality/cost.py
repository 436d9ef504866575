"""What a row of a log costs beside an algebraic observer: time, and operations."""

from typing import Any

from .. import timing
from .regimes import CURRENT, INTERVAL, VOLTAGE


def log(rows: int) -> tuple[Any, Any, Any]:
    """t, u and y of a motor that turns at 60 rad/s."""
    import numpy as np

    import aslo_jax as aslo

    motor = aslo.plants.PMSM.bmp0701f()
    R, L, m = (
        float(getattr(motor, k)) for k in ("resistance", "inductance", "magnet_flux")
    )
    rng = np.random.default_rng(0)
    t = INTERVAL * np.arange(rows)
    direct = np.stack([np.cos(300.0 * t), np.sin(300.0 * t)], axis=1)
    y = 2.0 * np.stack([-direct[:, 1], direct[:, 0]], axis=1)
    flux = L * y + m * direct
    mean = R * 0.5 * (y + np.roll(y, -1, axis=0))
    u = mean + (np.roll(flux, -1, axis=0) - flux) / INTERVAL
    u[-1] = u[-2]
    u = u + VOLTAGE * rng.standard_normal((rows, 2))
    return t, u, y + CURRENT * rng.standard_normal((rows, 2))


def cost(rows: int = 200_000, rounds: int = 15) -> dict[str, float]:
    """The seconds of the fused replay of a long log over those of ASLO: medians of ratios
    within a round. That of `Adaptive` begins where its bank has merged."""
    import jax

    import aslo_jax as aslo

    relation = aslo.plants.PMSM.bmp0701f().flux_relation()
    t, u, y = log(rows)
    filter, forgetting = aslo.LowPass(25.0), aslo.LeastSquares(aslo.LowPass(200.0))
    every: dict[str, Any] = {
        "ASLO": aslo.AlgebraicObserver(relation, filter),
        "ASLO, two rates": aslo.AlgebraicObserver(relation, filter, forgetting),
        "Lifted": aslo.Lifted(relation, CURRENT, VOLTAGE),
        "Adaptive": aslo.Adaptive(relation, CURRENT, VOLTAGE),
    }

    def replayed(observer):
        begin = slice(0, 12_000)
        state = aslo.replay(
            observer, t[begin], u[begin], y[begin], engine="fused", return_state=True
        )[1]
        rest = slice(11_999, None)
        return lambda: jax.block_until_ready(
            aslo.replay(
                observer, t[rest], u[rest], y[rest], engine="fused", state=state
            ).value
        )

    return timing.ratios({name: replayed(o) for name, o in every.items()}, rounds)
