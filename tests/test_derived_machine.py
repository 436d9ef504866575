"""A system of one's own, from a model in a file, in studies, calibrations and exports."""

import json
import tomllib

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from derivable_electrical import battery, levitation, pmsm
from scipy.linalg import expm
from test_derive_cli import MODEL, run

import aslo_jax as aslo
from aslo_jax.derivation import derive
from aslo_jax.described import calibrate_machine, machine_of
from aslo_jax.logs import read_log, write_table
from aslo_jax.machines import MachineError, read_machine
from aslo_jax.machines._derived_study import extended_kalman
from aslo_jax.study._config import ConfigurationError, configure, read_configuration
from aslo_jax.study._problem import Problem, fingerprint

R, L, K, J, B, LOAD = 0.9, 4e-3, 0.06, 3e-4, 2e-4, 0.03
MACHINE = """\
[machine]
kind = "derived"
model = "plant:motor"
"""
STUDY = f"""
title = "A motor of one's own"
interval = 2e-4
horizon = 0.1

{MACHINE}initial = {{ speed = 11.0, load = 0.02 }}

[control]
kind = "open_loop"
signal = {{ kind = "wave", offset = 6.0, amplitude = 4.0, frequency = 60.0 }}

[observers.ASLO]
kind = "aslo"
cutoff = 100.0

[observers.Lifted]
kind = "lifted_kalman"
output_deviation = 1e-5
input_deviation = 1e-5

[observers.Kalman]
kind = "kalman"
process = [2.5e-7, 4.5e-5, 4e-4]
measurement = 1e-12

[spread.resistance]
where = "plant.parameters.R"
distribution = "uniform"
low = 0.5
high = 1.0

[spread.load]
where = "initial.load"
distribution = "uniform"
low = 0.01
high = 0.05

[metrics.rms]
kind = "rms"
after = 0.05
"""
WRONG = "parameters = { R = 1.0, L = 4.4e-3 }  # as on the plate\n"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    found = tmp_path_factory.mktemp("derived")
    (found / "plant.py").write_text(MODEL)
    (found / "study.toml").write_text(STUDY)
    (found / "motor.toml").write_text(MACHINE)
    (found / "wrong.toml").write_text(MACHINE + WRONG)
    return found


def test_a_study_runs_the_model_with_every_observer(folder):
    """Without noise all of them give its states, and the plant moves as it must."""
    configuration = read_configuration(folder / "study.toml")
    assert configuration.entries == ("speed", "load")
    assert configuration.units["rms"] == "rad/s, N m"
    assert configuration.units["parameter_load"] == "N m"
    record = configuration.experiment.run(500)
    truth = np.asarray(record.hidden)
    np.testing.assert_allclose(truth[:, 1], 0.02)
    for name, limits in (
        ("ASLO", [1e-2, 1e-3]), ("Lifted", [1e-2, 1e-3]), ("Kalman", [0.3, 2e-3])
    ):  # fmt: skip
        error = np.abs(np.asarray(record.estimates[name].value) - truth)[400:]
        assert np.all(error < limits), name
    # Exactly, with the input held.
    A = np.array([[-B / J, K / J], [-K / L, -R / L]])
    s = np.array([11.0, 0.0])
    for k, u in enumerate(np.asarray(record.u)[:-1, 0]):
        M = np.zeros((3, 3))
        M[:2] = np.column_stack([A, [-0.02 / J, u / L]])
        s = (expm(2e-4 * M) @ [*s, 1.0])[:2]
        if k % 100 == 99:
            np.testing.assert_allclose(truth[k + 1, 0], s[0], rtol=1e-7)
            np.testing.assert_allclose(np.asarray(record.y)[k + 1, 0], s[1], rtol=1e-6)


def test_intensities_are_relative_to_the_ranges_as_of_ready_made_plants():
    """The same filter of a plant and of its model."""
    motor = aslo.plants.DCMotor()
    model = aslo.derivation.model_of(motor)
    plant = derive(model).plant()
    own = extended_kalman(plant, plant.initial(), 3e-4, 2e-9, 5e-2)
    other = aslo.ExtendedKalman.of_plant(motor, 3e-4, 5e-2, 2e-9)
    np.testing.assert_allclose(own.process, other.process, rtol=1e-12)
    assert jnp.ptp(jnp.diagonal(own.process)) > 0
    each = extended_kalman(plant, plant.initial(), [3e-4, 5e-2, 3e-4], 2e-9)
    np.testing.assert_allclose(each.process, own.process, rtol=1e-12)
    with pytest.raises(ValueError, match="`drift` must be left out beside a list"):
        extended_kalman(plant, plant.initial(), [3e-4, 5e-2, 3e-4], 2e-9, 5e-2)


