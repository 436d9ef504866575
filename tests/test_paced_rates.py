"""Rates that follow the speed: in a machine's file, chosen for a log, and tuned."""

import json
import tomllib

import motor_logs
import numpy as np
import pytest
from test_two_rates import MOTORS, as_log, described, error, pair

import aslo_jax as aslo
from aslo_jax.cli import main
from aslo_jax.described import by_table, changed, tune_study
from aslo_jax.machines import MachineError, PMSMDescription, read_machine
from aslo_jax.machines._rates import PerSpeedTable
from aslo_jax.schedules import PerSpeed
from aslo_jax.schema._toml_text import rewritten

PACE = "{ per_speed = 1.3, low = 4.0, high = 240.0 }"


def test_a_file_says_how_a_rate_follows_the_speed(tmp_path):
    machine = described(tmp_path, MOTORS[0], f"cutoff = 20.0\nforgetting = {PACE}")
    clean = motor_logs.run(MOTORS[0], "reversal")
    rates = machine.rates(as_log(clean))
    assert rates["cutoff"].constant == 20.0 and rates["cutoff"].as_json() == 20.0
    assert str(rates["forgetting"]).startswith("1.3 times the electrical speed, from 4 to")
    assert rates["forgetting"].as_json()["high"] == 240.0
    observer = machine.state_observer(rates)
    relation = aslo.plants.FluxRelation(MOTORS[0].R, MOTORS[0].Ld, MOTORS[0].psi)
    magnet = lambda u, y, x: x - MOTORS[0].Ld * y
    by_hand = aslo.AlgebraicObserver(
        relation,
        aslo.LowPass(20.0),
        aslo.LeastSquares(aslo.LowPass(PerSpeed(1.3, 4.0, 240.0, vector=magnet))),
        aslo.Guard(1e-3),
    )
    log = as_log(clean)
    both = [aslo.replay(o, log.t, log.u, log.y).value for o in (observer, by_hand)]
    np.testing.assert_allclose(*both, rtol=0, atol=1e-14)


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ("cutoff = { per_speed = -1.0 }", r"observer\.cutoff"),
        ("cutoff = { pace = 1.0 }", r"observer\.cutoff"),
        ('cutoff = "fast"', "number, or { per_speed = 1.0, low = 2.0, high = 300.0 }"),
        ("cutoff = { low = 9.0, high = 3.0 }", "at most `high`"),
    ],
)
def test_what_is_no_rate_is_refused(tmp_path, keys, message):
    with pytest.raises(MachineError, match=message):
        described(tmp_path, MOTORS[0], keys)


def test_other_machines_have_numbers_alone(tmp_path):
    path = tmp_path / "leg.toml"
    path.write_text(
        '[machine]\nkind = "robotic_leg"\nm1 = 2.0\nm2 = 3.0\n'
        f"[observer]\ncutoff = {PACE}\n"
    )
    with pytest.raises(MachineError, match=r"`observer\.cutoff`"):
        read_machine(path)


@pytest.mark.parametrize("motor", MOTORS, ids=lambda m: m.name)
def test_it_is_chosen_where_the_speed_varies_and_is_better_there(tmp_path, motor):
    machine = described(tmp_path, motor)
    clean = motor_logs.run(motor, "reversal")
    log = as_log(motor_logs.noisy(clean, motor, 4, 8e-3, 4e-3))
    rates = machine.rates(log)
    assert isinstance(rates["forgetting"].value, PerSpeedTable)
    assert "for speeds from" in rates["forgetting"].reason
    fixed = {name: rates[name].least for name in ("cutoff", "forgetting")}
    held = machine.rates(log, fixed)
    assert held["forgetting"].value == fixed["forgetting"]
    flux = pair(clean["flux"])
    assert error(machine, rates, log, flux) < 0.95 * error(machine, held, log, flux)
    steady = motor_logs.noisy(motor_logs.run(motor, "load"), motor, 4, 8e-3, 4e-3)
    assert isinstance(machine.rates(as_log(steady))["forgetting"].value, float)


