"""What a machine's file and a log may say, kind by kind: defaults, refusals, warnings,
figures, templates."""

import re
from pathlib import Path

import held_logs
import numpy as np
import pytest

import aslo_jax as aslo
from aslo_jax.cli import main
from aslo_jax.logs import write_table
from aslo_jax.machines import KINDS, MachineError, read_machine, template
from aslo_jax.plants import (
    WRIM,
    BallBeam,
    Drive,
    InteriorPMSM,
    MagneticBearing,
    RoboticLeg,
    Stepper,
    VariableLengthPendulum,
)

# As the presets of the plants; the bearing's force constant rounded.
PRESETS = {
    "pmsm": aslo.plants.PMSM.bmp0701f,
    "stepper": lambda: Stepper.bodson(friction=0.0),
    "interior_pmsm": InteriorPMSM.motulator_2200w,
    "wrim": lambda: WRIM.dfig_2mw(friction=0.0),
    "magnetic_bearing": lambda: MagneticBearing.laboratory(
        resistance=np.array([2.0, 2.0]), force_constant=2.0106e-5
    ),
    "robotic_leg": lambda: RoboticLeg(2.0, 3.0),
    "ball_beam": lambda: BallBeam(1.2, 9.81),
    "drive": lambda: Drive(400.0, 20e3),
    "mechanical": lambda: VariableLengthPendulum(1.3),
    "derived": lambda: aslo.derive(
        aslo.Model(
            lambda x, y, u: [u[0] - x[0]],
            lambda x, y, u: [x[0] - y[0]],
            states={"speed": (-1, 1)},
            outputs={"current": (-1, 1)},
            inputs={"voltage": (-1, 1)},
        )
    ).plant(),
}
MOTOR = """\
import aslo_jax as aslo

model = aslo.Model(
    lambda x, y, u: [u[0] - x[0]],
    lambda x, y, u: [x[0] - y[0]],
    states={"speed": (-1, 1)},
    outputs={"current": (-1, 1)},
    inputs={"voltage": (-1, 1)},
)
"""
ROBOT = """\
from aslo_jax.plants import VariableLengthPendulum

arm = VariableLengthPendulum(1.3)
"""


def run(capsys, *arguments) -> tuple[int, str, str]:
    """Exit code, standard output and standard error of a command."""
    with pytest.raises(SystemExit) as left:
        main([str(argument) for argument in arguments])
    output = capsys.readouterr()
    return int(left.value.code or 0), output.out, output.err


def estimate(capsys, folder: Path, log, *options) -> tuple[int, str, str]:
    """`log` is a file, or the columns of one; the machine is machine.toml."""
    if isinstance(log, dict):
        write_table(folder / "log.npz", log)
        log = folder / "log.npz"
    arguments = ("--machine", folder / "machine.toml", "--out", folder / "out.npz")
    return run(capsys, "estimate", log, *arguments, *options)


def machine(folder: Path, kind: str, *changes: tuple[str, str], observer: str = "") -> Path:
    """The template of a kind with replacements, and keys of its `[observer]`."""
    text = template(kind)
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    path = folder / "machine.toml"
    path.write_text(text + observer + "\n")
    return path


@pytest.fixture(scope="module")
def wrim_log():
    return held_logs.wrim(True, rows=2001)


OWN_WRIM = (
    ("stator_resistance = 0.0026", "stator_resistance = 1.3"),
    ("rotor_resistance = 0.0029", "rotor_resistance = 0.7"),
    ("stator_inductance = 0.002587", "stator_inductance = 0.10"),
    ("rotor_inductance = 0.002587", "rotor_inductance = 0.14"),
    ("mutual_inductance = 0.0025", "mutual_inductance = 0.11"),
)


def relative_error(path: Path, winding: str) -> float:
    """The median after 0.15 s of the flux error over the flux."""
    with np.load(path) as table:
        late = table["t"] > 0.15
        names = [f"flux_{winding}_{axis}" for axis in ("alpha", "beta")]
        error = np.hypot(*(table[f"error_{name}"][late] for name in names))
        return float(np.median(error / np.hypot(*(table[name][late] for name in names))))


