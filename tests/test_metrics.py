"""Metrics against NumPy on the recorded trajectory, in both engines, with an observer that
diverges in one sample of the batch. A new metric is a line in `METRICS`."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import aslo_jax as aslo
from aslo_jax.control import OpenLoop
from aslo_jax.metrics import (
    AngleError,
    CoastingFraction,
    Diverged,
    Final,
    FinalError,
    FluxAngle,
    Integral,
    IntegralSquaredError,
    Maximum,
    Mean,
    MeanError,
    PeakAngleError,
    PeakError,
    RMSError,
    RotorAngle,
    SettlingTime,
)
from aslo_jax.observers import AbstractObserver, Estimate
from aslo_jax.plants import AbstractPlant

pytest.importorskip("llvmlite")
H, STEPS, AFTER, L = 0.0625, 40, 0.5, 0.3  # every instant is exact
LATE, DEGREE = slice(8, None), 180 / np.pi


class Turning(eqx.Module):
    angle: jax.Array
    flux: jax.Array


class Rotor(AbstractPlant):
    """A flux that turns with a rotor of two pole pairs and gets smaller."""

    def initial(self):
        return Turning(jnp.asarray(0.1), jnp.array([1.0, 0.2]))

    def vector_field(self, t, x, u):
        a, b = x.flux
        return Turning(1.0 + 0.0 * u[0], jnp.stack([-2.0 * b - 0.3 * a, 2.0 * a - 0.1 * b]))

    def output(self, x):
        return 0.5 * x.flux

    def hidden(self, x):
        return x.flux


class Growing(AbstractObserver):
    """Twice y, plus an error that decays or grows at `rate`; coasting where it is large."""

    rate: jax.Array

    def equations(self, F, u, y):
        grow = lambda e: self.rate * e + 0.0 * e  # not a number after infinity
        error = F.state("error", jnp.array([0.4, -0.3]), grow)
        return Estimate(2.0 * y + error, jnp.ones(()), jnp.abs(error[0]) > 0.1)


def make(rate):
    command = OpenLoop(lambda t: jnp.zeros(2))
    return aslo.Experiment(Rotor(), command, {"a": Growing(rate)}, H)


def speed_error(record):
    return record.estimates["a"].value[0] - 2.0 * record.x.angle


# The fourth one overflows and then is not a number; the others must not notice.
RATES = np.array([-2.0, -0.5, 0.4, 1e8])


class Trajectory:
    """What NumPy sees of one lane."""

    def __init__(self, record, lane):
        self.t, self.x, self.flux, self.y, self.value, self.coasting = (
            np.asarray(part)[lane] for part in record
        )
        self.error = self.value - self.flux
        with np.errstate(over="ignore"):
            self.size = np.linalg.norm(self.error, axis=1)
        magnet = self.value - L * self.y
        gap = np.arctan2(magnet[:, 1], magnet[:, 0]) - 2 * self.x
        self.angle = DEGREE * np.angle(np.exp(1j * gap))


def settled(run):
    outside = np.flatnonzero(~(run.size <= 0.25))
    end = outside[-1] + 1 if outside.size else 0
    return run.t[end] if end < len(run.t) else np.inf


ANGLES: tuple[Any, Any] = FluxAngle("a", L), RotorAngle(2)
METRICS = {
    "rms": (RMSError("a", AFTER), lambda r: np.sqrt(np.mean(r.error[LATE] ** 2, axis=0))),
    "rms norm": (
        RMSError("a", AFTER, norm=True),
        lambda r: np.sqrt(np.mean(r.size[LATE] ** 2)),
    ),
    "peak": (PeakError("a", AFTER), lambda r: np.abs(r.error[LATE]).max(axis=0)),
    "peak norm": (PeakError("a", norm=True), lambda r: r.size.max()),
    "final": (FinalError("a"), lambda r: r.error[-1]),
    "final norm": (FinalError("a", norm=True), lambda r: r.size[-1]),
    "mean": (MeanError("a", AFTER), lambda r: r.error[LATE].mean(axis=0)),
    "mean norm": (
        MeanError("a", AFTER, norm=True),
        lambda r: np.linalg.norm(r.error[LATE].mean(axis=0)),
    ),
    "integral": (
        IntegralSquaredError("a", AFTER),
        lambda r: np.trapezoid(r.error[LATE] ** 2, r.t[LATE], axis=0),
    ),
    "integral norm": (
        IntegralSquaredError("a", norm=True),
        lambda r: np.trapezoid(r.size**2, r.t),
    ),
    "settled": (SettlingTime("a", 0.25), settled),
    "coasting": (CoastingFraction("a"), lambda r: r.coasting.mean()),
    "angle": (AngleError(*ANGLES, AFTER), lambda r: np.sqrt(np.mean(r.angle[LATE] ** 2))),
    "peak angle": (PeakAngleError(*ANGLES, AFTER), lambda r: np.abs(r.angle[LATE]).max()),
    "diverged": (Diverged("a"), lambda r: not np.isfinite(r.size**2).all()),
    "beyond": (Diverged("a", 0.6, AFTER), lambda r: not (r.size[LATE] <= 0.6).all()),
    "own mean": (
        Mean(speed_error, AFTER),
        lambda r: np.mean(r.value[LATE, 0] - 2 * r.x[LATE]),
    ),
    "share": (Mean(lambda r: r.x.angle > 1.0), lambda r: np.mean(r.x > 1.0)),
    "own maximum": (Maximum(lambda r: -r.y, AFTER), lambda r: (-r.y[LATE]).max(axis=0)),
    "own final": (Final(lambda r: r.estimates["a"].coasting), lambda r: r.coasting[-1]),
    "own integral": (
        Integral(lambda r: jnp.stack([r.y, 2.0 * r.y])),
        lambda r: np.trapezoid(np.stack([r.y, 2 * r.y]), r.t, axis=1),
    ),
}


@pytest.fixture(scope="module")
def batches():
    settings = dict(
        metrics={name: metric for name, (metric, _) in METRICS.items()},
        record=lambda r: (r.t, r.x.angle, r.hidden, r.y, *_estimate(r.estimates["a"])),
        every=1,
    )
    return {
        engine: aslo.run_batch(make, jnp.asarray(RATES), STEPS, engine=engine, **settings)
        for engine in ("scan", "fused")
    }


def _estimate(estimate):
    return estimate.value, estimate.coasting


@pytest.mark.parametrize("engine", ["scan", "fused"])
@pytest.mark.parametrize("name", METRICS)
def test_a_metric_against_numpy(batches, engine, name):
    """Of the samples that stay finite, from the trajectory of the same run."""
    batch = batches[engine]
    for lane in range(3):
        expected = METRICS[name][1](Trajectory(batch.record, lane))
        found = np.asarray(batch.metrics[name][lane])
        assert found.shape == np.shape(expected)
        np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-14)


def test_the_engines_agree(batches):
    a, b = batches["fused"], batches["scan"]
    for x, y in zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True):
        assert x.shape == y.shape and x.dtype == y.dtype
        np.testing.assert_allclose(x, y, rtol=1e-12, atol=1e-13)


@pytest.mark.parametrize("engine", ["scan", "fused"])
def test_a_sample_that_diverges_says_so(batches, engine):
    """Every magnitude is infinite, whatever is signed is not finite, nothing is zero."""
    batch = batches[engine]
    size = Trajectory(batch.record, 3).size
    assert np.isnan(size[-1]) and np.isfinite(size[:5]).all()
    found = {name: np.asarray(x)[3] for name, x in batch.metrics.items()}
    for name in ("rms", "rms norm", "peak", "peak norm", "final norm", "integral",
                 "integral norm", "settled", "angle", "peak angle"):  # fmt: skip
        assert np.isposinf(found[name]).all(), name
    for name in ("final", "mean", "mean norm", "own mean"):
        assert not np.isfinite(found[name]).any(), name
    assert found["diverged"] and found["beyond"]
    np.testing.assert_array_equal(batch.metrics["diverged"], [False, False, False, True])
    assert list(batch.metrics["beyond"][:3]) == [False, False, True]


def single(x):
    return x.astype(jnp.float32) if eqx.is_inexact_array(x) else x


def test_metrics_keep_single_precision():
    _, record = jax.tree.map(single, make(jnp.asarray(-1.0)).init())
    for name, (metric, _) in METRICS.items():
        metric = jax.tree.map(single, metric)
        state = jax.eval_shape(metric.init, record)
        after = jax.eval_shape(metric.update, state, record)
        types = [[x.dtype for x in jax.tree.leaves(tree)] for tree in (state, after)]
        assert types[0] == types[1], name
        assert jax.eval_shape(metric.result, state).dtype in (jnp.float32, jnp.bool_), name


def test_an_angle_error_is_taken_within_half_a_turn():
    """An angle of 3.1 rad, estimated at -3.1 rad: 2 pi - 6.2 rad from it."""
    metric = PeakAngleError(lambda r: r.x, lambda r: r.hidden[0])
    record = aslo.Record(
        *(jnp.asarray(v) for v in (0.0, -3.1)), jnp.asarray([3.1]), 0, 0, {}
    )
    found = metric.result(metric.init(record))
    np.testing.assert_allclose(found, DEGREE * (2 * np.pi - 6.2), rtol=1e-12)


def test_arguments_are_refused():
    for metric in (MeanError, IntegralSquaredError, RMSError, PeakError):
        with pytest.raises(ValueError, match="`after` must be finite and not negative"):
            metric("a", after=-1.0)
    for function in (Mean, Maximum, Integral):
        with pytest.raises(ValueError, match="`after` must be finite and not negative"):
            function(speed_error, after=-1.0)
    with pytest.raises(ValueError, match="`tolerance` must be positive"):
        SettlingTime("a", 0.0)
    with pytest.raises(ValueError, match=r"`bound` must be positive, but got -1\.0"):
        Diverged("a", -1.0)
