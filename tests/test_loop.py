"""A state that feeds others which drive it: `F.loop`, against a matrix exponential."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg

import aslo_jax as aslo
from aslo_jax.filters import Integrator


class Loop(aslo.AbstractObserver):
    """`x' = u - 2 x - 5 F[x]` with x measured by nobody: the drive of x is made of a
    filter of x."""

    closed: bool = eqx.field(static=True, default=True)

    def equations(self, F, u, y):
        F = F.using(aslo.LowPass(3.0))
        x, close = F.loop(Integrator(), jnp.asarray(1.0), "x")
        w = F(x, "w")
        if self.closed:
            x = close(lambda x: u - 2.0 * x - 5.0 * w)
        return aslo.Estimate(jnp.stack([x, w]), jnp.ones(()), jnp.asarray(False))


class Direct(aslo.AbstractObserver):
    """The same without a filter between, where `F.state` does."""

    loop: bool = eqx.field(static=True)

    def equations(self, F, u, y):
        def rate(x):
            return u - 2.0 * x

        if self.loop:
            x = F.loop(Integrator(), jnp.asarray(1.0), "x")[1](rate)
        else:
            x = F.state("x", jnp.asarray(1.0), rate)
        return aslo.Estimate(x[None], jnp.ones(()), jnp.asarray(False))


A = np.array([[-2.0, -5.0], [3.0, -3.0]])


def test_order_two():
    at_rest = np.linalg.solve(-A, [0.7, 0.0])
    exact = at_rest + scipy.linalg.expm(A) @ (np.array([1.0, 0.0]) - at_rest)
    errors = []
    for n in (25, 50, 100, 200):
        t = np.linspace(0.0, 1.0, n + 1)
        found = aslo.replay(Loop(), t, jnp.full(n + 1, 0.7), jnp.zeros(n + 1)).value[-1]
        errors.append(np.abs(found - exact).max())
    order = np.log2(np.array(errors[:-1]) / np.array(errors[1:]))
    assert ((order > 1.8) & (order < 2.2)).all(), errors
    assert errors[-1] < 1e-4


def test_the_vector_field_is_that_of_the_matrix():
    observer, zero = Loop(), jnp.zeros(())
    state = aslo.ObserverState({"x": jnp.asarray(0.3), "w": jnp.asarray(-0.6)}, zero)
    rate = observer.vector_field(zero, state, jnp.asarray(0.7), zero).states
    expected = A @ [0.3, -0.6] + [0.7, 0.0]
    np.testing.assert_allclose([rate["x"], rate["w"]], expected, rtol=1e-14)


def test_without_other_signals_it_is_a_plain_state():
    t, u = np.linspace(0.0, 1.0, 11), jnp.linspace(0.2, 1.0, 11)
    a, b = (aslo.replay(Direct(loop), t, u, 0 * u).value for loop in (True, False))
    np.testing.assert_array_equal(a, b)
    assert jnp.abs(a[-1] - a[0]) > 0.1


def test_its_name_is_taken():
    class Twice(aslo.AbstractObserver):
        def equations(self, F, u, y):
            F.loop(Integrator(), jnp.zeros(()), "x")
            F.state("x", jnp.zeros(()), 0.0 * y)

    with pytest.raises(ValueError, match="the state `x` is defined twice"):
        Twice().init(jnp.zeros(()))
