"""The machines of the paper's section 3 as noisy sampled loops, observed with two gains.

Resistances are not what the observer takes them for (1 % either way), currents and voltages
are noisy, the loop is closed over an encoder. The observers start exactly and solve by
least squares, whatever the gains: what these do is what differs.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp

import aslo_jax as aslo
from aslo_jax import plants
from aslo_jax.control import (
    BearingFeedback,
    FieldOriented,
    MagneticLevitation,
    MotorFeedback,
    OpenLoop,
)
from aslo_jax.disturbances import SampledNoise
from aslo_jax.observers import AbstractObserver, Estimate

PAPER = 5.0  # lambda = gamma of the paper (rad/s)
SPREAD = 0.01  # of the resistances, either way
THRESHOLD = 1e-3  # of the guards
NAME = "A-ASLO"


class Case(NamedTuple):
    """`place(gains, key)`, an experiment whose observer `NAME` has the two `gains` (rad/s);
    `steps` of it; the `scale` of its errors; errors count from `after` (s) on."""

    place: Callable[[Any, Any], aslo.Experiment]
    steps: int
    scale: Any
    after: float
    gains: tuple[str, str] = ("lambda", "gamma")


def uniform(key, index: int, low: float, high: float):
    """The `index`-th number of a sample, between low and high."""
    return low + (high - low) * aslo.random.uniform(key, 0, 8 + index)


def noises(key, interval: float, current: float, voltage: float) -> dict[str, Any]:
    """Sensors of currents (A) and voltages (V), standard deviations of a sample."""
    return {
        "sensor": SampledNoise(current, interval, key),
        "input_sensor": SampledNoise(voltage, interval, key, 1),
    }


def asymptotic(relation, gains, threshold: float = THRESHOLD) -> aslo.Asymptotic:
    """The A-ASLO of lambda and gamma (rad/s)."""
    inner = aslo.AlgebraicObserver(
        relation, aslo.LowPass(gains[0]), guard=aslo.Guard(threshold)
    )
    return aslo.Asymptotic(inner, gains[1])


def drive(machine, like, observer, sample, *, speed, wave, limit, interval, noise):
    """A motor under field-oriented control by an encoder: `speed` with a wave on it of
    random phase (mechanical rad/s), the resistance of the machine off by the spread."""
    key = sample
    phase, off = uniform(key, 0, 0.0, 2 * jnp.pi), uniform(key, 1, -SPREAD, SPREAD)
    warm = eqx.tree_at(lambda m: m.resistance, machine, machine.resistance * (1.0 + off))

    def reference(t):
        return speed + wave * jnp.sin(t + phase)

    def encoder(y, x, estimates):
        del estimates
        return MotorFeedback(y, machine.pole_pairs * x.angle, x.speed)

    return aslo.Experiment(
        warm,
        FieldOriented(like, reference, limit, 400.0),
        {NAME: observer},
        interval,
        feedback=encoder,
        **noises(key, interval, *noise),
    )


# ---- one for each plant --------------------------------------------------------------


def paper_load(t):
    """3 + 0.5 sin 0.1 t (N m)."""
    return 3.0 + 0.5 * jnp.sin(0.1 * t)


def pmsm(speed: float = 2.0, current_noise: Any = 0.01, load=paper_load) -> Case:
    """The motor of Table 1: 2 + 0.5 sin t rad/s, 10 mA, 0.1 V, 2 s at 5 kHz."""
    machine = plants.PMSM.bmp0701f(load=load)

    def place(gains, key):
        return drive(
            machine,
            machine,
            asymptotic(machine.flux_relation(), gains),
            key,
            speed=speed,
            wave=0.25 * speed,
            limit=2.3,
            interval=2e-4,
            noise=(current_noise, 0.1),
        )

    return Case(place, 10_000, 0.2086, 0.5)


def _as_pmsm(machine, inductance, **changes) -> plants.PMSM:
    """What a field-oriented controller takes the machine for."""
    return plants.PMSM(
        machine.resistance,
        inductance,
        machine.magnet_flux,
        machine.pole_pairs,
        machine.inertia,
        **changes,
    )


def interior_pmsm() -> Case:
    """The 2.2 kW motor of motulator at 30 rad/s and 5 N m: 40 mA, 0.5 V."""
    machine = plants.InteriorPMSM.motulator_2200w(load=lambda t: 5.0 + 0.0 * t)
    like = _as_pmsm(machine, machine.quadrature_inductance)

    def place(gains, key):
        observer = aslo.SelfConsistent(
            machine.self_consistent_relation(),
            aslo.LowPass(gains[0]),
            gains[1],
            jnp.array([0.545, 0.0]),
            guard=aslo.Guard(THRESHOLD),
        )
        return drive(
            machine,
            like,
            observer,
            key,
            speed=30.0,
            wave=7.5,
            limit=8.0,
            interval=2e-4,
            noise=(0.04, 0.5),
        )

    return Case(place, 10_000, 0.545, 0.5)


def stepper() -> Case:
    """Bodson's motor at 4 rad/s (200 rad/s electrical) and 0.1 N m: 20 mA, 0.02 V."""
    machine = plants.Stepper.bodson(load=lambda t: 0.1 + 0.0 * t)
    like = _as_pmsm(machine, machine.inductance, torque_factor=1.0)

    def place(gains, key):
        return drive(
            machine,
            like,
            asymptotic(machine.flux_relation(), gains),
            key,
            speed=4.0,
            wave=1.0,
            limit=3.0,
            interval=2e-4,
            noise=(0.02, 0.02),
        )

    return Case(place, 10_000, 0.19 / 50, 0.5)