def test_a_study_can_be_sent_to_another_process(folder):
    """With no function of the model: its code goes along."""
    cloudpickle = pytest.importorskip("cloudpickle")
    experiment = read_configuration(folder / "study.toml").experiment
    sent = cloudpickle.dumps(experiment)
    assert b"plant.py" not in sent
    again = cloudpickle.loads(sent)
    plant, other = experiment.plant, again.plant
    x, u = plant.initial(), jnp.array([3.0])
    same = jax.tree.map(
        np.array_equal,
        plant.vector_field(jnp.zeros(()), x, u),
        other.vector_field(jnp.zeros(()), x, u),
    )
    assert all(same.values())


def test_a_study_is_told_by_the_constants_of_its_model(folder, tmp_path):
    """One that is resumed must be the same one: numbers within functions, too."""

    def digest(text):
        (tmp_path / "plant.py").write_text(text)
        content = tomllib.loads(STUDY)
        content["observers"] = {"ASLO": content["observers"]["ASLO"]}
        found = configure(content, tmp_path)
        problem = Problem(
            found.experiment, found.spread, 4, 0, found.steps, found.metrics, None, None,
            "scan", 256, None, {}, None,
        )  # fmt: skip
        return fingerprint(problem)

    same = digest(MODEL)
    assert digest(MODEL) == same
    assert digest(MODEL.replace('- p["load"]', '- 1.01 * p["load"]')) != same


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("load = 0.02", "lode = 0.02", "`machine.initial.lode` is no name"),
        ("cutoff = 100.0", "cutoff = 1.0", "`cutoff` must be above 1.333 rad/s"),
        ("[2.5e-7, 4.5e-5, 4e-4]", "[1e-2, 1e-8]", "list of 3, for speed, load, current"),
        ("plant:motor", "plant:moter", "did you mean `motor`"),
        (
            '"plant:motor"',
            '"plant:motor"\nparameters = { lod = 1.0 }',
            "did you mean `load`",
        ),
        ("offset = 6.0", "offset = [6.0, 1.0]", "must have the shape (1,)"),
        ('"open_loop"\nsignal', '"tracking"\nsignal', "control"),
    ],
)
def test_a_study_that_does_not_suit_its_model_is_refused(folder, old, new, expected):
    content = tomllib.loads(STUDY.replace(old, new, 1))
    with pytest.raises(ConfigurationError) as caught:
        configure(content, folder)
    assert expected in str(caught.value)


def test_outputs_come_from_equations():
    """The current of a coil, from its flux and the place of the ball; what needs the input
    for its output, or has fewer equations than outputs, is refused as a plant."""
    case = levitation()
    plant = derive(case.model).plant()
    state = {"psi": jnp.asarray(0.03), "speed": jnp.zeros(()), "q": jnp.asarray(2e-3)}
    x, y, u = case.of(jnp.zeros(()), jnp.array([0.03, 2e-3, 0.0]))
    np.testing.assert_allclose(plant.output(state), y, rtol=1e-14)
    rates = plant.vector_field(jnp.zeros(()), state, u)
    expected = case.model.rates(x, y, u, jnp.zeros(0))
    np.testing.assert_allclose([rates["psi"], rates["speed"]], expected, rtol=1e-12)
    fed = derive(battery().model).plant()
    with pytest.raises(ValueError, match="must not depend on its input"):
        fed.output(fed.initial())
    with pytest.raises(ValueError, match="must be linear in the outputs"):
        derive(pmsm().model).plant()


def log_of(path, deviation=0.0, seed=0):
    """Under a held voltage that varies, exactly; noise on the current."""
    h, t = 1e-3, np.arange(0.0, 0.8, 1e-3)
    u = 6 + 4 * np.sin(30 * t) + 2 * np.sin(83 * t) + np.sign(np.sin(7 * t))
    A = np.array([[-B / J, K / J], [-K / L, -R / L]])
    states = [np.array([11.0, 0.5])]
    for k in range(t.size - 1):
        M = np.zeros((3, 3))
        M[:2] = np.column_stack([A, [-LOAD / J, u[k] / L]])
        states.append((expm(M * h) @ [*states[-1], 1.0])[:2])
    speed, current = np.array(states).T
    current = current + deviation * np.random.default_rng(seed).standard_normal(t.size)
    columns = {"t": t, "voltage": u, "current": current, "speed_true": speed}
    write_table(path, columns)
    return path


