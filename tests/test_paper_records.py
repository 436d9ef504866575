"""Section 4 of the paper: the records of its sampled loops, and the search for gains."""

import math

import jax
import numpy as np
import pytest

from aslo_jax.paper._section4 import (
    comparison_figures,
    records,
    settings as s,
    tuning,
)


@pytest.fixture(scope="module")
def recorded():
    return records.record(s.ball())


def test_records_are_what_an_encoder_reports(recorded):
    mechanism, found = s.ball(), recorded
    cases = list(records.CASES)
    assert found.y.shape == (4, records.VALIDATION + records.TRAINING, s.STEPS + 1, 2)
    for i, case in enumerate(records.CASES.values()):
        counts = np.asarray(found.y[i]) / np.array(
            records.resolutions(mechanism, case.bits)
        )
        np.testing.assert_allclose(counts, np.round(counts), atol=1e-6)
        assert counts[..., 1].min() >= 0 and counts[..., 1].max() < 2**case.bits
        assert len(np.unique(counts[..., 1])) > 50
    assert records.resolutions(mechanism, 12) == pytest.approx((1.2 / 4096, math.pi / 2048))
    # The motion is the same in every case; noise is only where it is asked for.
    plain, noisy, off = (
        np.asarray(found.y[cases.index(name)])
        for name in ("16 bit", "16 bit, noise", "16 bit, 5 % wrong")
    )
    np.testing.assert_array_equal(plain, off)
    difference = (noisy - plain)[..., 0]
    rounding = 1.2 / 2**16 / math.sqrt(6)
    assert difference.std() == pytest.approx(math.hypot(1e-4, rounding), rel=0.02)
    np.testing.assert_array_equal(found.velocity[0], found.velocity[1])
    first = np.asarray(found.velocity)[0, :, 0]
    assert len(np.unique(first, axis=0)) == len(first)
    box = np.asarray(mechanism.spread.velocity)
    assert (np.abs(first - mechanism.start.velocity) <= box + 1e-12).all()


def test_the_search_finds_the_best_gain_of_every_coordinate():
    """On errors that are least at known gains, the second one coupled to the first."""
    best = np.array([3.0, 80.0])

    boxes = {"one": (0.3, 1e3), "other": (0.1, 300.0)}

    def run(gains, systems, u, y, velocity):
        def of(gains, best):
            off = np.log(gains / best)
            coupled = off + np.array([[0.0, 0.3]]) * off[:, :1]
            size = 0.1 + np.abs(coupled)
            return np.broadcast_to(size[:, None], (len(gains), s.STEPS + 1, 2))

        return {"one": of(gains["one"], best), "other": of(gains["other"], best[::-1])}

    shape = (records.TRAINING, s.STEPS + 1, 2)
    training = (np.zeros((*shape[:2], 1)), np.zeros(shape), np.zeros(shape))
    found = tuning.search(run, boxes, s.ball().system, training)
    # To within the distance of the last trials.
    spacing = np.log(1e3 / 0.3) * 0.5 ** (tuning.ROUNDS - 1) / tuning.TRIALS
    assert (np.abs(np.log(found["one"] / best)) < spacing).all() and spacing < 0.15
    assert (np.abs(np.log(found["other"] / best[::-1])) < spacing).all()


def test_lanes_are_one_trial_on_every_record():
    """Trials are repeated, records tiled: each meets each."""
    seen = []

    def run(gains, systems, u, y, velocity):
        seen.append(np.stack([gains["one"][:, 0], y[:, 0, 0]], axis=1))
        sizes = np.ones((1, s.STEPS + 1, 1))
        return {name: each[:, None] * sizes for name, each in gains.items()}

    y = np.arange(3.0)[:, None, None] * np.ones((1, s.STEPS + 1, 2))
    gains = {"one": np.array([[1.0, 2.0], [3.0, 4.0]])}
    gains["other"] = 5.0 * gains["one"]
    rms = tuning.evaluate(run, gains, s.ball().system, (y, y, y))
    for name, each in gains.items():
        np.testing.assert_allclose(rms[name], each)
    assert {tuple(row) for row in seen[0]} == {(g, r) for g in (1, 3) for r in (0, 1, 2)}


def test_a_moving_rms_is_that_of_its_window():
    error = np.sin(np.arange(200.0))
    found = comparison_figures.moving_rms(error)
    width = comparison_figures.WINDOW
    expected = [
        math.sqrt(np.mean(error[k : k + width] ** 2)) for k in range(200 - width + 1)
    ]
    np.testing.assert_allclose(found, expected, rtol=1e-9)
    assert set(comparison_figures.COLORS) == set(tuning.CONTENDERS)


def test_the_parameters_are_wrong_where_it_is_said():
    wrong = records.wrong(s.leg(), s.leg().parameters)
    assert float(wrong.m1) == pytest.approx(2.1) and float(wrong.m2) == pytest.approx(2.85)
    right = records.assumed(s.ball(), records.CASES["16 bit"])
    assert float(right.length) == pytest.approx(1.2)
    jax.tree.map(np.testing.assert_array_equal, right, s.ball().system)
