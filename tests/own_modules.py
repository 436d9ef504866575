"""A plant, a controller and an observer as users write them."""

import equinox as eqx
import jax
import jax.numpy as jnp

import aslo_jax as aslo
from aslo_jax.control import AbstractController
from aslo_jax.plants import AbstractPlant


class Gyroscope(AbstractPlant):
    """A spinning body, `J w' = J w x w + u - d w`: a user's own plant, with a product of
    matrices, a remainder, an update in place and a map inside."""

    inertia: jax.Array
    damping: jax.Array

    def initial(self):
        return jnp.array([0.3, -2.0, 1.1])

    def vector_field(self, t, x, u):
        J = jnp.diag(self.inertia).at[0, 1].set(0.1).at[1, 0].set(0.1)
        momentum = J @ x
        drag = jax.vmap(lambda d, w: d * w * jnp.abs(w))(self.damping, x)
        phase = (t * 7.0) % (2 * jnp.pi)
        push = jnp.zeros(3).at[2].set(jnp.sin(phase))
        return self.divided(J, jnp.cross(momentum, x) + u + push - drag)

    def divided(self, J, torque):
        """By a product that is one: the vectors of an eigenvalue problem."""
        vectors = jnp.linalg.eigh(J)[1]
        return vectors @ vectors.T @ torque

    def output(self, x):
        return x[:2]

    def hidden(self, x):
        return x[2:]

    def no_input(self, y):
        return jnp.zeros(3)


class Network(AbstractController):
    """A small perceptron from the measurement to the torques."""

    net: eqx.nn.MLP

    def init(self, fed):
        return jnp.zeros(())

    def vector_field(self, t, state, fed):
        return jnp.tanh(fed[0]) - 0.1 * state

    def __call__(self, t, state, fed):
        return self.net(jnp.append(fed, state))


class Washout(aslo.AbstractObserver):
    """A user's own observer: a filter and a state with a limit."""

    rate: jax.Array

    def equations(self, F, u, y):
        F = F.using(aslo.LowPass(self.rate))
        rate = F.p(y[0], "rate")
        z = F.state("z", jnp.zeros(()), lambda z: jnp.clip(rate - z, -1.0, 1.0))
        return aslo.Estimate(z[None], jnp.ones(()), z > 0.5)


NET = eqx.nn.MLP(3, 3, 8, 2, activation=jnp.tanh, key=jax.random.key(4))


def spinning(sample):
    body = eqx.tree_at(
        lambda g: g.inertia, Gyroscope(jnp.ones(3), jnp.array([0.1, 0.2, 0.3])), sample
    )
    return aslo.Experiment(body, Network(NET), {"w": Washout(jnp.array(8.0))}, 1e-2)


class Solved(Gyroscope):
    """With systems of equations that vary from lane to lane."""

    def divided(self, J, torque):
        shifted = J @ J.T + jnp.eye(3)
        solved = jnp.linalg.inv(J) @ jnp.linalg.solve(shifted, torque)
        definite = jnp.linalg.cholesky(shifted)
        return J @ definite @ (definite.T @ solved)


class Spinner(Gyroscope):
    """Without an eigenvalue problem, which is not compiled."""

    def vector_field(self, t, x, u):
        J = jnp.diag(self.inertia).at[0, 1].set(0.1).at[1, 0].set(0.1)
        drag = jax.vmap(lambda d, w: d * w * jnp.abs(w))(self.damping, x)
        phase = (t * 7.0) % (2 * jnp.pi)
        push = jnp.zeros(3).at[2].set(jnp.sin(phase))
        return jnp.cross(J @ x, x) + u + push - drag


def spun(sample):
    body = Spinner(sample, jnp.array([0.1, 0.2, 0.3]))
    return aslo.Experiment(body, Network(NET), {"w": Washout(jnp.array(8.0))}, 1e-2)
