"""The generalised machine and the motors that are one: torque against the textbooks, power
balance, SciPy, and the flux of the stepper."""

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.integrate
from motion import Prescribed, observe

import aslo_jax as aslo
from aslo_jax.plants import PMSM, WRIM, InteriorPMSM, MachineState, Stepper

COMMON = dict(friction=2e-3, load=lambda t: 0.1 + 0.02 * t)
MACHINES = {
    "PMSM": PMSM.bmp0701f(**COMMON),
    "PMSM as printed": PMSM.bmp0701f(torque_factor=1.0, **COMMON),
    "interior PMSM": InteriorPMSM(3.6, 36e-3, 51e-3, 0.545, 3, 0.015, **COMMON),
    "stepper": Stepper.bodson(detent_torque=0.013, load=lambda t: 0.1 + 0.02 * t),
    "WRIM": WRIM(1.3, 0.7, 0.1, 0.3, 0.15, 2, 0.02, **COMMON),
}


@pytest.fixture(params=MACHINES)
def name(request):
    return request.param


def some_state(machine, seed=0):
    """Any fluxes and angle: n windings with currents of the order of an ampere."""
    rng = np.random.default_rng(seed)
    n = machine.initial().flux.shape[0]
    angle = jnp.asarray(rng.uniform(-9, 9))
    theta, y = machine.pole_pairs * angle, jnp.asarray(rng.normal(size=n))
    L = machine.inductances(theta)
    flux = (L * y if L.ndim == 0 else L @ y) + machine.magnet(theta)
    u = jnp.asarray(10 * rng.normal(size=n))
    return MachineState(flux, jnp.asarray(rng.normal()), angle), y, u


def textbook_torque(name, m, x, y):
    """In d and q, or as a cross product; complex numbers stand for vectors."""
    theta = m.pole_pairs * float(x.angle)
    if name == "WRIM":
        stator, rotor = complex(*y[:2]), complex(*y[2:]) * np.exp(1j * theta)
        product = float(m.mutual_inductance) * (stator * np.conj(rotor)).imag
        flux = complex(*x.flux[:2])
        np.testing.assert_allclose((np.conj(flux) * stator).imag, product, rtol=1e-12)
        return 1.5 * m.pole_pairs * product
    dq = complex(*y) * np.exp(-1j * theta)
    if name == "stepper":
        a, b = y
        main = -a * np.sin(50 * x.angle) + b * np.cos(50 * x.angle)
        return 0.19 * main - 0.013 * np.sin(200 * x.angle)
    if name == "interior PMSM":
        return 1.5 * 3 * (0.545 * dq.imag + (36e-3 - 51e-3) * dq.real * dq.imag)
    factor = 1.0 if "printed" in name else 1.5
    return factor * 5 * 0.2086 * dq.imag


@pytest.mark.parametrize("seed", range(3))
def test_currents_and_torque_of_the_textbook(name, seed):
    machine = MACHINES[name]
    x, y, _ = some_state(machine, seed)
    np.testing.assert_allclose(machine.output(x), y, rtol=1e-11, atol=1e-12)
    expected = textbook_torque(name, machine, x, y)
    np.testing.assert_allclose(machine.torque(x), expected, rtol=1e-10)


@pytest.mark.parametrize("seed", range(3))
def test_power_balance(name, seed):
    """What the supply gives is lost in resistance, friction and load, or stored in field,
    motion, and the detent, whose potential has the detent torque for slope."""
    machine, t = MACHINES[name], jnp.asarray(2.0)
    x, y, u = some_state(machine, seed)
    rate = machine.vector_field(t, x, u)

    def stored(x):
        kinetic = 0.5 * machine.inertia * x.speed**2
        return machine.field_energy(x) + kinetic

    _, storing = jax.jvp(stored, (x,), (rate,))
    factor = machine.torque_factor
    supplied = factor * jnp.sum(u * y)
    heat = factor * jnp.sum((u - machine.flux_rate(u, y)) * y)
    mechanical = (machine.friction * x.speed + machine.load(t)) * x.speed
    detent = machine.detent(machine.pole_pairs * x.angle) * x.speed
    terms = jnp.stack([supplied, -heat, -mechanical, detent])
    np.testing.assert_allclose(storing, terms.sum(), atol=1e-11 * jnp.abs(terms).max())


def textbook(name, m):
    """The equations with complex currents and fluxes, written out for each machine."""

    def rate(t, s):
        speed, angle = s[-2:]
        e = np.exp(1j * m.pole_pairs * angle)
        u = 20 * np.exp(1j * (30 * t + 8 * t**2))
        phi = s[:-2:2] + 1j * s[1:-2:2]
        if name == "WRIM":
            Ls, Lr, M = 0.1, 0.3, 0.15
            det = Ls * Lr - M * M
            i = np.array([Lr * phi[0] - M * e * phi[1], Ls * phi[1] - M * phi[0] / e]) / det
            dphi = [u - 1.3 * i[0], 0.3 * u.conjugate() - 0.7 * i[1]]
            torque = 3.0 * M * (i[0] * np.conj(e * i[1])).imag
        elif name == "interior PMSM":
            dq = phi[0] / e
            i = e * complex((dq.real - 0.545) / 36e-3, dq.imag / 51e-3)
            dphi = [u - 3.6 * i]
            torque = 4.5 * (np.conj(phi[0]) * i).imag
        elif name == "stepper":
            i = (phi[0] - 0.19 / 50 * e) / 1.5e-3
            dphi = [u - 0.55 * i]
            torque = 0.19 * (i / e).imag - 0.013 * np.sin(200 * angle)
        else:
            i = (phi[0] - 0.2086 * e) / 40.03e-3
            dphi = [u - 8.875 * i]
            torque = float(m.torque_factor) * 5 * (np.conj(phi[0]) * i).imag
        losses = float(m.friction) * speed + 0.1 + 0.02 * t
        flat = [part for d in dphi for part in (d.real, d.imag)]
        return [*flat, (torque - losses) / float(m.inertia), speed]

    return rate


