"""Exported C of machines of every kind: a log of each, as `replay` observes it."""

import held_logs
import numpy as np
import pytest
from compiled_c import Compiled, columns, error, rows_of
from exported_motor import SETTINGS, of_motor
from test_estimate_kinds import CASES

import aslo_jax as aslo
from aslo_jax.cli._export import exported_machine
from aslo_jax.machines import read_machine, template


@pytest.mark.parametrize("kind", CASES)
def test_a_log_of_every_kind(kind, tmp_path):
    case = CASES[kind]
    log = case.log(rows=401)
    machine = case.write(tmp_path)
    description = read_machine(machine)
    given = {"cutoff": 60.0}
    settings = SETTINGS | dict(interval=1e-4, prefix="machine")
    made = exported_machine(description, machine, given, **settings)
    signals = description.signals
    pick = lambda names: np.stack([log.get(n, 0.0 * log["t"]) for n in names], axis=1)
    u, y = pick((*signals.inputs, *signals.optional)), pick(signals.outputs)
    observer = description.state_observer(description.rates(given=given))
    wanted = lambda estimate: estimate
    if description.followed() is not None:
        loop = aslo.PhaseLockedLoop(100.0, within=True)
        observer = aslo.Staged(observer, loop, description.followed())
        wanted = of_motor
    expected = columns(wanted(aslo.replay(observer, 1e-4 * np.arange(401), u, y)))
    found = Compiled(made, tmp_path / "c")(rows_of(u, y))
    assert error(found, expected) < 1e-12


@pytest.mark.parametrize("kind", ["robotic_leg", "ball_beam", "drive"])
def test_a_log_of_every_mechanism(kind, tmp_path):
    machine = tmp_path / "machine.toml"
    machine.write_text(template(kind))
    description = read_machine(machine)
    settings = SETTINGS | dict(interval=1e-3, prefix="machine")
    made = exported_machine(description, machine, {"cutoff": 20.0}, **settings)
    signals, t = description.signals, 1e-3 * np.arange(300)
    wave = lambda n, f: np.stack([np.sin(f * t * (1 + 0.3 * k) + k) for k in range(n)], 1)
    u, y = wave(len(signals.inputs), 9.0), 1.0 + wave(len(signals.outputs), 7.0)
    observer = description.state_observer(description.rates(given={"cutoff": 20.0}))
    expected = columns(aslo.replay(observer, t, u, y))
    assert error(Compiled(made, tmp_path / "c")(rows_of(u, y)), expected) < 1e-12


def test_a_log_of_a_mechanism_in_python(tmp_path):
    """A crane, of which the machine's file names the module."""
    machine = tmp_path / "machine.toml"
    machine.write_text('[machine]\nkind = "mechanical"\nsystem = "robot:crane"\n')
    (tmp_path / "robot.py").write_text(held_logs.CRANE)
    description, log = read_machine(machine), held_logs.crane(rows=401)
    settings = SETTINGS | dict(interval=log["t"][1], prefix="crane")
    made = exported_machine(description, machine, {"cutoff": 20.0}, **settings)
    pick = lambda names: np.stack([log[name] for name in names], axis=1)
    u, y = pick(description.signals.inputs), pick(description.signals.outputs)
    observer = description.state_observer(description.rates(given={"cutoff": 20.0}))
    expected = columns(aslo.replay(observer, log["t"], u, y))
    assert np.ptp(expected, axis=0).max() > 0.1
    assert error(Compiled(made, tmp_path / "c")(rows_of(u, y)), expected) < 1e-12
