"""Forward derivatives of continuous runs by the fused engine."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import aslo_jax as aslo
from aslo_jax.disturbances import SampledNoise

pytest.importorskip("llvmlite")
PLANT = aslo.plants.IntegratorChain(2)
TS = np.linspace(0.0, 0.9, 7)
AT = jnp.array([3.0, 0.4, -0.7])  # filter (rad/s), position (m), velocity (m/s)


def push(t):  # m/s^2
    return jnp.cos(2.0 * t)


def run(at, engine="fused", **settings):
    """The printed ASLO, whose error is `(rate q - v) exp(-rate t)` of the first q and v."""
    rate, position, velocity = at
    observer = aslo.AlgebraicObserver(
        PLANT.relation(), aslo.LowPass(rate), aslo.Repeat(), guard=None, start="paper"
    )
    given: dict[str, Any] = dict(
        rtol=1e-9, atol=1e-11, initial=jnp.stack([position, velocity])
    )
    given |= dict(t1=TS[-1], ts=TS, engine=engine)
    return aslo.simulate(PLANT, push, {"A": observer}, **(given | settings))


def error(at, **settings):
    return run(at, **settings).error("A")[:, 0]


def test_derivatives_in_gains_and_first_states_in_closed_form():
    rate, position, velocity = np.asarray(AT)
    found = jax.jacfwd(error)(AT)
    decay = np.exp(-rate * TS)
    slope = position - TS * (rate * position - velocity)
    wanted = np.stack([slope * decay, rate * decay, -decay], axis=1)
    np.testing.assert_allclose(found, wanted, atol=1e-8)


def test_values_have_the_bits_of_a_run_without_derivatives():
    values, rates = jax.jvp(run, (AT,), (jnp.array([1.0, 0.0, 0.0]),))
    for ours, other in zip(*map(jax.tree.leaves, (values, run(AT))), strict=True):
        np.testing.assert_array_equal(ours, other)
    assert not rates.t.any()
    assert rates.estimates["A"].coasting.dtype == jax.dtypes.float0


@pytest.mark.parametrize(
    ("derivative", "said"),
    [
        (jax.grad(lambda at: error(at)[-1]), r"forward derivatives only.*\"diffrax\""),
        (jax.jacfwd(jax.jacfwd(error)), r"first derivatives only.*\"diffrax\""),
    ],
)
def test_other_derivatives_are_refused(derivative, said):
    with pytest.raises(NotImplementedError, match=said):
        derivative(AT)


@pytest.mark.slow
def test_derivatives_of_a_batch_are_those_of_each_run():
    along = lambda at: jax.jvp(error, (at,), (jnp.array([0.3, -1.0, 2.0]),))[1]
    many = jnp.stack([AT, 1.3 * AT, AT - 0.2])
    together = jax.jit(jax.vmap(along))(many)
    for k, at in enumerate(many):
        np.testing.assert_array_equal(together[k], along(at))


@pytest.mark.slow
def test_derivatives_under_held_noise_and_a_guard_are_those_of_differences():
    noise = SampledNoise(jnp.asarray(0.05), 0.1, aslo.random.key(3))
    plant = aslo.plants.IntegratorChain(2)

    def last(rate):
        observer = aslo.AlgebraicObserver(plant.relation(), aslo.LowPass(rate))
        given: dict[str, Any] = dict(
            rtol=1e-10, atol=1e-12, ts=TS, engine="fused", sensor=noise
        )
        run = aslo.simulate(plant, jnp.sin, {"A": observer}, t1=TS[-1], **given)
        return run.estimates["A"].value[-1]

    rate, step = jnp.asarray(4.0), 1e-4
    slope = jax.jacfwd(last)(rate)
    quotient = (last(rate + step) - last(rate - step)) / (2.0 * step)
    np.testing.assert_allclose(slope, quotient, rtol=1e-5)
