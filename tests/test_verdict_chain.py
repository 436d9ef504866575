"""The verdict together with the other links of the chain: missing samples, frames."""

import numpy as np
import pytest
from motor_logs import (
    MOTORS,
    as_log,
    estimated,
    in_alpha_beta,
    late,
    noisy,
    run,
    spiked,
)

from aslo_jax.diagnosis import diagnose

BY_NAME = {motor.name: motor for motor in MOTORS}
SERVO = BY_NAME["servo"]
NOTHING = complex(np.nan, np.nan)


slow = lambda *values: [pytest.param(v, marks=pytest.mark.slow) for v in values]


def recorded(motor=SERVO, profile="rich", noise=0.005):
    return noisy(run(motor, profile), motor, 3, noise)


def holed(log, share, seed=6, longest=8):
    """Without some samples of the current, some of the voltage, and a stretch of rows."""
    generator = np.random.default_rng(seed)
    lost = lambda: generator.random(log["t"].size) < share
    u, i = log["u"].copy(), log["i"].copy()
    u[lost()] = NOTHING
    i[lost()] = NOTHING
    i[700 : 700 + longest] = NOTHING
    return log | {"u": u, "i": i}


def kinds(log, motor=SERVO):
    return [w.kind for w in diagnose(as_log(log), [motor.circle()]).warnings]


@pytest.mark.parametrize("share", [0.003, 0.03, 0.1])
@pytest.mark.parametrize("profile", ["rich", "start", "steps"])
@pytest.mark.parametrize("name", ["servo", *slow("drone", "stepper")])
def test_right_logs_with_holes_pass_in_silence(name, profile, share):
    motor = BY_NAME[name]
    assert kinds(holed(recorded(motor, profile, 0.02), share), motor) == []


@pytest.mark.parametrize("share", [0.003, 0.03])
def test_causes_are_named_through_holes(share):
    log = recorded()
    assert kinds(holed(log | {"i": -log["i"]}, share)) == ["sign"]
    assert kinds(holed(log | {"u": late(log["u"], 2)}, share)) == ["voltage_timing"]
    for seed in range(4):
        spike = spiked(log, 1234, 12 * SERVO.current)
        assert kinds(holed(spike, share, seed)) == ["outliers"]


def test_an_outlier_beside_a_hole_is_found():
    log = spiked(recorded(), 1234, 12 * SERVO.current)
    for lost in ([1233], [1235], [1233, 1235], [1232, 1236], [1235, 1236, 1237]):
        i = log["i"].copy()
        i[lost] = NOTHING
        (warning,) = diagnose(as_log(log | {"i": i}), [SERVO.circle()]).warnings
        assert (warning.kind, warning.rows) == ("outliers", (1234,))


def off(table, log):
    flux = table["flux_alpha"] + 1j * table["flux_beta"]
    trusted = (table["coasting"] == 0) & (table["t"] > 0.03)
    assert trusted.mean() > 0.5
    return np.abs(flux - log["flux"])[trusted].max() / SERVO.psi


def test_the_command_coasts_over_holes(tmp_path, capsys, monkeypatch):
    from aslo_jax.cli import _table as tables

    log = recorded()
    columns = in_alpha_beta(holed(log, 0.02))
    whole = estimated(tmp_path, SERVO, columns, "--missing", "coast")
    monkeypatch.setattr(tables, "PIECE", 1300)
    pieces = estimated(tmp_path, SERVO, columns, "--missing", "coast")
    for summary, table in (whole, pieces):
        assert summary["warnings"] == []
        assert np.isfinite(list(table.values())).all()
        assert table["coasting"][700:708].all()
        assert off(table, log) < 0.03
        assert summary["quantities"]["flux"]["relative_max"] < 0.03
    np.testing.assert_allclose(
        pieces[1]["flux_alpha"], whole[1]["flux_alpha"], atol=1e-9 * SERVO.psi
    )
    assert "aslo-jax: warning" not in capsys.readouterr().err


def test_the_command_mends_a_log_with_holes_too(tmp_path, capsys):
    log = recorded()
    spike = holed(spiked(log, 2000, 30 * SERVO.current), 0.02)
    spike["u"][2000] = spike["i"][1999] = NOTHING
    summary, table = estimated(
        tmp_path, SERVO, in_alpha_beta(spike), "--missing", "coast", "-q"
    )
    assert [w["kind"] for w in summary["warnings"]] == ["outliers"]
    assert np.isfinite(list(table.values())).all()
    assert off(table, log) < 0.05


def in_dq(log, angle):
    turn = np.exp(-1j * angle)
    u, i = log["u"] * turn, log["i"] * turn
    names = dict(u_d=u.real, u_q=u.imag, i_d=i.real, i_q=i.imag, theta_e=angle)
    return dict(t=log["t"], **names)


def test_the_verdict_is_on_logs_in_other_frames(tmp_path, capsys):
    """A voltage held in dq is that of the instant, half a step late in its mean."""
    log = recorded()
    named = lambda columns, *options: [
        w["kind"]
        for w in estimated(tmp_path, SERVO, columns, *options, "-q")[0]["warnings"]
    ]
    dq = in_dq(log, log["angle"])
    assert named(dq, "--frame", "dq") == []
    half = 0.5 * np.gradient(log["angle"])
    held = dq | {k: in_dq(log, log["angle"] + half)[k] for k in ("u_d", "u_q")}
    assert named(held, "--frame", "dq") in ([], ["voltage_instant"])
    assert named(held, "--frame", "dq", "--voltage", "instant") == []
    wrong = in_dq(log, log["angle"]) | {"theta_e": log["angle"] / SERVO.pole_pairs}
    assert len(named(wrong, "--frame", "dq")) == 1
    phases = np.exp(2j * np.pi / 3 * np.arange(3))
    abc = lambda x: dict(zip("abc", (x[:, None] * phases.conj()).real.T, strict=True))
    both = {f"u_{k}": x for k, x in abc(log["u"]).items()}
    both |= {f"i_{k}": x for k, x in abc(log["i"]).items()} | {"t": log["t"]}
    assert named(both, "--frame", "abc") == []
    swapped = both | {"i_b": both["i_c"], "i_c": both["i_b"]}
    assert named(swapped, "--frame", "abc") == ["beta_flipped"]
