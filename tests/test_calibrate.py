"""Parameters from logs without truth, of every kind of machine, in closed form."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from machine_records import motor_log, record
from motion import Prescribed, PrescribedBearing

import aslo_jax as aslo
from aslo_jax.control import FieldOriented, MotorFeedback
from aslo_jax.paper._section3 import settings
from aslo_jax.tune import calibrate

MOTOR = aslo.plants.PMSM(8.875, 40.03e-3, 0.2086, 5, 60e-6)
STEPPER = aslo.plants.Stepper(0.55, 1.5e-3, 0.19, 50, 4.5e-5)
CASES = {"pmsm": (MOTOR, 120.0, 1.0), "stepper": (STEPPER, 200.0, 2.0)}


def varied(case, seed=0):
    """A run in which direct current, torque and speed vary."""
    machine, speed, size = CASES[case]
    return motor_log(
        machine, speed, lambda t: 0.8 * size * jnp.sin(31 * t),
        lambda t: size * (1 + 0.3 * jnp.sin(17 * t)), 2e-4, 1500, seed=seed,
    )  # fmt: skip


def found_by_observer(machine, log, factors=(1.05, 0.95, 1.03)):
    """One observer for both motors, and so one compilation for all that follows."""
    where = lambda r: (r.resistance, r.inductance, r.magnet_flux)
    relation = off(machine.flux_relation(), where, factors)
    observer = aslo.AlgebraicObserver(relation, aslo.LowPass(70.0), guard=aslo.Guard(1e-3))
    return calibrate(observer, *log, lambda o: where(o.relation))


def off(model, where, factors):
    """The model with parameters that are wrong by factors."""
    return eqx.tree_at(
        where, model, [x * f for x, f in zip(where(model), factors, strict=True)]
    )


def check(found, truth, at_most):
    """Every parameter is within 3.5 standard deviations, and surely known."""
    assert found.undetermined == () and found.reason == "it settled"
    for name, true in truth.items():
        low, high = found.interval[name]
        half = 0.5 * (high - low)
        assert half < at_most * abs(true), name
        assert abs(found.after[name] - true) < 3.5 / 1.96 * half, name


@pytest.mark.parametrize("case", CASES)
def test_motors(case):
    machine = CASES[case][0]
    found = found_by_observer(machine, varied(case))
    truth = {n: float(getattr(machine, n)) for n in ("resistance", "inductance")}
    check(found, truth | {"magnet_flux": float(machine.magnet_flux)}, 0.01)
    assert abs(found.correlation) < 0.1
    assert float(found.model.relation.resistance) == pytest.approx(
        found.after["resistance"]
    )


@pytest.mark.slow
def test_intervals_hold_the_truth_as_often_as_they_say():
    """12 intervals of 95 %: 3 or more misses would happen once in 50 times."""
    misses = 0
    for seed in range(1, 5):
        found = found_by_observer(MOTOR, varied("pmsm", seed))
        for name, (low, high) in found.interval.items():
            misses += not low < float(getattr(MOTOR, name)) < high
    assert misses <= 2


@pytest.mark.slow
def test_steady_motion_leaves_directions_undetermined():
    """At constant speed and torque, resistance, inductance and magnet flux cannot be told
    apart: an error of `R i` looks like the voltage of a magnet."""
    log = motor_log(MOTOR, 120.0, lambda t: 0.0 * t, lambda t: 1 + 0.0 * t, 2e-4, 1500)
    t = log[0]
    theta = 1.5 + 120.0 * t
    q = np.stack([-np.sin(theta), np.cos(theta)], axis=1)
    d = np.stack([np.cos(theta), np.sin(theta)], axis=1)
    noise = 3e-3 * np.random.default_rng(5).standard_normal(q.shape)
    u = 8.875 * q + 120.0 * (0.2086 * q - 40.03e-3 * d)
    u = np.concatenate([0.5 * (u[1:] + u[:-1]), u[-1:]])
    found = found_by_observer(MOTOR, (t, u, q + noise))
    assert np.isnan(found.after["resistance"])
    assert np.isnan(found.interval["resistance"]).all()
    assert any("resistance" in d.parts for d in found.undetermined)
    assert "not determined by this record (flat: " in str(found)


@pytest.mark.slow
def test_the_slow_run_of_the_paper():
    """At some 2 rad/s the back-EMF is a tenth of `R i`: the resistance is found to a tenth
    of a per cent, and the inductance is said not to be."""
    motor = settings.motor()
    feedback = lambda y, x, estimates: MotorFeedback(y, 5 * x.angle, x.speed)
    controller = FieldOriented(motor, settings.reference, current_limit=2.3)
    experiment = aslo.Experiment(
        motor, controller, {}, 1e-3, feedback=feedback, plant_steps=10
    )
    run = experiment.run(8000)
    noise = 5e-3 * np.random.default_rng(0).standard_normal(run.y.shape)
    log = run.t, run.u, np.asarray(run.y) + noise
    relation = aslo.plants.FluxRelation(1.05 * 8.875, 0.95 * 40.03e-3)
    observer = aslo.AlgebraicObserver(relation, aslo.LowPass(5.0))
    where = lambda o: (o.relation.resistance, o.relation.inductance)
    found = calibrate(observer, *log, where)
    assert abs(found.after["resistance"] / 8.875 - 1) < 1e-3
    assert np.isnan(found.after["inductance"])
    assert [set(d.parts) for d in found.undetermined] == [{"inductance"}]
    # It stays where it was, but for the little that the flat direction has of the other.
    kept = float(found.model.relation.inductance)
    assert kept == pytest.approx(0.95 * 40.03e-3, rel=1e-4)
    errors = []
    for relation in (observer.relation, found.model.relation):
        estimate = aslo.replay(aslo.AlgebraicObserver(relation, aslo.LowPass(10.0)), *log)
        error = np.linalg.norm(estimate.value - run.hidden, axis=1)[1000:]
        errors.append(np.median(error) / 0.2086)
    assert errors[0] > 0.4 and errors[1] < 5e-3


@pytest.mark.slow
def test_wrim():
    machine = aslo.plants.WRIM(1.3, 0.7, 0.10, 0.14, 0.11, 2, 0.02)

    def angle(t):
        return (0.3 + 110.0 * t + 0.5 * jnp.sin(15 * t)) / 2

    def current(t):
        s, r = 150.0 * t, 40.0 * t + 0.7
        a, b = 8 + 2 * jnp.sin(23 * t), 6 + 2 * jnp.cos(31 * t)
        return jnp.stack([a * jnp.cos(s), a * jnp.sin(s), b * jnp.cos(r), b * jnp.sin(r)])

    motion = Prescribed(machine, angle, current)
    log = record(motion, current, motion.mean_voltage, 2e-4, 1500, 1e-3)
    names = ("stator_resistance", "rotor_resistance", "stator_inductance",
             "rotor_inductance", "mutual_inductance")  # fmt: skip
    where = lambda m: tuple(getattr(m, n) for n in names)
    found = calibrate(off(machine, where, (1.05, 0.95, 1.04, 0.97, 1.02)), *log, where)
    check(found, {n: float(getattr(machine, n)) for n in names}, 0.01)


@pytest.mark.slow
def test_bearing():
    machine = aslo.plants.MagneticBearing(jnp.array([2.0, 2.7]), 0.5e-3, 2.0e-5, 0.8)
    motion = PrescribedBearing(machine)
    log = record(motion, motion.current, motion.mean_voltage, 2e-4, 1500, 1e-3)
    where = lambda m: (m.resistance, m.gap)
    wrong = off(machine, where, (jnp.array([1.05, 0.95]), 1.03))
    found = calibrate(wrong, *log, where, cutoff=30.0)
    truth = {"resistance[0]": 2.0, "resistance[1]": 2.7, "gap": 0.5e-3}
    check(found, truth, 0.02)


@pytest.mark.slow
def test_mechanism():
    """Masses and friction, from positions and forces."""
    machine = aslo.plants.CartOnArm(0.7, 0.3, damping=jnp.array([0.2, 0.1]))
    experiment = aslo.Experiment(machine, Forces(), {}, 4e-3, plant_steps=4)
    run = experiment.run(700)
    y = np.asarray(run.y)
    y = y + 1e-4 * np.random.default_rng(3).standard_normal(y.shape)
    y[:, 1] %= 2 * np.pi
    where = lambda m: (m.mass, m.inertia_arm, m.damping)
    wrong = off(machine, where, (1.1, 0.9, jnp.array([0.5, 1.5])))
    found = calibrate(wrong, run.t, run.u, y, where)
    truth = {"mass": 0.7, "inertia_arm": 0.3, "damping[0]": 0.2, "damping[1]": 0.1}
    check(found, truth, 0.02)


class Forces(aslo.control.AbstractController):
    """Forces that keep the cart about half a metre out, and turn the arm to and fro."""

    def init(self, fed):
        return None

    def vector_field(self, t, state, fed):
        return None

    def __call__(self, t, state, fed):
        pull = -20.0 * (fed[0] - 0.5) + 4 * jnp.sin(5 * t)
        return jnp.stack([pull, 3 * jnp.cos(3 * t) + 2 * jnp.sin(7 * t)])
