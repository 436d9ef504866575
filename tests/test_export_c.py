"""Exported C: the numbers of the library, by a compiler that knows nothing of it."""

import os
import re
import subprocess
import sys
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from compiled_c import Compiled, columns, compiled, compiler, error, rows_of
from own_modules import Washout
from test_estimate_kinds import CASES

import aslo_jax as aslo
from aslo_jax.cli import main
from aslo_jax.cli._export import exported_machine
from aslo_jax.control import AbstractController
from aslo_jax.logs import read_log
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


def of_motor(estimate):
    from aslo_jax.cli._export import _of_motor

    return _of_motor(estimate)


@pytest.fixture(scope="module")
def log():
    return read_log(LOG)


@pytest.fixture(scope="module")
def expected(log):
    return columns(of_motor(aslo.replay(motor_observer(), log.t, log.u, log.y)))


@pytest.fixture(scope="module")
def motor(tmp_path_factory):
    """By the command of the page, without a further option."""
    folder = tmp_path_factory.mktemp("motor")
    given = ("export", MOTOR, "--target", "c", "--interval", "2e-4", "--out", folder)
    assert command(*given) == 0
    return folder


def test_the_recorded_motor_through_the_binary_is_replay(motor, log, expected):
    flags = "CFLAGS=-O2 -Werror -fno-math-errno"
    for target in ("test", "motor_csv"):
        subprocess.run(["make", "-s", target, flags], cwd=motor, check=True)
    with LOG.open() as text:
        done = subprocess.run(
            [motor / "motor_csv"], stdin=text, capture_output=True, text=True, check=True
        )
    head, *rows = done.stdout.splitlines()
    assert head == (
        "t,theta_electrical,certificate,coasting,coasting_speed,flux_alpha,flux_beta,"
        "omega_electrical"
    )
    found = np.array([row.split(",") for row in rows], float)
    np.testing.assert_array_equal(found[:, 0], log.t)
    assert error(found[:, 1:], expected) < 1e-12


def test_compilers_have_nothing_to_say(motor, tmp_path):
    """Nor is a symbol missing, or kept outside of a function; with and without the
    processor's root."""
    for options in (("-O2",), ("-O0",), ("-O2", "-fno-math-errno"), ("-Os", "-DNDEBUG")):
        compiled(motor, "motor.c", "-c", *options)
        listed = subprocess.run(
            ["nm", "motor.o"], cwd=motor, capture_output=True, text=True, check=True
        ).stdout
        kinds = {line.split()[-2] for line in listed.splitlines()}
        assert kinds <= {"T", "t", "r", "R"}, (options, listed)
        names = {line.split()[-1] for line in listed.splitlines() if " T " in line}
        assert names == {"motor_defaults", "motor_init", "motor_step"}
    text = (motor / "motor.c").read_text()
    (motor / "motor.cpp").write_text(text)
    compiled(motor, "motor.cpp", "-c", "-Wall", "-Wextra", "-Werror", "-pedantic")
    words = set(re.findall(r"\b(\w*alloc|goto|double|static \w+ \w+ =)\b", text))
    assert words == {"double"}


def test_single_precision_is_as_near_as_is_said(tmp_path, log, expected):
    made = export_motor(dtype="float32")
    code = made.files["motor.c"]
    assert not re.search(r"\bdouble\b|\d\.\d+(e[-+]?\d+)?(?![\d.e]*f)\b", code)
    found = Compiled(made, tmp_path)(rows_of(log.u, log.y))
    angle = (found[:, 0] - expected[:, 0] + np.pi) % (2 * np.pi) - np.pi
    both = (found[:, 2] == 0) & (expected[:, 2] == 0) & (expected[:, 3] == 0)
    assert np.mean(found[:, 2] != expected[:, 2]) < 1e-3
    settled = both & (np.arange(len(both)) > 100)
    assert np.max(np.abs(angle[settled])) < 5e-5  # rad
    assert error(found[settled, 4:6], expected[settled, 4:6]) < 2e-5
    assert np.max(np.abs(found[settled, 6] - expected[settled, 6])) < 0.02  # rad/s


