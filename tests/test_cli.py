"""The command line on the recorded log: figures, files, refusals."""

import sys
from pathlib import Path

import numpy as np
import pytest

import aslo_jax as aslo
from aslo_jax.cli import _table as tables, main
from aslo_jax.logs import read_log, write_table
from aslo_jax.machines import read_machine

DATA = Path(aslo.__file__).parent / "data"
LOG, MOTOR = DATA / "pmsm_log.csv", DATA / "motor.toml"
REQUIRED = [
    "t",
    "flux_alpha",
    "flux_beta",
    "theta_electrical",
    "omega_electrical",
    "certificate",
    "coasting",
    "coasting_speed",
]
ERRORS = [
    "error_flux_alpha",
    "error_flux_beta",
    "error_theta_electrical",
    "error_omega_electrical",
]


def run(capsys, *arguments) -> tuple[int, str, str]:
    """Exit code, standard output and standard error of a command."""
    with pytest.raises(SystemExit) as left:
        main([str(argument) for argument in arguments])
    output = capsys.readouterr()
    return int(left.value.code or 0), output.out, output.err


def estimate(capsys, log, out, *options, machine=MOTOR) -> tuple[int, str, str]:
    return run(capsys, "estimate", log, "--machine", machine, "--out", out, *options)


def refusal(capsys, code, *arguments) -> str:
    """The one line that a refused command prints."""
    found, out, err = run(capsys, *arguments)
    assert found == code
    assert out == ""
    assert err.count("\n") == 1
    assert err.startswith("aslo-jax: error: ")
    return err


def read_csv(path) -> dict[str, np.ndarray]:
    names = path.read_text().splitlines()[0].split(",")
    values = np.loadtxt(path, delimiter=",", skiprows=1)
    return dict(zip(names, values.T, strict=True))


@pytest.fixture(scope="module")
def short(tmp_path_factory) -> Path:
    """The first 300 rows of the log, 60 ms."""
    path = tmp_path_factory.mktemp("short") / "short.csv"
    path.write_text("\n".join(LOG.read_text().splitlines()[:301]) + "\n")
    return path


@pytest.fixture(scope="module")
def direct() -> aslo.Estimate:
    """The library's own replay of the log, 4 substeps, cutoff 150 rad/s."""
    log, motor = read_log(LOG), read_machine(MOTOR).plant()
    observer = aslo.AlgebraicObserver(
        motor.flux_relation(), aslo.LowPass(150.0), guard=aslo.Guard(threshold=1e-3)
    )
    return aslo.replay(observer, log.t, log.u, log.y, substeps=4)


def test_estimate_of_the_recorded_log(tmp_path, capsys, direct):
    out, plot = tmp_path / "estimate.csv", tmp_path / "estimate.png"
    code, printed, err = estimate(capsys, LOG, out, "--plot", plot)
    assert (code, err) == (0, "")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["estimate.csv", "estimate.png"]
    table, truth = read_csv(out), read_csv(LOG)
    assert list(table) == REQUIRED + ERRORS
    np.testing.assert_array_equal(table["t"], truth["t"])

    # What the library gives, to rounding (the tool takes time from the log's first row).
    # The first rows, ill-conditioned, magnify rounding by one over the certificate.
    flux_columns = np.stack([table["flux_alpha"], table["flux_beta"]], axis=1)
    np.testing.assert_allclose(flux_columns, direct.value, atol=1e-9)
    np.testing.assert_allclose(table["certificate"], direct.certificate, atol=1e-9)
    np.testing.assert_array_equal(table["coasting"], direct.coasting)

    # What the truth columns say: 2e-3 from 20 ms on, 5e-5 median after 0.15 s.
    true_flux = np.stack([truth["flux_alpha"], truth["flux_beta"]], axis=1)
    relative = np.linalg.norm(flux_columns - true_flux, axis=1) / np.linalg.norm(
        true_flux, axis=1
    )
    t = table["t"]
    assert relative[t >= 0.02].max() < 2e-3
    assert np.median(relative[t >= 0.15]) < 5e-5
    assert relative[0] == 1.0
    assert table["coasting"][0] == 1
    assert table["coasting"][t > 0.002].max() == 0

    # Angle: of flux - L i, within 0.01 degrees of the truth, without jumps.
    turns = (table["theta_electrical"] - truth["theta_electrical"]) / (2 * np.pi)
    assert np.ptp((turns - np.round(turns))[t > 0.15]) * 360 < 0.02
    assert np.abs(np.diff(table["theta_electrical"])[t[1:] > 0.01]).max() < 0.07
    speed_error = table["omega_electrical"] - 5 * truth["omega_mechanical"]
    # The loop's w alone would lag by 2 al/b, 3 rad/s rms here.
    assert np.sqrt(np.mean(speed_error[t > 0.15] ** 2)) < 0.1

    # The error columns are estimate less truth, the angle's wrapped.
    np.testing.assert_allclose(
        table["error_flux_beta"], table["flux_beta"] - truth["flux_beta"], atol=1e-15
    )
    np.testing.assert_allclose(table["error_omega_electrical"], speed_error, atol=1e-12)
    error = table["error_theta_electrical"]
    assert np.abs(error).max() <= np.pi
    np.testing.assert_allclose(np.exp(1j * error), np.exp(2j * np.pi * turns), atol=1e-10)

    assert "8000 rows, 1.5998 s, median interval 0.2 ms" in printed
    assert "pmsm: least-squares, exact start, threshold 0.001, 4 substeps\n" in printed
    assert "  cutoff 150 rad/s\n  pll_bandwidth 100 rad/s\n" in printed
    assert "coasting: 0.137 % of the rows (11)" in printed
    assert "relative error, median 2.3e-05" in printed
    assert plot.read_bytes().startswith(b"\x89PNG")


