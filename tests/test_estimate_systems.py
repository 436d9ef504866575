"""Descriptions of mechanical systems: to the system they say, which may be Python beside
the file, or refused by name."""

import sys
from pathlib import Path

import held_logs
import numpy as np
import pytest
from test_estimate_mechanical import CASES, run

from aslo_jax.logs import Log
from aslo_jax.machines import MachineError, read_machine
from aslo_jax.observers import Velocities
from aslo_jax.plants import BallBeam, MechanicalSystem, RoboticLeg


def test_a_description_is_the_system_it_says(tmp_path):
    leg = read_machine(CASES["leg"].write(tmp_path)).plant()
    assert isinstance(leg, RoboticLeg)
    assert [float(leg.m1), float(leg.m2), *leg.damping] == [2.0, 3.1, 0.3, 0.2, 0.5]
    ball = read_machine(CASES["ball"].write(tmp_path)).plant()
    assert isinstance(ball, BallBeam)
    assert [float(ball.length), float(ball.gravity), *ball.damping] == [1.2, 9.81, 0.1, 0.3]
    crane = read_machine(CASES["crane"].write(tmp_path))
    assert isinstance(crane.plant(), MechanicalSystem)
    assert crane.signals.inputs == ("u1", "u2")
    assert crane.signals.outputs == ("q1", "q2", "q3")
    assert [q.unit for q in crane.quantities] == ["m/s", "rad/s", "rad/s"]


PLAIN = """\
import jax.numpy as jnp
from aslo_jax.plants import MechanicalSystem

def bob():
    return MechanicalSystem(lambda q: jnp.stack([MASS]), position=[0.0])

class Shelf:
    bob = bob()

number = 3.0
"""


def named(folder: Path, system: str, source: str = PLAIN) -> Path:
    folder.mkdir(exist_ok=True)
    (folder / "arm.py").write_text(source.replace("MASS", "2.0"))
    path = folder / "machine.toml"
    path.write_text(f'[machine]\nkind = "mechanical"\nsystem = "{system}"\n')
    return path


def test_a_system_is_imported_from_beside_its_file(tmp_path, monkeypatch):
    """An attribute, one of an attribute, what a function returns, in a package; imports are
    as they were afterwards, and equal names in two folders are two modules."""
    before, modules = list(sys.path), set(sys.modules)
    for system in ("arm:bob", "arm:Shelf.bob"):
        machine = read_machine(named(tmp_path / "one", system))
        assert float(machine.plant().inertia(np.zeros(1))[0, 0]) == 2.0
        assert machine.signals.required == ("t", "u1", "q1")
    package = tmp_path / "one" / "parts"
    package.mkdir()
    (package / "__init__.py").write_text("")
    (package / "arm.py").write_text(PLAIN.replace("MASS", "7.0"))
    (tmp_path / "one" / "machine.toml").write_text(
        '[machine]\nkind = "mechanical"\nsystem = "parts.arm:bob"\n'
    )
    machine = read_machine(tmp_path / "one" / "machine.toml")
    assert float(machine.plant().inertia(np.zeros(1))[0, 0]) == 7.0
    other = named(tmp_path / "two", "arm:bob", PLAIN.replace("MASS", "5.0"))
    assert float(read_machine(other).plant().inertia(np.zeros(1))[0, 0]) == 5.0
    monkeypatch.chdir(tmp_path / "two")
    assert float(read_machine("machine.toml").plant().inertia(np.zeros(1))[0, 0]) == 5.0
    assert sys.path == before
    assert not {"arm", "parts", "parts.arm"} & (set(sys.modules) - modules)


COUPLED = PLAIN.replace(
    "lambda q: jnp.stack([MASS]), position=[0.0]",
    "lambda q: jnp.array([[2.0, 0.5], [0.5, 1.0]]), position=[0.0, 0.0]",
)
REFUSED = {
    "no module": ("legs:bob", PLAIN, "there is no module `legs`, neither in "),
    "no package": ("legs.arm:bob", PLAIN, "there is no module `legs`, neither in "),
    "no attribute": (
        "arm:bobb",
        PLAIN,
        "`machine.system`, arm:bobb: there is no attribute `bobb` in it; did you mean "
        "`bob`?",
    ),
    "a number": (
        "arm:number",
        PLAIN,
        "arm:number: it must be an `AbstractMechanicalSystem`, for instance a "
        "`MechanicalSystem`, or return one, but it is a float",
    ),
    "it returns a number": (
        "arm:bob",
        "def bob():\n    return 1\n",
        "or return one, but it is an int",
    ),
    "it wants arguments": (
        "arm:bob",
        "def bob(mass):\n    return 1\n",
        "calling bob() failed with TypeError: bob() missing 1 required positional",
    ),
    "it does not run": (
        "arm:bob",
        "bob = 1 / 0\n",
        "importing it failed with ZeroDivisionError: division by zero",
    ),
    "it lacks a package": (
        "arm:bob",
        "import no_such_package_here\n",
        "importing it failed with ModuleNotFoundError: No module named 'no_such_package",
    ),
    "syntax": ("arm:bob", "def bob(:\n", "importing it failed with SyntaxError: "),
    "no path": (
        "arm.bob",
        PLAIN,
        "`machine.system`, an `AbstractMechanicalSystem`, or what returns one; Python that "
        'is run, must be "module:attribute", with dots where there are packages, but is '
        "'arm.bob'",
    ),
    "not of the class": (
        "arm:bob",
        COUPLED,
        "`machine.system`, arm:bob: Assumption 2 fails: the inertia matrix is not "
        "diagonal, M[0, 1] = 0.5",
    ),
}


