"""Section 4 of the paper: its propositions, its numbers, its claims, and the contenders."""

import csv
import dataclasses
import math

import jax
import numpy as np
import pytest
import scipy.integrate
import scipy.interpolate
from paper_claims import kind, replaced, verdicts

from aslo_jax import paper
from aslo_jax.paper import _section4 as section4
from aslo_jax.paper._section4 import (
    comparison_claims as comparison,
    figures,
    friction_claims as friction,
    identity_claims as identity,
    loops,
    records,
    settings as s,
    tables,
    tuning,
)

PRINTED = s.Printed()
FEW = {name: tuning.CONTENDERS[name] for name in ("ASLO", "high gain", "super-twisting")}


@pytest.fixture(scope="module")
def recorded():
    return records.record(s.ball())


@pytest.fixture(scope="module")
def leg():
    return loops.leg(PRINTED)


@pytest.fixture(scope="module")
def runs(recorded, leg):
    """The section's runs, of the sampled contenders a few on the ball and beam."""
    return section4.Runs(
        leg,
        loops.ball(PRINTED),
        *loops.friction(PRINTED),
        {"ball": tuning.compare(s.ball(), FEW, recorded)},
    )


def naive_proposition4(t, q, u, denominator, sign):
    """Prop. 4 line by line: every filter w' = lambda (x - w), by SciPy at 1e-10; m1 = 2,
    m2 = 3, lambda = 5, from zero but for that of pF[q2]."""
    m1, m2, lam = 2.0, 3.0, 5.0
    position, force = (scipy.interpolate.make_interp_spline(t, x, k=5) for x in (q, u))

    def lines(now, w):
        f1, f2, f3, fz, fi, fw1, fu2, fw4 = w
        (q1, q2, q3), (u1, u2) = position(now), force(now)
        z1, z2 = q1**2, u2 / (m1 * q1**2)
        w1 = lam * (q2 - f2) + fw1 / lam
        below = z1 * (fz if denominator == "F[z1]" else fi)
        rate2 = w1 / below if below > 0 else 0.0
        drives = [q1, q2, q3, z1, 1 / z1, z1 * z2 * fi, u2, q1 * rate2**2 + u1 / m1]
        rates = [lam * (x - y) for x, y in zip(drives, w, strict=True)]
        w3 = lam * (q3 - f3)
        return rates, [lam * (q1 - f1) + fw4 / lam, rate2, sign * fu2 / (m2 * lam) + w3]

    w = scipy.integrate.solve_ivp(
        lambda now, w: lines(now, w)[0],
        (0.0, t[-1]),
        [0.0, q[0, 1], 0, 0, 0, 0, 0, 0],
        "DOP853",
        t,
        rtol=1e-10,
        atol=1e-12,
        first_step=1e-6,
    ).y.T
    return np.array([lines(*each)[1] for each in zip(t, w, strict=True)])


@pytest.mark.parametrize(
    ("name", "form"),
    [
        ("Prop. 4", ("F[z1]", 1)),
        ("Prop. 4, F[1/z1]", ("F[1/z1]", 1)),
        ("Prop. 4, corrected", ("F[1/z1]", -1)),
    ],
)
def test_prop_4_is_its_lines(leg, name, form):
    run = leg
    expected = naive_proposition4(run.t, run.y, run.u, *form)
    # What interpolation between instants 10 ms apart leaves, more where the leg starts.
    later = run.t > 0.05
    found = run.estimates[name].value
    np.testing.assert_allclose(found[later], expected[later], rtol=0, atol=2e-6)


def test_the_printed_prop_4_is_wrong_by_the_errata(leg):
    late = leg.t > s.SETTLED
    worst = {
        name: np.abs(loops.error(leg, name)[late]).max(axis=0)
        for name in ("Prop. 4", "Prop. 4, F[1/z1]", "Prop. 4, corrected")
    }
    assert (worst["Prop. 4"] > 0.05).all()
    assert worst["Prop. 4, F[1/z1]"][:2].max() < 1e-9 < 0.2 < worst["Prop. 4, F[1/z1]"][2]
    assert worst["Prop. 4, corrected"].max() < 1e-9


def test_p2_decays_at_gamma_with_the_exact_start(leg):
    check_p2(leg)


@pytest.mark.slow
def test_p2_of_the_ball_decays_at_gamma_with_the_exact_start(runs):
    check_p2(runs.ball)


def check_p2(run):
    for gain in s.GAINS:
        error = loops.error(run, f"A-ASLO {gain:g}, exact")
        law = -run.hidden[0] * np.exp(-gain * run.t)[:, None]
        np.testing.assert_allclose(error, law, rtol=0, atol=1e-8)
        assert np.abs(loops.error(run, f"A-ASLO {gain:g}, paper") - law).max() > 0.1