def test_a_slow_filter_keeps_its_digits_in_single_precision(tmp_path):
    """What it loses over an interval is a part in 67,000, of which `1 - decay` would have
    three digits, and the filter an error of 1e-3."""
    rows = np.ones((100_000, 1))
    made = aslo.export_c(
        aslo.LowPass(0.3), interval=5e-5, y=1.0, dtype="float32", prefix="slow"
    )
    found = Compiled(made, tmp_path)(rows)[:, 0]
    exact = -np.expm1(-0.3 * 5e-5 * np.arange(100_000))
    assert np.max(np.abs(found - exact)) < 3e-5


def test_a_loop_in_single_precision_turns_for_ever(tmp_path):
    """After a million radians the angle has the digits that it had at first."""
    t = 1e-3 * np.arange(20_000)
    angle = 1e6 + 300.0 * t
    wrapped = (angle + np.pi) % (2 * np.pi) - np.pi
    loop = aslo.PhaseLockedLoop(60.0, within=True)
    settings = dict(interval=1e-3, u=np.zeros(1), y=0.0, dtype="float32", prefix="pll")
    made = aslo.export_c(loop, **settings)
    found = Compiled(made, tmp_path)(rows_of(np.zeros((20_000, 1)), wrapped))
    off = (found[500:, 0] - wrapped[500:] + np.pi) % (2 * np.pi) - np.pi
    assert np.max(np.abs(off)) < 1e-4
    assert np.max(np.abs(found[500:, 1] - 300.0)) < 0.1


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


MECHANISMS = {
    "robotic_leg": "",
    "ball_beam": "",
    "drive": "",
}


@pytest.mark.parametrize("kind", MECHANISMS)
def test_a_log_of_every_mechanism(kind, tmp_path):
    from aslo_jax.machines import template

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


def test_intervals_that_vary_substeps_and_missing_samples(tmp_path, log):
    rng = np.random.default_rng(0)
    rows = np.sort(rng.choice(2000, 700, replace=False))
    t, u, y = log.t[rows], log.u[rows], log.y[rows].copy()
    y[200:203] = np.nan
    made = export_motor(interval=None, substeps=2, missing="coast")
    observer = motor_observer()
    replayed = aslo.replay(observer, t, u, y, substeps=2, missing="coast")
    found = Compiled(made, tmp_path)(rows_of(u, y, np.diff(t)))
    assert error(found, columns(of_motor(replayed))) < 1e-12
    names = [f.name for f in made.inputs]
    assert names == ["dt", "u", "y"]


def test_what_is_refused_changes_nothing(tmp_path, log):
    made = export_motor(interval=None)
    code = Compiled(made, tmp_path)
    rows = rows_of(log.u, log.y, np.diff(log.t))[:50]
    good = code(rows)
    bad = {1: (3, np.nan), 3: (0, 0.0)}
    for status, (column, value) in bad.items():
        broken = rows.copy()
        broken[20, column] = value
        got, out = code.status(broken)
        assert got == status
        np.testing.assert_array_equal(out[:20], good[:20])
        assert not out[20:].any()
    main = """
        #include <string.h>
        #include "motor.h"
        int main(void) {
            static motor_state state, before;
            motor_parameters with; motor_output out; double u[2] = {0, 0}, y[2] = {0, 0};
            motor_defaults(&with);
            if (motor_step(&state, &with, 2e-4, u, y, &out) != MOTOR_NOT_BEGUN) return 1;
            if (motor_init(&state, &with, y, &out) != MOTOR_OK) return 2;
            before = state;
            y[1] = 1e308; y[1] *= 10.0;
            if (motor_step(&state, &with, 2e-4, u, y, &out) != MOTOR_NOT_FINITE) return 3;
            return memcmp(&state, &before, sizeof state) ? 4 : 0;
        }"""
    assert ran(tmp_path, main, "motor.c") == 0


def ran(folder: Path, main: str, *sources: str) -> int:
    (folder / "own.c").write_text(main)
    out = folder / "own"
    subprocess.run(
        [*compiler(), "-std=c99", "-O1", "-o", out, "own.c", *sources],
        cwd=folder,
        check=True,
    )
    return subprocess.run([out]).returncode


