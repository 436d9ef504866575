"""Cutoff and forgetting that are chosen for the noise of a log, and what they gain."""

import motor_logs
import numpy as np
import pytest

import aslo_jax as aslo
from aslo_jax.logs import Log
from aslo_jax.machines import MachineError, read_machine
from aslo_jax.machines._speed import slow_speed

MOTORS = (
    motor_logs.Motor("pump", "pmsm", 1.1, 3e-3, 3e-3, 0.09, 4, 250.0, 4.0, 2e-4),
    motor_logs.Motor("winch", "pmsm", 0.6, 9e-3, 9e-3, 0.8, 8, 90.0, 20.0, 3e-4),
)
pair = lambda z: np.stack([z.real, z.imag], axis=1)


def described(folder, motor, observer=""):
    path = folder / "machine.toml"
    path.write_text(
        f'[machine]\nkind = "pmsm"\nresistance = {motor.R}\ninductance = {motor.Ld}\n'
        f"magnet_flux = {motor.psi}\npole_pairs = {motor.pole_pairs}\ninertia = 1e-4\n"
        f"[observer]\n{observer}\n"
    )
    return read_machine(path)


def as_log(found):
    return Log(found["t"], pair(found["u"]), pair(found["i"]), {})


def error(machine, rates, log, flux):
    x = aslo.replay(machine.state_observer(rates), log.t, log.u, log.y).value
    return float(np.sqrt(np.mean((np.asarray(x) - flux)[1500:] ** 2)))


@pytest.mark.parametrize("motor", MOTORS, ids=lambda m: m.name)
def test_they_are_better_than_one_rate(tmp_path, motor):
    machine = described(tmp_path, motor)
    ratios = [ratio(machine, motor, profile) for profile in ("load", "rich", "reversal")]
    assert np.exp(np.mean(np.log(ratios))) < 0.93
    assert max(ratios) < 1.25  # a brisk reversal gets slower rates than it needs
    assert min(ratios) < 0.9


def ratio(machine, motor, profile):
    """The error with the rates that are chosen over that with one rate."""
    clean = motor_logs.run(motor, profile)
    log = as_log(motor_logs.noisy(clean, motor, 2, 8e-3, 4e-3))
    two = machine.rates(log)
    assert set(two) == {"cutoff", "forgetting", "pll_bandwidth"}
    assert "noise of" in two["forgetting"].reason
    assert two["cutoff"].least < two["forgetting"].least
    speed = aslo.machines.electrical_speed(log.t, log.u, log.y, motor.R)
    one = machine.rates(log, {"cutoff": aslo.machines.cutoff_for(speed)})
    assert "forgetting" not in one
    flux = pair(clean["flux"])
    return error(machine, two, log, flux) / error(machine, one, log, flux)


def test_noise_alone_makes_the_difference(tmp_path):
    motor = MOTORS[0]
    clean = motor_logs.run(motor, "load")
    assert "forgetting" not in described(tmp_path, motor).rates(as_log(clean))
    noisy = as_log(motor_logs.noisy(clean, motor, 2, 8e-3, 4e-3))
    for keys in ("gain = 30.0", 'completion = "repeat"', 'start = "paper"'):
        assert "forgetting" not in described(tmp_path, motor, keys).rates(noisy)
    machine = described(tmp_path, motor, "forgetting = 70.0")
    rates = machine.rates(noisy)
    assert rates["forgetting"].value == 70.0 and "speed" in rates["cutoff"].reason
    observer = machine.state_observer(rates)
    assert float(observer.completion.forgetting.rate) == 70.0
    # More noise of the voltage wants faster forgetting, more of the current slower.
    found = [
        described(tmp_path, motor)
        .rates(as_log(motor_logs.noisy(clean, motor, 2, i, u)))["forgetting"]
        .value
        for i, u in ((8e-3, 4e-3), (8e-3, 4e-2), (8e-2, 4e-3))
    ]
    assert found[2] <= found[0] < found[1]


def test_forgetting_has_no_meaning_without_least_squares(tmp_path):
    with pytest.raises(MachineError, match=r"`observer\.forgetting` is for"):
        described(tmp_path, MOTORS[0], 'forgetting = 7.0\ncompletion = "repeat"')


def test_a_slow_part_counts_and_a_rest_does_not_for_ever():
    t = 1e-4 * np.arange(20_000)
    steady = np.full(t.size, 100.0)
    slow = np.where((t > 1.0) & (t < 1.3), 2.0, 100.0)
    rest = np.where(t > 1.2, 0.0, 100.0)
    found = []
    for speed in (steady, slow, rest):
        v = 0.3 * speed * np.exp(1j * np.cumsum(speed) * 1e-4)
        found.append(slow_speed(t, pair(v), 0.3))
    np.testing.assert_allclose(found[0], 100.0, rtol=0.05)
    assert 2.0 < found[1] < 20.0
    assert found[2] >= 0.9 * np.median(rest) / 40.0
