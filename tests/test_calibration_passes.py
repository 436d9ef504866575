"""The passes of a calibration: machine code and XLA find the same."""

import jax.numpy as jnp
import numpy as np
import pytest

import aslo_jax as aslo
from aslo_jax.tune._calibration import passes
from aslo_jax.tune._calibration.imperfections import Recorded, perfect
from aslo_jax.tune._calibration.parameters import chosen
from aslo_jax.tune._calibration.problem import problem_of
from aslo_jax.tune._calibration.whiten import Signals

ROWS, STEP = 160, 2e-4
FIELDS = ("output_offset", "dead_time", "delay")


def motor():
    """A problem of a motor, of signals that no motor makes: the passes take any."""
    rng = np.random.default_rng(11)
    t = STEP * (np.arange(ROWS) + 0.1 * rng.uniform(size=ROWS))
    turning = lambda lead: np.stack([np.cos(210 * t + lead), np.sin(210 * t + lead)], 1)
    y = 3.0 * turning(0.3) + 0.02 * rng.standard_normal((ROWS, 2))
    u = 14.0 * turning(0.9) + 0.5 * rng.standard_normal((ROWS, 2))
    plant = aslo.plants.PMSM(0.7, 2.1e-3, 0.05, pole_pairs=3, inertia=1e-4)
    signals = Signals(*map(jnp.asarray, (np.diff(t), u, y)))
    recorded = Recorded(plant, perfect(plant, signals))
    errors = lambda r: tuple(getattr(r.imperfections, f) for f in FIELDS)
    of_plant = lambda r: (r.model.resistance, r.model.inductance, r.model.magnet_flux)
    selected = chosen(recorded, lambda r: (*of_plant(r), *errors(r)))
    return problem_of(selected, t, u, y, 400.0, None, {}, 4)


@pytest.fixture(scope="module")
def pair():
    problem = motor()
    size = np.array([11.0, 12.0]), np.array([0.02, 0.03])
    fused, plain = (passes.Passes(problem, *size) for _ in range(2))
    assert fused.fused
    plain.fused = False
    rng = np.random.default_rng(12)
    v = problem.unknowns + 0.02 * rng.standard_normal(problem.unknowns.size)
    return fused, plain, v


def same(a, b):
    a, b = np.asarray(a), np.asarray(b)
    assert np.max(np.abs(b)) > 0
    np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-9 * np.max(np.abs(b)))


def test_the_filter(pair):
    fused, plain, v = pair
    levels = np.array([0.3, -2.0])
    one, other = fused.filtered(v, levels), plain.filtered(v, levels)
    assert fused.fused
    same(one.cost, other.cost)
    same(one.size, other.size)
    same(one.slope, other.slope)
    same(one.gains.gain, other.gains.gain)
    same(one.gains.whiten, other.gains.whiten)
    # The slope in the levels, by differences.
    for j in range(2):
        moved = [plain.filtered(v, levels + s * 1e-5 * np.eye(2)[j]).cost for s in (1, -1)]
        np.testing.assert_allclose((moved[0] - moved[1]) / 2e-5, one.slope[j], rtol=1e-4)


def test_errors_and_their_slopes(pair):
    fused, plain, v = pair
    gains = plain.filtered(v, np.array([0.0, -1.0])).gains
    (e, J), (other, slopes) = fused.whitened(v, gains), plain.whitened(v, gains)
    assert fused.fused
    assert J.shape == (*e.shape, v.size)
    same(e, other)
    for j in range(v.size):  # of very different sizes
        same(J[..., j], slopes[..., j])


def test_what_machine_code_cannot_do_xla_does(pair, monkeypatch):
    _, plain, v = pair
    levels = np.array([0.1, -1.5])
    refused = passes.Passes(plain.problem, plain.drift, plain.reference)

    def run(*arguments):
        raise passes.NotFusible("for a test")

    monkeypatch.setattr(refused, "_run", run)
    same(refused.filtered(v, levels).cost, plain.filtered(v, levels).cost)
    assert not refused.fused