def test_two_instances_and_two_observers_in_one_binary(tmp_path, log):
    """Side by side, turn by turn: each is as it is alone."""
    export_motor().write(tmp_path)
    export_motor(prefix="other", fixed=("all",), dtype="float32").write(tmp_path)
    main = """
        #include "motor.h"
        #include "other.h"
        int main(void) {
            motor_state a, b, alone; motor_output x, y, z; motor_parameters p, q;
            other_state c; other_output w;
            int k;
            double u[2], i[2]; float v[2], j[2];
            motor_defaults(&p); q = p; q.first_filter_rate = 60.0;
            for (k = 0; k < 200; ++k) {
                u[0] = 3.0 - 0.01 * k; u[1] = 0.02 * k;
                i[0] = 0.5 * u[1]; i[1] = 1.0 - i[0];
                v[0] = (float)u[0]; v[1] = (float)u[1];
                j[0] = (float)i[0]; j[1] = (float)i[1];
                if (k == 0) {
                    motor_init(&a, &p, i, &x); motor_init(&b, &q, i, &y);
                    motor_init(&alone, &p, i, &z); other_init(&c, j, &w);
                } else {
                    motor_step(&alone, &p, u, i, &z);
                    motor_step(&b, &q, u, i, &y);
                    other_step(&c, v, j, &w);
                    motor_step(&a, &p, u, i, &x);
                }
            }
            if (x.flux[0] != z.flux[0] || x.speed != z.speed) return 1;
            if (x.certificate == y.certificate) return 2;
            return (w.flux[0] - x.flux[0] < 1e-3 && x.flux[0] - w.flux[0] < 1e-3) ? 0 : 3;
        }"""
    assert ran(tmp_path, main, "motor.c", "other.c") == 0


def test_parameters_are_tuned_at_run_time(tmp_path, log):
    made = export_motor()
    names = [f.name for f in made.parameters]
    values = [float(f.default) for f in made.parameters]
    changes = {
        "first_filter_rate": 90.0,
        "first_relation_resistance": 9.1,
        "second_bandwidth": 60.0,
    }
    for name, value in changes.items():
        values[names.index(name)] = value
    where = lambda o: (o.first.filter.rate, o.first.relation.resistance, o.second.bandwidth)
    other = eqx.tree_at(where, motor_observer(), tuple(map(jnp.asarray, changes.values())))
    expected = columns(of_motor(aslo.replay(other, log.t, log.u, log.y)))
    found = Compiled(made, tmp_path)(rows_of(log.u, log.y), values)
    assert error(found, expected) < 1e-12


def test_fixed_parameters_are_computed_beforehand(tmp_path, log, expected):
    free, fixed = export_motor(), export_motor(fixed=("all",))
    assert fixed.parameters == ()
    assert fixed.operations < 0.6 * free.operations
    assert fixed.of_parameters == 0
    assert error(Compiled(fixed, tmp_path)(rows_of(log.u, log.y)), expected) < 1e-12
    with pytest.raises(ValueError, match=r"`fixed` must hold .*first_filter_rate.*'rate'"):
        export_motor(fixed=("rate",))


def test_the_same_bytes_in_another_process(motor, tmp_path):
    environment = os.environ | {"PYTHONHASHSEED": "7"}
    given = ["export", MOTOR, "--interval", "2e-4", "--out", tmp_path]
    subprocess.run(
        [sys.executable, "-m", "aslo_jax", *given], env=environment, check=True, cwd=ROOT
    )
    made = sorted(p.name for p in tmp_path.iterdir())
    assert {"motor.c", "motor.h", "main.c", "README.md", "CMakeLists.txt"} < set(made)
    for name in made:
        assert (tmp_path / name).read_bytes() == (motor / name).read_bytes(), name


def test_a_users_own_module(tmp_path):
    rng = np.random.default_rng(3)
    u, y = rng.normal(size=(80, 1)), np.cumsum(rng.normal(size=(80, 1)), axis=0)
    observer = Washout(jnp.array(8.0))
    made = aslo.export_c(observer, interval=0.02, u=u[0], y=y[0], prefix="washout")
    expected = columns(aslo.replay(observer, 0.02 * np.arange(80), u, y))
    found = Compiled(made, tmp_path)(rows_of(u, y))
    assert error(found, expected) < 1e-12


class Restrained(aslo.AbstractObserver):
    """With a state that has 12 entries and a full matrix."""

    A: jax.Array

    def equations(self, F, u, y):
        x = F.state("x", jnp.zeros(12), lambda x: self.A @ x + y[0])
        P = F.state("P", jnp.eye(12), lambda P: self.A @ P + P @ self.A.T - P @ P.T)
        return aslo.Estimate(jnp.tanh(P @ x), jnp.ones(()), x[0] > 0.0)