def test_the_claims_of_the_leg(leg):
    claims = [
        *identity.proposition4(leg),
        *identity.asymptotic("leg", "4.1, Prop. 4, P2", leg),
    ]
    assert kind(claims, "not reproduced") == set()
    of_leg = {name for name in CORRECTED if name.startswith("leg")}
    assert kind(claims, "corrected") == of_leg


CORRECTED = {
    "leg, q2' as printed",
    "leg, q1' as printed",
    "leg, q3' as printed",
    "leg, printed start",
    "leg, rate, gamma > lambda",
    "leg, error, printed start",
    "ball, printed start",
    "ball, rate, gamma > lambda",
    "ball, error, printed start",
    "Assumption 3 with friction",
    "friction left out",
}


@pytest.mark.slow
def test_the_claims(runs):
    claims = section4.claims(runs)
    assert kind(claims, "not reproduced") == set()
    assert kind(claims, "corrected") == CORRECTED
    assert len({c.name for c in claims}) == len(claims) == 31


@pytest.mark.slow
def test_wrong_observers_are_found_out(runs):
    """A wrong gravity, a P2 with a quarter of its gain, and a Prop. 5 of another length."""
    ball = s.ball()
    system = ball.system
    heavy = dataclasses.replace(system, gravity=1.01 * system.gravity)
    quarters = tuple(0.25 * gain for gain in s.GAINS)
    observers = {
        "exact": s.a_aslo(s.aslo(heavy), system, quarters),
        "Prop. 5": PRINTED.ball(records.wrong(ball, {"length": 1}), s.RATE),
    }
    wrong = loops.solved(lambda: loops.simulated(ball, observers))
    both, slow = wrong.estimates["exact"], f"A-ASLO {s.GAINS[0]:g}"
    quarter = jax.tree.map(lambda x: x[:, 0], both["A-ASLO"])
    swapped = replaced(
        runs.ball,
        {
            "ASLO, exact": both["ASLO"],
            "Prop. 5": wrong.estimates["Prop. 5"],
            f"{slow}, exact": quarter,
            f"{slow}, paper": quarter,
        },
    )
    claims = [
        *identity.proposition5(swapped),
        *identity.asymptotic("ball", "4.2", swapped),
    ]
    assert kind(claims, "not reproduced") == {
        "ball, as printed",
        "ball, exact start",
        "ball, rate, gamma < lambda",
        "ball, error, exact start",
    }


@pytest.mark.slow
def test_a_right_prop_4_would_be_confirmed(runs):
    right = runs.leg.estimates["Prop. 4, corrected"]
    found = verdicts(identity.proposition4(replaced(runs.leg, {"Prop. 4": right})))
    for j in (1, 2, 3):
        assert found[f"leg, q{j}' as printed"] == "confirmed"
    assert found["leg, what q2' as printed is"] == "not reproduced"
    assert found["leg, what q3' as printed is"] == "not reproduced"
    # And the forms of friction, in place of each other.
    run = runs.constant
    swapped = replaced(run, {"integrated": run.estimates["left out"]})
    found = kind(friction.claims(swapped, runs.varying), "not reproduced")
    assert found == {"constant friction, integrated"}


def test_friction_adds_up_along_a_closed_path():
    assert abs(friction.circulation(0.0)) < 1e-12
    closed = 2 * math.pi * 0.3 / (2.0 * (1 - 0.2**2) ** 1.5)
    assert friction.circulation(0.3) == pytest.approx(closed, rel=1e-12)


@pytest.mark.slow
def test_friction_is_found_to_rounding_and_left_out_it_is_not(runs):
    later = runs.varying.t >= 5.0
    assert np.abs(loops.error(runs.varying, "bounded")[later]).max() < 1e-8
    assert np.abs(loops.error(runs.constant, "integrated")[1:]).max() < 1e-8
    rms = np.sqrt(np.mean(loops.error(runs.constant, "left out")[100:] ** 2, axis=0))
    # Of a constant inertia the error is R F[q']/(m lambda), here of the body.
    t, speed = runs.constant.t, runs.constant.hidden[:, 2]
    filtered = scipy.integrate.solve_ivp(
        lambda now, w: 5.0 * (np.interp(now, t, speed) - w),
        (0.0, t[-1]),
        [0.0],
        t_eval=t,
        max_step=0.01,
    ).y[0]
    expected = np.sqrt(np.mean((0.5 * filtered / (3.0 * 5.0))[100:] ** 2))
    assert rms[2] == pytest.approx(expected, rel=2e-3)
    assert 8e-3 < rms[0] < 1.2e-2


@pytest.mark.slow
def test_every_contender_has_the_same_budget_and_its_gains_in_the_box(runs):
    # As many records of validation as trials on records of training: compiled once.
    lanes = len(records.CASES) * records.VALIDATION
    assert lanes == tuning.TRIALS * records.TRAINING
    for tuned in runs.compared["ball"].tuned.values():
        for name, found in tuned.items():
            low, high = tuning.CONTENDERS[name].box
            assert (found.gains >= low * (1 - 1e-9)).all()
            assert (found.gains <= high * (1 + 1e-9)).all()
            assert found.rms.shape == (records.VALIDATION, 2)
            assert (found.peak >= found.rms).all() and (found.rms > 0).all()
            later = tuning.INSTANTS >= tuning.START_UP
            rms = np.sqrt(np.mean(found.first[later] ** 2, axis=0))
            np.testing.assert_allclose(found.rms[0], rms)


