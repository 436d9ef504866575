"""Plant, controller, observers and disturbances in continuous time by the fused engine."""

import functools
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..._checks import is_concrete
from ..._frontend.lower import NotFusible
from ..._interconnection import Interconnection, Simulation
from ..._typing import PyTree
from .._fused.refusal import notice, refusal
from .simulation import Plan, simulated
from .stepper import DIVERGED, ENDED
from .system import System


def cosimulated(
    loop: Interconnection,
    x0: PyTree,
    ends: tuple[float, float],
    ts: np.ndarray,
    tolerances: tuple[float, float],
    most: tuple[int, int | None],
    engine: str,
) -> Simulation[Any] | None:
    """From the plant's state x0, between two instants (s), saved at `ts`, ascending, by at
    most so many steps and threads; None with the engine `"auto"` where that fails."""
    dtype = np.dtype(jnp.result_type(float))
    x0 = jax.tree.map(jnp.asarray, x0)
    arrays, rest = eqx.partition((loop, x0), eqx.is_array)

    def begun(arrays):
        loop, x0 = eqx.combine(arrays, rest)
        return loop.init(jnp.asarray(ends[0], dtype), x0)

    def rate(arrays, t, state):
        return eqx.combine(arrays, rest)[0].vector_field(t, state, None)

    def record(arrays, t, state):
        return eqx.combine(arrays, rest)[0].record(t, state, None)

    jumps = np.empty(0) if loop.span is None else loop.span.jumps
    plan = Plan(float(ends[0]), float(ends[1]), ts.astype(dtype), jumps, *tolerances, *most)
    try:
        found, outcome = simulated(System(begun, rate, record), arrays, rest, plan)
    except NotImplementedError:  # a derivative
        raise
    except Exception as error:
        jax.eval_shape(rate, arrays, plan.ts[0], begun(arrays))  # an error of a part itself
        refused = refusal(error)
        refused = NotFusible(str(refused).replace('"scan"', '"diffrax"'))
        if engine != "auto":
            raise refused from error
        notice(f'Running with engine="diffrax". {refused}')
        return None
    if is_concrete(found.t, outcome.code):  # without XLA
        result = _results(np, np.asarray(found.t), np.asarray(outcome.code))
    else:
        result = _traced_results(found.t, outcome.code)
    return eqx.tree_at(
        lambda s: (s.t, s.result),
        found,
        (jnp.asarray(plan.ts), jnp.asarray(result)),
        is_leaf=lambda x: x is None,
    )


def _results(xp: Any, t: Any, code: Any) -> Any:
    """The code of `Simulation.result` for each row, by NumPy or JAX: zero where the instant
    t has been reached."""
    code = xp.where(code == DIVERGED, 2, xp.where(code == ENDED, 0, 1))
    return xp.where(xp.isfinite(t), 0, code[..., None])


_traced_results = jax.jit(functools.partial(_results, jnp))
