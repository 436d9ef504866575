"""Observers and a controller of a user's own, exported."""

import jax
import jax.numpy as jnp
import numpy as np

import aslo_jax as aslo
from aslo_jax.control import AbstractController


class Restrained(aslo.AbstractObserver):
    """With a state that has 12 entries and a full matrix."""

    A: jax.Array

    def equations(self, F, u, y):
        x = F.state("x", jnp.zeros(12), lambda x: self.A @ x + y[0])
        P = F.state("P", jnp.eye(12), lambda P: self.A @ P + P @ self.A.T - P @ P.T)
        return aslo.Estimate(jnp.tanh(P @ x), jnp.ones(()), x[0] > 0.0)


class Thirty(aslo.AbstractObserver):
    A: jax.Array

    def equations(self, F, u, y):
        x = F.state("x", jnp.zeros(30), lambda x: self.A @ x + y[0])
        return aslo.Estimate(x, jnp.ones(()), x[0] > 1.0)


class Damped(AbstractController):
    """A proportional and integral controller with a limit, that looks at the time."""

    gain: jax.Array

    def init(self, fed):
        return jnp.zeros(2)

    def vector_field(self, t, state, fed):
        return fed - 0.1 * state

    def __call__(self, t, state, fed):
        wanted = jnp.array([1.0, jnp.sin(20.0 * t)])
        return jnp.clip(self.gain * (wanted - fed) + 3.0 * state, -5.0, 5.0)


def restrained_observer() -> Restrained:
    A = np.random.default_rng(0).normal(size=(12, 12)) * 0.3 - 2.0 * np.eye(12)
    return Restrained(jnp.asarray(A))


def restrained() -> aslo.Exported:
    one = np.zeros(1)
    settings = dict(interval=0.01, u=one, y=one, prefix="full")
    return aslo.export_c(restrained_observer(), **settings)


def thirty() -> aslo.Exported:
    A = np.random.default_rng(0).normal(size=(30, 30)) - 6.0 * np.eye(30)
    settings = dict(interval=1e-3, u=np.zeros(1), y=np.zeros(1), dtype="float32")
    return aslo.export_c(Thirty(jnp.asarray(A)), prefix="thirty", **settings)


def controller() -> aslo.Exported:
    settings = dict(interval=0.01, y=np.zeros(2), prefix="pi")
    return aslo.export_c(Damped(jnp.asarray(2.0)), **settings)