def test_one_substep_and_no_truth(tmp_path, capsys):
    out = tmp_path / "out.npz"
    code, printed, _ = estimate(capsys, LOG, out, "--substeps", 1, "--no-truth")
    assert code == 0
    assert "truth" not in printed
    with np.load(out) as table:
        assert table.files == REQUIRED
        found = np.stack([table["flux_alpha"], table["flux_beta"]], axis=1)
    truth = read_log(LOG).truth
    error = found - np.stack([truth["flux_alpha"], truth["flux_beta"]], axis=1)
    relative = np.hypot(*error.T) / np.hypot(truth["flux_alpha"], truth["flux_beta"])
    late = read_log(LOG).t >= 0.15
    assert 1e-5 < np.median(relative[late]) < 5e-5


def test_formats_and_names_do_not_change_the_numbers(tmp_path, capsys, short):
    log = read_log(short)
    columns = {"clock": log.t, "ua": log.u[:, 0], "u_beta": log.u[:, 1]}
    columns |= {"i_alpha": log.y[:, 0], "i_beta": log.y[:, 1], **log.truth}
    write_table(tmp_path / "log.parquet", columns)
    write_table(tmp_path / "log.npz", columns)
    estimate(capsys, short, tmp_path / "csv.npz", "-q")
    for suffix in ("parquet", "npz"):
        out = tmp_path / f"from_{suffix}.npz"
        names = ("--column", "t=clock", "--column", "u_alpha=ua")
        code, printed, err = estimate(
            capsys, tmp_path / f"log.{suffix}", out, *names, "--quiet"
        )
        assert (code, printed, err) == (0, "", "")
        with np.load(tmp_path / "csv.npz") as expected, np.load(out) as found:
            assert found.files == expected.files
            for name in found.files:
                np.testing.assert_array_equal(found[name], expected[name])


def test_parquet_out_holds_what_npz_holds(tmp_path, capsys, short):
    estimate(capsys, short, tmp_path / "out.npz")
    estimate(capsys, short, tmp_path / "out.parquet")
    table = pytest.importorskip("pyarrow.parquet").read_table(tmp_path / "out.parquet")
    with np.load(tmp_path / "out.npz") as expected:
        assert table.column_names == expected.files
        for name in expected.files:
            np.testing.assert_array_equal(table[name].to_numpy(), expected[name])


def test_a_long_log_is_replayed_in_pieces_with_progress(
    tmp_path, capsys, short, monkeypatch
):
    estimate(capsys, short, tmp_path / "whole.npz")
    monkeypatch.setattr(tables, "PIECE", 70)
    run_log, lengths = tables.run_log, []

    def spy(observer, log, *rest):
        lengths.append(log[2].shape[0])
        return run_log(observer, log, *rest)

    monkeypatch.setattr(tables, "run_log", spy)
    code, _, err = estimate(capsys, short, tmp_path / "pieces.npz")
    assert code == 0
    assert "100%" in err
    assert "299/299" in err
    # 299 intervals in pieces of at most 70, overlapping by a sample, for both observers,
    # of which the loop starts where the angle is certified.
    assert lengths[0] == 60 and lengths[2::2] == [61] * 4
    assert 40 < lengths[1] < 60 and lengths[3::2] == [61] * 4
    assert len(lengths) == 10
    with (
        np.load(tmp_path / "whole.npz") as whole,
        np.load(tmp_path / "pieces.npz") as found,
    ):
        for name in REQUIRED:
            np.testing.assert_allclose(found[name], whole[name], rtol=1e-9, atol=1e-9)
    assert estimate(capsys, short, tmp_path / "pieces.npz", "-q")[2] == ""