def test_constants_are_found_from_a_log(folder, capsys):
    """In the file they take the place of those of the model; comments stay."""
    log = log_of(folder / "noisy.csv", 0.01)
    out, report = folder / "found.toml", folder / "found.json"
    code, _, err = run(
        capsys, "calibrate", log, "--machine", folder / "wrong.toml", "--out", out,
        "--parameter", "R", "--parameter", "L", "--json", report,
    )  # fmt: skip
    assert code == 0 and "warning" not in err, err
    found = json.loads(report.read_text())["parameters"]
    for name, true in (("R", R), ("L", L)):
        assert found[name]["low"] < true < found[name]["high"] and found[name]["written"]
    text = out.read_text()
    assert "# as on the plate" in text
    values = tomllib.loads(text)["machine"]["parameters"]
    np.testing.assert_allclose([values["R"], values["L"]], [R, L], rtol=3e-3)
    assert read_machine(out).constants()["K"] == K


@pytest.mark.slow
def test_only_what_a_log_tells_is_determined(folder):
    """The units of torque are in no log of voltage and current: of K, J and b the ratios
    K^2/J and b/J are."""
    machine = read_machine(folder / "motor.toml")
    log = read_log(log_of(folder / "other.csv", 0.003, 3), machine.signals)
    found = calibrate_machine(machine, log)
    assert found.determined("R") and found.determined("L")
    assert not any(map(found.determined, ("K", "J", "b")))
    (flat,) = found.undetermined
    np.testing.assert_allclose(
        [flat.parts[n] / flat.parts["J"] for n in ("K", "b")], [0.5, 1.0], rtol=0.02
    )


def test_a_model_without_constants_has_no_calibration(tmp_path):
    (tmp_path / "plant.py").write_text("""
import aslo_jax as aslo

motor = aslo.Model(
    lambda x, y, u: [200.0 * y[0] - 0.7 * x[0]],
    lambda x, y, u: [250.0 * u[0] - 225.0 * y[0] - 15.0 * x[0]],
    states={"speed": (-200, 200)},
    outputs={"current": (-5, 5)},
    inputs={"voltage": (-12, 12)},
)
""")
    (tmp_path / "motor.toml").write_text(MACHINE)
    machine = read_machine(tmp_path / "motor.toml")
    log = read_log(log_of(tmp_path / "log.csv"), machine.signals)
    with pytest.raises(MachineError, match="no parameters that are known"):
        calibrate_machine(machine, log)


def test_a_log_is_filtered_and_smoothed_by_the_relation(folder, capsys):
    """The Kalman filter, with the noise of the log, beside the truth; and both ways."""
    machine = folder / "lifted.toml"
    machine.write_text(MACHINE + '[observer]\nkind = "lifted_kalman"\n')
    log = log_of(folder / "log.csv", 0.01)
    errors = {}
    for way in ((), ("--smooth",)):
        out = folder / "out.npz"
        out.unlink(missing_ok=True)
        code, printed, err = run(
            capsys, "estimate", log, "--machine", machine, "--out", out, *way
        )
        assert code == 0 and not err and "found from the log" in printed
        with np.load(out) as table:
            assert np.all(table["coasting"][200:] == 0)
            error = table["error_speed"][200:]
            assert np.sqrt(np.mean((error / table["deviation_speed"][200:]) ** 2)) < 2.0
            errors[way] = np.sqrt(np.mean(error**2))
    assert errors[("--smooth",)] < errors[()] < 0.1


def test_a_key_without_effect_is_refused(folder):
    for key in ("cutoff = 30.0", 'completion = "repeat"'):
        machine = folder / "refused.toml"
        text = MACHINE + f'[observer]\nkind = "lifted_kalman"\n{key}\n'
        machine.write_text(text)
        with pytest.raises(MachineError, match="has no effect"):
            read_machine(machine)


