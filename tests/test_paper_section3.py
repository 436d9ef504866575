"""Section 3 of the paper: the PMSM, its numbers, its claims, and its figures."""

import csv
import dataclasses
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.integrate
from motion import PrescribedPMSM, observe
from paper_claims import kind, replaced, verdicts

import aslo_jax as aslo
from aslo_jax.paper import _section3 as section3
from aslo_jax.paper._section3 import (
    comparison_claims as comparison,
    figures,
    flux_claims,
    machine_claims,
    pmsm,
    settings as s,
    settling,
)
from aslo_jax.plot._figure import Figure

PRINTED = s.Printed()
WRONG = s.Printed(
    aslo=lambda relation, *args, **settings: s.aslo(
        dataclasses.replace(relation, resistance=1.01 * relation.resistance),
        *args,
        **settings,
    ),
    a_aslo=lambda relation, gain=s.GAIN, **settings: s.a_aslo(
        relation, gain / 4, **settings
    ),
    fo1=lambda relation, gain=s.GAIN: s.fo1(relation, 1e-4 * gain),
    fo3=lambda relation, gain=s.GAIN, start="paper": s.fo3(relation, 2 * gain, start),
)
NEEDED = (
    *pmsm.PAPER,
    *pmsm.EXACT[:2],
    "ASLO without m",
    "FO3 exact",
    "A-ASLO slow",
    "A-ASLO fast",
    "A-ASLO fast, exact",
    "angle",
    "Delta",
    "Delta exact",
)
SWAPPED = ("ASLO", "FO1", "FO3 exact", "A-ASLO slow", "ASLO exact, least squares")


@pytest.fixture(scope="module")
def closed():
    """The closed loop, some wrong observers among the right ones."""
    right, wrong = pmsm.observers(PRINTED), pmsm.observers(WRONG)
    beside = {name: right[name] for name in NEEDED}
    return pmsm.closed_loop(beside | {f"wrong {name}": wrong[name] for name in SWAPPED})


@pytest.fixture(scope="module")
def steady():
    return pmsm.steady(PRINTED)


@pytest.fixture(scope="module")
def reversal():
    return pmsm.reversal(PRINTED)


def swap(run, name):
    """The run with the wrong observer in the place of the right one."""
    return replaced(run, {name: run.estimates[f"wrong {name}"]})


def naive_proposition(ts, motion):
    """Prop. 2 line by line: w4 to w9 from zero, lambda = 5, by SciPy at 1e-12."""
    R, L, M, lam = 8.875, 40.03e-3, 0.2086, 5.0
    signals = jax.jit(lambda t: (motion.voltage(t), motion.current(t)))

    def lines(t, x):
        u, y = (np.asarray(v) for v in signals(t))
        fy, fz, g1, g2, fz3, f4, f6, g3 = x[:2], x[2:4], *x[4:7], x[7:9], *x[9:]
        z, z3 = u - R * y, -(M**2) / (2 * L) + L / 2 * (y @ y)
        w45 = fy + fz / (lam * L) - y
        w6 = g1 / lam + g2 / (lam * L) + fz3 - z3
        rates = [y - fy, z - fz, [z @ fy - g1, z @ fz / lam - g2, z3 - fz3]]
        rates += [w45 - f4, [w6 - f6, z @ f4 - g3]]
        return lam * np.concatenate(rates), w45, w6, f4, f6 + g3 / lam

    x = scipy.integrate.solve_ivp(
        lambda t, x: lines(t, x)[0],
        (0, ts[-1]),
        np.zeros(11),
        "DOP853",
        ts,
        rtol=1e-12,
        atol=1e-14,
    ).y.T
    flux, delta = [], []
    for t, now in zip(ts, x, strict=True):
        _, (w4, w5), w6, (w7, w8), w9 = lines(t, now)
        delta.append(w4 * w8 - w5 * w7)
        flux.append(np.array([w6 * w8 - w5 * w9, w4 * w9 - w6 * w7]) / delta[-1])
    return np.array(flux), np.array(delta)


