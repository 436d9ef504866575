"""Disturbances by themselves: statistics, derivatives, continuous time and refusals."""

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from plain_disturbances import STARTS, STEPS, T0, A, H, loop

import aslo_jax as aslo
from aslo_jax.disturbances import (
    Bias,
    Chain,
    DeadTime,
    Delay,
    DisturbanceState,
    Drift,
    GainError,
    MissingSamples,
    ParasiticLag,
    Quantisation,
    RandomWalk,
    SampledNoise,
    Saturation,
    Sinusoid,
    check_streams,
)


def passed(part, signals, key=None):
    """What a disturbance makes of a sequence of samples, without a loop."""
    state, out = part.init(T0, signals[0]), []
    for k, s in enumerate(signals):
        t = jnp.asarray(k * H)
        out.append(part(t, state, s))
        state = DisturbanceState(state.continuous, part.update(t, state, s))
    return np.asarray(out)


@pytest.mark.parametrize("delay", [0.0, 0.25, 1.0, 2.7, 3.0])
def test_a_delay_is_exact_on_a_ramp_and_a_shift_where_it_is_whole(delay):
    k = np.arange(10.0)
    part = Delay(delay, longest=3)
    after = k >= 3
    ramp = passed(part, jnp.asarray(2.0 + 0.5 * k))
    np.testing.assert_allclose(ramp[after], 2.0 + 0.5 * (k - delay)[after], rtol=1e-14)
    if delay == int(delay):
        signal = np.random.default_rng(1).normal(size=(10, 2))
        late = passed(part, jnp.asarray(signal))
        shifted = signal[np.maximum(np.arange(10) - int(delay), 0)]
        np.testing.assert_array_equal(late, shifted)


def test_dead_time_opposes_each_phase():
    """Phase currents 2, -0.5, -1.5 A: the error is -V (1, -1, -1) in the phases, which is
    -V 4/3 along alpha; turned by a third, its image turns by a third."""
    part, zero = DeadTime(3.0, 1e-3), jnp.zeros(2)
    phases = np.array([2.0, -0.5, -1.5])
    angles = 2 * np.pi / 3 * np.arange(3)
    clarke = 2 / 3 * np.stack([np.cos(angles), np.sin(angles)])
    found = part(T0, None, zero, jnp.asarray(clarke @ phases))
    np.testing.assert_allclose(found, [-4.0, 0.0], atol=1e-12)
    turned = part(T0, None, zero, jnp.asarray(clarke @ np.roll(phases, 1)))
    np.testing.assert_allclose(turned, -4.0 * np.array([-0.5, np.sqrt(0.75)]), atol=1e-12)
    # It takes power from any current, and within the threshold it is a resistance.
    for i in np.random.default_rng(2).normal(size=(20, 2)):
        assert part(T0, None, zero, jnp.asarray(i)) @ i < 0
    small = np.array([2e-4, -5e-4])
    np.testing.assert_allclose(
        part(T0, None, zero, jnp.asarray(small)), -3.0 / 1e-3 * small, rtol=1e-12
    )


def test_a_chain_acts_in_its_order():
    gain, bias, s = GainError(0.5), Bias(2.0), jnp.array([1.0, -3.0])
    np.testing.assert_array_equal(Chain(gain, bias)(T0, None, s), 1.5 * s + 2.0)
    np.testing.assert_array_equal(Chain(bias, gain)(T0, None, s), 1.5 * (s + 2.0))


