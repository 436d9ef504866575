"""A log in any frame, or with samples missing, gives the estimates of the log as it was."""

from pathlib import Path

import held_logs
import numpy as np
import pytest

from aslo_jax.cli import main
from aslo_jax.frames import inverse_clarke, park
from aslo_jax.logs import Frame, Log, LogError, LogReader, _reader, write_table
from aslo_jax.machines import template

MACHINE = """
[machine]
kind = "pmsm"
resistance = 1.7
inductance = 8.1e-3
magnet_flux = 0.093
pole_pairs = 4
inertia = 2e-4
"""
PAIRS = {"u": ("u_alpha", "u_beta"), "i": ("i_alpha", "i_beta")}


@pytest.fixture(scope="module")
def motor() -> dict[str, np.ndarray]:
    columns = held_logs.motor(1.7, 8.1e-3, 8.1e-3, 0.093, 4, 330.0, 3.0, rows=801)
    return {name: x for name, x in columns.items() if "flux" not in name}


def vector(motor, name: str) -> np.ndarray:
    return np.stack([motor[column] for column in PAIRS[name]], axis=1)


def in_dq(motor, factor: float = 1.0) -> dict[str, np.ndarray]:
    found = {"t": motor["t"]}
    for name in PAIRS:
        turned = factor * park(vector(motor, name), motor["theta_electrical"])
        found |= {f"{name}_d": turned[:, 0], f"{name}_q": turned[:, 1]}
    return found


def in_abc(motor) -> dict[str, np.ndarray]:
    phases = {name: inverse_clarke(vector(motor, name)) for name in PAIRS}
    columns = {f"{n}_{p}": x[:, k] for n, x in phases.items() for k, p in enumerate("abc")}
    return {"t": motor["t"]} | columns


def estimated(folder: Path, columns, *options) -> dict[str, np.ndarray]:
    write_table(folder / "log.npz", columns)
    (folder / "machine.toml").write_text(MACHINE)
    arguments = ["estimate", folder / "log.npz", "--machine", folder / "machine.toml"]
    with pytest.raises(SystemExit) as left:
        main([str(a) for a in (*arguments, "--out", folder / "out.npz", *options)])
    assert not left.value.code
    with np.load(folder / "out.npz") as table:
        return dict(table)


def assert_same(found, expected, rtol: float = 1e-9):
    for name in ("flux_alpha", "flux_beta", "theta_electrical", "omega_electrical"):
        size = np.abs(expected[name]).max()
        np.testing.assert_allclose(found[name], expected[name], atol=rtol * size, rtol=0)


def test_any_frame_gives_the_same_estimate(tmp_path, motor, capsys):
    bare = {name: x for name, x in motor.items() if name in ("t", *sum(PAIRS.values(), ()))}
    expected = estimated(tmp_path, bare, "-q")
    abc = in_abc(motor)
    assert_same(estimated(tmp_path, abc, "--frame", "abc", "-q"), expected)
    two = {name: x for name, x in abc.items() if not name.endswith("_c")}
    assert_same(estimated(tmp_path, two, "--frame", "abc", "-q"), expected)

    wrapped = motor["theta_electrical"] % (2.0 * np.pi)
    dq = in_dq(motor) | {"position": np.degrees(wrapped)}
    turn = ["--frame", "dq", "--angle", "position*pi/180"]
    capsys.readouterr()
    assert_same(estimated(tmp_path, dq, *turn), expected)
    largest = 0.5 * np.abs(np.diff(motor["theta_electrical"])).max()
    assert (
        f"half a step further on, here up to {largest:.3g} rad" in capsys.readouterr().out
    )

    shaft = in_dq(motor) | {"theta_m [deg]": np.degrees(motor["theta_electrical"]) / 4}
    turn = ["--frame", "dq", "--angle", "theta_m", "--angle-kind", "mechanical", "-q"]
    assert_same(estimated(tmp_path, shaft, *turn), expected)

    larger = in_dq(motor, 1.5**0.5) | {"theta_e": wrapped}
    turn = ["--frame", "dq", "--power-invariant", "-q"]
    assert_same(estimated(tmp_path, larger, *turn), expected)
    scaled = {n: x if n == "t" else 1.5**0.5 * x for n, x in bare.items()}
    assert_same(estimated(tmp_path, scaled, "--power-invariant", "-q"), expected)


def test_phases_may_have_a_mean_that_is_not_zero(motor):
    abc = in_abc(motor)
    lifted = {n: x + (12.0 if n[0] == "u" else 0.0) for n, x in abc.items()}
    np.testing.assert_allclose(
        Log.from_columns(lifted, frame="abc").u, vector(motor, "u"), atol=1e-12
    )