def test_the_command_says_what_it_follows(tmp_path, capsys):
    motor = MOTORS[0]
    found = motor_logs.noisy(motor_logs.run(motor, "reversal"), motor, 4, 8e-3, 4e-3)
    u, i = pair(found["u"]), pair(found["i"])
    table = np.column_stack([found["t"], u, i])
    names = "t,u_alpha,u_beta,i_alpha,i_beta"
    np.savetxt(tmp_path / "log.csv", table, delimiter=",", header=names, comments="")
    described(tmp_path, motor)
    out, summary = tmp_path / "out.csv", tmp_path / "summary.json"
    with pytest.raises(SystemExit) as ended:
        main(
            [
                "estimate",
                f"{tmp_path}/log.csv",
                "--machine",
                f"{tmp_path}/machine.toml",
                "--out",
                str(out),
                "--json",
                str(summary),
            ]
        )
    assert ended.value.code == 0
    assert "times the electrical speed, from" in capsys.readouterr().out
    rates = json.loads(summary.read_text())["rates"]
    assert set(rates["forgetting"]) == {"per_speed", "low", "high", "bandwidth"}


STUDY = f"""
title = "A drive"
interval = 1e-3
horizon = 0.6
[machine]
kind = "pmsm"
resistance = 2.1
inductance = 9e-3
magnet_flux = 0.11
pole_pairs = 4
inertia = 2e-4
load = {{ offset = 0.3 }}
[control]
kind = "field_oriented"
reference = {{ offset = 20.0, amplitude = 15.0, frequency = 8.0 }}
current_limit = 6.0
[observers.A]
kind = "aslo"
cutoff = {PACE} # of the rows
forgetting = 9.0
[[sensor]]
kind = "noise"
deviation = 0.02
[spread.load]
where = "plant.load.offset"
distribution = "uniform"
low = 0.2
high = 0.4
[metrics.rms]
kind = "rms"
"""


@pytest.mark.slow
def test_what_it_follows_is_tuned():
    content = tomllib.loads(STUDY)
    settings = dict(samples=4, iterations=2, engine="scan")
    found = tune_study(content, **settings)["A"]
    assert set(found.before) == {"cutoff.per_speed", "forgetting"}
    assert found.before["cutoff.per_speed"] == 1.3
    assert found.after["cutoff.per_speed"] != 1.3
    ends = tune_study(content, ["A.cutoff.low", "A.cutoff.high"], **settings)["A"]
    middle = (4.0 * 240.0) ** 0.5
    assert ends.after["cutoff.low"] <= middle <= ends.after["cutoff.high"]
    with pytest.raises(ValueError, match=r"A\.cutoff\.per_speed, A\.cutoff\.low"):
        tune_study(content, ["A.cutoff"], **settings)


def test_new_gains_go_into_their_tables():
    values = by_table("A", {"cutoff.per_speed": 2.5, "forgetting": 11.0})
    assert values == {
        "observers.A.cutoff": {"per_speed": 2.5},
        "observers.A": {"forgetting": 11.0},
    }
    text = rewritten(STUDY, values)
    assert "cutoff = { per_speed = 2.5, low = 4.0, high = 240.0 } # of the rows" in text
    assert tomllib.loads(text) == changed(tomllib.loads(STUDY), values)


def test_a_rate_of_its_own_kind_is_no_number():
    keys = {"kind": "pmsm", "resistance": 1.0, "inductance": 1e-3, "magnet_flux": 0.1}
    machine = PMSMDescription.model_validate(
        {
            "machine": keys | {"pole_pairs": 2, "inertia": 1e-4},
            "observer": {"cutoff": {"per_speed": 1.0}},
        }
    )
    with pytest.raises(TypeError, match="must be a number"):
        machine.rates()["cutoff"].constant  # noqa: B018