@pytest.mark.parametrize("kind", KINDS)
def test_the_template_of_a_kind_is_the_preset_of_its_plant(capsys, tmp_path, kind):
    code, printed, _ = run(capsys, "sample", "--kind", kind)
    assert code == 0
    (tmp_path / "machine.toml").write_text(printed)
    (tmp_path / "robot.py").write_text(ROBOT)
    (tmp_path / "motor.py").write_text(MOTOR)
    plant, preset = read_machine(tmp_path / "machine.toml").plant(), PRESETS[kind]()
    assert type(plant) is type(preset)
    for name, value in vars(preset).items():
        if isinstance(value, dict):
            assert getattr(plant, name) == value
        elif value is not None and not callable(value) and name != "code":
            np.testing.assert_allclose(getattr(plant, name), value, rtol=1e-12)
    # Every key of [observer], its comment sign taken away, is a valid one.
    lines = [line.removeprefix("# ") for line in printed.splitlines()[1:]]
    full = [line for line in lines if " = " in line or line.startswith("[")]
    # Those of the Kalman filter go with its `kind` alone.
    other = [line for line in full if "with kind =" in line]
    (tmp_path / "full.toml").write_text("\n".join(x for x in full if x not in other))
    stated = read_machine(tmp_path / "full.toml").observer.model_fields_set
    stated |= {line.split(" = ")[0] for line in other}
    assert stated == set(KINDS[kind].model_fields["observer"].annotation.model_fields)
    if other:
        asked = ['kind = "lifted_kalman"', 'saliency = "neglected"'][
            : 1 + ("interior" in kind)
        ]
        machine = full[: full.index("[observer]") + 1]
        (tmp_path / "lifted.toml").write_text("\n".join([*machine, *asked, *other]))
        observer = read_machine(tmp_path / "lifted.toml").observer
        assert observer.output_deviation == (1e-4 if "force" in str(other) else 0.01)


def test_a_template_of_no_kind_is_refused(capsys):
    code, _, err = run(capsys, "sample", "--kind", "induction")
    assert code == 2
    assert 'Argument `kind` (option --kind) must be one of "pmsm", "stepper",' in err


def test_the_version_and_the_columns_of_every_kind_are_told(capsys):
    assert run(capsys, "--version") == (0, f"aslo-jax {aslo.__version__}\n", "")
    code, printed, _ = run(capsys, "estimate", "--help")
    assert code == 0
    for text in (
        "pmsm, stepper, interior_pmsm\n    in: t, u_alpha, u_beta, i_alpha, i_beta\n",
        "optionally u_r_alpha, u_r_beta",
        "out: t, flux_1, flux_2 (Wb), position (m), velocity (m/s), certificate,",
        "ball_beam\n    in: t, u1, q1, q2\n    out: t, qdot1 (m/s), qdot2 (rad/s), certif",
    ):
        assert text in printed


def test_every_machine_in_the_documentation_is_read(tmp_path):
    page = (Path(__file__).parents[1] / "docs" / "machine-descriptions.md").read_text()
    found = re.findall(r"^```toml\n(.*?)^```$", page, re.MULTILINE | re.DOTALL)
    blocks = re.findall(r"^```python\n(.*?)^```$", page, re.MULTILINE | re.DOTALL)
    for name, mark in (("robot", "arm = "), ("motor", "model = aslo.Model(")):
        (text,) = (text for text in blocks if mark in text)
        (tmp_path / f"{name}.py").write_text(text)
    kinds = []
    for text in found:
        (tmp_path / "machine.toml").write_text(text)
        kinds.append(read_machine(tmp_path / "machine.toml").kind)
    assert kinds == list(KINDS)