def test_truth_in_the_frame_of_the_log_is_turned_too(motor):
    flux = np.stack([0.1 + 0.01 * np.sin(motor["t"]), 0.02 + motor["t"]], axis=1)
    angle = motor["theta_electrical"]
    turned = park(flux, angle)
    dq = in_dq(motor) | {"flux_d": turned[:, 0], "psi_q": turned[:, 1], "theta_e": angle}
    log = Log.from_columns(dq, frame="dq")
    found = np.stack([log.truth["flux_alpha"], log.truth["flux_beta"]], axis=1)
    np.testing.assert_allclose(found, flux, atol=1e-14)
    assert set(log.truth) == {"flux_alpha", "flux_beta", "theta_electrical"}
    assert not Log.from_columns(dq, frame="dq", truth=False).truth


def refusal(*arguments, **options) -> str:
    with pytest.raises(LogError) as error:
        Log.from_columns(*arguments, **options)
    return str(error.value)


def test_frames_that_make_no_sense_are_refused(motor):
    dq = in_dq(motor)
    assert "has no column `angle`" in refusal(dq | {"theta": motor["t"]}, frame="dq")
    assert "--angle theta" in refusal(dq | {"theta": motor["t"]}, frame="dq")
    shaft = dq | {"theta_m": motor["t"]}
    message = refusal(shaft, frame=Frame("dq", "theta_m", pole_pairs=3))
    assert "may be mechanical" in message and "--angle-kind electrical" in message
    Log.from_columns(shaft, frame=Frame("dq", "theta_m", "electrical"))
    for given, expected in (
        (dict(name="qd"), "must be one of alpha-beta, dq, abc, but is 'qd'"),
        (dict(name="abc", power_invariant=True), "phases are what they are"),
        (dict(angle="x"), "the frame is alpha-beta; add --frame dq"),
        (dict(name="dq", angle_kind="mechanical"), "needs the number of pole pairs"),
        (dict(name="dq", angle_kind="shaft"), "electrical or mechanical, but is 'shaft'"),
    ):
        with pytest.raises(LogError) as error:
            Frame(**given)
        assert expected in str(error.value)


def test_a_machine_without_alpha_and_beta_has_no_frames(tmp_path, capsys):
    write_table(tmp_path / "log.csv", {"t": np.arange(3.0)})
    (tmp_path / "machine.toml").write_text(template("magnetic_bearing"))
    arguments = ["estimate", tmp_path / "log.csv", "--machine", tmp_path / "machine.toml"]
    with pytest.raises(SystemExit) as left:
        main([*map(str, arguments), "--out", str(tmp_path / "o.csv"), "--frame", "dq"])
    assert left.value.code == 2
    assert "--frame dq is for columns alpha and beta, but" in capsys.readouterr().err


def holed(*rows: int, size: int = 60) -> dict[str, np.ndarray]:
    """A log that interpolation gives back, with samples missing in `rows`."""
    k = np.arange(float(size))
    columns = {"t": 1e-3 * k, "u_alpha": k, "u_beta": 1 - k, "i_alpha": 2 * k, "i_beta": -k}
    for row in rows:
        columns["i_alpha"][row] = np.nan
        columns["u_beta"][row] = np.inf
    return columns


def test_missing_samples_are_refused_by_default():
    assert "row 7 (counted from 0), column `u_beta`: the value is inf" in refusal(holed(7))
    for way in ("coast", "interpolate"):
        broken = holed() | {"t": np.where(np.arange(60) == 5, np.nan, holed()["t"])}
        assert "row 5 (counted from 0), column `t`" in refusal(broken, missing=way)


def test_missing_samples_are_passed_on():
    log = Log.from_columns(holed(7, 59), missing="coast")
    assert np.isnan(log.y[[7, 59], 0]).all() and np.isinf(log.u[7, 1])
    assert np.isfinite(np.delete(log.y, [7, 59], axis=0)).all()


@pytest.mark.parametrize(
    "rows", [[7], [1, 2, 3], [3, 4, 19, 20, 21, 40], list(range(1, 11))]
)
@pytest.mark.parametrize("batch", [3, 7, 60])
def test_missing_samples_are_interpolated(tmp_path, monkeypatch, rows, batch):
    """In whatever batches a file is read."""
    whole = _reader.open_source

    def in_batches(path):
        source = whole(path)

        def batches(wanted, blanks):
            (data,) = source.batches(wanted, blanks)
            for first in range(0, 60, batch):
                yield {n: x[first : first + batch] for n, x in data.items()}

        return type(source)(source.path, source.names, batches, source.where)

    monkeypatch.setattr(_reader, "open_source", in_batches)
    write_table(tmp_path / "log.npz", holed(*rows))
    reader = LogReader(tmp_path / "log.npz", missing="interpolate")
    (log,) = reader.pieces(60)
    full = holed()
    np.testing.assert_allclose(log.y[:, 0], full["i_alpha"], atol=1e-12)
    np.testing.assert_allclose(log.u[:, 1], full["u_beta"], atol=1e-12)
    longest = max(len(run) for run in np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1))
    assert f"{len(rows)} of 60 rows" in reader.said[-1]
    assert f"at most {longest} next to each other" in reader.said[-1]