@pytest.mark.parametrize("fault", REFUSED)
def test_what_is_no_system_is_refused(tmp_path, fault):
    system, source, expected = REFUSED[fault]
    path, before = named(tmp_path, system, source), list(sys.path)
    with pytest.raises(MachineError) as error:
        read_machine(path)
    assert str(error.value).startswith(f"{path}: ")
    assert expected in str(error.value)
    assert sys.path == before and "arm" not in sys.modules


FAULTS = {
    "friction below zero": (
        "leg",
        dict(damping="[0.3, -0.2, 0.5]"),
        "",
        "`machine.damping`, friction of length, leg and body (N s/m, N m s/rad), must be "
        "three finite numbers that are not negative, but is [0.3, -0.2, 0.5]",
    ),
    "too little friction": (
        "ball",
        dict(damping="[0.3]"),
        "",
        "must be two finite numbers that are not negative, but is [0.3]",
    ),
    "no mass": ("leg", dict(m1="0.0"), "", "(kg), must be a positive finite number"),
    "no length": ("ball", dict(length="-1.0"), "", "must be a positive finite number"),
    "a loop": (
        "crane",
        {},
        "pll_bandwidth = 5.0",
        '`observer.pll_bandwidth` is not for kind = "mechanical": its velocities come from '
        "its equations, not from a loop that follows an angle; remove it",
    ),
    "a rotor": (
        "leg",
        {},
        "rotor_cutoff = 5.0",
        'unknown key `observer.rotor_cutoff` of kind = "robotic_leg" (did you mean `cut',
    ),
    "saliency": ("ball", {}, 'saliency = "x"', '`observer.saliency` of kind = "ball_beam"'),
    "completion": (
        "ball",
        {},
        'completion = "both"',
        '`observer.completion`, how the row is solved, must be "least-squares" or "repeat"',
    ),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_faults_are_named_by_their_key(tmp_path, fault):
    name, changes, observer, expected = FAULTS[fault]
    path = CASES[name].write(tmp_path, observer, **changes)
    with pytest.raises(MachineError) as error:
        read_machine(path)
    assert expected in str(error.value)


def test_options_and_columns_that_do_not_fit_are_refused(tmp_path, capsys):
    path, log = CASES["ball"].write(tmp_path), held_logs.ball(21)
    code, _, err = run(capsys, tmp_path, log, "--pll-bandwidth", 50)
    assert code == 2
    assert f'--pll-bandwidth is not for {path}, whose kind is "ball_beam": its vel' in err
    code, _, err = run(capsys, tmp_path, {k: v for k, v in log.items() if k != "q2"})
    assert code == 2 and "has no column `q2`" in err
    code, _, err = run(capsys, tmp_path, log, "--column", "q3=q2")
    assert code == 2
    assert "must name one of t, u1, q1, q2, qdot1_true, qdot2_true, but got `q3`" in err
    with pytest.raises(MachineError, match="`log` must be given where neither"):
        read_machine(path).rates()


VARYING = PLAIN.replace(
    "position=[0.0])", "position=[0.0], friction=lambda q: 40.0 + 20 * jnp.cos(q))"
)


def test_varying_friction_wants_a_faster_filter(tmp_path):
    """60 N s/m over 2 kg at the most, hence above 30 rad/s, by default 60."""
    path = named(tmp_path, "arm:bob", VARYING)
    machine, t = read_machine(path), 1e-3 * np.arange(1001)
    log = Log(t, np.zeros((1001, 1)), np.ones((1001, 1)), {})
    assert machine.rates(log)["cutoff"].value == pytest.approx(60.0, rel=1e-2)
    assert machine.rates(log)["cutoff"].reason.startswith("twice the varying friction")
    with pytest.raises(MachineError, match=r"the cutoff must be above (29|30)\S* rad/s"):
        machine.rates(log, {"cutoff": 25.0})
    assert machine.rates(log, {"cutoff": 35.0})["cutoff"].value == 35.0
    observer = machine.state_observer(machine.rates(log))
    assert isinstance(observer, Velocities)  # no angle, nothing to unwrap