def test_matrices_are_loops(tmp_path):
    rng = np.random.default_rng(0)
    A = jnp.asarray(rng.normal(size=(12, 12)) * 0.3 - 2.0 * np.eye(12))
    u, y = rng.normal(size=(2, 60, 1))
    made = aslo.export_c(Restrained(A), interval=0.01, u=u[0], y=y[0], prefix="full")
    expected = columns(aslo.replay(Restrained(A), 0.01 * np.arange(60), u, y))
    assert error(Compiled(made, tmp_path)(rows_of(u, y)), expected) < 1e-12
    assert made.files["full.c"].count("\n") < 1200


class Damped(AbstractController):
    """A proportional and integral controller with a limit, that looks at the time."""

    gain: jax.Array

    def init(self, fed):
        return jnp.zeros(2)

    def vector_field(self, t, state, fed):
        return fed - 0.1 * state

    def __call__(self, t, state, fed):
        wanted = jnp.array([1.0, jnp.sin(20.0 * t)])
        return jnp.clip(self.gain * (wanted - fed) + 3.0 * state, -5.0, 5.0)


def test_a_chain_is_the_loop_of_an_experiment(tmp_path):
    """Of the motor: the C is fed what the experiment measures, and commands what that
    does."""
    plant = aslo.plants.PMSM(8.875, 40.03e-3, 0.2086, 5, 60e-6)
    relation = plant.flux_relation()
    observer = aslo.AlgebraicObserver(relation, aslo.LowPass(20.0))
    controller = Damped(jnp.asarray(40.0))
    feedback = lambda y, estimate: y + 0.1 * estimate.value
    experiment = aslo.Experiment(
        plant,
        controller,
        {"flux": observer},
        1e-3,
        feedback=lambda y, x, estimates: feedback(y, estimates["flux"]),
    )
    record = experiment.run(100)
    chain = aslo.Chain(observer, controller, feedback)
    made = aslo.export_c(chain, interval=1e-3, u=np.zeros(2), y=np.zeros(2), prefix="loop")
    expected = columns({"estimate": record.estimates["flux"], "u": record.u})
    found = Compiled(made, tmp_path)(columns(record.y))
    assert error(found, expected) < 1e-12
    assert [f.name for f in made.inputs] == ["y"]


def test_a_controller_a_filter_and_a_loop_alone(tmp_path):
    rng = np.random.default_rng(2)
    y = rng.normal(size=(90, 2))
    made = aslo.export_c(Damped(jnp.asarray(2.0)), interval=0.01, y=y[0], prefix="pi")
    found = Compiled(made, tmp_path / "pi")(y)
    state, t, expected = np.zeros(2), 0.0, []
    for fed in y:
        wanted = np.array([1.0, np.sin(20.0 * t)])
        expected.append(np.clip(2.0 * (wanted - fed) + 3.0 * state, -5.0, 5.0))
        state, t = state + 0.01 * (fed - 0.1 * state), t + 0.01
    assert error(found, np.array(expected)) < 1e-12

    A = np.array([[-3.0, 10.0], [-10.0, -3.0]])
    law = aslo.LinearFilter(A, np.array([0.0, 1.0]), np.array([2.0, 0.5]))
    made = aslo.export_c(
        law, interval=0.01, y=y[0, 0], prefix="band", fixed=("A", "B", "C")
    )
    found = Compiled(made, tmp_path / "band")(y[:, :1])
    import scipy.signal

    t = 0.01 * np.arange(90)
    system = scipy.signal.StateSpace(A, [[0.0], [1.0]], [[2.0, 0.5]], [[0.0]])
    _, exact, _ = scipy.signal.lsim(system, y[:, 0], t)
    assert error(found, exact.reshape(-1, 1)) < 1e-12

    loop = aslo.PhaseLockedLoop(40.0)
    angle = np.cumsum(rng.uniform(0.0, 0.4, 90))
    made = aslo.export_c(loop, interval=0.01, u=np.zeros(1), y=angle[0], prefix="pll")
    replayed = columns(aslo.replay(loop, t, np.zeros((90, 1)), angle))
    found = Compiled(made, tmp_path / "pll")(rows_of(np.zeros((90, 1)), angle))
    assert error(found, replayed) < 1e-12