def test_the_aslo_and_delta_are_those_of_the_printed_lines():
    motion, ts = PrescribedPMSM(), np.array([0.03, 0.1, 0.5, 2.0])
    flux, delta = naive_proposition(ts, motion)
    relation = motion.relation()
    delta_too = pmsm.Determinant(relation, "paper")
    both = aslo.SideBySide({"ASLO": s.aslo(relation), "Delta": delta_too})
    found = observe(both, motion.voltage, motion.current, jnp.asarray(ts))
    np.testing.assert_allclose(found["ASLO"].value, flux, rtol=0, atol=1e-9)
    np.testing.assert_allclose(found["Delta"].value[:, 0], delta, rtol=1e-9)
    assert np.abs(flux[0] - motion.flux(ts[0])).max() > 0.01


def test_the_closed_loop_and_its_exact_observer():
    """Over its first 1.2 s."""
    name = "ASLO exact, least squares"
    run = pmsm.closed_loop({name: pmsm.observers(PRINTED)[name]}, 1.2)
    later = run.t > 1.0
    assert np.abs(run.x.speed[later] - (2 + 0.5 * np.sin(run.t[later]))).max() < 0.05
    assert settling.size(run, name)[run.t > 9e-3].max() < 1e-8
    drive = {c.name: c.verdict for c in comparison.drive(run)}
    assert drive["load current, factor 3/2"] == "confirmed"


@pytest.mark.slow
def test_the_drive_follows_its_reference_under_its_load(closed):
    later = closed.t > 1.0
    t = closed.t[later]
    assert np.abs(closed.x.speed[later] - (2 + 0.5 * np.sin(t))).max() < 0.05
    torque = 3 + 0.5 * np.sin(0.1 * t) + 60e-6 * 0.5 * np.cos(t)
    current = np.linalg.norm(closed.y[later], axis=1)
    np.testing.assert_allclose(current, torque / (1.5 * 5 * 0.2086), rtol=1e-3)


@pytest.mark.slow
def test_the_claims_of_prop_2(closed, steady, reversal):
    claims = [
        *flux_claims.proposition(closed),
        *flux_claims.asymptotic(closed),
        *flux_claims.determinant(closed, steady, reversal),
    ]
    assert kind(claims, "not reproduced") == set()
    assert kind(claims, "corrected") == {
        "ASLO, printed start",
        "A-ASLO, gamma > lambda",
        "Delta at t = 0",
        "Delta in the start-up",
        "Delta at a reversal",
        "observability at standstill",
        "error at standstill",
    }


@pytest.mark.slow
def test_the_claims_of_the_comparison(closed):
    claims = [
        *comparison.comparison(_with_asymptotic(closed), np.array([0.9, 0.1])),
        *comparison.drive(closed),
    ]
    assert kind(claims, "not reproduced") == set()
    assert kind(claims, "corrected") == {
        "FO2 with gamma = 5",
        "ASLO, fastest",
        "ASLO, overshoot",
        "FO3, printed start",
        "load current, printed torque",
    }
    measured = {c.name: c.measured for c in claims}
    assert 3 < measured["ASLO, fastest"] < 5
    for factor, name in ((1.0, "printed torque"), (1.5, "factor 3/2")):
        current = 3.5 / (factor * 5 * 0.2086)
        assert measured[f"load current, {name}"] == pytest.approx(current, rel=1e-12)


@pytest.mark.slow
def test_the_claims_of_the_angle(closed):
    assert verdicts(machine_claims.angle(closed, PRINTED)) == {
        "angle, arctan": "corrected",
        "angle, atan2": "confirmed",
        "angle, directly": "confirmed",
    }

    def right(flux, current, inductance, pole_pairs):
        x = flux - inductance * current
        return np.arctan2(x[:, 1], x[:, 0]) / pole_pairs

    found = verdicts(machine_claims.angle(closed, s.Printed(angle=right)))
    assert found["angle, arctan"] == "confirmed"
    found = verdicts(machine_claims.angle(swap(closed, SWAPPED[-1]), PRINTED))
    assert found["angle, atan2"] == "not reproduced"


