"""Plants that are models: their equations against ones written a second time, what they
store against what flows in, and their derived observers without noise, one by one."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from accurate import simulated
from jax.flatten_util import ravel_pytree
from modelled_plants import CASES

import aslo_jax as aslo
from aslo_jax import plants
from aslo_jax.control import OpenLoop

COMPLETIONS = {"repeat": aslo.Repeat, "least-squares": aslo.LeastSquares}
QUICK = ("Buck", "LateralVehicle", "VanDerPol")  # the cheapest of each form
SLOW = [
    pytest.param(name, marks=() if name in QUICK else pytest.mark.slow) for name in CASES
]


def test_every_plant_of_the_kind_has_its_case():
    found = (getattr(plants, name) for name in plants.__all__)
    final = [
        each.__name__
        for each in found
        if isinstance(each, type)
        and issubclass(each, plants.AbstractModelledPlant)
        and not each.__name__.startswith("Abstract")
    ]
    assert sorted(final) == sorted(CASES)


def start_of(case):
    plant = case.plant
    if case.start is None:
        return plant.initial()
    return jnp.asarray(case.start, float) if isinstance(case.start, list) else case.start


def states(case, count=8):
    """Random states about the start, and inputs in their ranges, of each the entries."""
    rng = np.random.default_rng(3)
    flat, back = ravel_pytree(start_of(case))
    s = np.asarray(flat) * rng.uniform(0.6, 1.4, (count, flat.size))
    s = s + 1e-2 * rng.normal(size=s.shape)
    spans = case.plant.inputs.values()
    u = [rng.uniform(span.low, span.high, count) for span in spans]
    return s, np.reshape(u, (-1, count)).T, back


@functools.cache
def motion(name):
    """Of random states: the states, the inputs, and their rates."""
    case = CASES[name]()
    s, u, back = states(case)

    def rates(s, u):
        return ravel_pytree(case.plant.vector_field(jnp.zeros(()), back(s), u))[0]

    return case, s, u, np.asarray(jax.jit(jax.vmap(rates))(s, u))


@pytest.mark.parametrize("name", CASES)
def test_its_equations_are_those_written_a_second_time(name):
    case, s, u, found = motion(name)
    wanted = np.array([case.equations(*each) for each in zip(s, u, strict=True)])
    # As good as the largest of the terms that cancel.
    np.testing.assert_allclose(found, wanted, rtol=1e-12, atol=1e-12 * abs(found).max())


@pytest.mark.parametrize("name", CASES)
def test_what_it_stores_is_what_flows_in(name):
    """By a difference of fourth order along the rates."""
    case, *each = motion(name)
    for s, u, slope in zip(*each, strict=True):
        h = 1e-3 / max(1.0, np.abs(slope / np.maximum(np.abs(s), 1e-2)).max())
        at = [case.stored(s + k * h * slope) for k in (-2, -1, 1, 2)]
        found = (at[0] - 8 * at[1] + 8 * at[2] - at[3]) / (12 * h)
        rounding = 1e-15 * np.abs(at).max() / h
        assert abs(found - case.flow(s, u)) < 1e-8 * abs(found) + 10 * rounding


@pytest.mark.parametrize("name", CASES)
def test_the_model_is_the_plant(name):
    """Its functions of x, y and u are the rates, and zeros, of the plant that moves."""
    case, s, u, slope = motion(name)
    plant, (_, _, back) = case.plant, states(case, 1)
    n = len(plant.states)

    def functions(s, u, slope):
        state, moved = back(s), back(slope)
        y, y_rate = jax.jvp(plant.output, (state,), (moved,))
        x, x_rate = jax.jvp(plant.hidden, (state,), (moved,))
        g = [0.0 * x[0] if each is None else each for each in plant.g(x, y, u)]
        own = jnp.stack([*plant.f(x, y, u), *g])
        used = jnp.array([each is not None for each in plant.g(x, y, u)])
        wanted = jnp.concatenate([x_rate[:n], jnp.where(used, y_rate, 0.0)])
        return own, wanted, jnp.stack([*plant.h(x, y, u), 0.0 * x[0]])

    own, wanted, zero = jax.jit(jax.vmap(functions))(s, u, slope)
    size = 1e-13 * float(abs(wanted).max())
    np.testing.assert_allclose(own, wanted, rtol=1e-12, atol=size)
    np.testing.assert_allclose(zero, 0.0, atol=1e-13)
    hidden = jax.eval_shape(plant.hidden, back(s[0])).shape
    assert hidden == (len(plant.hidden_units()),)


@pytest.mark.parametrize("name", SLOW)
def test_its_observer_is_exact_without_noise(name):
    """Within ten times the figure of the theory's page, from its first instant on."""
    case = CASES[name]()
    found = aslo.derive(case.plant)
    observer = aslo.AlgebraicObserver(
        found.relation,
        aslo.LowPass(case.cutoff),
        COMPLETIONS[case.completion](),
        guard=None,
    )
    first, last = case.since, case.horizon
    early = np.linspace(first, min(10 * first, 0.5 * last), 8)
    ts = jnp.asarray(np.unique([*early, *np.linspace(0.5 * last, last, 8)]))
    run = simulated(case.plant, OpenLoop(case.drive), {"o": observer}, start_of(case), ts)
    y = jax.vmap(case.plant.output)(run.x)
    truth = np.asarray(found.lift(run.hidden, y))
    error = np.abs(np.asarray(run.estimates["o"].value) - truth)
    assert (error / np.abs(truth).max(axis=0)).max() < 10 * case.figure
    decoded = np.asarray(found.decode(jnp.asarray(truth), y))
    assert found.states == tuple(case.plant.hidden_units())
    np.testing.assert_allclose(decoded, run.hidden, rtol=1e-9, atol=1e-9)
