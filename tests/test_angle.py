"""The angle of a PMSM: from its flux, directly, and tracked."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.integrate
from motion import PrescribedPMSM, observe
from test_sampled import prescribed_log, record as record

import aslo_jax as aslo
from aslo_jax.observers import electrical_angle, rotor_angle, track_angle, wrap

MOTOR = PrescribedPMSM()
FLUX = MOTOR.relation()
R, L, M, POLES = MOTOR.resistance, MOTOR.inductance, MOTOR.magnet_flux, MOTOR.pole_pairs
LAM = 8.0
COMPLETIONS = {
    "repeat": aslo.Repeat(),
    "least squares": aslo.LeastSquares(),
    "bank": aslo.FilterBank([aslo.LowPass(20.0)]),
}


def test_the_rotor_angle_in_every_quadrant():
    """And not half a period off for half of the angles, as the printed arctangent is."""
    t = jnp.linspace(0.0, 3.0, 400)
    flux, current = jax.vmap(MOTOR.flux)(t), jax.vmap(MOTOR.current)(t)
    found = rotor_angle(flux, current, L, POLES)
    truth = jax.vmap(MOTOR.angle)(t)
    np.testing.assert_allclose(wrap(POLES * found - truth), 0.0, atol=1e-12)
    assert jnp.abs(found).max() <= jnp.pi / POLES  # one period, 2 pi / n_p
    chi = flux - L * current
    printed = jnp.arctan(chi[:, 1] / chi[:, 0]) / POLES
    off = jnp.abs(wrap(POLES * printed - truth)) > 3.0
    assert 0.3 < off.mean() < 0.7


def test_no_magnet_has_the_angle_zero_and_a_finite_gradient():
    value, gradient = jax.value_and_grad(electrical_angle)(jnp.zeros(2))
    assert value == 0
    assert jnp.isfinite(gradient).all()
    np.testing.assert_allclose(
        jax.grad(electrical_angle)(jnp.array([0.0, 2.0])), [-0.5, 0.0], atol=1e-15
    )


def magnet(t):
    theta = MOTOR.angle(t)
    return M * jnp.stack([jnp.cos(theta), jnp.sin(theta)])


@pytest.mark.parametrize("completion", COMPLETIONS.values(), ids=COMPLETIONS)
def test_the_direct_observer_is_the_flux_less_that_of_the_current(completion):
    """In sampled time too, with either start."""
    t, u, y, _ = prescribed_log(1e-3)
    for start in ("exact", "paper"):
        settings = dict(guard=None, start=start)
        flux = aslo.AlgebraicObserver(FLUX, aslo.LowPass(LAM), completion, **settings)
        direct = aslo.AlgebraicMagnet(FLUX, aslo.LowPass(LAM), completion, **settings)
        expected = aslo.replay(flux, t, u, y)
        found = aslo.replay(direct, t, u, y)
        # Both have the error of rounding over the certificate.
        allowed = 1e-11 + 1e-14 / expected.certificate[1:]
        error = jnp.abs(found.value - (expected.value - L * y)).max(axis=1)[1:]
        usable = allowed < 1e-3
        assert usable.mean() > 0.9
        assert (error < allowed)[usable].all()


@pytest.mark.parametrize("completion", COMPLETIONS.values(), ids=COMPLETIONS)
def test_the_direct_observer_holds_from_the_start(completion):
    ts = jnp.array([0.05, 0.1, 0.2, 0.5, 1.0])
    direct = aslo.AlgebraicMagnet(FLUX, aslo.LowPass(LAM), completion)
    found = observe(direct, MOTOR.voltage, MOTOR.current, ts)
    np.testing.assert_allclose(found.value, jax.vmap(magnet)(ts), atol=2e-7)
    assert not found.coasting.any()


def test_repeat_is_the_printed_second_row():
    """Row 2 of the theory, its filters integrated by SciPy one by one."""
    signals = jax.jit(lambda t: (MOTOR.voltage(t), MOTOR.current(t)))

    def row(s, i):
        r = s[1:3] - s[0] * i
        b = s[0] * (M**2 / (2 * L) - L / 2 * (i @ i)) + s[3]
        return r, b - L * (r @ i)

    def rate(t, s):
        u, i = (np.asarray(x) for x in signals(t))
        z, d = u - R * i, M**2 / (2 * L) - L / 2 * (i @ i)
        one, k, f, Fr, Fb, Frz, Fri = s[0], s[1:3], s[3], s[4:6], s[6], s[7], s[8]
        r, beta = row(s, i)
        return np.concatenate(
            [
                [LAM * (1 - one)],
                LAM * (i - k) + one * z / L,
                [LAM * (-d - f) + k @ z],
                LAM * (r - Fr),
                [LAM * (beta - Fb), LAM * (Fr @ z - Frz), LAM * (r @ i - Fri)],
            ]
        )

    ts = np.array([0.1, 0.3, 0.9])
    s = scipy.integrate.solve_ivp(
        rate, (0, 0.9), np.zeros(9), "DOP853", ts, rtol=1e-12, atol=1e-15
    ).y.T
    direct = aslo.AlgebraicMagnet(FLUX, aslo.LowPass(LAM), aslo.Repeat())
    found = observe(direct, MOTOR.voltage, MOTOR.current, jnp.asarray(ts)).value
    for k, t in enumerate(ts):
        i = np.asarray(MOTOR.current(jnp.asarray(t)))
        r, beta = row(s[k], i)
        second = s[k, 6] + s[k, 7] / LAM - L * (s[k, 4:6] @ i - s[k, 8])
        chi = np.linalg.solve([r, s[k, 4:6]], [beta, second])
        np.testing.assert_allclose(found[k], chi, atol=1e-8)


def test_the_magnet_flux_is_a_free_certificate():
    """A wrong resistance leaves |chi| off: without m it passes, with m it does not."""
    t, u, y, _ = prescribed_log(1e-3)
    found = {}
    for m in (0.0, M):
        relation = aslo.plants.FluxRelation(1.1 * R, L, m)
        observer = aslo.AlgebraicMagnet(relation, aslo.LowPass(LAM), guard=None)
        found[m] = aslo.replay(observer, t, u, y)
    np.testing.assert_allclose(found[0.0].value[50:], found[M].value[50:], atol=1e-9)
    square = jnp.sum(found[M].value ** 2, axis=1)
    part = jnp.clip(1 - jnp.abs(square / M**2 - 1), 0, 1)
    np.testing.assert_allclose(
        found[M].certificate[50:], (part * found[0.0].certificate)[50:], atol=1e-12
    )
    assert part[50:].mean() < 0.5


def test_standstill_coasts():
    t = np.arange(400) * 1e-3
    y = jnp.ones((t.size, 1)) * jnp.array([0.7, -0.4])
    start = L * y[0] + magnet(0.2)
    observer = aslo.AlgebraicMagnet(FLUX, aslo.LowPass(LAM), initial=start)
    found = aslo.replay(observer, t, R * y, y)
    assert found.coasting.all()
    expected = jnp.broadcast_to(magnet(0.2), y.shape)
    np.testing.assert_allclose(found.value, expected, atol=1e-12)


@pytest.mark.parametrize("direct", [False, True])
def test_angle_and_speed_are_tracked_on_the_shipped_record(record, direct):
    t, u, y, flux = record
    theta = electrical_angle(jnp.asarray(flux - L * y))
    kind = aslo.AlgebraicMagnet if direct else aslo.AlgebraicObserver
    bandwidth = 300.0
    observer = track_angle(kind(FLUX, aslo.LowPass(150.0)), bandwidth, 0.0 if direct else L)
    found = aslo.replay(observer, t, u, y)["second"].value
    late = t > 0.15
    assert jnp.abs(wrap(found[:, 0] - theta))[late].max() < 5e-3
    speed = jnp.gradient(jnp.unwrap(theta), jnp.asarray(t))
    lag = 2 * jnp.gradient(speed, jnp.asarray(t)) / bandwidth
    error = jnp.abs(found[:, 1] - speed)[late].max()
    assert error < 2.0 and jnp.abs(found[:, 1] + lag - speed)[late].max() < 0.6 * error


def test_the_start_is_checked():
    with pytest.raises(ValueError, match="Argument `start` must be"):
        aslo.AlgebraicMagnet(FLUX, aslo.LowPass(LAM), start="late")
