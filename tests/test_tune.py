"""Tuning: closed forms, fine grids, and what ends a descent."""

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest

import aslo_jax as aslo
from aslo_jax import tune
from aslo_jax.control import OpenLoop
from aslo_jax.disturbances import SampledNoise
from aslo_jax.filters import second_order
from aslo_jax.tune import losses

W, V = 1.0, 0.01  # two-sided intensities of the input's noise and the measurement's
BEST = (5 * W / (3 * V)) ** 0.25  # rad/s, theory, section 4
RELATION = aslo.plants.IntegratorChain(2).relation()
INTERVAL = 0.01


def settled(filter):
    return aslo.AlgebraicObserver(RELATION, filter, aslo.Repeat(), None, "paper")


def asymptotic(rate, gain):
    inner = settled(aslo.LowPass(rate))
    return aslo.Asymptotic(inner, gain, initial=jnp.zeros(1))


def gains(observer):
    return observer.observer.filter.rate, observer.gain


# ---- the linear example --------------------------------------------------------------


def variance(observer, key):
    del key
    return tune.stationary_variance(observer, W, V)


@pytest.fixture(scope="module")
def tuned():
    return tune.fit(asymptotic(50.0, 0.3), variance, where=gains)


def test_gains_of_the_linear_example(tuned):
    assert tuned.stopped == "converged"
    np.testing.assert_allclose(tuned.parameters, BEST, rtol=1e-2)
    np.testing.assert_allclose(tuned.loss, 5 / 3 * W / BEST, rtol=1e-6)
    assert round(BEST, 3) == 3.593 and round(tuned.loss, 5) == 0.46386
    np.testing.assert_allclose(gains(tuned.tree), tuned.parameters)


def test_tuned_second_order_filter_is_the_kalman_filter(tuned):
    def loss(p, key):
        return variance(settled(second_order(p["w0"], p["damping"])), key)

    start = {"w0": jnp.array(40.0), "damping": jnp.array(0.1)}
    best = tune.fit(start, loss, where=lambda p: (p["w0"], p["damping"]))
    np.testing.assert_allclose(best.parameters, [(W / V) ** 0.25, 0.5**0.5], rtol=1e-2)
    kalman = np.sqrt(2) * W**0.75 * V**0.25
    np.testing.assert_allclose(best.loss, kalman, rtol=1e-6)
    np.testing.assert_allclose(tuned.loss / best.loss, 1.037, atol=5e-4)


@pytest.mark.parametrize(("rate", "gain"), [(3.0, 2.0), (7.0, 0.4)])
def test_variance_in_closed_form(rate, gain):
    total, product = rate + gain, rate * gain
    expected = V * product**2 + W + W * total**2 / product
    found = variance(asymptotic(rate, gain), None)
    np.testing.assert_allclose(found, expected / (2 * total), rtol=1e-10)


def test_bare_algebraic_observer_has_no_variance():
    assert variance(settled(aslo.LowPass(3.0)), None) == jnp.inf


# ---- a batch -------------------------------------------------------------------------


def place(gains, sample):
    """The chain from an unknown velocity, its input and output measured with noise."""
    rate, gain = gains[0], gains[1]
    position = SampledNoise((V / INTERVAL) ** 0.5, INTERVAL, sample["key"])
    force = SampledNoise((W / INTERVAL) ** 0.5, INTERVAL, sample["key"], 1)
    return aslo.Experiment(
        aslo.plants.IntegratorChain(2),
        OpenLoop(jnp.zeros_like),
        {"A": asymptotic(rate, gain)},
        INTERVAL,
        input_sensor=force,
        sensor=position,
        initial=jnp.stack([0.0 * sample["v0"], sample["v0"]]),
    )


def draw(key):
    return {"key": key, "v0": 2.0 * aslo.random.normal(key, 0, 5)}


def same(gains, sample):
    """lambda = gamma."""
    return place((gains, gains), sample)


def batch(metric, place=same, samples=24, steps=300, **choice):
    return losses.MonteCarlo(place, metric, samples, steps, draw, **choice)


SETTINGS = {
    "mean square": batch(losses.MeanSquare("A")),
    "worst": batch(losses.MeanSquare("A"), reduce=losses.worst),
    "CVaR": batch(losses.MeanSquare("A"), reduce=losses.CVaR(0.3)),
    "noise and transient": batch(losses.NoiseAndTransient("A", 1.5, INTERVAL, 0.1)),
    "settling": batch(losses.SmoothSettling("A", 1.0, INTERVAL)),
}
GRID = np.geomspace(1.0, 12.0, 250)