def test_random_numbers_have_their_moments():
    """2,000 keys of 40 samples. A walk has the variance of its steps times their number,
    and no two of its increments are correlated; a sample is lost as often as it should be,
    whether the last one was or not; the default streams are independent."""
    keys = jax.vmap(aslo.random.fold, (None, 0))(aslo.random.key(5), jnp.arange(2000))

    @jax.jit
    @jax.vmap
    def sequences(key):
        parts = (
            SampledNoise(0.2, H, key),
            RandomWalk(0.2, key),
            MissingSamples(0.3, key),
        )

        def step(states, k):
            out = []
            t, s = k * H, k.astype(float)
            for part, state in zip(parts, states, strict=True):
                own = DisturbanceState(state.continuous, part.update(t, state, s))
                out.append((own, part(t, state, s)))
            return tuple(o[0] for o in out), tuple(o[1] - s for o in out)

        first = tuple(part.init(T0, jnp.zeros(())) for part in parts)
        return jax.lax.scan(step, first, jnp.arange(41))[1]

    noise, walk, missing = map(np.asarray, sequences(keys))
    increments = np.diff(walk, axis=1)
    sem = 0.2**2 * np.sqrt(2 / increments.size)
    assert abs(np.var(increments) - 0.2**2) < 4 * sem
    assert abs(np.var(walk[:, 40]) - 40 * 0.2**2) < 4 * 40 * 0.2**2 * np.sqrt(2 / 2000)
    lagged = np.mean(increments[:, 1:] * increments[:, :-1])
    assert abs(lagged) < 4 * 0.2**2 / np.sqrt(increments[:, 1:].size)
    lost = missing[:, 1:] < 0
    for share in (lost, lost[:, 1:][lost[:, :-1]], lost[:, 1:][~lost[:, :-1]]):
        assert abs(share.mean() - 0.3) < 4 * np.sqrt(0.3 * 0.7 / share.size)
    for a, b in ((noise[:, :-1], increments), (noise[:, 1:], lost), (increments, lost)):
        assert abs(np.corrcoef(a.ravel(), b.ravel())[0, 1]) < 4 / np.sqrt(a.size)


def test_derivatives_go_through_gain_bias_and_delay():
    @jax.jit
    def loss(parameters):
        gain, bias, delay, voltage = parameters
        sensor = Chain(GainError(gain), Delay(delay, longest=2), Bias(bias))
        actuator = DeadTime(voltage, 0.1)
        run = loop(jnp.asarray(STARTS[0]), sensor=sensor, actuator=actuator).run(STEPS)
        return jnp.sum(run.x**2)

    at = jnp.array([0.2, 0.1, 1.4, 0.3])
    _, slope = jax.jit(jax.value_and_grad(loss))(at)
    for k in range(4):
        step = 1e-6 * jnp.eye(4)[k]
        central = (loss(at + step) - loss(at - step)) / 2e-6
        np.testing.assert_allclose(slope[k], central, rtol=1e-6)
        assert abs(central) > 1e-2


@pytest.mark.parametrize(("delay", "expected"), [(0.0, -1.0), (1.0, -2.0), (2.0, -2.0)])
def test_the_derivative_of_a_whole_delay_is_that_of_one_side(delay, expected):
    """Samples 0, 2, 3, of which the last two differ by 1 and the first two by 2."""
    state = DisturbanceState(sampled=jnp.array([2.0, 0.0]))
    slope = jax.grad(lambda d: Delay(d, 2)(T0, state, jnp.asarray(3.0)))(delay)
    assert slope == expected


def test_a_chain_in_continuous_time():
    """Ripple, drift and a lag on the way to an integrator, against the closed form."""
    w, tau, rate = 7.0, 0.2, 0.4
    part = Chain(Sinusoid(0.5, w), Drift(rate), ParasiticLag(tau))
    ts = jnp.linspace(0.0, 2.0, 11)
    run = aslo.simulate(
        aslo.plants.IntegratorChain(2), lambda t: jnp.zeros_like(t), {}, t1=2.0, ts=ts,
        actuator=part, initial=jnp.zeros(2), solver=aslo.RungeKutta4(),
        stepsize_controller=diffrax.ConstantStepSize(), dt0=1 / 512,
    )  # fmt: skip
    t, pole = np.asarray(ts), np.exp(-np.asarray(ts) / tau)
    # The lag's response v to sin(w t) and to t; then the velocity is its integral.
    size = 0.5 / (1 + (w * tau) ** 2)
    ripple = size * (
        (1 - np.cos(w * t)) / w - tau * np.sin(w * t) + w * tau**2 * (1 - pole)
    )
    ramp = rate * (t**2 / 2 - tau * t + tau**2 * (1 - pole))
    np.testing.assert_allclose(run.x[:, 1], ripple + ramp, atol=1e-9)
    np.testing.assert_array_equal(run.u, 0.0)  # the observers see the command


