"""Levitation: the magnetic bearing in a closed loop, with and without a position sensor."""

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.signal

import aslo_jax as aslo
from aslo_jax.control import BearingFeedback, MagneticLevitation
from aslo_jax.disturbances import SampledNoise
from aslo_jax.observers import BearingObserver
from aslo_jax.plants import BearingState, MagneticBearing

GAP, WEIGHT, TOUCHDOWN, STIFFNESS = 0.5e-3, 9.81, 0.75, 5e6
INTERVAL, REST = 5e-5, 0.05
# The bandwidths of position and fluxes and the observer's filter of the velocity (rad/s).
B, FLUX_B, RATE = 200.0, 2000.0, 1000.0
PUSH, PUSHED = 5.0, 0.2  # N, from this time on (s)


def centre(t):
    return jnp.zeros_like(t)


def force(t):
    return jnp.where(t < PUSHED, 0.0, PUSH) - WEIGHT


def position_sensor(y, x, estimates):
    del estimates
    return BearingFeedback(y, x.flux, x.position, x.velocity)


def self_sensing(y, x, estimates):
    del x
    found = estimates["bearing"].value
    return BearingFeedback(y, found[:2], found[2], found[3])


BEARING = MagneticBearing.laboratory(
    force=force, touchdown=TOUCHDOWN * GAP, touchdown_stiffness=STIFFNESS
)
# At rest below, with half of the bias flux that the observer has no guess of.
BELOW = -TOUCHDOWN * GAP - WEIGHT / STIFFNESS
RESTING = BearingState(jnp.full(2, 1e-2), jnp.asarray(BELOW), jnp.zeros(()))


RIPPLE = dict(ripple=10.0, ripple_frequency=2 * np.pi * 500)  # V, rad/s


def controller(bearing=BEARING, **settings):
    settings = RIPPLE | settings
    settings = dict(bandwidth=B, flux_bandwidth=FLUX_B, rest=REST) | settings
    return MagneticLevitation(bearing, centre, bias=1.0, voltage_limit=60.0, **settings)


def observer(resistance=2.0):
    relation = eqx.tree_at(
        lambda r: r.resistance, BEARING.flux_relation(), jnp.asarray(resistance)
    )
    flux = aslo.AlgebraicObserver(
        relation,
        aslo.LowPass(1000.0),
        aslo.LeastSquares(aslo.LowPass(80.0)),
        guard=aslo.Guard(5e-5),
    )
    return BearingObserver(flux, aslo.LowPass(RATE), aslo.Guard(1e-3))


def levitation(feedback=self_sensing, resistance=2.0, noise=0.0, **settings):
    """The loop at 20 kHz; `resistance` (ohm) is what the observer takes it for, and
    `noise` (A) that of the currents."""
    return aslo.Experiment(
        BEARING,
        controller(**settings),
        {"bearing": observer(resistance)},
        INTERVAL,
        feedback=feedback,
        sensor=SampledNoise(noise, INTERVAL, aslo.random.key(1)),
        initial=RESTING,
    )


def response(t, observed=True):
    """The position (m) after a step of 1 N: `p^2 q = f/m - C ((3 b^2 + b^3/p) q + 3 b v)`
    with C the lag of the fluxes, and `v = p q`, less `(f/m)/(p + rate)` in the observer's
    velocity, which knows nothing of f."""
    C = FLUX_B * np.array([1.0])
    lag, slow = np.array([1.0, FLUX_B]), np.array([1.0, RATE])
    closed = np.polyadd(np.polymul([1.0, 0.0, 0.0, 0.0], lag), C * [3 * B, 3 * B**2, B**3])
    push = np.polymul(lag, slow)
    if observed:
        push = np.polyadd(push, 3 * B * C)
    system = scipy.signal.TransferFunction(np.append(push, 0.0), np.polymul(closed, slow))
    return scipy.signal.step(system, T=np.asarray(t))[1]


def test_poles_are_placed():
    """With everything measured, the position follows a step as `(b/(p + b))^3`, up to the
    lag of the flux control."""
    bearing = MagneticBearing.laboratory()
    ts = jnp.linspace(0.0, 0.06, 61)
    bt = B * ts
    expected = 1e-4 * (1 - jnp.exp(-bt) * (1 + bt + bt**2 / 2))
    errors = []
    for flux_bandwidth in (1e4, 2e4):
        control = MagneticLevitation(
            bearing, lambda t: 1e-4 + 0 * t, 1.0, B, flux_bandwidth=flux_bandwidth
        )
        run = aslo.simulate(
            bearing, control, {}, t1=0.06, ts=ts, feedback=position_sensor,
            solver=diffrax.Dopri8(), dt0=1e-6,
        )  # fmt: skip
        errors.append(float(jnp.abs(run.x.position - expected).max()))
    assert errors[0] < 5e-6
    assert 1.8 < errors[0] / errors[1] < 2.2


