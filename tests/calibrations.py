"""Calibrations that nobody has computed, for what is said and drawn of them."""

from typing import Any

import jax.numpy as jnp
import numpy as np

from aslo_jax.tune import Calibration
from aslo_jax.tune._calibration.imperfections import Imperfections


def calibrated(**changes: Any) -> Calibration:
    """Two parameters with parabolas, an error of the record that starts at zero and has no
    interval, and prediction errors with a line at 40 Hz; but for the `changes`."""
    rng, t = np.random.default_rng(4), 1e-3 * np.arange(2000)
    names = ("resistance", "inductance", "output_offset[0]")
    estimate = dict(zip(names, (2.0, 5e-3, -0.1), strict=True))
    half = dict(zip(names, (0.01, 1e-3, np.nan), strict=True))
    places = np.array([-1.0, 0.0, 1.0])
    errors = np.sqrt(2) * np.sin(2 * np.pi * 40.0 * t) + 0.1 * rng.standard_normal(t.size)
    fields: dict[str, Any] = dict(
        model=None,
        before=dict(zip(names, (2.1, 4e-3, 0.0), strict=True)),
        estimate=estimate,
        after=estimate | {"inductance": np.nan, "output_offset[0]": np.nan},
        interval={n: (x - half[n], x + half[n]) for n, x in estimate.items()},
        imperfections=Imperfections(jnp.zeros(2), jnp.zeros(2), 1.0, 0.0, 0.0, 0.1, True),
        withdrawn="",
        findings=(),
        allowed=dict.fromkeys(names, ()),
        undetermined=(),
        confidence=0.95,
        output_noise=np.zeros(2),
        drift_noise=np.zeros(2),
        correlation=0.0,
        profiles={n: (x * (1 + 0.1 * places), 4 * places**2) for n, x in estimate.items()},
        t=t,
        errors=errors[:, None],
        rounds=3,
        reason="it settled",
    )
    return Calibration(**fields | changes)
