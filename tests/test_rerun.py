"""One sample of a study once more."""

import numpy as np
import pytest
from studies import INTERVAL, SAMPLES, SPREAD, experiment, settings

from aslo_jax.cli import main
from aslo_jax.study import Spread, open_study, rerun, run
from aslo_jax.study._config import read_study
from aslo_jax.study._statistics import summarise

INDEX = 437  # neither at the start nor at the end of a block


def again(index=INDEX, spread=SPREAD, **changes):
    given = settings(**({"every": 1} | changes))
    return rerun(experiment(), spread, index=index, **given)


@pytest.mark.parametrize("design", ["iid", "lhs", "sobol"])
def test_a_sample_has_the_numbers_that_the_study_has(design):
    spread = Spread(SPREAD.parameters, design)

    whole = run(experiment(), spread, **settings()).isel(sample=INDEX)
    found = again(spread=spread)
    assert found.sample == INDEX
    for name, value in found.parameters.items():
        assert value == float(whole[f"parameter_{name}"])
    for name, each in found.metrics.items():
        for observer, value in each.items():
            np.testing.assert_array_equal(value, whole[name].sel(observer=observer).values)
    for observer in ("ASLO", "Luenberger"):
        error = np.abs(found.simulation.error(observer)[:, 0])
        kept = whole["error"].sel(observer=observer).values
        np.testing.assert_allclose(error[::10], kept, rtol=1e-12, atol=1e-15)
        rms = np.sqrt(np.mean(error[1:] ** 2))
        assert found.metrics["rms"][observer] == pytest.approx(rms, rel=0.1)


def test_every_signal_is_there_at_every_instant():
    found = again()
    t = np.asarray(found.simulation.t)
    np.testing.assert_allclose(t, INTERVAL * np.arange(21), rtol=1e-15)
    # The input is known, and the sensor has noise of the deviation that was drawn.
    np.testing.assert_allclose(found.simulation.u, np.cos(3.0 * t), rtol=1e-15)
    position = np.asarray(found.simulation.x)[:, 0]
    noise = np.asarray(found.simulation.y) - position
    assert 0.4 < noise.std() / found.parameters["noise"] < 1.6
    speed = found.parameters["speed"] + np.sin(3.0 * t) / 3.0
    assert np.ptp(np.asarray(found.simulation.hidden)[:, 0] - speed) < 0.1
    assert len(again(every=5).simulation.t) == 5


@pytest.mark.parametrize("index", [-1, SAMPLES, True, 1.0])
def test_what_is_no_sample_is_refused(index):
    with pytest.raises(ValueError, match="Argument `index` must be"):
        again(index)


def test_the_worst_sample_is_named():
    x = np.array([0.1, 3.0, 0.2, 3.0])
    assert summarise(x).worst_sample == 1
    assert summarise(np.array([5.0, 1.0, np.nan, 2.0])).worst_sample == 2


STUDY = """
title = "A reversal"
interval = 1e-3
horizon = 0.05

[machine]
kind = "pmsm"
resistance = 3.1
inductance = 7e-3
magnet_flux = 0.12
pole_pairs = 4
inertia = 2e-4

[control]
kind = "field_oriented"
reference = { offset = 20.0, amplitude = 10.0, frequency = 60.0 }
current_limit = 4.0

[observers.ASLO]
kind = "aslo"
cutoff = 40.0

[[sensor]]
kind = "noise"
deviation = 0.02

[spread.resistance]
where = "plant.resistance"
distribution = "normal"
mean = 3.1
deviation = 0.2

[spread.inductance]
where = "plant.inductance"
distribution = "uniform"
low = 0.9
high = 1.1
relative = true

[spread.both]
where = ["plant.magnet_flux", "sensor.deviation"]
distribution = "correlated"
mean = [0.12, 0.02]
deviation = [0.001, 0.001]
correlation = [[1.0, 0.5], [0.5, 1.0]]
names = ["magnet_flux", "current_noise"]

[metrics.rms]
kind = "rms"
"""


@pytest.fixture
def study(tmp_path):
    path = tmp_path / "reversal.toml"
    path.write_text(STUDY)
    return path


def command(*arguments):
    with pytest.raises(SystemExit) as ended:
        main(["study", *map(str, arguments)])
    return ended.value.code or 0


def test_parameters_have_the_units_of_the_machine(study):
    units = read_study(study)[2].units
    assert units["parameter_resistance"] == "ohm"
    assert units["parameter_inductance"] == "1"  # a factor
    assert units["parameter_magnet_flux"] == "Wb"
    assert "parameter_current_noise" not in units


def test_the_command_writes_a_sample_and_refuses_that_of_another_study(
    study, tmp_path, capsys
):
    out = tmp_path / "out"
    given = [study, "--samples", 20, "--seed", 5, "--out", out]
    assert command(*given, "--no-report") == 0
    said = capsys.readouterr().out
    stored = open_study(out / "study.zarr")
    size = np.sqrt((stored["rms"].sel(observer="ASLO").values ** 2).sum(axis=1))
    worst = int(size.argmax())
    assert f"worst in sample {worst}" in said
    assert stored["parameter_resistance"].attrs["units"] == "ohm"

    assert command(*given, "--replay", worst) == 0
    said = capsys.readouterr().out
    assert f"resistance = {float(stored['parameter_resistance'][worst]):.6g} ohm" in said
    assert (out / f"sample_{worst}.png").read_bytes()[:4] == b"\x89PNG"
    table = np.genfromtxt(
        out / f"sample_{worst}.csv", delimiter=",", names=True, deletechars=""
    )
    assert len(table["t"]) == 51
    for k, name in enumerate(("flux_alpha", "flux_beta")):
        error = table[f"ASLO.{name}"] - table[name]
        rms = float(stored["rms"].sel(observer="ASLO").values[worst, k])
        assert np.sqrt(np.mean(error**2)) == pytest.approx(rms, rel=0.05)

    other = [study, "--samples", 20, "--seed", 6, "--out", out, "--replay", worst]
    assert command(*other) == 2
    assert "a study of --seed 5, not 6" in capsys.readouterr().err
    assert command(*given, "--replay", 20) == 2
    assert "from 0 to 19" in capsys.readouterr().err
    assert command(*given, "--replay", 3, "--resume") == 2
    assert "--replay excludes --resume" in capsys.readouterr().err
