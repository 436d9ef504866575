"""Linear systems as objects of python-control and SciPy, and from these."""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from numpy.typing import ArrayLike

from .._checks import real
from .._extras import require
from .._laws import AbstractFilter
from .._typing import PyTree, RealArray
from ..observers import AbstractObserver, ReducedLuenberger, SteadyStateKalman
from ..plants import AbstractPlant
from ._realised import matrices_of_filter, matrices_of_observer

__all__ = ["LinearPlant", "kalman", "luenberger", "plant", "to_control", "to_scipy"]


class LinearPlant(AbstractPlant):
    """`x' = A x + B u, y = C x`; the hidden part is x.

    - `A`, shape `(n, n)`, in 1/s; `B`, shape `(n, m)`; `C`, shape `(p, n)`.
    """

    A: Float[Array, "n n"] = eqx.field(converter=real)
    B: Float[Array, "n m"] = eqx.field(converter=real)
    C: Float[Array, "p n"] = eqx.field(converter=real)

    def initial(self) -> PyTree:
        return jnp.zeros(self.A.shape[0])

    def vector_field(self, t: RealArray, x: PyTree, u: PyTree) -> PyTree:
        del t
        return self.A @ x + self.B @ u

    def output(self, x: PyTree) -> PyTree:
        return self.C @ x

    def hidden(self, x: PyTree) -> RealArray:
        return x

    def no_input(self, y: PyTree) -> PyTree:
        del y
        return jnp.zeros(self.B.shape[1])


def plant(system: Any) -> LinearPlant:
    """A plant from a `system`: a `StateSpace` of python-control or SciPy.

    **Raises:** `ValueError` for a system in discrete time, with feed-through, or that has
    no matrices.
    """
    return LinearPlant(*_matrices(system))


def kalman(
    system: Any,
    input_intensity: ArrayLike | float,
    measurement_intensity: ArrayLike | float,
) -> SteadyStateKalman:
    """The steady-state Kalman filter of a `StateSpace`, by [`SteadyStateKalman.design`][].

    - `system`: as in [`plant`][];
    - `input_intensity`, `measurement_intensity`: two-sided, of white noise on the input and
      on the measurement, shapes `(m, m)` and `(p, p)` (unit squared times second).

    **Raises:** `ValueError` as [`plant`][].
    """
    matrices = _matrices(system)
    return SteadyStateKalman.design(*matrices, input_intensity, measurement_intensity)


def luenberger(system: Any, poles: ArrayLike) -> ReducedLuenberger:
    """The reduced-order Luenberger observer of a `system` as in [`plant`][] whose output is
    its first p states, with the `poles` of its error, shape `(n - p,)` (rad/s).

    **Raises:** `ValueError` as [`plant`][], and for an output that is not the first states.
    """
    import scipy.signal

    A, B, C = _matrices(system)
    p, n = C.shape
    if p >= n or not np.array_equal(C, np.eye(p, n)):
        raise ValueError(
            "Argument `system` must have the first of its states as output, C = [I 0], but "
            f"has C = {C.tolist()}; change its coordinates."
        )
    placed: Any = scipy.signal.place_poles(A[p:, p:].T, A[:p, p:].T, np.asarray(poles))
    return ReducedLuenberger(A, B, placed.gain_matrix.T)


def to_scipy(module: Any, *, u: Any = None, y: Any = None) -> Any:
    """A linear `module`, an observer, a filter or a plant, as a `scipy.signal.StateSpace`.

    The inputs of an observer are those of u and then those of y, its outputs the value of
    its estimate; the state of a [`ReducedLuenberger`][] is its inner one, without `gain y`.
    An observer begins with its first sample, and a `StateSpace` at zero.

    - `u`, `y`: examples of the input and the measurement of an observer that does not
      declare them, vectors of which the shape matters.

    **Raises:** `ValueError` for what is not linear, also a filter whose rate varies, or has
    several estimates.
    """
    import scipy.signal

    return scipy.signal.StateSpace(*_realisation(module, u, y)[:4])


def to_control(module: Any, *, u: Any = None, y: Any = None) -> Any:
    """A `module` of [`to_scipy`][] as a `control.StateSpace`, for Bode plots and poles.

    Its signals are named `u0`, `y0`, `value0` and so on (of a filter `s` and `filtered`; of
    a plant `u0` and `y0`).

    - `u`, `y`: as of [`to_scipy`][].

    **Raises:** `ValueError` as [`to_scipy`][]; `ImportError` without python-control.
    """
    control = require("control", "interop")
    *matrices, m = _realisation(module, u, y)
    D = matrices[3]
    if isinstance(module, AbstractFilter):
        inputs, outputs = ["s"], ["filtered"]
    elif isinstance(module, LinearPlant):
        inputs, outputs = _named("u", m), _named("y", D.shape[0])
    else:
        inputs = _named("u", m) + _named("y", D.shape[1] - m)
        outputs = _named("value", D.shape[0])
    return control.ss(*matrices, inputs=inputs, outputs=outputs)


def _named(name: str, count: int) -> list[str]:
    return [f"{name}{k}" for k in range(count)]


def _matrices(system: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    if not all(hasattr(system, name) for name in "ABCD"):
        raise ValueError(
            "Argument `system` must be a `StateSpace` of python-control or SciPy, but is a "
            f"`{type(system).__name__}`."
        )
    if system.dt not in (None, 0):
        raise ValueError(
            f"Argument `system` must be in continuous time, but has dt = {system.dt}."
        )
    A, B, C, D = (np.asarray(getattr(system, name), float) for name in "ABCD")
    if D.any():
        raise ValueError("Argument `system` must have no feed-through, but D is not zero.")
    return A, B, C


def _realisation(module: Any, u: Any, y: Any) -> tuple[Any, ...]:
    """A, B, C and D, and how many of the inputs are those of u."""
    if isinstance(module, SteadyStateKalman):
        A, B, C, L = (np.asarray(x) for x in (module.A, module.B, module.C, module.gain))
        out = np.eye(len(A)) if module.select is None else np.asarray(module.select)
        given = np.hstack([B, L])
        return A - L @ C, given, out, np.zeros((len(out), given.shape[1])), B.shape[1]
    if isinstance(module, ReducedLuenberger):
        A, B, L = (np.asarray(x) for x in (module.A, module.B, module.gain))
        p = L.shape[1]
        error = A[p:, p:] - L @ A[:p, p:]
        of_y = error @ L + A[p:, :p] - L @ A[:p, :p]
        given = np.hstack([B[p:] - L @ B[:p], of_y])
        through = np.hstack([np.zeros((len(L), B.shape[1])), L])
        return error, given, np.eye(len(L)), through, B.shape[1]
    if isinstance(module, AbstractFilter):
        return *matrices_of_filter(module), 0
    if isinstance(module, LinearPlant):
        A, B, C = (np.asarray(x) for x in (module.A, module.B, module.C))
        return A, B, C, np.zeros((len(C), B.shape[1])), B.shape[1]
    if isinstance(module, AbstractObserver):
        given = {"u": u, "y": y}
        for name, example in given.items():
            shape = getattr(module, "signals", {}).get(name)
            if example is None and (shape is None or None in shape):
                raise ValueError(
                    f"Argument `{name}` must be given: an example of the input `{name}`, "
                    "of which only the shape matters, since the observer does not "
                    "declare it."
                )
            given[name] = jnp.zeros(shape) if example is None else jnp.asarray(example)
        return *matrices_of_observer(module, **given), given["u"].size
    raise ValueError(
        "Argument `module` must be an observer, a filter or a `LinearPlant`, but is a "
        f"`{type(module).__name__}`."
    )
