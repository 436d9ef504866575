"""The passes of a calibration: machine code and XLA find the same."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import aslo_jax as aslo
from aslo_jax.tune._calibration import passes
from aslo_jax.tune._calibration.imperfections import Recorded, perfect, seen
from aslo_jax.tune._calibration.parameters import chosen
from aslo_jax.tune._calibration.problem import problem_of
from aslo_jax.tune._calibration.relative import Observers, Relative
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


def test_slopes_of_what_the_machine_has_seen_are_those_of_xla():
    """Of every field and every entry; none at all in what is no error of the record."""
    rng = np.random.default_rng(13)
    for plant in (
        aslo.plants.PMSM(0.7, 2.1e-3, 0.05, pole_pairs=3, inertia=1e-4),
        aslo.plants.Stepper(0.55, 1.5e-3, 0.19, 50, 4.5e-5),
    ):
        u, y = rng.standard_normal((2, 40, 2))
        signals = Signals(np.full(39, STEP), u, y)
        recorded = Recorded(plant, perfect(plant, signals))
        fields = (*FIELDS, "gain", "input_offset", "threshold")
        errors = lambda r, f=fields: tuple(getattr(r.imperfections, n) for n in f)
        selected = chosen(recorded, lambda r, e=errors: (r.model.resistance, *e(r)))
        scale = np.where(selected.scale == 0, 0.3, selected.scale)
        selected = dataclasses.replace(selected, scale=scale)
        for delay in (0.0, 1.3, -4.1):  # also between the samples, and beyond both ends
            q = 0.2 * rng.standard_normal(len(selected.names))
            q[selected.names.index("delay")] = delay
            apart = (
                lambda q: selected.place(q).imperfections(  # noqa: B023
                    Signals(*map(jnp.asarray, signals))  # noqa: B023
                )[1:]
            )
            found, du, dy = seen(selected, signals, q)
            for mine, theirs in zip(found[1:], apart(jnp.asarray(q)), strict=True):
                np.testing.assert_allclose(mine, theirs, atol=1e-13)
            slopes = jax.jacfwd(apart)(jnp.asarray(q))
            for mine, theirs in zip((du, dy), slopes, strict=True):
                np.testing.assert_allclose(mine, np.moveaxis(theirs, -1, 0), atol=1e-12)
            assert not du[0].any() and not dy[0].any()


@pytest.mark.parametrize("even", [True, pytest.param(False, marks=pytest.mark.slow)])
def test_where_a_search_starts_is_compared_as_by_xla(even):
    """Residuals of the algebraic estimates and their slopes, on logs with one interval and
    with many."""
    rng = np.random.default_rng(14)
    t = 1e-3 * (np.arange(120) + (0.0 if even else 0.1) * rng.uniform(size=120))
    turning = lambda lead: np.stack([np.cos(90 * t + lead), np.sin(90 * t + lead)], 1)
    y = 2.0 * turning(0.2) + 0.1 * rng.standard_normal((120, 2))
    signals = Signals(np.diff(t), 9.0 * turning(1.1), y)
    plant = aslo.plants.PMSM(0.7, 2.1e-2, 0.05, pole_pairs=3, inertia=1e-4)
    recorded = Recorded(plant, perfect(plant, signals))
    selected = chosen(
        recorded,
        lambda r: (
            r.model.resistance,
            r.model.inductance,
            r.imperfections.output_offset,
            r.imperfections.delay,
        ),
    )
    selected = dataclasses.replace(selected, scale=np.full(5, 0.3))
    cost = Relative(selected, Observers(60.0), t, signals, (True,), 1)
    q = np.array([0.1, -0.2, 0.03, 0.02])
    rows, slopes = cost(q)
    assert cost.fused
    cost.fused = False
    same(rows, cost(q)[0])
    plain = cost(q)[1]
    for j in range(q.size):
        same(slopes[:, j], plain[:, j])
