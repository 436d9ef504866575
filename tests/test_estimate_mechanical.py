"""Velocities of mechanisms through the command line: those of logs that SciPy made from the
equations written out (tests/held_logs.py)."""

import dataclasses
from collections.abc import Callable
from pathlib import Path

import held_logs
import matplotlib.figure
import numpy as np
import pytest

from aslo_jax.cli import _table as tables, main
from aslo_jax.logs import read_log, write_table
from aslo_jax.machines import cutoff_for_positions, read_machine, typical_frequency

Columns = dict[str, np.ndarray]


@dataclasses.dataclass(frozen=True)
class Case:
    keys: str
    log: Callable[..., Columns]
    angles: tuple[bool, ...]
    units: tuple[str, ...]

    def write(self, folder: Path, observer: str = "", **changes: str) -> Path:
        keys = self.keys
        for name, value in changes.items():
            keys = "\n".join(
                f"{name} = {value}" if line.startswith(name) else line
                for line in keys.splitlines()
            )
        path = folder / "machine.toml"
        path.write_text(f"[machine]\n{keys}\n[observer]\n{observer}\n")
        (folder / "robot.py").write_text(held_logs.CRANE)
        return path


CASES = {
    "leg": Case(
        'kind = "robotic_leg"\nm1 = 2.0\nm2 = 3.1\ndamping = [0.3, 0.2, 0.5]',
        held_logs.leg,
        (False, True, True),
        ("m/s", "rad/s", "rad/s"),
    ),
    "ball": Case(
        'kind = "ball_beam"\nlength = 1.2\ngravity = 9.81\ndamping = [0.1, 0.3]',
        held_logs.ball,
        (False, True),
        ("m/s", "rad/s"),
    ),
    "crane": Case(
        'kind = "mechanical"\nsystem = "robot:crane"',
        held_logs.crane,
        (False, True, True),
        ("m/s", "rad/s", "rad/s"),
    ),
}


def command(folder: Path, log: Columns, *options) -> int:
    """The exit code of a run whose table is out.npz."""
    write_table(folder / "log.npz", log)
    arguments = ["estimate", folder / "log.npz", "--machine", folder / "machine.toml"]
    with pytest.raises(SystemExit) as left:
        main([str(a) for a in (*arguments, "--out", folder / "out.npz", *options)])
    return int(left.value.code or 0)


def run(capsys, folder: Path, log: Columns, *options) -> tuple[int, str, str]:
    """Exit code, standard output and standard error."""
    code = command(folder, log, *options)
    output = capsys.readouterr()
    return code, output.out, output.err


def estimates(folder: Path, log: Columns, *options) -> Columns:
    assert command(folder, log, "-q", *options) == 0
    with np.load(folder / "out.npz") as table:
        return dict(table)


def bare(log: Columns) -> Columns:
    return {name: column for name, column in log.items() if "true" not in name}


def medians(table: Columns, log: Columns, after: float = 0.0) -> np.ndarray:
    """Of every velocity, the median error of certified rows over the median speed."""
    found = []
    for j in range(1, 4):
        if f"qdot{j}" in table:
            rows = (table[f"coasting_qdot{j}"] == 0) & (log["t"] >= after)
            truth = log[f"qdot{j}_true"]
            error = np.abs(table[f"qdot{j}"] - truth)[rows]
            found.append(np.median(error) / np.median(np.abs(truth[rows])))
    return np.array(found)


def encoded(log: Columns, angles: tuple[bool, ...]) -> Columns:
    """Through encoders of 12 bits, for a turn and for 2 m."""
    steps = [(2 * np.pi if angle else 2.0) / 4096 for angle in angles]
    read = {f"q{j}": s * np.round(log[f"q{j}"] / s) for j, s in enumerate(steps, start=1)}
    return log | read


@pytest.fixture(scope="module", params=CASES)
def case(request, tmp_path_factory) -> tuple[Case, Path, Columns, Columns]:
    """A case, its folder, the log and the estimates."""
    case, folder = CASES[request.param], tmp_path_factory.mktemp("case")
    case.write(folder)
    log = case.log()
    return case, folder, log, estimates(folder, log)


# A system from Python is compiled again by every command.
QUICK = pytest.mark.parametrize("case", ["leg", "ball"], indirect=True)