def test_against_scipy(name):
    machine, ts = MACHINES[name], jnp.linspace(0.0, 0.05, 6)
    x0 = eqx.tree_at(lambda x: x.angle, machine.initial(), jnp.asarray(0.2))
    x0 = eqx.tree_at(lambda x: x.flux, x0, machine.magnet(machine.pole_pairs * x0.angle))
    start = [*x0.flux, x0.speed, x0.angle]
    tight = dict(rtol=1e-12, atol=1e-13)
    expected = scipy.integrate.solve_ivp(
        textbook(name, machine), (0, 0.05), start, "DOP853", np.asarray(ts), **tight
    ).y.T

    def voltage(t):
        a = 30 * t + 8 * t**2
        u = 20 * jnp.stack([jnp.cos(a), jnp.sin(a)])
        return jnp.concatenate([u, 0.3 * u * jnp.array([1, -1])]) if name == "WRIM" else u

    x = aslo.simulate(
        machine,
        voltage,
        {},
        t1=0.05,
        ts=ts,
        initial=x0,
        solver=diffrax.Dopri8(),
        stepsize_controller=diffrax.ClipStepSizeController(
            diffrax.PIDController(**tight), step_ts=ts
        ),
    ).x
    found = jnp.concatenate([x.flux, x.speed[:, None], x.angle[:, None]], axis=1)
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9)
    assert jnp.abs(x.speed[-1]) > 0.05


def test_parameters_have_gradients(name):
    machine = MACHINES[name]
    x, _, u = some_state(machine)

    def loss(machine):
        rate = machine.vector_field(jnp.asarray(1.0), x, u)
        return jnp.sum(rate.flux**2) + rate.speed**2

    gradient = eqx.filter_grad(loss)(machine)
    leaves = jax.tree.leaves(eqx.filter(gradient, eqx.is_inexact_array))
    assert len(leaves) >= 6
    assert all(jnp.isfinite(leaf) and leaf != 0 for leaf in leaves)


def test_the_load_of_the_paper_needs_the_factor():
    """3.5 N m at 2.24 A with 3/2, at 3.36 A as printed."""
    for factor, current in ((1.5, 2.24), (1.0, 3.36)):
        motor = PMSM.bmp0701f(torque_factor=factor)
        x = motor.initial()
        flux = x.flux + motor.inductance * jnp.array([0.0, current])
        torque = motor.torque(MachineState(flux, x.speed, x.angle))
        np.testing.assert_allclose(torque, 3.5, rtol=2e-3)


def test_parameter_sets():
    assert WRIM.dfig_2mw().initial().flux.shape == (4,)
    assert InteriorPMSM.motulator_2200w(inertia=0.03).inertia == 0.03
    np.testing.assert_allclose(Stepper.bodson().magnet_flux, 3.8e-3)
    with pytest.raises(ValueError, match="`pole_pairs` must be at least 1, but got 0"):
        Stepper.bodson(pole_pairs=0)
    with pytest.raises(ValueError, match="`direct_inductance` must be positive"):
        InteriorPMSM.motulator_2200w(direct_inductance=-1.0)
    with pytest.raises(ValueError, match=r"mutual_inductance\^2` must be positive"):
        WRIM.dfig_2mw(mutual_inductance=2.6e-3)


STEPPER = Prescribed(
    Stepper.bodson(),
    lambda t: 0.2 * t + 0.05 * (1 - jnp.cos(t)) + 0.1,
    lambda t: jnp.stack([1.2 * jnp.cos(9 * t) + 0.3, (0.8 + 0.3 * t) * jnp.sin(7 * t)]),
)


@pytest.mark.parametrize("magnet_flux", [True, False])
def test_the_flux_of_the_stepper(magnet_flux):
    """m = K_m/N_r, N_r pole pairs: the paper's start within its bounds, relative to m; the
    exact start from a tenth of a second, without m."""
    relation = STEPPER.machine.flux_relation()
    if not magnet_flux:
        relation = eqx.tree_at(lambda r: r.magnet_flux, relation, jnp.zeros(()))
    start = dict(start="paper", guard=None) if magnet_flux else {}
    completion = aslo.Repeat() if magnet_flux else aslo.LeastSquares()
    observer = aslo.AlgebraicObserver(relation, aslo.LowPass(5.0), completion, **start)
    ts = jnp.array([0.1, 1.0, 2.0, 5.0])
    estimate = observe(observer, STEPPER.voltage, STEPPER.current, ts)
    error = jnp.linalg.norm(estimate.value - jax.vmap(STEPPER.flux)(ts), axis=1)
    if magnet_flux:
        # The bounds of the PMSM, whose magnet is 55 times as strong.
        weaker = 3.8e-3 / 0.2086
        assert (error[1:] < weaker * jnp.array([2e-2, 5e-4, 1e-8])).all()
        assert error[0] > 1e-3
    else:
        assert error.max() < 1e-12
