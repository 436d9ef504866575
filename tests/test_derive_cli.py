"""From a model in a file to the estimates of a log, by the command line."""

import numpy as np
import pytest
from scipy.linalg import expm

from aslo_jax.cli import main
from aslo_jax.machines import MachineError, read_machine

MODEL = """
import aslo_jax as aslo

motor = aslo.Model(
    f=lambda x, y, u, p: [(p["K"] * y[0] - p["b"] * x[0] - p["load"]) / p["J"]],
    g=lambda x, y, u, p: [(u[0] - p["R"] * y[0] - p["K"] * x[0]) / p["L"]],
    states={"speed": (-200, 200)},
    outputs={"current": (-5, 5)},
    inputs={"voltage": (-12, 12)},
    parameters={"L": 4e-3, "R": 0.9, "K": 0.06, "J": 3e-4, "b": 2e-4, "load": 0.03},
    unknown=["load"],
    units={"speed": "rad/s", "current": "A", "voltage": "V", "load": "N m"},
)
hopeless = aslo.Model(
    f=lambda x, y, u: [-abs(x[0])],
    g=lambda x, y, u: [x[0]],
    states={"v": (-1, 1)},
    outputs={"q": (-1, 1)},
)
"""


def run(capsys, *arguments):
    with pytest.raises(SystemExit) as left:
        main([str(argument) for argument in arguments])
    output = capsys.readouterr()
    return int(left.value.code or 0), output.out, output.err


def write_log(path):
    """Under a held voltage, exactly."""
    h, t = 2e-4, np.arange(0.0, 0.5, 2e-4)
    u = 6 + 4 * np.sin(30 * (t + h / 2)) + 2 * np.sin(83 * (t + h / 2))
    A = np.array([[-2e-4 / 3e-4, 0.06 / 3e-4], [-0.06 / 4e-3, -0.9 / 4e-3]])
    states = [np.array([11.0, 0.5])]
    for k in range(t.size - 1):
        M = np.zeros((3, 3))
        M[:2] = np.column_stack([A, [-0.03 / 3e-4, u[k] / 4e-3]])
        states.append((expm(M * h) @ [*states[-1], 1.0])[:2])
    speed, current = np.array(states).T
    columns = np.column_stack([t, u, current, speed])
    header = "t,voltage,current,speed_true"
    np.savetxt(path, columns, delimiter=",", header=header, comments="")


def test_a_model_in_a_file_is_estimated_with(capsys, tmp_path):
    (tmp_path / "plant.py").write_text(MODEL)
    write_log(tmp_path / "log.csv")
    code, printed, err = run(capsys, "derive", f"{tmp_path / 'plant.py'}:motor")
    assert (code, err) == (0, "")
    assert "states: speed, load" in printed and "proved" in printed
    assert "certificate" in printed
    machine, out = tmp_path / "motor.toml", tmp_path / "out.npz"
    code, printed, err = run(
        capsys, "estimate", tmp_path / "log.csv", "--machine", machine, "--out", out
    )
    assert (code, err) == (0, "")
    with np.load(out) as table:
        late = table["t"] > 0.1
        assert np.abs(table["error_speed"][late]).max() < 0.1
        np.testing.assert_allclose(table["load"][late], 0.03, atol=2e-3)
    code, _, err = run(capsys, "derive", f"{tmp_path / 'plant.py'}:motor")
    assert code == 2 and "motor.toml exists" in err


def test_what_cannot_be_derived_writes_nothing(capsys, tmp_path):
    path = tmp_path / "plant.py"
    path.write_text(MODEL)
    code, _, err = run(capsys, "derive", f"{path}:hopeless")
    assert code == 2 and "`abs`" in err and "plant.py:15" in err
    assert list(tmp_path.glob("*.toml")) == []
    for wrong, expected in (
        ("plant:motor", "must be a file of Python"),
        (f"{tmp_path / 'none.py'}:motor", "does not exist"),
        (f"{path}:moter", "did you mean `motor`"),
    ):
        code, _, err = run(capsys, "derive", wrong)
        assert code == 2 and expected in err


def test_a_cutoff_below_the_fastest_mode_is_refused(tmp_path):
    (tmp_path / "plant.py").write_text(MODEL)
    file = tmp_path / "machine.toml"
    file.write_text('[machine]\nkind = "derived"\nmodel = "plant:motor"\n')
    machine = read_machine(file)
    with pytest.raises(MachineError, match=r"must be above 1\.333 rad/s"):
        machine.rates(None, {"cutoff": 1.0})
    assert machine.signals.inputs == ("voltage",)
    assert [q.unit for q in machine.quantities] == ["rad/s", "N m"]