def test_the_velocities_are_found(case):
    """To 1e-4 in the median, from the first certified row on, with angles that wrap; all
    that is put out is what it says."""
    case, _, log, table = case
    for j, angle in enumerate(case.angles, start=1):
        assert (np.abs(np.diff(log[f"q{j}"])).max() > np.pi) == angle
    names = [f"qdot{j}" for j in range(1, len(case.angles) + 1)]
    assert list(table) == [
        "t",
        *names,
        *(f"certificate_{name}" for name in names),
        *(f"coasting_{name}" for name in names),
        *(f"error_{name}" for name in names),
    ]
    assert (medians(table, log) < 1e-4).all()
    assert (medians(table, log, after=0.5) < 3e-6).all()
    for name in names:
        np.testing.assert_array_equal(
            table[f"error_{name}"], table[name] - log[f"{name}_true"]
        )
        coasting = table[f"coasting_{name}"]
        np.testing.assert_array_equal(coasting, table[f"certificate_{name}"] <= 1e-2)
        first = int(np.argmin(coasting))
        assert 3 < first < 12 and not coasting[first:].any()


def residuals(printed: str) -> list[float]:
    """The medians of the consistency, by velocity."""
    lines = [line for line in printed.splitlines() if line.startswith("  velocity ")]
    return [float(line.split("median ")[1].split(",")[0]) for line in lines]


def test_without_truth_the_same_and_its_consistency(case, capsys):
    case, folder, log, scored = case
    code, printed, err = run(capsys, folder, bare(log))
    assert (code, err) == (0, "")
    with np.load(folder / "out.npz") as table:
        assert not any("error" in name for name in table)
        for name, column in table.items():
            np.testing.assert_array_equal(column, scored[name])
    assert "consistency, | change of q - integral of qdot | / integral" in printed
    found = residuals(printed)
    assert len(found) == len(case.angles) and max(found) < 1e-5


@QUICK
def test_consistency_tells_of_a_wrong_parameter(case, capsys, tmp_path):
    case, _, log, _ = case
    case.write(tmp_path, m1="2.2", length="1.3")
    _, printed, _ = run(capsys, tmp_path, bare(log))
    assert 5e-3 < max(residuals(printed)) < 0.5


@QUICK
def test_a_force_a_row_late_is_seen(case):
    """The tolerance above is tight enough for the convention of time to matter."""
    _, folder, log, _ = case
    late = log | {k: np.roll(v, 1) for k, v in log.items() if k.startswith("u")}
    assert medians(estimates(folder, late), log).max() > 1e-4


