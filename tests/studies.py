"""A small study for the tests, in a module of its own that other processes can import."""

import jax
import jax.numpy as jnp
import xarray

import aslo_jax as aslo
from aslo_jax.control import OpenLoop
from aslo_jax.disturbances import SampledNoise
from aslo_jax.metrics import CoastingFraction, RMSError, SettlingTime
from aslo_jax.study import Normal, Spread, Uniform
from aslo_jax.study._problem import BLOCK, Problem, Study

INTERVAL, SAMPLES, SEED = 0.01, 600, 3


def signal(t):
    return jnp.cos(3.0 * t)


def experiment() -> aslo.Experiment:
    """The double integrator with noise on its position."""
    plant = aslo.plants.IntegratorChain(2)
    observer = aslo.AlgebraicObserver(plant.relation(), aslo.LowPass(5.0))
    return aslo.Experiment(
        plant,
        OpenLoop(signal),
        {"ASLO": observer, "Luenberger": aslo.ReducedLuenberger.of_chain(2, 5.0)},
        INTERVAL,
        sensor=SampledNoise(0.01, INTERVAL, aslo.random.key(0)),
    )


def settling(observer: str) -> SettlingTime:
    return SettlingTime(observer, 0.1)


SPREAD = Spread(
    {
        "rate": ("observers.ASLO.filter.rate", Normal(5.0, 0.1)),
        "speed": ("initial.1", Uniform(-1.0, 1.0)),
        "noise": ("sensor.deviation", Uniform(0.01, 0.02)),
    }
)


def settings(**changes) -> dict:
    """The arguments of `run` after experiment and spread."""
    return {
        "samples": SAMPLES,
        "key": jax.random.key(SEED),
        "steps": 20,
        "every": 10,
        "metrics": {"rms": RMSError, "settled": settling, "coasting": CoastingFraction},
    } | changes


def run_study(**changes):
    """The study as a dataset."""
    return aslo.study.run(experiment(), SPREAD, **settings(**changes))


def study_of(**changes) -> Study:
    """The study, before it runs."""
    arguments = settings(**changes)
    seed = aslo.random.seed_of(arguments.pop("key"))
    problem = Problem(
        experiment(),
        SPREAD,
        engine="auto",
        chunk=BLOCK,
        scale=None,
        configuration=None,
        units={},
        entries=None,
        seed=seed,
        **arguments,
    )
    return Study(problem)


def assert_same(a: xarray.Dataset, b: xarray.Dataset) -> None:
    """Bit for bit, NaN and infinity included."""
    assert set(a.data_vars) == set(b.data_vars)
    for name in (*a.data_vars, *a.coords):
        assert a[name].dims == b[name].dims
        assert a[name].attrs == b[name].attrs
        x, y = a[name].values, b[name].values
        assert x.dtype == y.dtype
        assert x.tobytes() == y.tobytes(), name
