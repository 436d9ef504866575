"""Parameters from logs without truth, of every kind of machine, in closed form."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from motion import Prescribed, PrescribedBearing, PrescribedMechanism

import aslo_jax as aslo
from aslo_jax.tune import Corrected, calibrate


def record(motion, current, mean, interval, rows, noise, seed=0):
    """t, u and y of a motion, with white noise on y (of its rms)."""
    t = interval * jnp.arange(rows)
    y = np.asarray(jax.vmap(current)(t))
    u = np.asarray(jax.vmap(mean)(t, t + interval))
    size = noise * np.sqrt(np.mean(y**2, axis=0))
    return np.asarray(t), u, y + size * np.random.default_rng(seed).standard_normal(y.shape)


def motor_log(machine, speed, i_d, i_q, interval, rows, noise=3e-3, seed=0):
    p = machine.pole_pairs

    def angle(t):  # mechanical
        return 0.3 + (speed * t + 0.25 * speed / 9 * (1 - jnp.cos(9 * t))) / p

    def current(t):
        theta = p * angle(t)
        d, q = i_d(t), i_q(t)
        c, s = jnp.cos(theta), jnp.sin(theta)
        return jnp.stack([d * c - q * s, d * s + q * c])

    motion = Prescribed(machine, angle, current)
    return record(motion, current, motion.mean_voltage, interval, rows, noise, seed)


PMSM = aslo.plants.PMSM(8.875, 40.03e-3, 0.2086, 5, 60e-6)


def pmsm_log(seed=0):
    return motor_log(
        PMSM, 120.0, lambda t: 0.8 * jnp.sin(31 * t), lambda t: 1 + 0.3 * jnp.sin(17 * t),
        2e-4, 2000, seed=seed,
    )  # fmt: skip


def off(model, where, factors):
    """The model with parameters that are wrong by factors."""
    return eqx.tree_at(
        where, model, [x * f for x, f in zip(where(model), factors, strict=True)]
    )


def check(found, truth, at_least):
    """Every parameter within its interval, three times over, which is at most so wide."""
    for name, true in truth.items():
        low, high = found.interval[name]
        half = 0.5 * (high - low)
        assert half < at_least * abs(true), name
        assert abs(found.after[name] - true) < 3 * half, name
    assert found.undetermined == ()


def test_pmsm():
    where = lambda m: (m.resistance, m.inductance, m.magnet_flux)
    found = calibrate(off(PMSM, where, (1.05, 0.95, 1.03)), *pmsm_log(), where)
    print(found, found.reason, found.rounds, found.output_noise)
    check(found, dict(resistance=8.875, inductance=40.03e-3, magnet_flux=0.2086), 0.01)


def test_stepper():
    machine = aslo.plants.Stepper(0.55, 1.5e-3, 0.19, 50, 4.5e-5)
    log = motor_log(
        machine, 200.0, lambda t: 1.2 * jnp.sin(40 * t), lambda t: 2 + jnp.sin(17 * t),
        2e-4, 2000,
    )  # fmt: skip
    where = lambda m: (m.resistance, m.inductance, m.torque_constant)
    found = calibrate(off(machine, where, (1.05, 0.95, 1.02)), *log, where)
    print(found, found.reason, found.rounds)
    check(found, dict(resistance=0.55, inductance=1.5e-3, torque_constant=0.19), 0.01)


def test_wrim():
    machine = aslo.plants.WRIM(1.3, 0.7, 0.10, 0.14, 0.11, 2, 0.02)

    def angle(t):
        return (0.3 + 110.0 * t + 0.5 * jnp.sin(15 * t)) / 2

    def current(t):
        s, r = 150.0 * t, 40.0 * t + 0.7
        a, b = 8 + 2 * jnp.sin(23 * t), 6 + 2 * jnp.cos(31 * t)
        return jnp.stack([a * jnp.cos(s), a * jnp.sin(s), b * jnp.cos(r), b * jnp.sin(r)])

    motion = Prescribed(machine, angle, current)
    log = record(motion, current, motion.mean_voltage, 2e-4, 2000, 1e-3)
    names = ("stator_resistance", "rotor_resistance", "stator_inductance",
             "rotor_inductance", "mutual_inductance")  # fmt: skip
    where = lambda m: tuple(getattr(m, n) for n in names)
    found = calibrate(off(machine, where, (1.05, 0.95, 1.04, 0.97, 1.02)), *log, where)
    print(found, found.reason, found.rounds)
    check(found, {n: float(getattr(machine, n)) for n in names}, 0.01)


def test_bearing():
    machine = aslo.plants.MagneticBearing(jnp.array([2.0, 2.7]), 0.5e-3, 2.0e-5, 0.8)
    motion = PrescribedBearing(machine)
    log = record(motion, motion.current, motion.mean_voltage, 2e-4, 2500, 1e-3)
    where = lambda m: (m.resistance, m.gap)
    wrong = off(machine, where, (jnp.array([1.05, 0.95]), 1.03))
    found = calibrate(wrong, *log, where, cutoff=30.0)
    print(found, found.reason, found.rounds)
    truth = {"resistance[0]": 2.0, "resistance[1]": 2.7, "gap": 0.5e-3}
    check(found, truth, 0.01)


def test_mechanism():
    machine = aslo.plants.RoboticLeg(2.0, 3.1, jnp.array([0.3, 0.2, 0.5]))
    q = lambda t: jnp.stack(
        [1.1 + 0.2 * jnp.sin(3 * t), 2 * t + 0.5 * jnp.sin(4 * t), -0.3 - t + jnp.sin(2.5 * t)]
    )
    motion = PrescribedMechanism(machine, q)
    t = 2e-3 * jnp.arange(1500)
    y = np.asarray(jax.vmap(q)(t))
    print(y.shape)


def test_gain_and_offsets():
    t, u, y = pmsm_log()
    relation = Corrected(PMSM.flux_relation(), 1.0, jnp.zeros(2), jnp.zeros(2))
    observer = aslo.AlgebraicObserver(relation, aslo.LowPass(70.0))
    u, y = u / 1.03 - [0.4, -0.3], y + [0.02, -0.01]
    where = lambda o: (o.relation.gain, o.relation.input_offset, o.relation.output_offset,
        o.relation.relation.inductance)  # fmt: skip
    found = calibrate(observer, t, u, y, where)
    print(found)
