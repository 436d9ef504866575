"""Continuous co-simulation: plant, controller, observers and disturbances in one solve."""

from collections.abc import Callable, Mapping
from typing import Any

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from . import _choices
from ._checks import counted, function, is_concrete, kind, number, one_of, positive, whole
from ._interconnection import Interconnection, Simulation
from ._jumps import between_jumps, span
from ._typing import ContinuousEngine, PyTree
from .control import AbstractController
from .control._base import controlled, held_input
from .disturbances import AbstractDisturbance, check_streams
from .disturbances._streams import check_disturbances
from .observers import AbstractObserver
from .observers._base import Est, check_observers
from .plants import AbstractPlant
from .plants._base import check_first

__all__ = ["Simulation", "simulate"]


def simulate(
    plant: AbstractPlant,
    controller: AbstractController | Callable[[Float[Array, ""]], PyTree],
    observers: Mapping[str, AbstractObserver[Est]],
    *,
    t1: float,
    t0: float = 0.0,
    ts: Float[Array, " N"] | Float[np.ndarray, " N"] | None = None,
    initial: PyTree | None = None,
    actuator: AbstractDisturbance | None = None,
    sensor: AbstractDisturbance | None = None,
    input_sensor: AbstractDisturbance | None = None,
    feedback: Callable[[PyTree, PyTree, dict[str, Any]], PyTree] | None = None,
    solver: diffrax.AbstractSolver[Any] | None = None,
    stepsize_controller: diffrax.AbstractStepSizeController[Any, Any] | None = None,
    dt0: float | None = None,
    adjoint: diffrax.AbstractAdjoint | None = None,
    max_steps: int = 100_000,
    rtol: float | None = None,
    atol: float | None = None,
    engine: ContinuousEngine = "diffrax",
    threads: int | None = None,
) -> Simulation[Est]:
    """Integrate a plant, its controller, and observers beside each other.

    **Arguments:**

    - `controller`: a controller, or a function of time (s) for an open loop;
    - `observers`: by name;
    - `t0`, `t1`: the span (s); `ts`: the instants to save, shape `(N,)`, by default 1001
      even ones;
    - `initial`: the state of the plant at `t0`, by default `plant.initial()`;
    - `actuator`: between the controller's output and the plant, unseen by the observers;
      `sensor`: between the plant's output and everyone; `input_sensor`: between the
      controller's output and the observers;
    - `feedback(y, x, estimates)`: what the controller is fed, by default y. Estimates are
      then needed before there is an input, so u must have the shape of
      `plant.no_input(y)`, by default that of y;
    - `rtol`, `atol`: the tolerance of every step's error, `atol + rtol |x|` in each state,
      by default 1e-8 and 1e-10 (1e-5 and 1e-7 where JAX computes in single precision);
    - `max_steps`: that are tried at most;
    - `engine`: `"diffrax"`, the reference, differentiable, with Tsit5 unless it is given
      another `solver`; `"fused"` compiles the vector field and the steps to machine code
      (the extra `study`), with forward derivatives of the first order (`jax.jvp`,
      `jax.jacfwd`); `jax.vmap` runs many systems beside each
      other in it, each with steps of its own, on all processors. `"auto"` is `"fused"`
      where that extra is installed, nothing is traced by `jax.jit` or a derivative, and
      nothing is asked of diffrax; a system that cannot be compiled runs by diffrax, with a
      warning that says why; `threads` of `"fused"`, by default as many as there are
      processors;
    - `solver`, `stepsize_controller` (in place of `rtol` and `atol`), `dt0`, `adjoint`: as
      in `diffrax.diffeqsolve`, for that engine only. Pass `diffrax.ConstantStepSize()` and
      `dt0` for fixed steps, for which [`RungeKutta4`][] is the cheaper solver, and
      `diffrax.ForwardMode()` for forward gradients.

    Held disturbances jump at known instants: both engines step to them, never across. The
    fused engine integrates derivatives beside the states, to the same `rtol` and `atol`.
    It takes Tsitouras' pair of orders 5 and 4 down to a `rtol` of 2e-5 and
    Verner's of 9 and 8 below, with interpolants of orders 4 and 9 at `ts`; its |x| is the
    largest value that the state has had up to now.

    **Returns:** a [`Simulation`][]. `jax.vmap` maps it over initial states and parameters
    alike. What a run of the fused engine does not reach is NaN, with a warning and a
    `result`; other runs of a batch go on.

    **Raises:** `ValueError` for a span, instants, a step or a first state that do not fit,
    for parts that are none, and for what the engine does not take; [`NotFusible`][] where
    the fused engine cannot compile a part; diffrax's own error when its solver fails.
    """
    one_of("engine", engine, _choices.ContinuousEngine)
    controller = controlled(controller)
    if threads is not None:
        whole("threads", counted("threads", threads))
    kind("plant", plant, AbstractPlant, hint="a plant")
    check_observers(observers)
    function("feedback", feedback)
    kind("solver", solver, diffrax.AbstractSolver, hint="a solver of diffrax")
    number("t0", t0, "s")
    number("t1", t1, "s")
    if dt0 is not None:
        number("dt0", dt0, "s")
    if is_concrete(t0, t1) and not t0 < t1:
        raise ValueError(f"Argument `t1` must be after t0 = {t0} s, but got {t1} s.")
    if ts is None:
        ts = _even(t0, t1)
    elif is_concrete(ts, t0, t1):
        instants = np.asarray(ts)
        if not (instants.ndim == 1 and (np.diff(instants) > 0).all()):
            raise ValueError("Argument `ts` must be a strictly increasing vector.")
        if instants[0] < t0 or instants[-1] > t1:
            raise ValueError(
                f"Argument `ts` must lie in [{t0}, {t1}] s, but it spans "
                f"[{instants[0]}, {instants[-1]}] s."
            )
    check_disturbances(actuator, sensor, input_sensor)
    check_streams((actuator, sensor, input_sensor))
    held = (actuator, sensor, input_sensor, held_input(controller))
    within = span(held, t0, t1)
    parts = (actuator, sensor, input_sensor, feedback, within)
    loop = Interconnection(plant, controller, dict(observers), *parts)
    asked = {
        "solver": solver,
        "stepsize_controller": stepsize_controller,
        "dt0": dt0,
        "adjoint": adjoint,
    }
    asked = [name for name, given in asked.items() if given is not None]
    tolerances = _tolerances(rtol, atol, stepsize_controller)
    x0 = plant.initial() if initial is None else initial
    check_first(plant, x0)
    if engine != "diffrax":
        most = counted("max_steps", max_steps), threads
        found = _fused(loop, x0, (t0, t1), ts, tolerances, most, asked, engine)
        if found is not None:
            return found
    steps = stepsize_controller
    if steps is None:
        steps = diffrax.PIDController(*tolerances)
    steps = between_jumps(steps, within, t0, dt0)
    ts = jnp.asarray(ts)
    start, end = jnp.asarray(t0, ts.dtype), jnp.asarray(t1, ts.dtype)
    solution = diffrax.diffeqsolve(
        diffrax.ODETerm(loop.vector_field),
        diffrax.Tsit5() if solver is None else solver,
        start,
        end,
        None if dt0 is None else jnp.asarray(dt0, ts.dtype),
        loop.init(start, x0),
        saveat=diffrax.SaveAt(ts=ts, fn=loop.record),
        stepsize_controller=steps,
        adjoint=diffrax.RecursiveCheckpointAdjoint() if adjoint is None else adjoint,
        max_steps=max_steps,
    )
    assert solution.ys is not None
    return solution.ys