def test_a_loop_within_a_turn_is_the_same_loop():
    """But for turns, also where the angle is measured without wrapping."""
    t = 0.01 * np.arange(400)
    angle = 30.0 * t + 3.0 * np.sin(4.0 * t)
    u = np.zeros((400, 1))
    free = aslo.replay(aslo.PhaseLockedLoop(40.0), t, u, angle)
    within = aslo.replay(aslo.PhaseLockedLoop(40.0, within=True), t, u, angle)
    np.testing.assert_allclose(within.value[:, 1], free.value[:, 1], rtol=1e-9)
    turns = (within.value[:, 0] - free.value[:, 0]) / (2 * np.pi)
    np.testing.assert_allclose(turns, np.round(turns), atol=1e-9)
    assert np.max(np.abs(within.value[1:, 0])) <= np.pi + 1e-12
    with pytest.raises(ValueError, match="`within` must be False where `wraps` is"):
        aslo.PhaseLockedLoop(40.0, wraps=False, within=True)


class Sorted(aslo.AbstractObserver):
    """What the engine does not take."""

    def equations(self, F, u, y):
        x = F.state("x", jnp.zeros(8), lambda x: y[0] - x)
        vectors = jnp.linalg.eigh(jnp.outer(x, x) + jnp.eye(8))[1]
        return aslo.Estimate(vectors[0], jnp.ones(()), x[0] > 0.0)


def test_what_cannot_be_exported_is_refused(tmp_path, capsys):
    with pytest.raises(aslo.NotFusible, match=r"test_export_c\.py:\d+"):
        aslo.export_c(Sorted(), interval=0.1, u=np.zeros(1), y=np.zeros(1))
    refused = {
        r"`dtype` must be one of float32, float64, but got 'float16'": dict(
            dtype="float16"
        ),
        r"`prefix` must begin with a letter": dict(prefix="2x"),
        r"`prefix` .* no word of C, but got 'double'": dict(prefix="double"),
        r'`missing` must be "refuse" or "coast"': dict(missing="interpolate"),
        r"`interval` must be positive": dict(interval=-1.0),
    }
    for message, settings in refused.items():
        given = dict(interval=0.1, u=np.zeros(1), y=np.zeros(1)) | settings
        with pytest.raises(ValueError, match=message):
            aslo.export_c(Washout(jnp.array(8.0)), **given)
    with pytest.raises(ValueError, match="`u` must be given"):
        aslo.export_c(Washout(jnp.array(8.0)), interval=0.1)
    with pytest.raises(ValueError, match="must be an observer, a filter, a controller"):
        aslo.export_c(lambda x: x, interval=0.1)

    bare = tmp_path / "bare.toml"
    text = re.sub(r"cutoff = .*", "", MOTOR.read_text())
    bare.write_text(text)
    said = {
        "give --cutoff": ("export", bare, "--interval", "2e-4", "--out", tmp_path / "x"),
        "either --interval": ("export", MOTOR, "--out", tmp_path / "x"),
        "--target must be one of": (
            "export",
            MOTOR,
            *("--interval", "1e-4", "--target", "vhdl", "--out", tmp_path / "x"),
        ),
        "must be at most 50 rad/s": ("export", MOTOR, "--interval", "0.01", "--out", bare),
    }
    for message, arguments in said.items():
        assert command(*arguments) == 2
        assert message in capsys.readouterr().err
    assert not (tmp_path / "x").exists()
    given = (
        "export",
        bare,
        "--interval",
        "2e-4",
        "--cutoff",
        "150",
        "--out",
        tmp_path / "y",
    )
    assert command(*given) == 0


def test_the_readme_lists_what_the_header_declares(motor):
    text, header = (motor / "README.md").read_text(), (motor / "motor.h").read_text()
    structs = {
        name: re.findall(r"^    \w+ (\w+)(?:\[\d+\])?;$", body, re.MULTILINE)
        for body, name in re.findall(r"typedef struct \{(.*?)\} (\w+);", header, re.DOTALL)
    }
    sections = dict(re.findall(r"## (\w+)\n(.*?)(?=\n## |\Z)", text, re.DOTALL))
    listed = {k: re.findall(r"^\| `(\w+)` ", v, re.MULTILINE) for k, v in sections.items()}
    assert listed["Parameters"] == structs["motor_parameters"]
    assert listed["Outputs"] == structs["motor_output"]
    assert [*listed["State"], "begun"] == structs["motor_state"]
    arguments = re.search(r"motor_step\((.*?)\)", header, re.DOTALL)[1]
    assert set(listed["Inputs"]) <= set(re.findall(r"\w+", arguments))


