"""The Kalman filter of a relation through the command line: the noise that it finds, its
error beside that of the algebraic observer, and what it claims."""

import dataclasses
import json

import held_logs
import motor_logs
import numpy as np
import pytest

import aslo_jax as aslo
from aslo_jax.cli import _smoothing as smoothing, main
from aslo_jax.logs import Log, write_table
from aslo_jax.machines import _noise, read_machine

MOTOR = motor_logs.Motor("own", "pmsm", 1.7, 5e-3, 5e-3, 0.11, 4, 210.0, 3.0, 2e-4)
CURRENT, VOLTAGE = 4e-3, 5e-3  # noise, relative
LIFTED = 'kind = "lifted_kalman"'


def of_motor(log):
    pair = lambda name, z: {f"{name}_alpha": z.real, f"{name}_beta": z.imag}
    signals = pair("u", log["u"]) | pair("i", log["i"]) | pair("flux", log["flux"])
    return {"t": log["t"], **signals, "theta_electrical": log["angle"]}


@pytest.fixture(scope="module")
def clean():
    return motor_logs.run(MOTOR, "rich", rows=4001)


@pytest.fixture
def noisy(clean, tmp_path):
    log = motor_logs.noisy(clean, MOTOR, 11, CURRENT, VOLTAGE)
    write_table(tmp_path / "log.npz", of_motor(log))
    return tmp_path


def machine(folder, observer="", motor=MOTOR):
    path = folder / "machine.toml"
    path.write_text(
        f'[machine]\nkind = "pmsm"\nresistance = {motor.R}\ninductance = {motor.Ld}\n'
        f"magnet_flux = {motor.psi}\npole_pairs = {motor.pole_pairs}\ninertia = 1e-4\n"
        f"[observer]\n{observer}\n"
    )
    return path


def run(folder, *options, code=0):
    """The table of an estimate of `log.npz` by `machine.toml`."""
    files = folder / "log.npz", "--machine", folder / "machine.toml"
    out = folder / "out.npz"
    with pytest.raises(SystemExit) as left:
        main([str(x) for x in ("estimate", *files, "--out", out, *options)])
    assert int(left.value.code or 0) == code
    if code:
        return {}
    with np.load(out) as table:
        return {name: table[name] for name in table.files}


def flux_error(table, rows):
    pair = [table["error_flux_alpha"][rows], table["error_flux_beta"][rows]]
    return float(np.sqrt(np.mean(np.square(pair))))


LATE = slice(1500, 3500)


def test_it_beats_the_algebraic_observer_knows_by_how_much_and_smooths(
    noisy, clean, capsys
):
    machine(noisy)
    algebraic = run(noisy)
    assert not any(name.startswith("deviation") for name in algebraic)
    machine(noisy, LIFTED)
    found = run(noisy, "--json", noisy / "summary.json")
    printed = capsys.readouterr().out
    assert "observer for pmsm: lifted_kalman, threshold 0.9, 1 substep\n" in printed
    assert printed.count("(found from the log)") == 2
    noise = json.loads((noisy / "summary.json").read_text())["noise"]
    assert noise["found"] == ["output_deviation", "input_deviation"]
    level = np.sqrt(np.mean(np.abs(clean["u"]) ** 2))
    np.testing.assert_allclose(noise["output_deviation"], CURRENT * 3.0, rtol=0.05)
    np.testing.assert_allclose(noise["input_deviation"], VOLTAGE * level, rtol=0.05)
    assert flux_error(found, LATE) < 0.8 * flux_error(algebraic, LATE)
    smoothed = run(noisy, "--smooth")
    assert "1 substep, smoothed over the whole log" in capsys.readouterr().out
    assert flux_error(smoothed, LATE) < flux_error(found, LATE) / 1.2
    assert smoothed["coasting"].sum() < found["coasting"].sum()
    for table in (found, smoothed):
        for name in ("flux_alpha", "flux_beta", "theta_electrical"):
            of = table[f"error_{name}"] / table[f"deviation_{name}"]
            assert 0.5 < np.mean(of[LATE] ** 2) < 1.8


def test_deviations_of_the_file_are_taken(noisy, capsys):
    machine(noisy, f"{LIFTED}\noutput_deviation = [0.012, 0.012]\nprior = 0.3")
    one = run(noisy, "--json", noisy / "summary.json")
    noise = json.loads((noisy / "summary.json").read_text())["noise"]
    assert noise["output_deviation"] == [0.012, 0.012]
    assert noise["found"] == ["input_deviation"]
    assert "output_deviation 0.012 A\n" in capsys.readouterr().out
    machine(noisy, f"{LIFTED}\noutput_deviation = 0.12\nprior = 0.3")
    other = run(noisy)
    wider = other["deviation_flux_alpha"][LATE] / one["deviation_flux_alpha"][LATE]
    assert np.median(wider) > 1.6


