"""Datasheet values: each convention against a motor that turns, and worked examples."""

import itertools
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from aslo_jax.datasheet import (
    agreed_flux,
    emf_from_flux,
    flux_from_emf,
    flux_from_torque,
    star_equivalent,
    torque_from_flux,
)
from aslo_jax.plants import PMSM, MachineState

MOTOR = PMSM.bmp0701f()
FLUX, PAIRS = float(MOTOR.magnet_flux), MOTOR.pole_pairs


def waveforms(speed):
    """Phase and line-to-line voltage of the turning motor without current over one
    electrical period, from the library's own model, by the inverse Clarke transform."""
    period = 2 * np.pi / (PAIRS * speed)
    t = jnp.linspace(0.0, period, 3601)[:-1]

    def linked(t):
        return MOTOR.magnet(PAIRS * speed * t)

    _, emf = jax.vmap(lambda t: jax.jvp(linked, (t,), (jnp.ones_like(t),)))(t)
    a, b = emf[:, 0], -0.5 * emf[:, 0] + 0.5 * math.sqrt(3) * emf[:, 1]
    return {"phase": np.asarray(a), "lines": np.asarray(a - b)}


@pytest.mark.parametrize(
    ("amplitude", "between", "per", "speed"),
    [
        *itertools.product(
            ("peak", "rms"),
            ("lines", "phase"),
            ("krpm", "rad/s"),
            ("mechanical", "electrical"),
        )
    ],
)
def test_back_emf_in_every_convention(amplitude, between, per, speed):
    """What a voltmeter reads, over the speed, gives the flux."""
    turning = 37.0  # rad/s
    volts = waveforms(turning)[between]
    reading = np.abs(volts).max() if amplitude == "peak" else np.sqrt(np.mean(volts**2))
    stated = turning * (PAIRS if speed == "electrical" else 1)
    stated /= 2 * np.pi * 1000 / 60 if per == "krpm" else 1.0
    words = dict(amplitude=amplitude, between=between, per=per, speed=speed)
    found = flux_from_emf(reading / stated, pole_pairs=PAIRS, **words)
    np.testing.assert_allclose(found, FLUX, rtol=1e-5)
    there = emf_from_flux(FLUX, pole_pairs=PAIRS, **words)
    np.testing.assert_allclose(there, reading / stated, rtol=1e-5)


@pytest.mark.parametrize(("amplitude", "factor"), [("peak", 1.0), ("rms", math.sqrt(2))])
def test_torque_constant_of_the_model(amplitude, factor):
    x = MOTOR.initial()
    current = 1.7  # A, peak, on the q axis at angle zero
    flux = x.flux + MOTOR.inductance * jnp.array([0.0, current])
    torque = float(MOTOR.torque(MachineState(flux, x.speed, x.angle)))
    constant = torque / (current / factor)
    found = flux_from_torque(constant, pole_pairs=PAIRS, amplitude=amplitude)
    np.testing.assert_allclose(found, FLUX, rtol=1e-12)
    there = torque_from_flux(FLUX, pole_pairs=PAIRS, amplitude=amplitude)
    np.testing.assert_allclose(there, constant, rtol=1e-12)


def test_a_worked_example():
    """98 V rms between lines at 1000 rpm, 1.6 N m per A rms, 6 poles."""
    emf = flux_from_emf(
        98.0,
        pole_pairs=3,
        amplitude="rms",
        between="lines",
        per="krpm",
        speed="mechanical",
    )
    # 98 sqrt(2)/sqrt(3) = 80.02 V peak of a phase; 3 * 104.72 = 314.16 rad/s.
    np.testing.assert_allclose(emf, 80.0167 / 314.1593, rtol=1e-5)
    torque = flux_from_torque(1.6, pole_pairs=3, amplitude="rms")
    # 1.6/sqrt(2) = 1.1314 N m per A peak; 3/2 * 3 = 4.5.
    np.testing.assert_allclose(torque, 1.131371 / 4.5, rtol=1e-6)
    assert agreed_flux(emf, torque, pole_pairs=3) == emf


def test_in_si_units_between_a_phase_and_its_star_the_flux_is_the_constant():
    flux = flux_from_emf(
        0.2,
        pole_pairs=7,
        amplitude="peak",
        between="phase",
        per="rad/s",
        speed="electrical",
    )
    assert flux == 0.2


def test_resistance_of_star_and_delta():
    """By combining resistors: a winding R, seen between two terminals."""
    R = 3.0
    between_star, between_delta = R + R, R * (R + R) / (R + R + R)
    for connection, winding, lines in (
        ("star", R, between_star),
        ("delta", R, between_delta),
    ):
        of_winding = star_equivalent(winding, between="phase", connection=connection)
        of_lines = star_equivalent(lines, between="lines", connection=connection)
        np.testing.assert_allclose(of_winding, of_lines, rtol=1e-12)
    assert star_equivalent(between_star, between="lines", connection="star") == R


def test_inductance_between_lines_is_twice_that_of_the_model():
    """Ldi/dt with the current in at one terminal and out at another: i_alpha = i,
    i_beta = -i/sqrt(3), and the voltage between them is that of a - b."""
    L = float(MOTOR.inductance)
    rate = np.array([1.0, -1 / math.sqrt(3)])
    a, beta = L * rate
    b = -0.5 * a + 0.5 * math.sqrt(3) * beta
    between = a - b
    found = star_equivalent(between, between="lines", connection="star")
    np.testing.assert_allclose(found, L, rtol=1e-12)


@pytest.mark.parametrize(
    ("factor", "cause"),
    [
        (math.sqrt(2), "Ke 1.41 times more; a factor of that size comes from taking peak"),
        (1 / math.sqrt(3), "Kt 1.73 times more; a .* taking line-to-line for phase; check"),
        (5.1, "taking electrical for mechanical speed; check"),
        (104.7, "taking V per krpm for V s/rad; check"),
        (1.5, "taking torque without the factor 3/2; check"),
        (11.7, r"Kt 0\.2 Wb, Ke 11\.7 times more; check the conventions"),
    ],
)
def test_constants_that_disagree_are_refused(factor, cause):
    with pytest.raises(ValueError, match=cause):
        agreed_flux(0.2 * factor, 0.2, pole_pairs=5)


def test_words_are_checked():
    words = dict(amplitude="peak", between="lines", per="krpm", speed="mechanical")
    for name, value in words.items():
        wrong = words | {name: "line"}
        with pytest.raises(ValueError, match=f'`{name}` must be "{value}" or "'):
            flux_from_emf(1.0, pole_pairs=2, **wrong)
    with pytest.raises(ValueError, match='`connection` must be "star" or "delta", but'):
        star_equivalent(1.0, between="lines", connection="y")
    with pytest.raises(ValueError, match="`pole_pairs` must be a whole number from 1"):
        flux_from_torque(1.0, pole_pairs=0, amplitude="peak")


def test_arrays_and_tracers_pass():
    convert = jax.jit(lambda k: flux_from_torque(k, pole_pairs=2, amplitude="rms"))
    np.testing.assert_allclose(convert(jnp.array([3.0, 6.0])), [0.70710678, 1.41421356])