@pytest.mark.slow
def test_wrong_observers_are_found_out(closed):
    def found(claims, name):
        return kind(claims(swap(closed, name)), "not reproduced")

    exact, later = {"ASLO, exact start"}, {"ASLO, error at 2 s", "ASLO, error at 5 s"}
    assert found(flux_claims.proposition, "ASLO exact, least squares") == exact
    assert found(flux_claims.proposition, "ASLO") == later
    assert found(flux_claims.asymptotic, "A-ASLO slow") == {"A-ASLO, gamma < lambda"}
    assert found(comparison.mixing, "FO3 exact") == {"FO3, exact start"}

    def compared(run):
        return comparison.comparison(_with_asymptotic(run), np.zeros(1))

    assert found(compared, "FO1") == {"all errors converge"}
    unstable = comparison.comparison(_with_asymptotic(closed), np.array([0.5, np.nan]))
    assert kind(unstable, "not reproduced") == {"FO1, any gain"}


def _with_asymptotic(run):
    """The comparison lists the exact A-ASLO too, which no claim is about."""
    names = [name for name in pmsm.EXACT if name.startswith("A-")]
    return replaced(run, dict.fromkeys(names, run.estimates["ASLO exact, Repeat"]))


def test_delta_in_steady_state(steady):
    """Odd in the speed, of its third power at slow speeds, nothing at standstill."""
    last = steady.estimates["Delta"].value[:, -1, 0]
    delta = dict(zip(pmsm.STEADY_SPEEDS, last.tolist(), strict=True))
    assert abs(delta[0.0]) < 1e-20
    assert delta[2.0] == pytest.approx(-delta[-2.0], rel=1e-9)
    assert delta[2.0] == pytest.approx(-((0.2086 / 0.04003) ** 2) * 5e3 / 125**2, rel=1e-9)
    slow = -((0.2086 / 0.04003) ** 2) * 0.5**3 / 5**3
    assert delta[0.1] == pytest.approx(slow, rel=0.03)
    for name in ("Repeat", "least squares"):
        certificate = steady.estimates[name].certificate[:, -1]
        assert certificate[0] < 1e-20 and certificate[3:].min() > 1e-2


def test_at_standstill_the_wrong_flux_stays_and_is_not_certified(steady):
    lost = settling.size(steady, "least squares")[0]
    assert lost[-1] == pytest.approx(lost[0], rel=1e-9) and lost[0] > 0.1
    estimate = steady.estimates["least squares"]
    assert estimate.coasting[0].all() and not estimate.coasting[2:, 1:].any()


def test_a_reversal_upsets_repeat_and_not_least_squares(reversal):
    later = reversal.t > 1.0
    peak = {name: error[later].max() for name, error in reversal.error.items()}
    assert peak["least squares"] < 5e-3 < 1.0 < peak["Repeat, no guard"]
    assert peak["Repeat"] < 0.05 * peak["Repeat, no guard"]
    coasts = {name: reversal.t[later & c] for name, c in reversal.coasting.items()}
    assert coasts["Repeat, no guard"].size == coasts["least squares"].size == 0
    for name in ("Repeat", "least squares, lambda 50"):
        for instant in (math.pi, 2 * math.pi):
            assert np.abs(coasts[name] - instant).min() < 0.2
        below = reversal.certificate[name] < s.THRESHOLD
        np.testing.assert_array_equal(below, reversal.coasting[name])


def test_the_figure_of_the_reversal_is_the_same_bytes_every_time(reversal):
    runs = section3.Runs(*[None] * 10)._replace(reversal=reversal)
    figure = figures.reversal(runs)
    assert isinstance(figure, Figure)
    assert figure.png() == figure.png()
    rows = list(csv.DictReader(figure.csv().splitlines()))
    assert len(rows) == 8000
    errors = [float(row["least_squares_error_wb"]) for row in rows]
    np.testing.assert_allclose(errors, reversal.error["least squares"], rtol=1e-8)


@pytest.mark.slow
def test_the_panels_of_the_paper(closed):
    runs = section3.Runs(*[None] * 10)._replace(closed=_with_asymptotic(closed))
    for figure in (figures.flux_errors(runs), figures.exact_start(runs)):
        assert figure.png().startswith(b"\x89PNG")
    table = list(csv.DictReader(figures.flux_errors(runs).csv().splitlines()))
    last = [float(table[-1][f"fo2_gamma_5_{i}_wb"]) for i in (1, 2)]
    expected = closed.estimates["FO2, gamma 5"].value[-1] - closed.hidden[-1]
    np.testing.assert_allclose(last, expected, rtol=1e-8)
    assert np.linalg.norm(last) > 0.02