LONGER = ("noise and transient", "worst", "CVaR", "settling")
SLOW = [pytest.param(n, marks=pytest.mark.slow) for n in LONGER]


@pytest.mark.parametrize("name", ["mean square", *SLOW])
def test_tuned_point_is_the_best_of_a_fine_grid(name):
    loss, key = SETTINGS[name], aslo.random.key(4)
    on_grid = np.asarray(jax.jit(jax.vmap(lambda g: loss(g, key)))(jnp.asarray(GRID)))
    best = on_grid.argmin()
    assert 0 < best < GRID.size - 1
    smooth = name not in ("worst", "CVaR")
    descent = optax.adam(optax.cosine_decay_schedule(0.3, 60))
    found = tune.fit(
        jnp.array(GRID[-1]),
        loss,
        where=lambda g: g,
        key=key,
        optimiser=None if smooth else descent,
        iterations=60,
        patience=60,
    )
    assert found.mode == "forward"
    assert GRID[best - 1] < found.parameters[0] < GRID[best + 1]
    # A point of the grid may be nearer to the best one, which is 1 % wide.
    assert found.loss <= on_grid[best] * (1 + 1e-4)
    # Fresh samples: other numbers, the same story.
    assert found.validation != found.loss
    assert found.validation < found.initial_validation


@pytest.mark.slow
def test_monte_carlo_finds_the_closed_form():
    """Sampling delays by half an interval, 1.8 % of the time constant; 2,500 independent
    instants or so know the variance to 3 % and the gains better, as the loss is three times
    as curved in their logarithms."""
    start = jnp.array([9.0, 1.2])
    loss = batch(losses.MeanSquare("A", after=3.0), place, samples=96, steps=1800)
    found = tune.fit(start, loss, where=lambda g: g)
    product, total = np.prod(found.parameters), np.sum(found.parameters)
    np.testing.assert_allclose(np.sqrt(product), BEST, rtol=0.04)
    variance = (V * product**2 + W + W * total**2 / product) / (2 * total)
    np.testing.assert_allclose(variance, 5 / 3 * W / BEST, rtol=5e-3)
    np.testing.assert_allclose(found.validation, 5 / 3 * W / BEST, rtol=0.05)


@pytest.mark.slow
def test_reverse_mode_has_the_same_gradient():
    loss, key = batch(losses.MeanSquare("A"), place, 4, 90), aslo.random.key(1)
    g = jnp.array([3.0, 2.0])
    forward = jax.jit(jax.jacfwd(lambda g: loss(g, key)))(g)
    reverse = jax.jit(jax.grad(lambda g: loss.reversible()(g, key)))(g)
    assert jnp.abs(forward).min() > 1e-3
    np.testing.assert_allclose(reverse, forward, rtol=1e-10)


# ---- costs and reductions in closed form ---------------------------------------------


def test_cvar_lies_between_the_mean_and_the_worst():
    costs = jnp.array([1.0, 5.0, 2.0, 8.0])
    np.testing.assert_allclose(losses.CVaR(1.0)(costs), losses.mean(costs))
    np.testing.assert_allclose(losses.CVaR(0.25)(costs), losses.worst(costs))
    np.testing.assert_allclose(losses.CVaR(0.375)(costs), (8.0 + 0.5 * 5.0) / 1.5)
    with pytest.raises(ValueError, match=r"`fraction` must be in \(0, 1\], but got 0.0"):
        losses.CVaR(0.0)


def test_smooth_settling_time_of_an_exponential():
    """|e| = 10 exp(-gain t), as the algebraic estimate of a chain at rest is right."""
    plant = aslo.plants.IntegratorChain(2)
    rest = aslo.Asymptotic(settled(aslo.LowPass(3.0)), 2.0, initial=jnp.array([10.0]))
    loop = aslo.Experiment(plant, OpenLoop(jnp.zeros_like), {"A": rest}, 1e-3)
    metric = losses.SmoothSettling("A", 0.5, 1e-3, width=0.1)
    loss = losses.MonteCarlo(lambda loop, key: loop, metric, 1, 3000, engine="scan")
    # The logistic function is odd about the tolerance, so its width does not matter.
    expected = np.log(10.0 / 0.5) / 2.0
    np.testing.assert_allclose(loss(loop, aslo.random.key(0)), expected, rtol=1e-3)


