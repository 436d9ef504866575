"""The value of a function of a vector with its gradient, forward or in reverse."""

from collections.abc import Callable
from typing import Any

import jax
from jaxtyping import Array, Float

from .._typing import UsedMode

Objective = Callable[[Float[Array, " P"], Any], Float[Array, ""]]
Slope = Callable[[Float[Array, " P"], Any], tuple[Float[Array, ""], Float[Array, " P"]]]


def slope(objective: Objective, mode: UsedMode) -> Slope:
    """`objective(z, data)` with its gradient in z, compiled. Forward, all directions run
    beside one run of the values; that is the cheaper way while there are few of them."""

    def forward(z, data):
        def twice(z):
            value = objective(z, data)
            return value, value

        gradient, value = jax.jacfwd(twice, has_aux=True)(z)
        return value, gradient

    return jax.jit(forward if mode == "forward" else jax.value_and_grad(objective))


def with_gradient(slope: Slope) -> Objective:
    """The function of a [`slope`][], for whatever calls `jax.value_and_grad` on it, as the
    line searches of optax do: its derivative in reverse is the gradient of `slope`, however
    that was found. The gradient is not differentiable again."""

    @jax.custom_vjp
    def objective(z, data):
        return slope(z, data)[0]

    def forward(z, data):
        return slope(z, data)

    def backward(gradient, cotangent):
        return cotangent * gradient, None

    objective.defvjp(forward, backward)
    return objective
