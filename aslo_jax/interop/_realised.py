"""The matrices of functions that are linear, proved by their operations."""

from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend import core
from jax.flatten_util import ravel_pytree

from .._laws import AbstractFilter
from .._typing import PyTree
from ..observers import AbstractObserver

__all__ = ["matrices_of_filter", "matrices_of_observer"]

# What calls a function that is looked into; of others every result is taken to depend on
# every argument.
CALLS = ("jit", "pjit", "closed_call", "core_call", "custom_jvp_call", "custom_vjp_call")


def matrices_of_filter(law: AbstractFilter) -> tuple[np.ndarray, ...]:
    """A, B, C and D of a filter of one signal.

    **Raises:** `ValueError` for one whose rate varies, or that is not linear."""
    if law.varies:
        raise ValueError(
            "Argument `module` must have a constant rate, but that of this "
            f"{type(law).__name__} varies; give one at an operating point, such as "
            "`LowPass(number)`."
        )
    start = jnp.zeros_like(law.inject(jnp.zeros(())))

    def both(X: Any, s: Any) -> tuple[Any, Any]:
        return law.flow(X, law.inject(s)), law.output(X) + law.feedthrough(s)

    return _matrices(both, start, jnp.zeros(()), type(law).__name__)


def matrices_of_observer(
    observer: AbstractObserver, u: PyTree, y: PyTree
) -> tuple[np.ndarray, ...]:
    """A, B, C and D of an observer in continuous time, from u and then y to the value of
    its estimate; `u` and `y` are examples.

    **Raises:** `ValueError` for one that is not linear, or of several estimates."""
    state, t = observer.init(y, u), jnp.zeros(())
    name = type(observer).__name__

    def both(states: Any, given: Any) -> tuple[Any, Any]:
        now = type(state)(states, state.y, state.gap)
        rates = observer.vector_field(t, now, *given).states
        return rates, value_of(observer.estimate(t, now, *given), name)

    zero = jax.tree.map(jnp.zeros_like, (u, y))
    return _matrices(both, jax.tree.map(jnp.zeros_like, state.states), zero, name)


def value_of(estimate: Any, name: str) -> Any:
    """The value of an estimate.

    **Raises:** `ValueError` for several estimates."""
    if not isinstance(
        getattr(estimate, "value", None), jax.Array | jax.ShapeDtypeStruct | np.ndarray
    ):
        raise ValueError(
            "Argument `observer` must have one vector as its estimate, but that of "
            f"{name} is of several; take one of them."
        )
    return estimate.value


def _matrices(
    both: Callable[[Any, Any], tuple[Any, Any]], state: PyTree, given: PyTree, name: str
) -> tuple[np.ndarray, ...]:
    """Of what puts out a vector or a number, without the states that it does not depend on,
    leaf by leaf."""
    leaves, tree = jax.tree.flatten(state)
    sizes = [x.size for x in leaves]
    edges = np.cumsum([0, *sizes])
    zero, unravel = ravel_pytree((state, given))

    def flat(x: Any) -> list[Any]:
        """The output, and the rate of every leaf."""
        rates, out = both(*unravel(x))
        return [jnp.ravel(x) for x in (out, *tree.flatten_up_to(rates))]

    def pushed(x: Any, along: Any) -> Any:
        return jax.jvp(flat, (x,), (along,))[1]

    bent = _depending(jax.make_jaxpr(pushed)(zero, zero).jaxpr, [True, False])
    offsets, slopes = flat(zero), [np.asarray(x) for x in jax.jacfwd(flat)(zero)]
    wanted, kept = [0], set[int]()  # 0 for the output, k + 1 for the leaf k
    while wanted:
        row = wanted.pop()
        if bent[row]:
            raise ValueError(
                f"Argument `module` must be linear, but this {name} is not: in its "
                "equations are products or conditions of its state and inputs; `to_nlsys` "
                "takes it as it is."
            )
        if np.any(offsets[row]):
            raise ValueError(
                f"Argument `module` must be linear, but this {name} does not stay at zero "
                "where its state and its inputs are; `to_nlsys` takes it as it is."
            )
        for k in range(len(leaves)):
            if k not in kept and slopes[row][:, edges[k] : edges[k + 1]].any():
                kept.add(k)
                wanted.append(k + 1)
    columns = [j for k in sorted(kept) for j in range(edges[k], edges[k + 1])]
    of_state = np.concatenate(
        [np.zeros((0, zero.size))] + [slopes[k + 1] for k in sorted(kept)]
    )
    n = edges[-1]
    return of_state[:, columns], of_state[:, n:], slopes[0][:, columns], slopes[0][:, n:]


def _depending(jaxpr: Any, given: Sequence[bool]) -> list[bool]:
    """Which results may depend on the arguments that are marked."""
    marked = {v for v, mark in zip(jaxpr.invars, given, strict=True) if mark}
    is_marked = lambda x: not isinstance(x, core.Literal) and x in marked
    for equation in jaxpr.eqns:
        marks = [is_marked(x) for x in equation.invars]
        inner = equation.params.get("jaxpr", equation.params.get("call_jaxpr"))
        if equation.primitive.name in CALLS and inner is not None:
            found = _depending(getattr(inner, "jaxpr", inner), marks)
        else:
            found = [any(marks)] * len(equation.outvars)
        marked |= {v for v, mark in zip(equation.outvars, found, strict=True) if mark}
    return [is_marked(v) for v in jaxpr.outvars]
