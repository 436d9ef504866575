"""Clarke's and Park's transformation, and their inverses.

The space vector of three phases is

    x_s = x_alpha + j x_beta = 2/3 (x_a + x_b e^(j 2 pi/3) + x_c e^(j 4 pi/3)),

amplitude-invariant: balanced phases of the amplitude X have `|x_s| = X`. With
`power_invariant` the factor is sqrt(2/3), so that `u . i` is the power of the phases, where
it is else 2/3 of it. The mean of the phases, the zero sequence, is in neither. In a frame
that has turned by an angle theta, `x_d + j x_q = (x_alpha + j x_beta) e^(-j theta)`: the d
axis points along theta, and q leads d by 90 degrees. motulator has the same conventions.

Every function takes NumPy or JAX arrays (what it is given, it returns) with the phases, or
the two components, along the last axis and any axes in front, and refuses other sizes with
a `ValueError`.
"""

import math
from typing import Any

import numpy as np
from jaxtyping import Array, Float

Values = Float[np.ndarray, "*N _"] | Float[Array, "*N _"]
Angles = float | Float[np.ndarray, "..."] | Float[Array, "..."]

ROOT3 = math.sqrt(3.0)
POWER = math.sqrt(1.5)  # from the amplitude-invariant to the power-invariant vector


def clarke(phases: Values, *, power_invariant: bool = False) -> Values:
    """The components alpha and beta of `phases`, shape `(..., 2)`.

    - `phases`: a, b, c, shape `(..., 3)`; or a and b alone, shape `(..., 2)`, of three that
      sum to zero;
    - `power_invariant`: the factor sqrt(2/3) in place of 2/3.
    """
    count = _size("phases", phases, (2, 3))
    a, b = phases[..., 0], phases[..., 1]
    if count == 3:
        c = phases[..., 2]
        alpha, beta = (2.0 * a - b - c) / 3.0, (b - c) / ROOT3
    else:
        alpha, beta = a, (a + 2.0 * b) / ROOT3
    return _scaled(_pair(alpha, beta), POWER if power_invariant else 1.0)


def inverse_clarke(vector: Values, *, power_invariant: bool = False) -> Values:
    """The phases a, b, c, shape `(..., 3)`, whose sum is zero.

    - `vector`: alpha and beta, shape `(..., 2)`;
    - `power_invariant`: whether `vector` is.
    """
    _size("vector", vector, (2,))
    vector = _scaled(vector, 1.0 / POWER if power_invariant else 1.0)
    alpha, beta = vector[..., 0], vector[..., 1]
    across = 0.5 * ROOT3 * beta
    return _pair(alpha, across - 0.5 * alpha, -across - 0.5 * alpha)


def park(vector: Values, angle: Angles) -> Values:
    """The components d and q, shape `(..., 2)`, in a frame that has turned by `angle`.

    - `vector`: alpha and beta, shape `(..., 2)`;
    - `angle`: of the d axis (rad, electrical), shape `(...)` or a number.
    """
    return inverse_park(vector, -angle)


def inverse_park(vector: Values, angle: Angles) -> Values:
    """The components alpha and beta, shape `(..., 2)`, of a vector in a frame that has
    turned by `angle`.

    - `vector`: d and q, shape `(..., 2)`;
    - `angle`: of the d axis (rad, electrical), shape `(...)` or a number.
    """
    _size("vector", vector, (2,))
    library = _library(vector, angle)
    c, s = library.cos(angle), library.sin(angle)
    x, y = vector[..., 0], vector[..., 1]
    return _pair(c * x - s * y, s * x + c * y)


def _size(name: str, array: Any, sizes: tuple[int, ...]) -> int:
    shape = getattr(array, "shape", ())
    if not shape or shape[-1] not in sizes:
        wanted = " or ".join(map(str, sizes))
        raise ValueError(
            f"Argument `{name}` must be an array with {wanted} entries along its last "
            f"axis, but its shape is {shape}."
        )
    return shape[-1]


def _scaled(vector: Values, factor: float) -> Values:
    return vector if factor == 1.0 else factor * vector


def _library(*arrays: Any) -> Any:
    """NumPy, unless one of the `arrays` is JAX's, which is imported only then."""
    if all(isinstance(x, (float, int, np.ndarray, np.generic)) for x in arrays):
        return np
    import jax.numpy as jnp

    return jnp


def _pair(*components: Any) -> Any:
    return _library(*components).stack(components, axis=-1)
