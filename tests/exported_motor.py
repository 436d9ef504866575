"""The shipped motor and its recorded log, for the tests of exported C."""

import functools
import subprocess
from pathlib import Path

import numpy as np
import pytest
from compiled_c import columns, compiler

import aslo_jax as aslo
from aslo_jax.cli import main
from aslo_jax.cli._export import _of_motor as of_motor, exported_machine
from aslo_jax.logs import Log, read_log
from aslo_jax.machines import read_machine

ROOT = Path(__file__).parents[1]
MOTOR = ROOT / "aslo_jax" / "data" / "motor.toml"
LOG = ROOT / "aslo_jax" / "data" / "pmsm_log.csv"
SETTINGS = dict(
    interval=2e-4, dtype="float64", prefix="motor", substeps=1, missing="refuse", fixed=()
)


def command(*arguments) -> int:
    with pytest.raises(SystemExit) as left:
        main([str(a) for a in arguments])
    return left.value.code or 0


def export_motor(**settings):
    return exported_machine(read_machine(MOTOR), MOTOR, {}, **(SETTINGS | settings))


def motor_observer():
    """What the command exports, as the library has it."""
    machine = read_machine(MOTOR)
    rates = machine.rates()
    loop = aslo.PhaseLockedLoop(rates["pll_bandwidth"].value, within=True)
    return aslo.Staged(machine.state_observer(rates), loop, machine.followed())


@functools.cache
def motor_log() -> Log:
    return read_log(LOG)


@functools.cache
def motor_estimate() -> np.ndarray:
    """What `replay` makes of the log, column by column."""
    log = motor_log()
    return columns(of_motor(aslo.replay(motor_observer(), log.t, log.u, log.y)))


def ran(folder: Path, main: str, *sources: str) -> int:
    (folder / "own.c").write_text(main)
    out = folder / "own"
    subprocess.run(
        [*compiler(), "-std=c99", "-O1", "-o", out, "own.c", *sources],
        cwd=folder,
        check=True,
    )
    return subprocess.run([out]).returncode
