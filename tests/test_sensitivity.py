"""Sobol indices and derivatives against known ones, and on a motor at low speed."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.stats

import aslo_jax as aslo
from aslo_jax.control import FieldOriented, MotorFeedback
from aslo_jax.control._base import OpenLoop
from aslo_jax.disturbances import SampledNoise
from aslo_jax.metrics import RMSError
from aslo_jax.plants._machine import MachineState
from aslo_jax.study._sensitivity import slopes, sobol_indices, to_text


def test_the_function_of_ishigami():
    """`sin x1 + 7 sin^2 x2 + 0.1 x3^4 sin x1`, uniform in (-pi, pi); closed forms."""

    def evaluate(u):
        x = np.pi * (2.0 * u - 1.0)
        return np.sin(x[:, 0]) * (1.0 + 0.1 * x[:, 2] ** 4) + 7.0 * np.sin(x[:, 1]) ** 2

    a, b = 7.0, 0.1
    first = 0.5 * (1.0 + b * np.pi**4 / 5.0) ** 2, a**2 / 8.0, 0.0
    both = 8.0 * b**2 * np.pi**8 / 225.0
    total = first[0] + both, first[1], both
    variance = first[0] + first[1] + both
    found = {i.name: i for i in sobol_indices(evaluate, ["x1", "x2", "x3"], 1024)}
    for k, name in enumerate(("x1", "x2", "x3")):
        for index, exact in ((found[name].first, first[k]), (found[name].total, total[k])):
            assert abs(index.value - exact / variance) < 0.02
            assert index.low < exact / variance < index.high
            assert index.high - index.low < 0.3


def linear(values):
    return 3.0 + 2.0 * values["a"] - 0.5 * values["b"] + 0.0 * values["c"]


def test_a_linear_metric():
    """Normal parameters of the deviations 1, 2 and 5: the parts are 4 : 1 : 0, the order
    of the table."""
    deviations = {"b": 2.0, "c": 5.0, "a": 1.0}

    def evaluate(u):
        x = scipy.stats.norm.ppf(u) * np.array(list(deviations.values()))
        return linear(dict(zip(deviations, x.T, strict=True)))

    table = sobol_indices(evaluate, list(deviations), 256)
    assert [index.name for index in table] == ["a", "b", "c"]
    np.testing.assert_allclose([i.total.value for i in table], [0.8, 0.2, 0.0], atol=0.02)
    points = {name: np.linspace(0.0, d, 7) for name, d in deviations.items()}
    table = slopes(linear, points, deviations)
    assert [slope.name for slope in table] == ["a", "b", "c"]
    np.testing.assert_allclose([s.mean for s in table], [[2.0] * 3, [-1.0] * 3, [0.0] * 3])
    np.testing.assert_allclose([s.rms.value for s in table], [2.0, 1.0, 0.0])
    lines = to_text(table).splitlines()
    assert lines[0].split() == ["name", "mean", "rms"]
    assert lines[2] == "b     -1 (-1 to -1)  1 (1 to 1)"


def test_slopes_of_opposite_sign_do_not_cancel_in_the_rms():
    points = {"x": np.array([-1.0, 1.0, -1.0, 1.0])}
    (slope,) = slopes(lambda v: v["x"] ** 2, points, {"x": 0.5})
    np.testing.assert_allclose((slope.mean.value, slope.rms.value), (0.0, 1.0), atol=1e-15)


SPEED, LOAD = 3.0, 2.0  # rad/s, N m
SPREAD = {"resistance": 8.875, "inductance": 40.03e-3, "inertia": 2e-3}


def motor_metric():
    """The rms flux error (Wb) of an observer that has the nominal parameters, of motors
    that do not, turning slowly under load."""
    nominal = aslo.plants.PMSM.bmp0701f(inertia=2e-3, load=lambda t: LOAD + 0.0 * t)
    flux = aslo.AlgebraicObserver(nominal.flux_relation(), aslo.LowPass(30.0))
    current = jnp.array([0.0, LOAD / (1.5 * 5 * 0.2086)])

    def make(values):
        where = lambda m: tuple(getattr(m, name) for name in SPREAD)
        plant = eqx.tree_at(where, nominal, tuple(values[name] for name in SPREAD))
        first = plant.inductance * current + jnp.array([0.2086, 0.0])
        return aslo.Experiment(
            plant,
            FieldOriented(nominal, lambda t: SPEED + 0.0 * t, current_limit=2.3),
            {"ASLO": flux},
            5e-4,
            feedback=lambda y, x, e: MotorFeedback(y, 5 * x.angle, x.speed),
            initial=MachineState(first, jnp.full_like(x0, SPEED), x0),
        )

    x0 = jnp.zeros(())

    def evaluate(values):
        rms = {"rms": RMSError("ASLO", after=0.3)}
        batch = aslo.run_batch(make, values, 1_200, metrics=rms, engine="fused")
        return jnp.linalg.norm(batch.metrics["rms"], axis=1)

    return evaluate


def test_resistance_matters_at_low_speed_and_inductance_does_not():
    metric = motor_metric()

    def evaluate(u):
        factors = 1.0 + 0.05 * scipy.stats.norm.ppf(u)
        columns = zip(SPREAD.items(), factors.T, strict=True)
        return metric({name: nominal * x for (name, nominal), x in columns})

    table = {index.name: index for index in sobol_indices(evaluate, list(SPREAD), 64)}
    assert table["resistance"].total.low > 0.8
    assert table["inductance"].total.high < 0.1
    assert table["inertia"].total.high < 0.02


def test_slopes_through_the_engine():
    """The error of an observer of the double integrator that starts exactly is all noise:
    the metric is in proportion to its deviation, and blind to the speed at the start."""
    plant = aslo.plants.IntegratorChain()
    keys = aslo.random.key(3)

    def make(values):
        observer = aslo.AlgebraicObserver(plant.relation(), aslo.LowPass(values["cutoff"]))
        return aslo.Experiment(
            plant,
            OpenLoop(lambda t: jnp.sin(t)),
            {"ASLO": observer},
            0.01,
            sensor=SampledNoise(values["deviation"], 0.01, keys),
            initial=jnp.stack([jnp.zeros(()), values["speed"]]),
        )

    def evaluate(values):
        rms = {"rms": RMSError("ASLO", after=0.5)}
        batch = aslo.run_batch(make, values, 200, metrics=rms, engine="fused")
        return batch.metrics["rms"][:, 0]

    points = {
        "cutoff": np.array([4.0, 9.0, 16.0]),
        "deviation": np.array([0.1, 0.2, 0.3]),
        "speed": np.array([1.0, -2.0, 3.0]),
    }
    # So small a scatter that rounding of the input's filter shows nowhere.
    deviations = {"cutoff": 0.5, "deviation": 0.02, "speed": 1.0}
    table = {slope.name: slope for slope in slopes(evaluate, points, deviations)}
    value = np.asarray(evaluate(points))
    gain = np.mean(value / points["deviation"])
    np.testing.assert_allclose(table["deviation"].mean.value, 0.02 * gain, rtol=1e-3)
    assert table["speed"].rms.value < 1e-3 * table["deviation"].rms.value
    nudged = {
        name: np.concatenate([x, x]) + (name == "cutoff") * np.repeat([1e-4, -1e-4], 3)
        for name, x in points.items()
    }
    up, down = np.split(np.asarray(evaluate(nudged)), 2)
    expected = 0.5 * np.mean(up - down) / 2e-4
    np.testing.assert_allclose(table["cutoff"].mean.value, expected, rtol=1e-6)


def test_metrics_that_have_no_indices():
    with pytest.raises(ValueError, match="`base` must be a power of two, but got 100"):
        sobol_indices(lambda u: u[:, 0], ["a"], 100)
    with pytest.raises(ValueError, match="must return a metric that varies, but it is 1"):
        sobol_indices(lambda u: np.ones(len(u)), ["a"], 8)
    with pytest.raises(ValueError, match="but did not at 1 of 24 points"):
        sobol_indices(lambda u: np.where(np.arange(24) == 3, np.inf, 1.0), ["a"], 8)
    with pytest.raises(ValueError, match=r"must return the shape \(24,\)"):
        sobol_indices(lambda u: u, ["a"], 8)
    with pytest.raises(ValueError, match="`deviations` must have the names"):
        slopes(linear, {"a": np.ones(2)}, {"b": 1.0})
