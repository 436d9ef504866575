"""Continuous co-simulation: plant, controller, observers and disturbances in one solve."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Generic

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ._checks import function, is_concrete, kind, number
from ._jumps import Span, between_jumps, span
from ._module import Module
from ._typing import PyTree
from .control import AbstractController
from .control._base import controlled
from .disturbances import AbstractDisturbance, DisturbanceState, check_streams
from .disturbances._streams import check_disturbances
from .observers import AbstractObserver, Estimate, ObserverState
from .observers._base import Est, check_observers
from .plants import AbstractPlant
from .plants._base import check_first


class Simulation(Module, Generic[Est]):
    """What [`simulate`][] returns; every leaf has a leading axis of the `N` instants `t`.

    - `t` (s), shape `(N,)`; `u`, the input that the observers saw; `y`, the measurement
      they saw;
    - `x`, the state of the plant; `hidden`, its unmeasured part, shape `(N, n)`;
    - `estimates`: by observer name; `states`: every inner state of every observer, by
      observer name and state name.
    """

    t: Float[Array, "*N"]
    u: PyTree
    y: PyTree
    x: PyTree
    hidden: Float[Array, "*N n"]
    estimates: dict[str, Est]
    states: dict[str, Any]

    def error(self: "Simulation[Estimate]", name: str) -> Float[Array, "*N n"]:
        """Estimate less truth of observer `name`, in the units of the state."""
        return self.estimates[name].value - self.hidden

    def to_dataframe(
        self,
        *,
        names: Sequence[str] | None = None,
        units: Mapping[str, str] | None = None,
    ) -> Any:
        """The simulation as a `pandas.DataFrame` with the index `t` (s) (the extra
        `study`).

        - `names` of the `n` entries of the hidden state, by default `hidden_0` and so on;
        - `units`: by column (`"ASLO.value_0"`), by entry of every observer (`"value_0"`,
          or a name) or by signal (`"u"`), kept in `attrs["units"]` of the table.

        The columns are `u_0` and so on (`u` of a scalar, `u.name_0` of a mapping), the same
        of `y` and of the state `x`, the hidden state by its names, and for each observer
        `ASLO.` before its entries, by the same names where they are as many and otherwise
        `value_0` and so on, and before `certificate` (1) and `coasting`.

        **Raises:** `ValueError` for names that do not fit, for a batch of simulations, or
        for the unit of no column; `ImportError` naming the command that installs pandas.
        """
        from ._tables import dataframe, simulation_columns

        return dataframe(simulation_columns(self, names), units or {})

    def to_xarray(
        self,
        *,
        names: Sequence[str] | None = None,
        units: Mapping[str, str] | None = None,
    ) -> Any:
        """The same as an `xarray.Dataset`: one variable for each column of
        [`Simulation.to_dataframe`][], over the coordinate `t` (s), with its unit in the
        attribute `units`."""
        from ._tables import dataset, simulation_columns

        return dataset(simulation_columns(self, names), units or {})


class _Loop(Module):
    """The interconnection: who sees what."""

    plant: AbstractPlant
    controller: AbstractController
    observers: dict[str, AbstractObserver[Any]]
    actuator: AbstractDisturbance | None
    sensor: AbstractDisturbance | None
    input_sensor: AbstractDisturbance | None
    feedback: Callable[[PyTree, PyTree, dict[str, Any]], PyTree] | None
    span: Span | None

    def fed(self, t, x, y, observers):
        if self.feedback is None:
            return y
        # No estimate depends on u at the instant, so any of its shape will do.
        u = self.plant.no_input(y)
        estimates = {
            name: observer.estimate(t, ObserverState(observers[name], y), u, y)
            for name, observer in self.observers.items()
        }
        return self.feedback(y, x, estimates)

    def signals(self, t, state):
        measured = self.plant.output(state["plant"])
        y = _through(self.sensor, t, state["sensor"], measured, measured)
        fed = self.fed(t, state["plant"], y, state["observers"])
        command = self.controller(t, state["controller"], fed)
        applied = _through(self.actuator, t, state["actuator"], command, measured)
        seen = _through(self.input_sensor, t, state["input_sensor"], command, measured)
        return measured, y, fed, command, applied, seen

    def init(self, t0, x):
        measured = self.plant.output(x)
        sensor = _init("sensor", self.sensor, t0, measured, measured)
        y = _through(self.sensor, t0, sensor, measured, measured)
        blind = {} if self.feedback is None else self.observers
        u = self.plant.no_input(y)
        fed = self.fed(t0, x, y, {k: o.init(y, u).states for k, o in blind.items()})
        controller = self.controller.init(fed)
        command = jax.tree.map(jnp.asarray, self.controller(t0, controller, fed))
        actuator = _init("actuator", self.actuator, t0, command, measured)
        input_sensor = _init("input_sensor", self.input_sensor, t0, command, measured)
        seen = _through(self.input_sensor, t0, input_sensor, command, measured)
        return {
            "plant": x,
            "controller": controller,
            "observers": {k: o.init(y, seen).states for k, o in self.observers.items()},
            "actuator": actuator,
            "sensor": sensor,
            "input_sensor": input_sensor,
        }

    def vector_field(self, t, state, args):
        del args
        if self.span is not None:
            t = self.span.inside(t)
        measured, y, fed, command, applied, seen = self.signals(t, state)
        observers = {
            name: observer.vector_field(
                t, ObserverState(state["observers"][name], y), seen, y
            ).states
            for name, observer in self.observers.items()
        }
        return {
            "plant": self.plant.vector_field(t, state["plant"], applied),
            "controller": self.controller.vector_field(t, state["controller"], fed),
            "observers": observers,
            "actuator": _rate(self.actuator, t, state["actuator"], command, measured),
            "sensor": _rate(self.sensor, t, state["sensor"], measured, measured),
            "input_sensor": _rate(
                self.input_sensor, t, state["input_sensor"], command, measured
            ),
        }

    def record(self, t, state, args) -> Simulation[Any]:
        del args
        _, y, _, _, _, seen = self.signals(t, state)
        estimates = {
            name: observer.estimate(t, ObserverState(state["observers"][name], y), seen, y)
            for name, observer in self.observers.items()
        }
        x = state["plant"]
        return Simulation(
            t, seen, y, x, self.plant.hidden(x), estimates, state["observers"]
        )


def _through(part, t, state, signal, output):
    return signal if part is None else part(t, state, signal, output)


def _init(name, part, t, signal, output):
    if part is None:
        return None
    state = part.init(t, signal, output)
    if jax.tree.leaves(state.sampled):
        raise ValueError(
            f"Argument `{name}` must have no state that is updated at samples, of which "
            f"there are none in continuous time, but {type(part).__name__} has one; run an "
            "`Experiment`."
        )
    return state


def _rate(part, t, state, signal, output):
    if part is None:
        return None
    # What is updated at samples has no leaves here, but is part of the tree.
    rate = part.vector_field(t, state, signal, output)
    return DisturbanceState(rate, state.sampled)


def simulate(
    plant: AbstractPlant,
    controller: AbstractController | Callable[[Float[Array, ""]], PyTree],
    observers: Mapping[str, AbstractObserver[Est]],
    *,
    t1: float,
    t0: float = 0.0,
    ts: Float[Array, " N"] | None = None,
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
) -> Simulation[Est]:
    """Integrate a plant, its controller, and observers beside each other, with diffrax.

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
    - `solver`, `stepsize_controller`, `dt0`, `adjoint`, `max_steps`: as in
      `diffrax.diffeqsolve`; by default Tsit5 with `rtol=1e-8`, `atol=1e-10`
      (1e-5 and 1e-7 where JAX computes in single precision). Pass
      `diffrax.ConstantStepSize()` and `dt0` for fixed steps, for which [`RungeKutta4`][]
      is the cheaper solver, and `diffrax.ForwardMode()` for forward gradients.

    **Returns:** a [`Simulation`][]. Differentiable, and `jax.vmap` maps it over initial
    states and parameters alike.

    **Raises:** `ValueError` for a span, instants, a step or a first state that do not fit,
    and for parts that are none; diffrax's own error when the solver fails.
    """
    controller = controlled(controller)
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
        ts = jnp.linspace(t0, t1, 1001)
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
    within = span((actuator, sensor, input_sensor), t0, t1)
    parts = (actuator, sensor, input_sensor, feedback, within)
    loop = _Loop(plant, controller, dict(observers), *parts)
    steps = stepsize_controller
    if steps is None:
        single = jnp.finfo(jnp.result_type(float)).bits == 32
        rtol, atol = (1e-5, 1e-7) if single else (1e-8, 1e-10)
        steps = diffrax.PIDController(rtol=rtol, atol=atol)
    steps = between_jumps(steps, within, t0, dt0)
    x0 = plant.initial() if initial is None else initial
    check_first(plant, x0)
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
