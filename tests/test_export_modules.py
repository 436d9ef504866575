"""Exported C of observers, controllers, filters and chains of a user's own."""

import re
import subprocess

import jax.numpy as jnp
import numpy as np
import pytest
import scipy.signal
from compiled_c import Compiled, columns, compiler, error, rows_of
from exported_modules import Damped, restrained, restrained_observer, thirty
from exported_motor import MOTOR, command
from own_modules import Washout

import aslo_jax as aslo


def test_a_users_own_module(tmp_path):
    rng = np.random.default_rng(3)
    u, y = rng.normal(size=(80, 1)), np.cumsum(rng.normal(size=(80, 1)), axis=0)
    observer = Washout(jnp.array(8.0))
    made = aslo.export_c(observer, interval=0.02, u=u[0], y=y[0], prefix="washout")
    expected = columns(aslo.replay(observer, 0.02 * np.arange(80), u, y))
    found = Compiled(made, tmp_path)(rows_of(u, y))
    assert error(found, expected) < 1e-12


def test_matrices_are_loops(tmp_path):
    made, observer = restrained(), restrained_observer()
    u, y = np.random.default_rng(0).normal(size=(2, 60, 1))
    expected = columns(aslo.replay(observer, 0.01 * np.arange(60), u, y))
    assert error(Compiled(made, tmp_path)(rows_of(u, y)), expected) < 1e-12
    assert made.files["full.c"].count("\n") < 1200


def test_thirty_states_fit_a_drive(tmp_path):
    """With a full matrix of parameters, by the size of the object."""
    thirty().write(tmp_path)
    build = [*compiler(), "-std=c99", "-Os", "-c", "thirty.c", "-o", "thirty.o"]
    subprocess.run(build, cwd=tmp_path, check=True)
    said = subprocess.run(
        ["size", "thirty.o"], cwd=tmp_path, capture_output=True, text=True, check=True
    ).stdout
    text, data, bss = map(int, said.splitlines()[1].split()[:3])
    assert 3600 < text < 16_384  # the matrix itself has 3600 bytes
    assert data == bss == 0


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


class Named(aslo.AbstractObserver):
    """With states that are called as what C, its headers and the struct have."""

    def equations(self, F, u, y):
        names = ("begun", "while", "linux", "NULL", "x hat", "größe")
        found = [
            F.state(n, jnp.zeros(()), lambda x, k=k: y["state"] - (1.0 + k) * x)
            for k, n in enumerate(names)
        ]
        return aslo.Estimate(jnp.stack(found), jnp.ones(()), found[0] > 0.0)


def test_names_that_are_words_of_c(tmp_path):
    rng = np.random.default_rng(5)
    u, y = rng.normal(size=(40, 1)), {"state": rng.normal(size=40)}
    first = dict(u=u[0], y={"state": 0.0})
    made = aslo.export_c(Named(), interval=0.1, prefix="named", **first)
    names = [f.name for f in made.state]
    assert {"begun_", "while_", "linux_", "NULL_", "x_hat", "gruf6udfe"} < set(names)
    found = Compiled(made, tmp_path, "-O1", "-std=gnu99")(rows_of(u, y))
    expected = columns(aslo.replay(Named(), 0.1 * np.arange(40), u, y))
    assert error(found, expected) < 1e-12
    for prefix, said in (
        ("y", r"`prefix` must not be 'y' here, since `.*` would be `y_state`"),
        ("Main", r'`prefix` must not be "main", which is the file of the test'),
    ):
        with pytest.raises(ValueError, match=said):
            aslo.export_c(Named(), interval=0.1, prefix=prefix, **first)


class Sensitive(aslo.AbstractObserver):
    """Makes ten thousand times as much of the last bits of y."""

    def equations(self, F, u, y):
        x = F.state("x", jnp.zeros(()), lambda x: y[0] - x)
        return aslo.Estimate(jnp.sin(1e4 * y + x), jnp.ones(()), x > 0.0)


def test_its_own_test_allows_for_what_the_last_bits_do(tmp_path):
    """As of an adaptive filter, whose matrices magnify them."""
    one = np.zeros(1)
    made = aslo.export_c(Sensitive(), interval=0.01, u=one, y=one, prefix="keen")
    calm = aslo.export_c(Washout(jnp.array(8.0)), interval=0.01, u=one, y=one)
    tolerance = lambda text: float(re.search(r"define TOLERANCE (\S+)", text)[1])
    assert tolerance(calm.files["main.c"]) == 1e-12
    assert tolerance(made.files["main.c"]) == 1e-10
    made.write(tmp_path)
    assert subprocess.run(["make", "-s", "test"], cwd=tmp_path).returncode == 0


class Sorted(aslo.AbstractObserver):
    """What the engine does not take."""

    def equations(self, F, u, y):
        x = F.state("x", jnp.zeros(8), lambda x: y[0] - x)
        vectors = jnp.linalg.eigh(jnp.outer(x, x) + jnp.eye(8))[1]
        return aslo.Estimate(vectors[0], jnp.ones(()), x[0] > 0.0)


def test_what_cannot_be_exported_is_refused(tmp_path, capsys):
    with pytest.raises(aslo.NotFusible, match=r"test_export_modules\.py:\d+"):
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