def test_a_chain_of_sampled_and_integrated_states_drives_the_plant():
    """A whole delay, then a lag, on the actuator: the lag's exact response to the command
    of the sample before. Runge-Kutta's error in a step is (h/tau)^5/120."""
    part = Chain(Delay(1.0), ParasiticLag(1.0))
    run = loop(jnp.asarray(STARTS[0]), actuator=part).run(STEPS)
    v, x, u = np.zeros(2), STARTS[0], np.asarray(run.u)
    S = np.block([[A, np.eye(2)], [np.zeros((2, 2)), -np.eye(2)]])
    power, step, pulse = np.eye(4), np.eye(4), H * np.eye(4)
    for n in range(1, 20):
        power = power @ S * (H / n)
        step, pulse = step + power, pulse + H * power / (n + 1)
    for k in range(STEPS):
        both = step @ [*x, *v] + pulse @ [0, 0, *u[max(k - 1, 0)]]
        x, v = both[:2], both[2:]
        np.testing.assert_allclose(run.x[k + 1], x, atol=1e-6)


def test_what_is_sampled_is_refused_in_continuous_time():
    plant = aslo.plants.IntegratorChain(2)
    with pytest.raises(
        ValueError, match=r"`sensor` must have no state that is updated.*Del"
    ):
        aslo.simulate(plant, jnp.sin, {}, t1=1.0, sensor=Delay(1.0))
    with pytest.raises(ValueError, match=r"`actuator` must .*Chain has one; run an `Exp"):
        aslo.simulate(plant, jnp.sin, {}, t1=1.0, actuator=Chain(Bias(1.0), Delay(1.0)))


def test_two_that_draw_the_same_numbers_are_refused():
    key = aslo.random.key(1)
    noise = SampledNoise(0.1, H, key)
    same = {"sensor": Chain(Bias(1.0), noise), "input_sensor": noise}
    with pytest.raises(
        ValueError, match=r"`stream` of SampledNoise and SampledNoise.*are 0"
    ):
        loop(jnp.zeros(2), **same)
    with pytest.raises(ValueError, match="`stream` of SampledNoise"):
        aslo.simulate(aslo.plants.IntegratorChain(2), jnp.sin, {}, t1=1.0, **same)
    with pytest.raises(ValueError, match="`stream` of MissingSamples and SampledNoise"):
        jax.eval_shape(
            lambda key: check_streams(
                [MissingSamples(0.1, key, stream=3), SampledNoise(0.1, H, key, stream=3)]
            ),
            key,
        )
    check_streams([noise, SampledNoise(0.1, H, key, stream=1), RandomWalk(0.1, key, 2)])
    check_streams([noise, SampledNoise(0.1, H, aslo.random.key(2))])


def test_arguments_are_refused():
    key = aslo.random.key(0)
    with pytest.raises(
        ValueError, match=r"`delay` must be in \[0, 2\] samples, but got 2\.5"
    ):
        Delay(2.5, longest=2)
    with pytest.raises(ValueError, match="`longest` must be at least 1, but got 0"):
        Delay(0.0, longest=0)
    with pytest.raises(ValueError, match="`longest` must be given where `delay` is traced"):
        jax.jit(lambda d: Delay(d).delay)(0.5)
    with pytest.raises(
        ValueError, match=r"`probability` must be in \[0, 1\], but got 1\.5"
    ):
        MissingSamples(1.5, key)
    with pytest.raises(ValueError, match=r"`lower` must be below `upper`.* 1\.0 and -1\.0"):
        Saturation(1.0, -1.0)
    with pytest.raises(ValueError, match=r"`threshold` must be positive and finite \(A\)"):
        DeadTime(1.0, 0.0)
    with pytest.raises(ValueError, match="`step` must be positive"):
        Quantisation(0.0)
    with pytest.raises(ValueError, match="`parts` must hold a disturbance, but is empty"):
        Chain()
    with pytest.raises(
        ValueError, match=r"`parts` must have Delay.*before what is integrat"
    ):
        loop(jnp.zeros(2), actuator=Chain(ParasiticLag(1.0), Delay(1.0))).init()
    with pytest.raises(ValueError, match=r"`input_sensor` must have no.*Chain has one"):
        loop(jnp.zeros(2), input_sensor=Chain(ParasiticLag(1.0))).init()
    with pytest.raises(ValueError, match="`output` must be the plant's output"):
        DeadTime(1.0, 0.1)(T0, None, jnp.zeros(2))