@pytest.mark.slow
def test_the_covariance_of_states_is_that_of_their_errors():
    """Of many records with noise, where x of the relation is the states' own product."""
    found = derive(
        aslo.Model(
            lambda x, y, u: [u[0] - 2.0 * x[0], 0.0],
            lambda x, y, u: [x[0] * x[1] - y[0], x[1] * u[0]],
            states={"x": (0.5, 2.0), "gain": (1.0, 3.0)},
            outputs={"y": (-2.0, 2.0), "z": (-2.0, 2.0)},
            inputs={"u": (1.0, 4.0)},
        )
    )
    h, count, deviation = 0.01, 200, np.array([0.01, 0.02])
    t = h * np.arange(count)
    u = (2.5 + np.sin(7.0 * t))[:, None]
    plant, state = found.plant(), jnp.array([1.1, 2.2, 0.0, 0.3])

    def step(s, u):
        fine = h / 10
        for _ in range(10):
            a = plant.drift(s, u)
            s = s + fine * plant.drift(s + 0.5 * fine * a, u)
        return s, s

    _, later = jax.lax.scan(step, state, jnp.asarray(u[:-1]))
    s = np.concatenate([np.asarray(state)[None], later])
    rng = np.random.default_rng(0)
    noisy = s[:, 2:] + deviation * rng.standard_normal((64, count, 2))
    observer = found.kalman_filter(jnp.asarray(deviation), jnp.array([1e-6]))
    run = jax.jit(jax.vmap(lambda y: aslo.replay(observer, t, u, y)))
    estimate = run(jnp.asarray(noisy))
    error = np.asarray(estimate.value)[:, -1] - s[-1, :2]
    P = np.asarray(estimate.covariance)[:, -1]
    distance = np.einsum("ni,nij,nj->n", error, np.linalg.inv(P), error)
    assert 1.5 < distance.mean() < 2.6  # chi squared of two degrees of freedom


def test_the_machine_of_a_study_finds_its_model(folder):
    machine = machine_of(tomllib.loads(STUDY), folder)
    assert machine.signals.inputs == ("voltage",) and set(machine.constants()) == set(
        "RLKJb"
    )


@pytest.mark.slow
def test_a_cutoff_is_tuned(folder, capsys):
    text = STUDY + '[[sensor]]\nkind = "noise"\ndeviation = 0.01\n'
    (folder / "noisy.toml").write_text(text.replace("cutoff = 100.0", "cutoff = 600.0"))
    out = folder / "tuned.toml"
    code, printed, _ = run(
        capsys, "tune", folder / "noisy.toml", "--out", out, "--gain", "ASLO.cutoff",
        "--samples", "16", "--iterations", "5", "--after", "0.05",
    )  # fmt: skip
    assert code == 0 and "less" in printed
    assert tomllib.loads(out.read_text())["observers"]["ASLO"]["cutoff"] != 600.0


@pytest.mark.slow
def test_an_observer_of_a_model_is_exported(folder, capsys):
    code, printed, _ = run(
        capsys, "export", folder / "motor.toml", "--out", folder / "c", "--cutoff", "100",
        "--interval", "2e-4",
    )  # fmt: skip
    assert code == 0 and "operations a step" in printed
    assert "8 parameters" in printed  # none of them twice


PMSM = """
import aslo_jax as aslo

pmsm = aslo.Model(
    f=lambda x, y, u, p: u - p["R"] * y,
    h=lambda x, y, u, p: [((x - p["L"] * y) ** 2).sum() - p["m"] ** 2],
    states={"flux_alpha": (-0.5, 0.5), "flux_beta": (-0.5, 0.5)},
    outputs={"i_alpha": (-5, 5), "i_beta": (-5, 5)},
    inputs={"u_alpha": (-200, 200), "u_beta": (-200, 200)},
    parameters={"R": 9.3, "L": 38e-3, "m": 0.212},
)
"""


@pytest.mark.slow
def test_a_model_that_is_no_plant_is_fitted_by_its_relation(tmp_path):
    """The recorded motor from ten lines: its speed is in no equation."""
    (tmp_path / "plant.py").write_text(PMSM)
    file = tmp_path / "pmsm.toml"
    file.write_text(MACHINE.replace("motor", "pmsm") + "[observer]\ncutoff = 150.0\n")
    machine = read_machine(file)
    log = read_log("aslo_jax/data/pmsm_log.csv", machine.signals)
    found = calibrate_machine(machine, log)
    truth = {"R": 8.875, "L": 40.03e-3, "m": 0.2086}
    for name, value in truth.items():
        assert found.after[name] == pytest.approx(value, rel=1e-4)
