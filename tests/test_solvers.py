"""The fixed-step solver: its order, and its polynomials between the steps."""

import diffrax
import jax.numpy as jnp
import numpy as np

import aslo_jax as aslo


def errors(dt, ts):
    """Of `x' = -x cos t`, `x = exp(-sin t)`."""
    solution = diffrax.diffeqsolve(
        diffrax.ODETerm(lambda t, x, args: {"x": -x["x"] * jnp.cos(t)}),
        aslo.RungeKutta4(),
        0.0,
        2.0,
        dt,
        {"x": jnp.ones(2)},
        saveat=diffrax.SaveAt(ts=ts),
    )
    return jnp.abs(solution.ys["x"][:, 1] - jnp.exp(-jnp.sin(ts))).max()


def test_fourth_order_at_the_steps_and_between_them():
    at_steps = jnp.linspace(0.05, 1.9, 38)
    for ts in (at_steps, jnp.linspace(0.05, 1.95, 997)):
        ratio = errors(0.05, ts) / errors(0.025, ts)
        assert 13.0 < ratio < 19.0
    assert errors(0.025, jnp.array([2.0])) < 1e-7


def test_a_simulation_with_fixed_steps():
    chain = aslo.plants.IntegratorChain(2)
    observer = aslo.AlgebraicObserver(chain.relation(), aslo.LowPass(5.0), aslo.Repeat())
    run = aslo.simulate(
        chain,
        jnp.sin,
        {"ASLO": observer},
        t1=1.0,
        ts=jnp.array([0.5, 1.0]),
        initial=jnp.array([0.2, 0.3]),
        solver=aslo.RungeKutta4(),
        stepsize_controller=diffrax.ConstantStepSize(),
        dt0=1e-2,
    )
    np.testing.assert_allclose(run.error("ASLO"), 0.0, atol=1e-8)
    np.testing.assert_allclose(run.hidden[:, 0], 1.3 - np.cos([0.5, 1.0]), atol=1e-9)