def test_the_cutoff_comes_from_the_option_the_file_or_the_log(tmp_path, capsys, short):
    table = MOTOR.read_text().split("[observer]")[0]
    machine = tmp_path / "motor.toml"
    machine.write_text(table)
    out = tmp_path / "out.npz"
    _, printed, _ = estimate(capsys, short, out, machine=machine)
    # 270 rad/s over sqrt(3) is 156.
    cutoff = float(printed.partition("cutoff ")[2].partition(" rad/s")[0])
    assert cutoff == pytest.approx(156.0, rel=0.05)
    assert "for the log's electrical speed of 2" in printed
    machine.write_text(table + "[observer]\ncutoff = 90\npll_bandwidth = 70\n")
    _, printed, _ = estimate(capsys, short, out, machine=machine)
    assert "  cutoff 90 rad/s\n  pll_bandwidth 70 rad/s\n" in printed
    options = ("--cutoff", 60, "--pll-bandwidth", 55)
    _, printed, _ = estimate(capsys, short, out, *options, machine=machine)
    assert "  cutoff 60 rad/s\n  pll_bandwidth 55 rad/s\n" in printed


def test_a_log_at_rest_coasts_and_says_so(tmp_path, capsys):
    zero = np.zeros(50)
    columns = {"t": 1e-3 * np.arange(50.0), "u_alpha": zero + 8.875, "u_beta": zero}
    write_table(tmp_path / "log.csv", columns | {"i_alpha": zero + 1.0, "i_beta": zero})
    code, printed, err = estimate(
        capsys, tmp_path / "log.csv", tmp_path / "out.csv", "--plot", tmp_path / "out.png"
    )
    assert code == 0
    assert "coasting: 100 % of the rows (50)" in printed
    assert "no estimate is certified in this log" in err
    table = read_csv(tmp_path / "out.csv")
    assert list(table) == REQUIRED
    assert all(np.isfinite(column).all() for column in table.values())
    np.testing.assert_allclose(table["flux_alpha"], 0.0, atol=1e-15)


def test_repeat_and_gain_are_run(tmp_path, capsys, short):
    machine = tmp_path / "motor.toml"
    machine.write_text(
        MOTOR.read_text().replace('"least-squares"', '"repeat"').replace("# gain", "gain")
    )
    log, description = read_log(short), read_machine(machine)
    _, printed, _ = estimate(capsys, short, tmp_path / "out.npz", machine=machine)
    assert "pmsm: repeat" in printed
    assert "  gain 50 rad/s\n" in printed
    observer = description.state_observer(description.rates())
    direct = aslo.replay(observer, log.t, log.u, log.y, substeps=4)
    with np.load(tmp_path / "out.npz") as found:
        np.testing.assert_allclose(found["flux_beta"], direct.value[:, 1], atol=1e-8)


def test_a_refused_log_leaves_earlier_outputs_as_they_were(tmp_path, capsys, short):
    bad = tmp_path / "bad.csv"
    text = short.read_text().splitlines()
    text[200] = text[200].replace(text[200].split(",")[3], "nan")
    bad.write_text("\n".join(text))
    out, plot = tmp_path / "out.csv", tmp_path / "out.png"
    out.write_text("earlier")
    message = refusal(
        capsys, 2, "estimate", bad, "--machine", MOTOR, "--out", out, "--plot", plot
    )
    assert "bad.csv, line 201, column `i_alpha`: the value is nan" in message
    assert "remove or repair that row" in message
    assert out.read_text() == "earlier"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["bad.csv", "out.csv"]


def test_a_failing_figure_leaves_no_table(tmp_path, capsys, short, monkeypatch):
    def fail(*_):
        raise OSError("No space left on device")

    monkeypatch.setattr("aslo_jax.cli._figure.save_figure", fail)
    options = ("--out", tmp_path / "out.csv", "--plot", tmp_path / "out.png")
    message = refusal(capsys, 1, "estimate", short, "--machine", MOTOR, *options)
    named = f"{options[1]}, {options[3]}"
    assert message == f"aslo-jax: error: cannot write {named}: No space left on device\n"
    assert list(tmp_path.iterdir()) == []


