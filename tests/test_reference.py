"""The bound of a study and what decides its errors, against closed forms."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import aslo_jax as aslo
from aslo_jax import study
from aslo_jax.control import OpenLoop
from aslo_jax.disturbances import SampledNoise
from aslo_jax.metrics import RMSError
from aslo_jax.study import Discrete, LogNormal, Spread, Uniform

H, STEPS = 0.02, 12


def experiment() -> aslo.Experiment:
    """The integral of the acceleration: its error is the speed at the start, always."""
    plant = aslo.plants.IntegratorChain(2)
    return aslo.Experiment(
        plant,
        OpenLoop(lambda t: jnp.sin(3.0 * t)),
        {"integral": aslo.OpenLoopIntegrator(plant.relation())},
        H,
        sensor=SampledNoise(0.1, H, aslo.random.key(0)),
    )


@pytest.mark.parametrize("scale", [None, np.array([4.0])])
def test_bound_is_that_of_a_regression(scale):
    """Without noise on the state, samples of the position are linear in its last value."""
    spread = Spread({"noise": ("sensor.deviation", Discrete((0.1,)))})
    found = study.bound_of(
        experiment(), spread, STEPS, key=jax.random.key(1), trajectories=2, scale=scale
    )
    back = -H * np.arange(STEPS + 1)
    rows = np.stack([np.ones_like(back), back], axis=1)
    start = np.array([[1.0, back[-1]], [0.0, 1.0]])
    information = rows.T @ rows / 0.1**2 + start.T @ start / 10.0**2
    expected = np.linalg.inv(information)[1, 1] / (1.0 if scale is None else 16.0)
    assert found.variance.shape == (2, STEPS + 1, 1)
    np.testing.assert_allclose(found.variance[:, -1, 0], expected, rtol=1e-9)


def test_influence_of_what_the_error_is_and_is_not():
    """The error is the speed at the start: all of its variance comes from there."""
    spread = Spread(
        {
            "noise": ("sensor.deviation", Uniform(0.1, 0.2)),
            "speed": ("initial.1", LogNormal(1.0, 0.5)),
        }
    )
    found = study.influences(experiment(), spread, RMSError, STEPS, base=64, engine="scan")
    speed, noise = found["integral"]
    assert (speed.name, noise.name) == ("speed", "noise")
    assert speed.total.value == pytest.approx(1.0, abs=0.1)
    assert noise.total.value == pytest.approx(0.0, abs=1e-12)


def test_influence_needs_a_spread():
    with pytest.raises(ValueError, match="Argument `spread` must name a parameter"):
        study.influences(experiment(), Spread({}), RMSError, STEPS)