def test_the_header_says_what_it_is(motor):
    header = (motor / "motor.h").read_text()
    for said in (
        f"aslo_jax {aslo.__version__}",
        "aslo-jax export motor.toml --target c --interval 0.0002",
        "Prop. 2",
        "i_alpha, i_beta; stationary frame, amplitude-invariant",
        "u was held over the",
        "rad/s, electrical",
        "operations in float64",
        "bytes and padding",
        "#define MOTOR_INTERVAL 0.0002",
    ):
        assert said in " ".join(header.replace("\n *", " ").split()), said
    assert not re.search(r"/(tmp|home|work|root)\b", header)


def test_columns_of_a_csv_file_that_lack_or_are_broken(motor):
    subprocess.run(["make", "-s", "motor_csv"], cwd=motor, check=True)
    given = {
        "t,u_alpha\n0,1\n": (2, "no column u_beta"),
        "t,u_alpha,u_beta,i_alpha,i_beta\n0,1,2,3,x\n": (2, "row 1: not 5 numbers"),
        "t,u_alpha,u_beta,i_alpha,i_beta\n0,1,2,3,nan\n": (1, "row 1: status 1"),
    }
    for text, (code, said) in given.items():
        done = subprocess.run(
            [motor / "motor_csv"], input=text, capture_output=True, text=True
        )
        assert (done.returncode, said in done.stderr) == (code, True), done.stderr


def test_sanitizers_and_the_stack(motor, tmp_path, log):
    """Nothing undefined in a run over the log, and no more of the stack than is said."""
    for name in ("motor.c", "motor.h", "main.c", "motor_csv.c"):
        (tmp_path / name).write_text((motor / name).read_text())
    flags = ("-O1", "-g", "-fsanitize=undefined,address", "-fno-sanitize-recover=all")
    probe = tmp_path / "probe.c"
    probe.write_text("int main(void) { return 0; }")
    works = subprocess.run([*compiler(), *flags, "-o", tmp_path / "probe", probe])
    if works.returncode:
        pytest.skip("this compiler has no sanitizers")
    done = subprocess.run(
        [*compiler(), "-std=c99", *flags, "-o", "checked", "motor_csv.c", "motor.c"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    with LOG.open() as text:
        ran = subprocess.run(
            [tmp_path / "checked"], stdin=text, capture_output=True, text=True
        )
    assert ran.returncode == 0, ran.stderr
    subprocess.run(
        [*compiler(), "-std=c99", "-O2", "-fstack-usage", "-c", "motor.c"],
        cwd=tmp_path,
        check=True,
    )
    used = {
        line.split("\t")[0].rpartition(":")[2]: int(line.split("\t")[1])
        for line in (tmp_path / "motor.su").read_text().splitlines()
    }
    said = re.search(
        r"at most (\d+) bytes of automatic",
        " ".join((motor / "motor.h").read_text().replace("\n *", " ").split()),
    )
    assert 0 < used["motor_step"] <= int(said[1])


@pytest.mark.slow
def test_ten_thousand_models_in_single_precision(tmp_path, log):
    """Of parameters, cutoffs and bandwidths: how far single precision is off where both
    are certified."""
    single = Compiled(export_motor(dtype="float32"), tmp_path / "single")
    double = Compiled(export_motor(), tmp_path / "double")
    rows = rows_of(log.u, log.y)[:2000]
    names = [f.name for f in double.exported.parameters]
    start = np.array([float(f.default) for f in double.exported.parameters])
    spread = {name: 0.2 for name in names if "relation" in name or "connect" in name}
    spread |= {"first_filter_rate": 0.8, "second_bandwidth": 0.5}
    rng = np.random.default_rng(0)
    worst, apart = [], []
    for _ in range(10_000):
        values = start.copy()
        for name, share in spread.items():
            values[names.index(name)] *= rng.uniform(1.0 - share, 1.0 + share)
        a, b = single(rows, values), double(rows, values)
        both = (a[:, 2] == 0) & (b[:, 2] == 0) & (np.arange(len(a)) > 100)
        apart.append(np.mean(a[:, 2] != b[:, 2]))
        magnet = start[names.index("first_relation_magnet_flux")]
        off = np.abs(a - b)[both][:, 4:6] / magnet
        worst.append(np.max(off, initial=0.0))
    assert np.median(worst) > 1e-8  # there were certified rows
    assert np.max(worst) < 5e-6  # of the magnet's flux; measured 1.7e-6
    assert max(apart) < 1e-3
