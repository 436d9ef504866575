"""The bound of a study and what decides its errors, against closed forms."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import xarray as xr

import aslo_jax as aslo
from aslo_jax import study
from aslo_jax.control import OpenLoop
from aslo_jax.disturbances import SampledNoise
from aslo_jax.metrics import RMSError
from aslo_jax.study import Discrete, LogNormal, Normal, Parameter, Spread, Uniform

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


@pytest.mark.slow
def test_the_bound_without_the_parameters_that_are_spread():
    """A motor that stands: its currents tell the resistance, and with it the flux."""
    motor = aslo.plants.PMSM(1.7, 9.3e-3, 0.11, 3, 2.3e-3)
    key = aslo.random.key(0)
    observer = aslo.OpenLoopIntegrator(motor.flux_relation())
    loop = aslo.Experiment(
        motor,
        OpenLoop(lambda t: jnp.stack([jnp.cos(9.0 * t), jnp.sin(5.0 * t)])),
        {"integral": observer},
        1e-3,
        sensor=SampledNoise(0.1, 1e-3, key),
    )
    relative = lambda where, mean, deviation: Parameter(
        where, Normal(mean, deviation), relative=True
    )
    spread = Spread(
        {
            "hot": relative("plant.resistance", 1.2, 0.3),
            "weak": Parameter("plant.magnet_flux", Normal(0.1, 0.002)),
            "known": relative("*.inductance", 1.0, 0.1),
            "noise": relative("sensor.deviation", 1.0, 0.01),
        }
    )
    found = study.unknown_in(loop, spread)
    assert list(found) == ["resistance", "magnet_flux"]
    np.testing.assert_allclose([*found.values()], [0.25, 0.02], rtol=0.05)
    settings: Any = dict(key=jax.random.key(1), trajectories=3)
    known = study.bound_of(loop, spread, 40, **settings)
    unknown = study.bound_of(loop, spread, 40, unknown=found, scale=np.ones(2), **settings)
    assert (unknown.norm[1:] > known.norm[1:]).all()
    of_magnet = np.sqrt(unknown.parameters["magnet_flux"])
    assert of_magnet.shape == (3, 41) and (of_magnet <= found["magnet_flux"]).all()
    dataset = study.with_bound(xr.Dataset(), known, {"rms": 0.01}, unknown)
    assert dataset["cramer_rao_rms"].attrs["unknown"] == unknown.rms(0.01).value


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
