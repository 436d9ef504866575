"""The stationary error of a linear observer under white noise, in closed form."""

import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float

from ..observers import AbstractObserver, ObserverState

Matrices = tuple[Array, Array, Array, Array]


def linearised(observer: AbstractObserver) -> Matrices:
    """A, B, C, D of `X' = A X + B (u, y)`, estimate `C X + D (u, y)`, of a linear observer
    of scalar u and y: the derivatives of its `vector_field` and `estimate` at the origin.
    X are all its states, one after the other."""
    zero = jnp.zeros(())
    states, unravel = ravel_pytree(observer.init(zero, zero).states)

    def state(X):
        return ObserverState(unravel(X), zero)

    def flow(X, w):
        return ravel_pytree(observer.vector_field(zero, state(X), w[0], w[1]).states)[0]

    def estimate(X, w):
        return observer.estimate(zero, state(X), w[0], w[1]).value

    w = jnp.zeros(2)
    A, B = jax.jacfwd(flow, (0, 1))(states, w)
    C, D = jax.jacfwd(estimate, (0, 1))(states, w)
    return A, B, C, D


def lyapunov(A: Float[Array, "k k"], Q: Float[Array, "k k"]) -> Float[Array, "k k"]:
    """P of `A P + P A' + Q = 0`, with derivatives, for a matrix A of few rows."""
    eye = jnp.eye(A.shape[0], dtype=A.dtype)
    P = jnp.linalg.solve(jnp.kron(A, eye) + jnp.kron(eye, A), -Q.reshape(-1))
    return P.reshape(A.shape)


def stationary_variance(
    observer: AbstractObserver, input_noise: float, measurement_noise: float
) -> Float[Array, ""]:
    """The variance of the first entry's error, long after the start, of a linear `observer`
    of scalar u and y, under white noise of two-sided intensities `input_noise` W on u (unit
    squared times second) and `measurement_noise` V on y. Differentiable in the observer.

    The observer must be linear as it stands: with `start="paper"`, which is what any start
    settles to, with `guard=None`, and an [`Asymptotic`][] with an `initial` estimate. An
    estimate with direct feed-through of y, as the bare algebraic one, has no finite
    variance; the result is then infinite.

    Noise on the input of the plant has the same effect as noise on u with its sign changed,
    so W covers both.

    Source: theory, section 4.
    """
    A, B, C, D = linearised(observer)
    noise = jnp.diag(jnp.array([input_noise, measurement_noise], B.dtype))
    P = lyapunov(A, B @ noise @ B.T)
    through = jnp.sum(jnp.abs(D[0]) * jnp.diag(noise)) > 1e-9
    return jnp.where(through, jnp.inf, (C @ P @ C.T)[0, 0])
