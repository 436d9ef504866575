"""Integration to 1e-12 by SciPy. A test that integrates a system once pays for compiling
its right-hand side alone; an adaptive solve in JAX takes several times as long to compile,
and is tested for itself in `test_simulate`."""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy.integrate
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float, PyTree

import aslo_jax as aslo

STEPS = 100_000  # at most, from one instant to the next


def integrated(
    initial: Callable[[PyTree], PyTree],
    rate: Callable[[PyTree, Array, PyTree], PyTree],
    record: Callable[[PyTree, Array, PyTree], PyTree],
    given: PyTree,
    ts: Float[Array, " N"],
    rtol: float = 1e-12,
    atol: float = 1e-20,
) -> PyTree:
    """`record(given, t, x)` at `ts`, the axis that comes first, of `x' = rate(given, t, x)`
    from `initial(given)` at t = 0.

    The solver steps to each of `ts`, since dense output is less accurate than the steps.
    The three functions belong to a module, and `given` has what varies from call to call:
    the arrays in it are arguments, so that the next one of its kind is not compiled again.
    """
    leaves, structure = jax.tree.flatten(given)
    arrays = [jnp.asarray(x) for x in leaves if eqx.is_inexact_array_like(x)]
    rest = tuple(None if eqx.is_inexact_array_like(x) else x for x in leaves)
    start, slope, records = _compiled(initial, rate, record, structure, rest)
    x, t, step, found = np.asarray(start(arrays)), 0.0, None, []
    for end in np.asarray(ts):
        if end > t:
            first = None if step is None else min(step, end - t)
            solver = scipy.integrate.DOP853(
                lambda t, x: np.asarray(slope(arrays, t, x)),
                *(t, x, end),
                rtol=rtol,
                atol=atol,
                first_step=first,
            )
            for _ in range(STEPS):
                step = solver.h_abs
                solver.step()
                if solver.status != "running":
                    break
            assert solver.status == "finished", solver.status
            t, x = end, solver.y
        found.append(x)
    return records(arrays, jnp.asarray(ts), jnp.asarray(found))


class Run(NamedTuple):
    """What [`simulated`][] returns, with a leading axis of the instants `t` (s)."""

    t: Array
    x: PyTree
    hidden: Array
    estimates: dict[str, Any]

    def error(self, name):
        return self.estimates[name].value - self.hidden


def simulated(plant, controller, observers, initial, ts, rtol=1e-12, atol=1e-14) -> Run:
    """The closed loop of `aslo.simulate` without disturbances, from y to u, with observers
    beside it."""
    given = plant, controller, observers, initial
    return integrated(_start, _rate, _record, given, ts, rtol, atol)


def _signals(given, t, x):
    y = given[0].output(x["plant"])
    return y, jax.tree.map(jnp.asarray, given[1](t, x["controller"], y))


def _start(given):
    plant, controller, observers, initial = given
    x = {"plant": initial, "controller": controller.init(plant.output(initial))}
    y, u = _signals(given, jnp.zeros(()), x)
    return x | {"observers": {k: o.init(y, u).states for k, o in observers.items()}}


def _rate(given, t, x):
    plant, controller, observers, _ = given
    y, u = _signals(given, t, x)
    return {
        "plant": plant.vector_field(t, x["plant"], u),
        "controller": controller.vector_field(t, x["controller"], y),
        "observers": {
            k: o.vector_field(t, aslo.ObserverState(x["observers"][k], y), u, y).states
            for k, o in observers.items()
        },
    }


def _record(given, t, x):
    plant, _, observers, _ = given
    y, u = _signals(given, t, x)
    estimates = {
        k: o.estimate(t, aslo.ObserverState(x["observers"][k], y), u, y)
        for k, o in observers.items()
    }
    return Run(t, x["plant"], plant.hidden(x["plant"]), estimates)


@functools.lru_cache(32)
def _compiled(initial, rate, record, structure, rest):
    backs = []  # from a vector to the states, as of the last trace

    def given(arrays):
        left = iter(arrays)
        leaves = [next(left) if x is None else x for x in rest]
        return jax.tree.unflatten(structure, leaves)

    @jax.jit
    def start(arrays):
        x, back = ravel_pytree(initial(given(arrays)))
        backs.append(back)
        return x

    @jax.jit
    def slope(arrays, t, x):
        return ravel_pytree(rate(given(arrays), t, backs[-1](x)))[0]

    @jax.jit
    def records(arrays, ts, xs):
        at = lambda t, x: record(given(arrays), t, backs[-1](x))
        return jax.vmap(at)(ts, xs)

    return start, slope, records