@pytest.mark.slow
def test_the_tuned_aslo_beats_the_tuned_differentiators(runs):
    ball = runs.compared["ball"]
    for case, tuned in ball.tuned.items():
        assert (comparison.ratios(tuned) < (0.7 if "wrong" in case else 0.2)).all()
    # A differentiator trades noise for lag: an encoder 16 times as fine makes its error
    # smaller, but by less.
    coarse, fine = (ball.tuned[case]["high gain"].total for case in ("12 bit", "16 bit"))
    assert (coarse / fine > 2).all() and (coarse / fine < 16).all()
    # A wrong model costs more than an encoder, and matters to a slow filter.
    swept = ball.swept
    assert (swept["gravity"][0] > 100 * swept["nothing"][0]).all()
    np.testing.assert_allclose(swept["gravity"][-1], swept["nothing"][-1], rtol=0.01)
    assert list(swept) == ["nothing", "length", "gravity"]


@pytest.mark.slow
def test_where_the_aslo_is_worse_it_is_said(runs):
    ball = runs.compared["ball"]
    tuned = ball.tuned["16 bit"]
    poor = tuned["ASLO"]._replace(rms=2.0 * tuned["high gain"].rms * np.array([1.0, 0.1]))
    worse = ball._replace(tuned=ball.tuned | {"16 bit": tuned | {"ASLO": poor}})
    claims = {c.name: c for c in comparison.claims({"ball": worse})}
    assert claims["ball, q1', 16 bit"].verdict == "corrected: it is 2 times as large"
    assert claims["ball, q2', 16 bit"].verdict == "confirmed"
    assert claims["ball, q2', 16 bit"].measured == pytest.approx(0.2)
    table = tables.comparison(runs._replace(compared={"ball": worse}))
    said = {(row["case"], row["velocity"]): row for row in table.rows}
    assert said["16 bit", "q1'"]["ASLO is"] == "worse"
    assert said["16 bit", "q1'"]["ASLO over it"] == "2"
    assert said["16 bit", "q2'"]["ASLO is"] == "no worse"


@pytest.mark.slow
def test_run_writes_every_figure_table_and_claim(runs, tmp_path, capsys, monkeypatch):
    section = dataclasses.replace(section4.SECTION, run=lambda printed: runs)
    monkeypatch.setattr(section4, "SECTION", section)
    paper.run(4, tmp_path)
    names = {path.name for path in tmp_path.iterdir()}
    drawn = ("identities", "proposition4", "friction", "peers", "tuned", "model_errors")
    expected = {f"{name}.{kind}" for name in drawn for kind in ("png", "pdf", "csv")}
    listed = ("settling", "comparison", "contenders", "claims")
    expected |= {f"{name}.{kind}" for name in listed for kind in ("md", "csv")}
    assert names == expected | {"index.md"}
    assert "31 claims: 20 confirmed, 11 corrected, 0 not" in capsys.readouterr().out

    rows = {
        (row["experiment"], row["observer"], row["velocity"]): row
        for row in read(tmp_path / "settling.csv")
    }
    # 5 exp(-5 t) m/s falls below 5 % of 0.2 m/s at 1.24 s.
    assert rows["leg", "Prop. 4, corrected", "q1'"]["settled_5_percent_s"] == "1.24"
    assert rows["leg", "ASLO, exact", "q1'"]["settled_0.1_percent_s"] == "0"
    assert rows["leg", "Prop. 4", "q2'"]["settled_5_percent_s"] == "> 8"
    assert float(rows["leg, constant friction", "left out", "q1'"]["rms"]) > 5e-3
    rows = read(tmp_path / "contenders.csv")
    assert len(rows) == len(records.CASES) * len(FEW) * 2
    gains = runs.compared["ball"].tuned["12 bit"]["high gain"].gains
    found = [
        r["value"] for r in rows if (r["case"], r["contender"]) == ("12 bit", "high gain")
    ]
    assert found == [f"{gain:.3g}" for gain in gains]

    table = read(tmp_path / "model_errors.csv")
    rates = np.array([float(row["lambda_rad_per_s"]) for row in table])
    np.testing.assert_allclose(rates, tuning.RATES, rtol=1e-8)
    for name in drawn:
        header = list(read(tmp_path / f"{name}.csv")[0])
        assert len(set(header)) == len(header)
        units = ("_s", "_per_s", "_index")
        assert all(column.endswith(units) for column in header), header
    assert figures.friction(runs).png() == (tmp_path / "friction.png").read_bytes()


def read(path):
    with path.open() as file:
        return list(csv.DictReader(file))