def test_lift_off_and_hold_without_a_position_sensor():
    record = levitation().run(6_000, every=10)
    t, q, found = record.t, record.x.position / GAP, record.estimates["bearing"]
    # Equal fluxes lift nobody; their ripple, 9 N, rattles the weight by 3 um.
    assert (jnp.abs(q - q[0])[t < REST] < 0.01).all()
    assert not found.coasting[t > 0.01].any()
    assert q[jnp.searchsorted(t, 0.09)] > -0.05
    assert q[t < PUSHED].max() < 5e-3  # no overshoot
    assert jnp.abs(q)[(t > 0.12) & (t < PUSHED)].max() < 5e-3
    error = jnp.abs(found.value - record.hidden)[t > 0.1]
    assert error[:, :2].max() < 1e-5 and error[:, 2].max() < 1e-4 * GAP
    # An unknown force on the velocity, as the observer documents it.
    still = jnp.searchsorted(t, jnp.array([PUSHED - 1e-3, 0.3 - 1e-3]))
    bias = (found.value - record.hidden)[still, 3]
    np.testing.assert_allclose(bias, np.array([9.81, 4.81]) / RATE, rtol=0.05)


def test_a_push_moves_it_as_the_transfer_function_says():
    record = levitation().run(6_000, every=10)
    after = record.t >= PUSHED
    t, moved = record.t[after] - PUSHED, record.x.position[after]
    expected = PUSH * response(t)
    # The ripple shakes it by 0.8 um, 1.5 % of the peak; half an interval is another 0.5 %.
    assert jnp.abs(moved - expected).max() < 0.03 * expected.max()
    assert 1.5 < response(t).max() / response(t, observed=False).max() < 1.7
    assert 0.10 < jnp.abs(moved).max() / GAP < 0.12


@pytest.mark.parametrize(
    ("resistance", "noise", "rms", "peak"),
    [(2.0, 0.01, 0.012, 0.12), (2.1, 0.01, 0.025, 0.12), (1.9, 0.01, 0.025, 0.13)],
)
def test_it_holds_with_noise_and_a_wrong_resistance(resistance, noise, rms, peak):
    """10 mA on currents of 1 A, 20,000 times a second, and 5 % of the resistance."""
    record = levitation(resistance=resistance, noise=noise).run(8_000, every=10)
    t, q = record.t, record.x.position / GAP
    assert not record.estimates["bearing"].coasting[t > 0.1].any()
    assert q.max() < 0.5  # the overshoot of the lift-off
    still = ((t > 0.15) & (t < PUSHED)) | (t > 0.3)
    assert jnp.sqrt(jnp.mean(q[still] ** 2)) < rms
    assert jnp.abs(q[t > 0.15]).max() < peak


def test_a_slow_filter_takes_a_wrong_resistance_for_motion():
    """The rows must be free of their mean, where the error of `R i` is: their filter is to
    be fast, and the forgetting slow."""

    def rms(rate):
        loop = levitation(resistance=2.02)
        at = lambda e: e.observers["bearing"].flux.filter.rate
        loop = eqx.tree_at(at, loop, rate)
        record = loop.run(8_000, every=10)
        still = (record.t > 0.12) & (record.t < PUSHED)
        return jnp.sqrt(jnp.mean((record.x.position[still] / GAP) ** 2))

    slow, fast = eqx.filter_vmap(rms)(jnp.array([80.0, 1000.0]))
    assert fast < 0.01
    assert slow > 0.1


def test_both_fluxes_must_vary_and_not_in_proportion():
    """The certificate of a body that a position sensor holds, over the phase between the
    ripples: common and differential ones show one direction only."""

    def certificate(phase, ripple):
        loop = levitation(position_sensor, ripple_phase=phase, ripple=ripple)
        return loop.run(4_000, every=4_000).estimates["bearing"].certificate[-1]

    phases = jnp.array([0.0, np.pi / 4, np.pi / 2, np.pi, np.pi / 2])
    ripples = jnp.array([10.0, 10.0, 10.0, 10.0, 0.0])
    common, eighth, quarter, differential, none = eqx.filter_vmap(certificate)(
        phases, ripples
    )
    assert quarter > 2e-3 and quarter / 3 < eighth < quarter
    assert jnp.maximum(jnp.maximum(common, differential), none) < 1e-50


def test_without_a_ripple_it_never_finds_the_centre():
    for noise in (0.0, 0.01):
        record = levitation(ripple=0.0, noise=noise).run(6_000, every=10)
        found, late = record.estimates["bearing"], record.t > REST
        assert found.coasting[late].all()
        assert found.certificate[late].max() < 1e-9
        assert jnp.abs(record.x.position).min() > 0.25 * GAP


@eqx.filter_jit
def switched(before, after, at, steps):
    """The record of `steps` samples after sample `at`, where one loop takes over from the
    other."""
    carry, _ = before.init()
    prepared = before.prepare(carry)
    carry = jax.lax.fori_loop(
        0, at, lambda k, carry: before.advance(k, carry, prepared)[0], carry
    )
    return jax.lax.scan(
        lambda carry, k: after.advance(k, carry, prepared),
        carry,
        jnp.arange(at, at + steps),
    )[1]