@pytest.mark.parametrize("case", ["ball"], indirect=True)
def test_wrapped_angles_and_pieces_change_nothing(case, monkeypatch):
    case, folder, log, whole = case
    turns = {f"q{j}": np.unwrap(log[f"q{j}"]) for j, a in enumerate(case.angles, 1) if a}
    smooth = estimates(folder, log | turns)
    machine = read_machine(folder / "machine.toml")
    recorded = read_log(folder / "log.npz", machine.signals)
    wrapped = dataclasses.replace(recorded, y=np.stack([log["q1"], log["q2"]], axis=1))
    for name, found in machine.residuals(whole, recorded).items():
        again = machine.residuals(whole, wrapped)[name]
        np.testing.assert_allclose(again[100:], found[100:], rtol=1e-6, atol=1e-9)
    monkeypatch.setattr(tables, "PIECE", 1500)
    pieces = estimates(folder, log)
    assert np.abs(turns["q2"] - log["q2"]).max() > 6.0
    for name, column in whole.items():
        np.testing.assert_allclose(smooth[name], column, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(pieces[name], column, rtol=1e-9, atol=1e-9)


@QUICK
def test_encoders_of_twelve_bits(case):
    """The cutoff is that of the log without encoders, the error below 3e-3."""
    case, folder, log, _ = case
    machine = read_machine(folder / "machine.toml")
    cutoffs = []
    for columns in (log, encoded(log, case.angles)):
        write_table(folder / "encoded.npz", columns)
        recorded = read_log(folder / "encoded.npz", machine.signals)
        cutoffs.append(machine.rates(recorded)["cutoff"].value)
    assert cutoffs[1] == pytest.approx(cutoffs[0], rel=0.03)
    table = estimates(folder, encoded(log, case.angles))
    found = medians(table, log, after=0.3)
    assert (found < 3e-3).all() and (found > 1e-5).all()


@pytest.mark.parametrize(
    "settings",
    ['completion = "repeat"', "gain = 20.0", 'start = "paper"', "cutoff = 20.0"],
)
def test_settings_of_the_observer_are_used(tmp_path, settings):
    """Each finds the velocities too, and leaves its own errors."""
    case, log = CASES["ball"], held_logs.ball(2001)
    case.write(tmp_path)
    plain = estimates(tmp_path, log)
    case.write(tmp_path, settings)
    table = estimates(tmp_path, log)
    assert (medians(table, log, after=1.0) < 1e-4).all()
    assert np.abs(table["qdot1"] - plain["qdot1"])[100:].max() > 1e-8


def test_the_summary_says_what_was_done(tmp_path, capsys):
    CASES["leg"].write(tmp_path)
    code, printed, err = run(capsys, tmp_path, held_logs.leg(1001))
    assert (code, err) == (0, "")
    for text in (
        "observer for robotic_leg: least-squares, exact start, threshold 0.01, 4 substeps",
        " rad/s, the typical frequency of the positions)\n",
        "  cutoff ",
        "coasting_qdot2: ",
        "against the truth columns:\n  velocity 1, from ",
        " m/s (of ",
        " rad/s (of ",
    ):
        assert text in printed
    run(capsys, tmp_path, held_logs.leg(1001), "--cutoff", 31)
    assert (
        "  cutoff 31 rad/s\n"
        in run(capsys, tmp_path, held_logs.leg(1001), "--cutoff", 31)[1]
    )


def test_the_figure_shows_every_velocity(tmp_path, monkeypatch):
    figures, save = [], matplotlib.figure.Figure.savefig

    def spy(self, *arguments, **settings):
        figures.append(self)
        save(self, *arguments, **settings)

    monkeypatch.setattr(matplotlib.figure.Figure, "savefig", spy)
    CASES["leg"].write(tmp_path)
    log = held_logs.leg(501)
    plot = tmp_path / "out.png"
    table = estimates(tmp_path, log, "--plot", plot)
    assert plot.read_bytes().startswith(b"\x89PNG")
    axes = figures[0].axes
    assert [axis.get_title(loc="left") for axis in axes] == [
        "Inputs",
        "Outputs",
        "Relative error, |estimate - truth| / rms of the truth",
        "Velocity 1",
        "Velocity 2",
        "Velocity 3",
        "Certificate; grey: coasting",
    ]
    for j, axis in enumerate(axes[3:6], start=1):
        drawn, truth = (line.get_ydata() for line in axis.get_lines())
        np.testing.assert_array_equal(drawn, table[f"qdot{j}"])
        np.testing.assert_array_equal(truth, log[f"qdot{j}_true"])
        error = axes[2].get_lines()[j - 1].get_ydata()
        size = np.sqrt(np.mean(log[f"qdot{j}_true"] ** 2))
        expected = np.abs(table[f"error_qdot{j}"]) / size
        np.testing.assert_allclose(error, expected, rtol=1e-12)


@pytest.mark.parametrize("omega", [0.8, 3.0, 12.0])
def test_the_typical_frequency_of_positions(omega):
    """That of a sinusoid about steady motion, beside slower ones and one that is noise; an
    encoder's steps change little."""
    t, rng = 1e-3 * np.arange(20001), np.random.default_rng(2)
    fast = 0.4 * np.sin(omega * t + 0.3) + 5.0 * t
    slow, still, noise = np.sin(0.3 * omega * t), 0.0 * t + 1.0, rng.standard_normal(t.size)
    q = np.stack([slow, fast, still, noise], axis=1)
    assert typical_frequency(t, q) == pytest.approx(omega, rel=0.1)
    step = 2 * np.pi / 4096
    assert typical_frequency(t, step * np.round(q / step)) == pytest.approx(omega, rel=0.1)
    cutoff, why = cutoff_for_positions(t, q)
    assert cutoff == pytest.approx(min(max(10 * omega, 5.0), 100.0), rel=0.1)
    ends = ("a tenth of the sampling rate, less than ten times", "ten times ")
    assert why.startswith(ends[0] if 10 * omega > 100 else ends[1])


def test_the_cutoff_of_a_mechanism_at_rest():
    t, q = 1e-3 * np.arange(100), np.ones((100, 2))
    cutoff, why = cutoff_for_positions(t, q)
    assert cutoff == 5.0
    assert why.startswith("the least, more than ten times 0 rad/s")
    assert cutoff_for_positions(100 * t, q)[0] == pytest.approx(1.0)