class BothWindings(AbstractObserver):
    """The fluxes of stator and rotor (Wb), one after the other, by an A-ASLO each."""

    stator: aslo.Asymptotic
    rotor: aslo.Asymptotic

    def equations(self, F, u, y):
        first = self.stator.equations(F.scope("stator"), u, y)
        second = self.rotor.equations(F.scope("rotor"), u, y)
        return Estimate(
            jnp.concatenate([first.value, second.value]),
            jnp.minimum(first.certificate, second.certificate),
            first.coasting | second.coasting,
        )


def wrim() -> Case:
    """The WRIM of `aslo-jax paper --section 3`, shorted slip rings, a stator supply of 20 V
    at 12 rad/s, its amplitude modulated by 30 % with a random phase: 20 mA, 0.05 V."""
    from aslo_jax.paper._section3.machines import wrim as machine_of

    machine, interval = machine_of(), 2e-4

    def place(gains, key):
        phase = uniform(key, 0, 0.0, 2 * jnp.pi)
        off = 1.0 + uniform(key, 1, -SPREAD, SPREAD), 1.0 + uniform(key, 2, -SPREAD, SPREAD)
        where = lambda m: (m.stator_resistance, m.rotor_resistance)
        true = tuple(r * f for r, f in zip(where(machine), off, strict=True))
        warm = eqx.tree_at(where, machine, true)

        def supply(t):
            a = 12.0 * t + 0.3 * jnp.sin(2.0 * t + phase)
            size = 20.0 * (1.0 + 0.3 * jnp.sin(3.0 * t + phase))
            return size * jnp.stack([jnp.cos(a), jnp.sin(a)])

        windings = (
            asymptotic(machine.flux_relation(name), gains, 1e-5)
            for name in ("stator", "rotor")
        )
        return aslo.Experiment(
            warm,
            OpenLoop(supply),
            {NAME: BothWindings(*windings)},
            interval,
            **noises(key, interval, 0.02, 0.05),
        )

    return Case(place, 10_000, 1.7, 0.5)


def bearing() -> Case:
    """A levitated body that follows 10 % of the gap at 20 rad/s, with the ripple of
    docs/closed-loops.md: 10 mA, 0.1 V. No A-ASLO here: the two gains are the rates of the
    filters of fluxes and velocity."""
    machine, interval = plants.MagneticBearing.laboratory(), 1e-4
    gap, flux = 0.5e-3, 2e-2

    def place(gains, key):
        phase, off = uniform(key, 0, 0.0, 2 * jnp.pi), uniform(key, 1, -SPREAD, SPREAD)
        warm = eqx.tree_at(
            lambda m: m.resistance, machine, machine.resistance * (1.0 + off)
        )

        def reference(t):
            return 0.1 * gap * jnp.sin(20.0 * t + phase)

        def sensors(y, x, estimates):
            del estimates
            return BearingFeedback(y, x.flux, x.position, x.velocity)

        control = MagneticLevitation(
            machine,
            reference,
            bias=1.0,
            voltage_limit=60.0,
            ripple=10.0,
            ripple_frequency=2 * jnp.pi * 500,
        )
        fluxes = aslo.AlgebraicObserver(
            machine.flux_relation(), aslo.LowPass(gains[0]), guard=aslo.Guard(5e-5)
        )
        observer = aslo.BearingObserver(
            fluxes, aslo.LowPass(gains[1]), aslo.Guard(THRESHOLD)
        )
        return aslo.Experiment(
            warm,
            control,
            {NAME: observer},
            interval,
            feedback=sensors,
            **noises(key, interval, 0.01, 0.1),
        )

    scale = jnp.array([flux, flux, gap, 200.0 * gap])
    return Case(place, 10_000, scale, 0.25, ("lambda of the fluxes", "of the velocity"))


CASES = {
    "PMSM": pmsm,
    "interior PMSM": interior_pmsm,
    "stepper": stepper,
    "WRIM": wrim,
    "bearing": bearing,
}