def _even(t0: Any, t1: Any) -> Any:
    """Instants, known under `jax.jit` too where the span is."""
    if not is_concrete(t0, t1):
        return jnp.linspace(t0, t1, 1001)
    with jax.ensure_compile_time_eval():
        return jnp.linspace(t0, t1, 1001)


def _tolerances(rtol: Any, atol: Any, steps: Any) -> tuple[float, float]:
    """Relative and absolute."""
    single = jnp.finfo(jnp.result_type(float)).bits == 32
    usual = (1e-5, 1e-7) if single else (1e-8, 1e-10)
    for name, given in (("rtol", rtol), ("atol", atol)):
        if given is None:
            continue
        if steps is not None:
            raise ValueError(
                f"Argument `{name}` must not be given with `stepsize_controller`, which "
                "has one of its own."
            )
        number(name, given, "1" if name == "rtol" else "the units of the state")
        positive(name, given)
    return usual[0] if rtol is None else rtol, usual[1] if atol is None else atol


def _fused(
    loop: Interconnection,
    x0: PyTree,
    ends: tuple[Any, Any],
    ts: Any,
    tolerances: tuple[float, float],
    most: tuple[int, int | None],
    asked: list[str],
    engine: ContinuousEngine,
) -> Simulation[Any] | None:
    """By the fused engine; None where diffrax is to do it."""
    if asked:
        if engine == "auto":
            return None
        raise ValueError(
            f"Argument `{asked[0]}` is of diffrax alone, but got engine={engine!r}. Give "
            '`rtol` and `atol` instead, or engine="diffrax".'
        )
    known = is_concrete(ts, *ends, *tolerances)
    everything = jax.tree.leaves((eqx.filter(loop, eqx.is_array), x0))
    if engine == "auto" and not (known and is_concrete(*everything)):
        return None
    if not known:
        raise ValueError(
            "Arguments `t0`, `t1`, `ts`, `rtol` and `atol` must be numbers with "
            'engine="fused", but one is being traced; make `ts` with NumPy, or use '
            'engine="diffrax".'
        )
    from .engines._adaptive.cosimulation import cosimulated

    return cosimulated(loop, x0, ends, np.asarray(ts), tolerances, most, engine)