REFUSED = {
    "--out over the log": (["--out", "{log}"], "--out would overwrite the log"),
    "--plot over --out": (
        ["--out", "{dir}/a.csv", "--plot", "{dir}/../{name}/a.csv"],
        "--plot would overwrite --out",
    ),
    "--out a directory": (["--out", "{dir}/sub.csv"], "it is a directory; name a file"),
    "no such directory": (["--out", "{dir}/none/a.csv"], "does not exist; create it"),
    "--out suffix": (["--out", "{dir}/a.xlsx"], "'.xlsx', but a table is one of .csv"),
    "--plot suffix": (
        ["--out", "{dir}/a.csv", "--plot", "{dir}/a.csv.txt"],
        "'.txt', but a figure is one of .png, .pdf, .svg",
    ),
    "--cutoff": (["--out", "{dir}/a.csv", "--cutoff", "-3"], "`--cutoff` must be positive"),
    "--cutoff inf": (
        ["--out", "{dir}/a.csv", "--cutoff", "inf"],
        "`--cutoff` must be positive and finite (rad/s), but got inf",
    ),
    "--cutoff nan": (["--out", "{dir}/a.csv", "--cutoff", "nan"], "`--cutoff` must be pos"),
    "--max-gap": (
        ["--out", "{dir}/a.csv", "--max-gap", "0"],
        "--max-gap) must be positive (s)",
    ),
    "gaps": (
        ["--out", "{dir}/a.csv", "--max-gap", "1e-4"],
        "line 3, column `t`: a gap of 0.0002 s before 0.0002 s, above the limit of 0.0001",
    ),
    "--pll-bandwidth": (
        ["--out", "{dir}/a.csv", "--pll-bandwidth", "9e3"],
        "must be at most 2500 rad/s for the sampling interval of this log, 0.0002 s, but",
    ),
    "--column form": (["--out", "{dir}/a.csv", "--column", "t"], "the form NAME=COLUMN"),
    "--column twice": (
        ["--out", "{dir}/a.csv", "--column", "t=a", "--column", "t=b"],
        "--column gives `t` twice, a and b",
    ),
    "--column name": (
        ["--out", "{dir}/a.csv", "--column", "i_aplha=x"],
        "got `i_aplha`; did you mean `i_alpha`?",
    ),
    "--column target": (
        ["--out", "{dir}/a.csv", "--column", "i_alpha=iAlfa"],
        "no column `iAlfa`; perhaps it goes by another name: --column i_alpha=i_alpha "
        "(close to it: `i_alpha`)",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_refused_arguments(tmp_path, capsys, short, case):
    options, expected = REFUSED[case]
    (tmp_path / "sub.csv").mkdir()
    filled = [
        option.format(log=short, dir=tmp_path, name=tmp_path.name) for option in options
    ]
    before = short.read_bytes()
    message = refusal(capsys, 2, "estimate", short, "--machine", MOTOR, *filled)
    assert expected in message
    assert [p.name for p in tmp_path.iterdir()] == ["sub.csv"]
    assert short.read_bytes() == before


def test_refused_files(tmp_path, capsys, short):
    out = tmp_path / "out.csv"
    message = refusal(capsys, 2, "estimate", "none.csv", "--machine", MOTOR, "--out", out)
    assert "none.csv does not exist" in message
    message = refusal(capsys, 2, "estimate", short, "--machine", "none", "--out", out)
    assert "none does not exist" in message
    machine = tmp_path / "motor.toml"
    machine.write_text(MOTOR.read_text().replace("8.875 ", "-8.875"))
    message = refusal(capsys, 2, "estimate", short, "--machine", machine, "--out", out)
    assert "motor.toml: `machine.resistance`, stator resistance (ohm), must be" in message
    assert not out.exists()


@pytest.mark.parametrize(
    ("module", "extra"), [("matplotlib", "cli,plot"), ("pyarrow", "cli")]
)
def test_a_missing_package_is_named_with_its_command(
    tmp_path, capsys, short, monkeypatch, module, extra
):
    for name in [name for name in sys.modules if name.partition(".")[0] == module]:
        monkeypatch.setitem(sys.modules, name, None)
    monkeypatch.setitem(sys.modules, module, None)
    options = ("--out", tmp_path / "out.csv", "--plot", tmp_path / "out.png")
    message = refusal(capsys, 1, "estimate", short, "--machine", MOTOR, *options)
    assert f'`{module}` is not installed: pip install "aslo_jax[{extra}]"' in message
    assert list(tmp_path.iterdir()) == []


def test_sample_writes_what_the_package_ships(tmp_path, capsys):
    code, printed, _ = run(capsys, "sample", "--out", tmp_path)
    assert code == 0
    for name in ("pmsm_log.csv", "motor.toml", "README.md"):
        assert (tmp_path / name).read_bytes() == (DATA / name).read_bytes()
        assert name in printed
    assert "pmsm_log.csv exists" in refusal(capsys, 2, "sample", "--out", tmp_path)


def test_paper_calls_the_experiments(tmp_path, capsys, monkeypatch):
    called = []
    monkeypatch.setattr("aslo_jax.paper.run", lambda *a: called.append(a), raising=False)
    code, _, _ = run(capsys, "paper", "--section", 2, "--out", tmp_path)
    assert code == 0
    assert called == [(2, tmp_path)]
