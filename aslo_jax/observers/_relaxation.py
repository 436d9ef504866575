"""What the sampled steps of stiff corrections share."""

import jax.numpy as jnp
from jaxtyping import Array, Float


def relaxation(rate: Float[Array, ""], h: Float[Array, ""]) -> Float[Array, ""]:
    """`(1 - exp(-rate h)) / rate`, in seconds: how long a step of `h` seconds towards the
    target of `x' = -rate (x - target)` lasts, measured at its first speed. `h` at rate 0.
    """
    v = rate * h
    small = v < 1e-4
    v_large = jnp.where(small, 1.0, v)
    series = 1.0 - v * (0.5 - v / 6.0)
    return h * jnp.where(small, series, -jnp.expm1(-v_large) / v_large)