def test_switching_the_ripple_off_in_flight_loses_the_centre():
    """Certified from the past for some 50 ms, then coasting, then off by more than half of
    the gap. Noise on the currents is an excitation of a kind, by way of the controller:
    with it the body stays up on a tenth of the certificate, and wanders."""
    ends = {}
    for noise in (0.0, 0.01):
        on = levitation(noise=noise)
        off = eqx.tree_at(lambda e: e.controller.ripple, on, jnp.zeros(()))
        record = switched(on, off, 3_900, 4_100)
        ends[noise] = record, jnp.abs(record.x.position) / GAP
    record, q = ends[0.0]
    found = record.estimates["bearing"]
    lost = int(jnp.argmax(found.coasting))
    assert 0.03 < record.t[lost] - record.t[0] < 0.08
    assert found.certificate[0] > 2e-3 and found.certificate[-1] < 1e-20
    assert q[:lost].max() < 0.15 and q[lost:].max() > 0.5
    record, q = ends[0.01]
    certificate = record.estimates["bearing"].certificate
    assert q.max() < 0.5 and certificate[-1] < 0.1 * certificate[0]
    assert jnp.sqrt(jnp.mean(q[2_000:] ** 2)) > 0.012  # against 0.008 with the ripple


@pytest.mark.slow
def test_in_continuous_time():
    """The same loop in one solve, and the sampled one approaches it."""
    loop = levitation()
    ts = jnp.linspace(0.0, 0.15, 76)
    run = aslo.simulate(
        BEARING, loop.controller, loop.observers, t1=0.15, ts=ts, initial=RESTING,
        feedback=self_sensing, dt0=1e-6,
    )  # fmt: skip
    late, error = ts > 0.1, run.error("bearing")
    assert not run.estimates["bearing"].coasting[ts > 0.01].any()
    assert jnp.abs(run.x.position[late]).max() < 0.02 * GAP
    assert jnp.abs(error[late, :3]).max() < 1e-8
    np.testing.assert_allclose(error[-1, 3], WEIGHT / RATE, rtol=1e-3)
    apart = []
    for n in (1, 2):
        fine = eqx.tree_at(lambda e: e.interval, loop, jnp.asarray(INTERVAL / n))
        record = fine.run(3_000 * n, every=40 * n)
        apart.append(float(jnp.abs(record.x.position - run.x.position).max()) / GAP)
    assert apart[0] < 2e-3
    assert apart[1] < 0.8 * apart[0]


def test_a_load_beyond_the_limit_does_not_wind_up():
    """Pressed to the ground for 0.1 s, then let go: no excursion to the other side."""
    heavy = lambda t: jnp.where((t > 0.05) & (t < 0.15), -120.0, -WEIGHT)
    bearing = eqx.tree_at(lambda b: b.force, BEARING, heavy)
    control = controller(bearing, ripple=0.0)
    np.testing.assert_allclose(control.force_limit, 80.4, rtol=1e-3)
    control = eqx.tree_at(lambda c: c.rest, control, jnp.zeros(()))
    loop = aslo.Experiment(bearing, control, {}, INTERVAL, feedback=position_sensor)
    record = loop.run(5_000, every=10)
    t, q = record.t, record.x.position / GAP
    assert q[(t > 0.1) & (t < 0.15)].max() < -TOUCHDOWN
    assert q[t > 0.15].max() < TOUCHDOWN
    assert jnp.abs(q[t > 0.22]).max() < 0.01


@pytest.mark.slow
def test_gradients_through_the_loop():
    """The mean square of the position over 20 ms in the air, by bandwidth and ripple."""
    aware = eqx.tree_at(
        lambda e: (e.initial, e.observers["bearing"].flux.initial),
        levitation(),
        (BEARING.initial(), BEARING.initial().flux),
        is_leaf=lambda x: x is None,
    )

    def loss(*values):
        at = lambda e: (e.controller.bandwidth, e.controller.ripple, e.controller.rest)
        loop = eqx.tree_at(at, aware, (*values, jnp.zeros(())))
        return jnp.mean((loop.run(400, every=40).x.position / GAP) ** 2)

    at = jnp.asarray(200.0), jnp.asarray(10.0)
    loss = eqx.filter_jit(loss)
    gradient = eqx.filter_jit(jax.jacfwd(loss, (0, 1)))(*at)
    for k, step in enumerate((0.02, 1e-3)):
        ends = [loss(*(a + s * (i == k) for i, a in enumerate(at))) for s in (step, -step)]
        central = (ends[0] - ends[1]) / (2 * step)
        np.testing.assert_allclose(gradient[k], central, rtol=1e-5)


def test_arguments_are_refused():
    with pytest.raises(ValueError, match=r"`bias` must be positive and finite \(A\)"):
        MagneticLevitation(BEARING, centre, bias=0.0)
    with pytest.raises(ValueError, match=r"`bandwidth` must be positive and finite \(rad"):
        controller(bandwidth=-1.0)