REFUSED = {
    "pll of a bearing": (
        "magnetic_bearing",
        "pll_bandwidth = 50.0",
        '`observer.pll_bandwidth` is not for kind = "magnetic_bearing": nothing turns in '
        "it, so there is no angle to follow; remove it",
    ),
    "repeat of a bearing": (
        "magnetic_bearing",
        'completion = "repeat"',
        '`observer.completion`, from one row to two, must be "least-squares", but is '
        "'repeat': the determinant of \"repeat\" changes sign as the body moves",
    ),
    "gain of a bearing": ("magnetic_bearing", "gain = 5.0", "has no asymptotic form"),
    "start of a bearing": ("magnetic_bearing", 'start = "paper"', "the exact start only"),
    "pll of a wrim": ("wrim", "pll_bandwidth = 50.0", "has no angle that a phase-locked"),
    "a key of another kind": (
        "pmsm",
        "velocity_cutoff = 50.0",
        'unknown key `observer.velocity_cutoff` of kind = "pmsm" (a key of '
        "magnetic_bearing; allowed: cutoff, completion",
    ),
    "a slip of the pen": (
        "stepper",
        "threshhold = 1.0",
        'unknown key `observer.threshhold` of kind = "stepper" (did you mean `threshold`?',
    ),
    "saliency": (
        "interior_pmsm",
        'saliency = "ignored"',
        '`observer.saliency`, what becomes of the d current, must be "self-consistent" or '
        "\"neglected\", but is 'ignored'",
    ),
    "paper's start with self-consistency": (
        "interior_pmsm",
        'start = "paper"',
        '`observer.start`, how the filters start, must be "exact" with '
        "`observer.saliency = \"self-consistent\"` (the default), but is 'paper'; remo",
    ),
    "saliency of a pmsm": ("pmsm", 'saliency = "neglected"', "a key of interior_pmsm; all"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_observer_settings_that_make_no_sense_are_refused(tmp_path, case):
    kind, observer, expected = REFUSED[case]
    path = machine(tmp_path, kind, observer=observer)
    with pytest.raises(MachineError) as error:
        read_machine(path)
    assert str(error.value).startswith(f"{path}: ")
    assert expected in str(error.value)


FAULTS = {
    "one coil too many": (
        "magnetic_bearing",
        ("[2.0, 2.0]", "[2.0, 2.0, 2.0]"),
        "`machine.resistance`, resistance of a coil, of both or of each (ohm), must be a "
        "positive finite number, or two, [R1, R2], but is [2.0, 2.0, 2.0].",
    ),
    "a coil below zero": (
        "magnetic_bearing",
        ("[2.0, 2.0]", "[2.0, -2.0]"),
        "or two, [R1, R2], but is [2.0, -2.0].",
    ),
    "no leakage": (
        "wrim",
        ("mutual_inductance = 0.0025", "mutual_inductance = 0.0026"),
        "`machine.mutual_inductance`, stator to rotor (H), must be below the square root "
        "of stator_inductance * rotor_inductance, 0.002587, but is 0.0026",
    ),
    "no magnet": (
        "interior_pmsm",
        ("magnet_flux", "# magnet_flux"),
        'is missing, which `observer.saliency = "self-consistent"` (the default) needs: '
        'give it, or set `observer.saliency = "neglected"`',
    ),
    "a key of the plant's": (
        "wrim",
        ("mutual_inductance", "mutual"),
        'unknown key `machine.mutual` of kind = "wrim" (did you mean `mutual_inductance`?',
    ),
    "inductance of an interior motor": (
        "interior_pmsm",
        ("direct_inductance", "inductance"),
        "`machine.direct_inductance`, inductance Ld of the d axis (H), is missing: it must "
        "be a positive finite number",
    ),
    "an unknown kind": (
        "wrim",
        ('"wrim"', '"steper"'),
        '`machine.kind`, the kind of machine, must be one of "pmsm", "stepper", '
        '"interior_pmsm", "wrim", "magnetic_bearing", "robotic_leg", "ball_beam", '
        '"drive", "mechanical", "derived", but is \'steper\'; did you mean `stepper`?',
    ),
}


@pytest.mark.parametrize("case", FAULTS)
def test_faults_in_a_machine_are_named(tmp_path, case):
    kind, change, expected = FAULTS[case]
    with pytest.raises(MachineError) as error:
        read_machine(machine(tmp_path, kind, change))
    assert expected in str(error.value)


def test_an_option_that_makes_no_sense_for_a_kind_is_refused(tmp_path, capsys, wrim_log):
    for kind in ("wrim", "magnetic_bearing"):
        path = machine(tmp_path, kind)
        code, _, err = estimate(capsys, tmp_path, wrim_log, "--pll-bandwidth", 50)
        assert code == 2
        assert f'--pll-bandwidth is not for {path}, whose kind is "{kind}": ' in err
        assert err.endswith("; remove it.\n")
    with pytest.raises(MachineError, match=r'`gain` is not for .* "magnetic_bearing": its'):
        read_machine(path).rates(given={"gain": 5.0})
    with pytest.raises(MachineError, match="its rates are cutoff, rotor_cutoff, gain"):
        read_machine(machine(tmp_path, "wrim")).rates(given={"bandwidth": 5.0})


def test_the_rates_of_every_kind(tmp_path):
    """Given, then in the file, then by default, with the reason."""

    def rates(kind, observer="", **given):
        found = read_machine(machine(tmp_path, kind, observer=observer)).rates(given=given)
        return {name: rate.value for name, rate in found.items()}

    assert rates("pmsm", cutoff=70.0) == {"cutoff": 70.0, "pll_bandwidth": 100.0}
    assert rates("pmsm", "cutoff = 9.0\ngain = 3.0", cutoff=8.0) == {
        "cutoff": 8.0,
        "gain": 3.0,
        "pll_bandwidth": 100.0,
    }
    assert rates("interior_pmsm", cutoff=70.0)["gain"] == 70.0
    assert "gain" not in rates("interior_pmsm", 'saliency = "neglected"', cutoff=70.0)
    assert rates("wrim", cutoff=70.0) == {"cutoff": 70.0, "rotor_cutoff": 70.0}
    assert rates("wrim", "rotor_cutoff = 9.0", cutoff=70.0)["rotor_cutoff"] == 9.0
    assert rates("magnetic_bearing") == {"cutoff": 30.0, "velocity_cutoff": 200.0}
    assert rates("magnetic_bearing", cutoff=5.0)["cutoff"] == 5.0
    with pytest.raises(MachineError, match="`log` must be given where neither"):
        rates("wrim")


def test_each_winding_has_its_cutoff_from_the_log(tmp_path, capsys, wrim_log):
    """314 rad/s of the supply and 54 of the slip, over sqrt(3)."""
    machine(tmp_path, "wrim", *OWN_WRIM)
    _, printed, err = estimate(capsys, tmp_path, wrim_log)
    values = {
        name: float(printed.partition(f"  {name} ")[2].partition(" rad/s")[0])
        for name in ("cutoff", "rotor_cutoff")
    }
    assert values["cutoff"] == pytest.approx(314 / np.sqrt(3), rel=0.06)
    assert values["rotor_cutoff"] == pytest.approx(54 / np.sqrt(3), rel=0.2)
    assert "the typical frequency of u - R i there" in printed
    assert err == ""


def test_rotor_voltages_count_and_come_in_pairs(tmp_path, capsys, wrim_log):
    machine(tmp_path, "wrim", *OWN_WRIM)
    options = ("--cutoff", 60)
    assert estimate(capsys, tmp_path, wrim_log, *options)[0] == 0
    assert relative_error(tmp_path / "out.npz", "r") < 1e-3
    shorted = {k: v for k, v in wrim_log.items() if not k.startswith("u_r")}
    _, printed, _ = estimate(capsys, tmp_path, shorted, *options)
    assert "not in the log, taken as zero: u_r_alpha, u_r_beta" in printed
    assert relative_error(tmp_path / "out.npz", "r") > 0.1
    assert relative_error(tmp_path / "out.npz", "s") < 1e-3
    half = {k: v for k, v in wrim_log.items() if k != "u_r_beta"}
    code, _, err = estimate(capsys, tmp_path, half, *options)
    assert code == 2
    assert "no column `u_r_beta`" in err
    assert "or give none of u_r_alpha, u_r_beta" in err


def test_a_log_of_another_kind_is_refused_by_its_columns(tmp_path, capsys, wrim_log):
    machine(tmp_path, "magnetic_bearing")
    code, _, err = estimate(capsys, tmp_path, wrim_log)
    assert code == 2
    assert "no columns `u_1`, `u_2`, `i_1`, `i_2`" in err


def test_time_in_milliseconds_is_doubted(tmp_path, capsys, wrim_log):
    machine(tmp_path, "wrim", *OWN_WRIM)
    code, _, err = estimate(capsys, tmp_path, wrim_log | {"t": 1e3 * wrim_log["t"]})
    assert code == 0
    assert "warning: the log has 10 rows a second, too slow for this kind" in err
    assert "`t` may be in ms, not in seconds" in err


def test_a_log_that_mostly_coasts_says_what_to_check(tmp_path, capsys, wrim_log):
    machine(tmp_path, "wrim", *OWN_WRIM, observer="threshold = 0.5")
    code, _, err = estimate(capsys, tmp_path, wrim_log)
    assert code == 0
    assert "stator flux cannot be observed in it: is it supplied, and does its flux" in err
    assert "Check too that `t` is in seconds (1e+04 rows a second), the parameters" in err
    assert "% of the rows coast (rotor flux): is it supplied" in err