def test_pieces_and_rows_in_doubt(noisy, monkeypatch):
    from aslo_jax.cli import _table as table

    machine(noisy, f"{LIFTED}\noutput_deviation = 0.012\ninput_deviation = 0.08")
    whole = run(noisy)
    monkeypatch.setattr(table, "PIECE", 700)
    pieces = run(noisy)
    for name, column in whole.items():
        np.testing.assert_allclose(pieces[name], column, atol=1e-9, err_msg=name)


@pytest.mark.slow
def test_it_finds_parameters_that_are_wrong(noisy, clean, capsys):
    off = dataclasses.replace(MOTOR, R=1.12 * MOTOR.R, psi=0.985 * MOTOR.psi)
    adaptive = 'kind = "adaptive"\nbank = 7'
    machine(noisy, LIFTED, off)
    ruined = run(noisy)
    machine(noisy, adaptive, off)
    found = run(noisy)
    printed = capsys.readouterr().out
    assert "pmsm: adaptive, unknown resistance and magnet_flux, 1 substep\n" in printed
    assert flux_error(found, LATE) < 0.2 * flux_error(ruined, LATE)
    assert not found["coasting"][LATE].any() and not found["held"][-1]
    for name, true in (("resistance", MOTOR.R), ("magnet_flux", MOTOR.psi)):
        deviation = found[f"deviation_{name}"][-1]
        assert deviation < 0.01 * true
        assert abs(found[name][-1] - true) < 4.0 * deviation + 2e-3 * true


def in_closed_loop(answer, count=20_000):
    """Noise of a current, 20 mA, and what a controller makes of it beside 0.3 V of its
    own."""
    rng = np.random.default_rng(4)
    t = 1e-4 * np.arange(count)
    y = np.stack([np.cos(300.0 * t), np.sin(300.0 * t)], 1)
    y = y + 0.02 * rng.standard_normal(y.shape)
    u = 40.0 * np.stack([np.cos(300.0 * t + 1.0), np.sin(300.0 * t + 1.0)], 1)
    return u - answer * y + 0.3 * rng.standard_normal(u.shape), y


@pytest.mark.parametrize("answer", [0.0, 60.0])
def test_the_answer_of_a_controller_is_no_noise(answer):
    u, y = in_closed_loop(answer)
    y[5000:5050] += 7.0  # nor is what cannot be right
    found = _noise.white_noise(u, y, [(0, 1)], [(0, 1)])
    np.testing.assert_allclose(found.output, 0.02, rtol=0.03)
    np.testing.assert_allclose(found.input, 0.3, rtol=0.05)
    assert not found.least_output and not found.least_input


def test_the_least_noise_is_that_of_steps_or_a_thousandth():
    t = 1e-4 * np.arange(5000)
    x = np.stack([np.cos(5.0 * t), np.sin(5.0 * t)], 1)
    found = _noise.white_noise(x, 0.1 * np.round(x / 0.1), [(0, 1)], [(0, 1)])
    np.testing.assert_allclose(found.output, 0.1 / 12**0.5, rtol=1e-6)
    np.testing.assert_allclose(found.input, 1e-3 * np.sqrt(np.mean(x**2)), rtol=1e-6)
    assert found.least_output and found.least_input


WRIM = (
    '[machine]\nkind = "wrim"\nstator_resistance = 1.3\nrotor_resistance = 0.7\n'
    "stator_inductance = 0.10\nrotor_inductance = 0.14\nmutual_inductance = 0.11\n"
    "pole_pairs = 2\ninertia = 0.02\n[observer]\n"
)


def with_noise(log, noise, seed=5):
    rng = np.random.default_rng(seed)
    size = log["t"].size
    moved = {
        k: log[k] + noise[k[0]] * rng.standard_normal(size) for k in log if k[0] in "ui"
    }
    return log | moved


@pytest.mark.slow
def test_both_windings_of_a_wrim(tmp_path):
    log = with_noise(held_logs.wrim(True, rows=4001), {"u": 0.5, "i": 0.02})
    write_table(tmp_path / "log.npz", log)
    for observer in (LIFTED, ""):
        (tmp_path / "machine.toml").write_text(WRIM + observer)
        table = run(tmp_path, *(["--smooth"] if observer else []))
        for part in "sr":
            names = [f"flux_{part}_{axis}" for axis in ("alpha", "beta")]
            error = np.stack([table[f"error_{n}"][LATE] for n in names])
            if observer:
                claimed = np.stack([table[f"deviation_{n}"][LATE] for n in names])
                assert 0.2 < np.mean((error / claimed) ** 2) < 3.0
                rms = np.sqrt(np.mean(error**2))
                keep = {part: rms} if part == "s" else keep | {part: rms}
            else:
                assert keep[part] < np.sqrt(np.mean(error**2))


def refused(folder, capsys, *options):
    run(folder, *options, code=2)
    return capsys.readouterr().err