def test_noise_and_transient_are_parted_at_the_split():
    metric = losses.NoiseAndTransient("A", 0.5, 0.25, weight=3.0, scale=2.0)
    errors = [4.0, 2.0, 1.0, 3.0]  # at 0, 0.25, 0.5, 0.75 s

    def record(k):
        estimate = aslo.Estimate(jnp.array([errors[k]]), jnp.ones(()), jnp.array(False))
        zero = jnp.zeros(1)
        return aslo.Record(jnp.array(0.25 * k), zero, zero, zero, zero, {"A": estimate})

    state = metric.init(record(0))
    for k in range(1, 4):
        state = metric.update(state, record(k))
    np.testing.assert_allclose(metric.parts(state), [(1 + 9) / 8, 0.25 * (16 + 4) / 4])
    np.testing.assert_allclose(metric.result(state), 1.25 + 3 * 1.25)


# ---- what is tuned -------------------------------------------------------------------


def test_rates_of_a_bank_over_a_log():
    """Every filter has a rate; the truth is a sinusoid with a noisy measurement."""
    t = np.arange(300) * 1e-2
    y = np.sin(2 * t) + 1e-3 * np.random.default_rng(0).normal(size=t.size)
    chain = aslo.plants.IntegratorChain(3).relation()
    bank = aslo.FilterBank((aslo.LowPass(9.0),))
    observer = aslo.AlgebraicObserver(chain, aslo.LowPass(30.0), bank)
    truth = np.stack([2 * np.cos(2 * t), -4 * np.sin(2 * t)], axis=1)
    loss = losses.Recorded(t, -8 * np.cos(2 * t), y, truth, after=0.5, scale=[2.0, 4.0])
    where = lambda o: (o.filter.rate, o.completion.filters[0].rate)
    found = tune.fit(observer, loss, where=where, optimiser=optax.adam(0.2), iterations=8)
    assert found.mode == "forward" and found.stopped == "iteration limit"
    assert found.loss < 0.5 * found.initial_loss
    assert found.tree.completion.filters[0].rate == found.parameters[1] != 9.0
    assert found.validation == found.loss  # a log is a log


def test_diffrax_default_adjoint_is_differentiated_in_reverse():
    def loss(gain, key):
        del key
        term = diffrax.ODETerm(lambda t, x, gain: 1.0 - gain * x)
        solution = diffrax.diffeqsolve(
            term, diffrax.Heun(), 0.0, 1.0, 0.1, jnp.array(0.0), gain
        )
        return (solution.ys[-1] - 0.3) ** 2

    settings = dict(where=lambda g: g, optimiser=optax.adam(0.2), iterations=5)
    found = tune.fit(jnp.array(1.0), loss, **settings)
    assert found.mode == "reverse"
    assert found.loss < found.initial_loss


def test_many_parameters_are_differentiated_in_reverse():
    loss = lambda x, key: jnp.sum((x - 2.0) ** 2)
    found = tune.fit(jnp.ones(17), loss, where=lambda x: x, optimiser=optax.sgd(0.1))
    assert found.mode == "reverse"
    few = dict(where=lambda x: x, optimiser=optax.sgd(0.1), iterations=1)
    assert tune.fit(jnp.ones(16), loss, **few).mode == "forward"
    assert tune.fit(jnp.ones(16), loss, mode="reverse", **few).mode == "reverse"


# ---- the descent ---------------------------------------------------------------------


# ---- charts --------------------------------------------------------------------------


def test_front_in_closed_form():
    """(x + 1)^(1-w) (1/x + 1)^w is least at x = w/(1 - w)."""
    costs = lambda x, key: jnp.stack([x + 1.0, 1.0 / x + 1.0])
    weights = np.array([0.2, 0.5, 0.8])
    front = tune.pareto(
        jnp.array(9.0), costs, where=lambda x: x, weights=weights, optimiser=optax.sgd(3.0)
    )
    x = weights / (1 - weights)
    np.testing.assert_allclose(front.parameters[:, 0], x, rtol=2e-3)
    np.testing.assert_allclose(front.costs, np.stack([x + 1, 1 / x + 1], 1), rtol=2e-3)
    with pytest.raises(ValueError, match=r"`weights` must lie in \[0, 1\]"):
        tune.pareto(jnp.array(9.0), costs, where=lambda x: x, weights=[1.5])


def test_surface_is_the_loss_at_every_pair():
    where = lambda p: (p["a"], p["b"])
    loss = lambda p, key: p["a"] - 2 * p["b"]
    p = {"a": jnp.array(1.0), "b": jnp.array(1.0)}
    over = tune.surface(p, loss, where=where, first=[1.0, 2.0, 3.0], second=[5.0, 7.0])
    np.testing.assert_allclose(over.loss, [[-9, -13], [-8, -12], [-7, -11]])
    with pytest.raises(ValueError, match="`where` must select two leaves"):
        tune.surface(p, loss, where=lambda p: (p["a"],), first=[1.0], second=[1.0])
