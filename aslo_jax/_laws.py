"""What a state follows: laws, and filters, which are laws that signals are injected into.

A filter is used in state-space form, `X' = A X + v` with output `C X`, because the
Swapping Lemma needs its inner state `X` and not only its output. `v` is either an
injected signal, `v = B s`, or a product that the lemma asks for. The state of a
filtered signal of shape `(...)` has shape `(order, ...)`; a filter of order one may drop
the axis of length one.
"""

import abc
import math
from collections.abc import Callable
from typing import Any, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from ._checks import kind
from ._module import Module
from ._typing import PyTree, RealArray

__all__ = [
    "AbstractFilter",
    "AbstractLaw",
    "Hold",
    "Integrator",
    "Remembering",
    "check_filter",
    "held",
    "scalar_hold",
]


class AbstractLaw(Module):
    """How one named state evolves, in continuous and in sampled time."""

    @abc.abstractmethod
    def flow(self, X: PyTree, v: PyTree) -> PyTree:
        """The derivative `X'` at state `X` and drive `v` (units of `X` per second)."""

    @abc.abstractmethod
    def discretise(self, h: Float[Array, ""] | float) -> PyTree:
        """What `advance` needs for an interval of `h` seconds; computed once."""

    @abc.abstractmethod
    def advance(self, X: PyTree, v0: PyTree, v1: PyTree, coefficients: PyTree) -> PyTree:
        """The state after the interval, the drive being `v0` at its left end and `v1`
        at its right end."""

    def mapped(self, f: Callable[..., PyTree], *drives: PyTree) -> PyTree:
        """The first of the `drives` with `f` of the values of all for its value."""
        return f(*drives)


class Integrator(AbstractLaw):
    """`X' = v`: any state that is not a filter. Sampled by the trapezoidal rule, which
    is Heun's method when `v` depends on `X`."""

    def flow(self, X: PyTree, v: PyTree) -> PyTree:
        del X
        return v

    def discretise(self, h: RealArray | float) -> PyTree:
        return h

    def advance(self, X: PyTree, v0: PyTree, v1: PyTree, coefficients: PyTree) -> PyTree:
        # Time may be double where the state is single; a state keeps its precision.
        half = jnp.asarray(0.5 * coefficients, jnp.result_type(X))
        return X + half * (v0 + v1)


class AbstractFilter(AbstractLaw):
    """A proper, stable, linear time-invariant filter `F(s) = D + C (sI - A)^-1 B`.

    `advance` is exact for a drive that is linear over the interval (first-order hold),
    and so for a held drive too.
    """

    @property
    @abc.abstractmethod
    def strictly_proper(self) -> bool:
        """Whether `D = 0`, so that `pF` is proper."""

    @abc.abstractmethod
    def inject(self, s: Float[Array, "..."] | float) -> Array:
        """`B s`: the drive of a filtered signal, shape `(order, ...)`."""

    @abc.abstractmethod
    def output(self, X: Array) -> Float[Array, "..."]:
        """`C X`: the filtered signal without feedthrough."""

    @abc.abstractmethod
    def feedthrough(self, s: Float[Array, "..."] | float) -> Float[Array, "..."] | float:
        """`D s`."""

    @abc.abstractmethod
    def equilibrium(self, s: Float[Array, "..."] | float) -> Array:
        """`-A^-1 B s`: the state at which a constant signal `s` has settled."""

    @property
    def varies(self) -> bool:
        """Whether A is another one at another instant; a pass knows what it is now."""
        return False

    @property
    def derivative(self) -> "AbstractFilter":
        """The filter whose flow, with `s` injected, is the filtered derivative of `s`."""
        return self

    def following(
        self, drive: PyTree, start: PyTree | None
    ) -> tuple[AbstractLaw, PyTree, PyTree]:
        """The law of a state of the filter under `drive`, a value or a function of the
        state, and both as that law takes them; it starts from zero by default."""
        return self, drive, start


def check_filter(filter: Any) -> None:
    """Refuse what is no filter, a rate for instance."""
    kind("filter", filter, AbstractFilter, hint="a filter such as `LowPass(20.0)`")


class Hold(NamedTuple):
    """First-order hold: `X1 = decay X0 + left v0 + right v1`.

    In single precision also what is `lost`, `1 - decay` with all of its digits: a decay
    next to 1 has hardly any of them, and a filter of 0.3 rad/s at 20 kHz would be wrong
    by 1e-3 at rest. `X1 = X0 + (left v0 + right v1 - lost X0)` then.
    """

    decay: Array
    left: Array
    right: Array
    lost: Array | None = None


def held(hold: Hold, X: Any, times: Callable[[Array, Any], Any], v0: Any, v1: Any) -> Any:
    """The state after the interval of a hold; `times` multiplies by a coefficient."""
    driven = times(hold.left, v0), times(hold.right, v1)
    if hold.lost is None:
        return times(hold.decay, X) + driven[0] + driven[1]
    return X + (driven[0] + driven[1] - times(hold.lost, X))


class Remembering(NamedTuple):
    """The `hold` of a filter, and what it remembers after an interval, each of shape `()`:
    its `slowest` part by itself, and `whole` by all its time constants together."""

    hold: Any
    slowest: Array
    whole: Array


def scalar_hold(rate: Array, h: Array) -> Hold:
    # With v = rate h and p = (1 - exp(-v))/v the weights are h (p - a)/v and
    # h (1 - p)/v. Both lose their digits to cancellation as v -> 0, hence the series of
    # phi2 = (1 - p)/v below v = 1/2, whose first omitted term is below 1e-17.
    v = rate * h
    small = v < 0.5
    v_small = jnp.where(small, v, 0.0)
    phi2 = jnp.zeros_like(v_small)
    for k in reversed(range(14)):
        phi2 = 1.0 / math.factorial(k + 2) - v_small * phi2
    phi1 = 1.0 - v_small * phi2
    v_large = jnp.where(small, 1.0, v)
    p = -jnp.expm1(-v_large) / v_large
    left = jnp.where(small, phi1 - phi2, (p - jnp.exp(-v_large)) / v_large)
    right = jnp.where(small, phi2, (1.0 - p) / v_large)
    lost = v * jnp.where(small, phi1, p) if v.dtype == jnp.float32 else None
    return Hold(jnp.exp(-v), h * left, h * right, lost)