def test_what_is_refused(noisy, capsys, monkeypatch):
    machine(noisy)
    assert "--smooth is for an `observer.kind` of" in refused(noisy, capsys, "--smooth")
    machine(noisy, LIFTED)
    assert "--substeps must be 1" in refused(noisy, capsys, "--substeps", 4)
    assert "`cutoff` has no effect with" in refused(noisy, capsys, "--cutoff", 100)
    machine(noisy, 'kind = "adaptive"\ndrift = 0.01')
    assert "has an `observer.drift`" in refused(noisy, capsys, "--smooth")
    machine(noisy, LIFTED)
    monkeypatch.setattr(smoothing, "MOST", 4000)
    assert "at most 4000 rows" in refused(noisy, capsys, "--smooth")
    for keys, message in (
        (f"{LIFTED}\ngain = 50.0", "`observer.gain` has no effect with"),
        ("prior = 0.1", "`observer.prior` is for `observer.kind"),
        (f"{LIFTED}\nthreshold = 1.5", "`observer.threshold` must be below 1"),
        (f"{LIFTED}\ninput_deviation = -1.0", "positive"),
        (f"{LIFTED}\nbank = 5", '`observer.bank` is for `observer.kind = "adaptive"`'),
        ('kind = "adaptive"\nprior = 0.1', "`observer.prior` has no effect with"),
        ('kind = "adaptive"\nparameters = ["inertia"]', "parameters"),
    ):
        machine(noisy, keys)
        assert message in refused(noisy, capsys), keys
    salient = (
        '[machine]\nkind = "interior_pmsm"\nresistance = 3.6\ndirect_inductance = 36e-3\n'
        "quadrature_inductance = 51e-3\npole_pairs = 3\ninertia = 0.015\n"
        f"magnet_flux = 0.5\n[observer]\n{LIFTED}\n"
    )
    (noisy / "machine.toml").write_text(salient)
    assert '`observer.saliency = "neglected"`' in refused(noisy, capsys)


@pytest.mark.parametrize("kind", ["stepper", "interior_pmsm"])
def test_other_motors(kind, tmp_path):
    motor = next(m for m in motor_logs.MOTORS if m.kind == kind)
    log = motor_logs.noisy(motor_logs.run(motor, "start"), motor, 3, 4e-3, 4e-3)
    write_table(tmp_path / "log.npz", of_motor(log))
    own = {
        "stepper": f"inductance = {motor.Ld}\n"
        f"torque_constant = {motor.psi * motor.pole_pairs}\n",
        "interior_pmsm": f"direct_inductance = {motor.Ld}\n"
        f"quadrature_inductance = {motor.Lq}\n",
    }
    text = f'[machine]\nkind = "{kind}"\nresistance = {motor.R}\n{own[kind]}'
    text += f"pole_pairs = {motor.pole_pairs}\ninertia = 1e-4\n[observer]\n"
    text += 'saliency = "neglected"\n' if kind == "interior_pmsm" else ""
    (tmp_path / "machine.toml").write_text(text)
    algebraic = flux_error(run(tmp_path), LATE)
    (tmp_path / "machine.toml").write_text(text + LIFTED)
    table = run(tmp_path)
    assert flux_error(table, LATE) < algebraic
    of = table["error_theta_electrical"] / table["deviation_theta_electrical"]
    assert 0.4 < np.mean(of[LATE] ** 2) < 2.5


def test_a_machine_without_deviations_says_how_to_find_them(tmp_path, clean):
    description = read_machine(machine(tmp_path, LIFTED))
    with pytest.raises(ValueError, match=r"`with_noise_of\(log\)` returns"):
        description.state_observer(description.rates())
    log = motor_logs.noisy(clean, MOTOR, 1, CURRENT, VOLTAGE)
    pair = lambda z: np.stack([z.real, z.imag], 1)
    signals = pair(log["u"]), pair(log["i"])
    whole = Log(log["t"], *signals, {})
    found = description.with_noise_of(whole)
    assert found.observer.prior is None and not found.lacks_noise
    estimate = aslo.replay(found.state_observer(found.rates()), log["t"], *signals)
    assert set(found.columns(estimate, whole)) >= {"deviation_flux_beta", "certificate"}


def test_a_bearing_from_a_prior(tmp_path, capsys):
    log = with_noise(held_logs.bearing(), {"u": 0.02, "i": 1e-3})
    write_table(tmp_path / "log.npz", log)
    keys = "resistance = [2.0, 2.7]\ngap = 0.5e-3\nforce_constant = 2.0e-5\nmass = 0.8\n"
    text = f'[machine]\nkind = "magnetic_bearing"\n{keys}[observer]\n'
    (tmp_path / "machine.toml").write_text(text + LIFTED)
    assert "`observer.prior` must be given" in refused(tmp_path, capsys)
    rms = {}
    for observer in ("", f"{LIFTED}\nprior = 0.01"):
        (tmp_path / "machine.toml").write_text(text + observer)
        table = run(tmp_path)
        late = slice(1500, None)
        assert not table["coasting"][late].any()
        for name in ("flux_1", "flux_2", "position", "velocity"):
            error = table[f"error_{name}"][late]
            rms.setdefault(name, []).append(float(np.sqrt(np.mean(error**2))))
    for algebraic, kalman in rms.values():
        assert kalman < 0.9 * algebraic
    assert "--smooth is not for" in refused(tmp_path, capsys, "--smooth")
