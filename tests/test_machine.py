"""Machine descriptions: to the motor and observer they say, or refused by key."""

import math
from pathlib import Path

import numpy as np
import pytest

import aslo_jax as aslo
from aslo_jax.machines import MachineError, cutoff_for, electrical_speed, read_machine
from aslo_jax.plants import FluxRelation

MOTOR = """\
[machine]
kind = "pmsm"
resistance = 8.875
inductance = 40.03e-3
magnet_flux = 0.2086
pole_pairs = 5
inertia = 60e-6
"""


def write(folder: Path, text: str) -> Path:
    path = folder / "motor.toml"
    path.write_text(text)
    return path


def read(folder: Path, text: str):
    return read_machine(write(folder, text))


def refusal(folder: Path, text: str) -> str:
    with pytest.raises(MachineError) as error:
        read(folder, text)
    message = str(error.value)
    assert "motor.toml" in message
    assert "\n" not in message
    return message


def test_the_motor_has_the_numbers_of_the_file(tmp_path):
    motor = read(tmp_path, MOTOR).plant()
    assert isinstance(motor, aslo.plants.PMSM)
    assert float(motor.resistance) == 8.875
    assert float(motor.inductance) == 40.03e-3
    assert float(motor.magnet_flux) == 0.2086
    assert motor.pole_pairs == 5
    assert float(motor.inertia) == 60e-6


def test_what_is_missing_in_observer_has_a_default(tmp_path):
    machine = read(tmp_path, MOTOR)
    observer = machine.state_observer(machine.rates(given={"cutoff": 70.0}))
    assert isinstance(observer, aslo.AlgebraicObserver)
    assert isinstance(observer.filter, aslo.LowPass)
    assert float(observer.filter.rate) == 70.0
    assert isinstance(observer.completion, aslo.LeastSquares)
    assert observer.start == "exact"
    assert observer.guard == aslo.Guard(threshold=1e-3)
    with pytest.raises(MachineError, match="`log` must be given where neither `given` nor"):
        machine.rates()


def test_observer_settings_are_used(tmp_path):
    settings = """
[observer]
cutoff = 30
completion = "repeat"
start = "paper"
threshold = 0.02
gain = 12.5
"""
    machine = read(tmp_path, MOTOR + settings)
    observer = machine.state_observer(machine.rates())
    assert isinstance(observer, aslo.Asymptotic)
    assert float(observer.gain) == 12.5
    inner = observer.observer
    assert isinstance(inner.filter, aslo.LowPass)
    assert float(inner.filter.rate) == 30.0
    assert isinstance(inner.completion, aslo.Repeat)
    assert inner.start == "paper"
    assert inner.guard == aslo.Guard(threshold=0.02)
    relation = inner.relation
    assert isinstance(relation, FluxRelation)
    assert [float(relation.resistance), float(relation.inductance)] == [8.875, 40.03e-3]


FAULTS = {
    "missing": (
        MOTOR.replace("inertia = 60e-6", ""),
        "`machine.inertia`, inertia of the rotor (kg m^2), is missing: it must be a posi",
    ),
    "negative": (
        MOTOR.replace("8.875", "-8.875"),
        "`machine.resistance`, stator resistance (ohm), must be a positive finite number, "
        "but is -8.875",
    ),
    "zero": (MOTOR.replace("40.03e-3", "0"), "inductance (H), must be a positive finite"),
    "infinite": (MOTOR.replace("0.2086", "inf"), "(Wb), must be a positive finite number"),
    "text": (MOTOR.replace("8.875", '"8.875"'), "finite number, but is '8.875'"),
    "boolean": (MOTOR.replace("8.875", "true"), "finite number, but is True"),
    "half a pole pair": (
        MOTOR.replace("= 5", "= 5.5"),
        "`machine.pole_pairs`, number of pole pairs, must be a positive whole number, but "
        "is 5.5",
    ),
    "kind": (
        MOTOR.replace("pmsm", "induction"),
        '`machine.kind`, the kind of machine, must be one of "pmsm", "stepper", ',
    ),
    "no kind": (MOTOR.replace("kind", "#"), "`machine.kind`, the kind of machine, is miss"),
    "unknown key": (
        MOTOR + "resistanse = 1.0\n",
        'unknown key `machine.resistanse` of kind = "pmsm" (did you mean `resistance',
    ),
    "unknown table": (
        MOTOR + "[obsever]\n",
        "unknown key `obsever` (did you mean `observer`? allowed: machine, observer, "
        "calibration)",
    ),
    "no machine": (
        "[observer]\n",
        "`[machine]` is missing; its first key is `kind`, one of",
    ),
    "not a table": ("machine = 3\n", "the table `[machine]` must be a table"),
    "completion": (
        MOTOR + '[observer]\ncompletion = "dare"\n',
        '`observer.completion`, from one row to two, must be "least-squares" or "repeat", '
        "but is 'dare'",
    ),
    "start": (MOTOR + '[observer]\nstart = "cold"\n', 'must be "exact" or "paper"'),
    "cutoff": (
        MOTOR + "[observer]\ncutoff = 0.0\n",
        "a positive finite number, or { per_speed",
    ),
    "gain": (MOTOR + "[observer]\ngain = -5\n", "`observer.gain`"),
    "syntax": (MOTOR + "gain = \n", "is not valid TOML: Invalid value (at line 8"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_is_named_by_its_key(tmp_path, fault):
    text, expected = FAULTS[fault]
    assert expected in refusal(tmp_path, text)


def test_every_fault_is_told_at_once(tmp_path):
    message = refusal(tmp_path, MOTOR.replace("8.875", "-1").replace("= 5", "= 0"))
    assert "machine.resistance" in message
    assert "machine.pole_pairs" in message


def test_what_is_not_a_file(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"none\.toml does not exist"):
        read_machine(tmp_path / "none.toml")
    with pytest.raises(MachineError, match="is a directory"):
        read_machine(tmp_path)
    (tmp_path / "x.toml").write_bytes(b"\xff\xfe")
    with pytest.raises(MachineError, match="is not valid TOML"):
        read_machine(tmp_path / "x.toml")


@pytest.mark.parametrize("speed", [3.0, -40.0, 250.0])
def test_electrical_speed_of_a_turning_flux(speed):
    """A flux that turns at `speed` with u - R i = its derivative, then with noise on u."""
    rng = np.random.default_rng(1)
    t = 2e-4 * np.arange(8000)
    angle = speed * t
    y = 1.5 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    v = 0.2 * speed * np.stack([-np.sin(angle), np.cos(angle)], axis=1)
    found = electrical_speed(t, v + 8.0 * y, y, 8.0)
    # A chord of half a radian is sin(0.5)/0.5 = 0.96 of its arc.
    assert found == pytest.approx(abs(speed), rel=0.05)
    noise = 0.3 * 0.2 * abs(speed) * rng.standard_normal(v.shape)
    noisy = electrical_speed(t, v + noise + 8.0 * y, y, 8.0)
    assert noisy == pytest.approx(abs(speed), rel=0.10)


def test_cutoff_of_a_speed():
    assert cutoff_for(300.0) == pytest.approx(300.0 / math.sqrt(3.0))
    at_rest = electrical_speed(np.arange(4.0), np.zeros((4, 2)), np.zeros((4, 2)), 1.0)
    assert at_rest == 0.0
    assert cutoff_for(at_rest) == 5.0