def test_what_cannot_be_interpolated_is_refused():
    long = refusal(holed(*range(20, 31)), missing="interpolate")
    assert "row 20 (counted from 0): samples are missing in 11 rows" in long
    assert "--most-missing" in long
    Log.from_columns(holed(*range(20, 31)), missing="interpolate", most_missing=11)
    for row in (0, 59):
        assert f"row {row} (counted from 0): samples are missing at an end" in refusal(
            holed(row), missing="interpolate"
        )
    assert "must be one of refuse, coast, interpolate" in refusal(holed(), missing="skip")
    assert "must be at least 1 row" in refusal(holed(), most_missing=0)


def test_blanks_and_words_for_nothing_are_missing(tmp_path):
    text = ["t,u_alpha,u_beta,i_alpha,i_beta"]
    text += [f"{k},{k},{k},{'' if k == 3 else 'NA' if k == 4 else k},0" for k in range(9)]
    (tmp_path / "log.csv").write_text("\n".join([*text, ""]))
    with pytest.raises(LogError, match=r"line 5, column `i_alpha`: the value is blank"):
        LogReader(tmp_path / "log.csv")
    (log,) = LogReader(tmp_path / "log.csv", missing="interpolate").pieces(9)
    np.testing.assert_array_equal(log.y[:, 0], np.arange(9.0))


def scored(capsys, folder: Path, columns, *options) -> tuple[dict[str, np.ndarray], str]:
    capsys.readouterr()
    return estimated(folder, columns, *options), capsys.readouterr().out


def test_bias_and_scatter_are_told_apart(tmp_path, motor, capsys):
    """An encoder mounted with an offset, near half a turn where errors wrap, and noise."""
    noise = 0.02 * np.random.default_rng(3).normal(size=motor["t"].size)
    truth = {"theta_electrical": motor["theta_electrical"] + np.pi - 0.03 + noise}
    log = motor | truth
    table, said = scored(capsys, tmp_path, log)
    line = next(line for line in said.splitlines() if "angle, from" in line)
    bias, scatter = (
        float(line.partition(word)[2].split()[0].strip(","))
        for word in ("bias ", "scatter ")
    )
    assert abs(abs(bias) - np.degrees(np.pi - 0.03)) < 0.3
    assert abs(scatter - np.degrees(0.02)) < 0.12
    aligned, said = scored(capsys, tmp_path, log, "--align")
    assert "was removed" in said
    late = aligned["t"] > 0.06
    assert abs(np.mean(aligned["error_theta_electrical"][late])) < 3e-3
    moved = np.angle(np.exp(1j * table["error_theta_electrical"][late]))
    assert np.abs(moved).min() > 3.0
    for name in ("flux_alpha", "theta_electrical"):  # the estimate stays
        np.testing.assert_array_equal(aligned[name], table[name])


def test_any_truth_is_scored(tmp_path, motor, capsys):
    bare = {name: x for name, x in motor.items() if name in ("t", *sum(PAIRS.values(), ()))}
    shaft = {"theta_m [deg]": np.degrees(motor["theta_electrical"] / 4.0)}
    table, said = scored(capsys, tmp_path, bare | shaft)
    assert "angle, from" in said and "flux, from" not in said
    late = table["t"] > 0.06
    assert np.abs(table["error_theta_electrical"][late]).max() < 5e-3
    part = {"psi_beta": np.full(motor["t"].size, 0.1)}
    table, said = scored(capsys, tmp_path, bare | part)
    assert "flux_beta: error, bias" in said
    np.testing.assert_allclose(table["error_flux_beta"], table["flux_beta"] - 0.1)


def test_truth_that_is_missing_is_not_scored(tmp_path, motor, capsys):
    holed = np.where(np.arange(motor["t"].size) % 3 == 1, np.nan, motor["theta_electrical"])
    _, said = scored(
        capsys, tmp_path, motor | {"theta_electrical": holed}, "--missing", "interpolate"
    )
    assert "nan" not in said and "angle, from" in said
