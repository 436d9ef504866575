"""The interconnection of plant, controller, observers and disturbances in continuous time,
and what is recorded of it."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Generic

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from ._jumps import Span
from ._module import Module
from ._typing import PyTree
from .control import AbstractController
from .disturbances import AbstractDisturbance, DisturbanceState
from .observers import AbstractObserver, Estimate, ObserverState
from .observers._base import Est
from .plants import AbstractPlant


class Simulation(Module, Generic[Est]):
    """What [`simulate`][] returns; every leaf has a leading axis of the `N` instants `t`.

    - `t` (s), shape `(N,)`; `u`, the input that the observers saw; `y`, the measurement
      they saw;
    - `x`, the state of the plant; `hidden`, its unmeasured part, shape `(N, n)`;
    - `estimates`: by observer name; `states`: every inner state of every observer, by
      observer name and state name;
    - `result`, shape `(N,)`, with `engine="fused"`: 0 where the instant has been reached.
      Where all else is NaN it says why it has not: 1, `max_steps` steps were not enough; 2,
      the solution has diverged, or become too steep for any step. `None` with diffrax,
      which raises an error instead.
    """

    t: Float[Array, "*N"]
    u: PyTree
    y: PyTree
    x: PyTree
    hidden: Float[Array, "*N n"]
    estimates: dict[str, Est]
    states: dict[str, Any]
    result: Int[Array, "*N"] | None = None

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


class Interconnection(Module):
    """The interconnection: who sees what."""

    plant: AbstractPlant
    controller: AbstractController
    observers: dict[str, AbstractObserver[Any]]
    actuator: AbstractDisturbance | None
    sensor: AbstractDisturbance | None
    input_sensor: AbstractDisturbance | None
    feedback: Callable[[PyTree, PyTree, dict[str, Any]], PyTree] | None
    span: Span | None

    def estimates(self, t, observers, u, y):
        return {
            name: observer.estimate(t, ObserverState(observers[name], y), u, y)
            for name, observer in self.observers.items()
        }

    def fed(self, t, x, y, observers):
        """What the controller is fed, and the estimates that this takes, if any."""
        if self.feedback is None:
            return y, None
        # No estimate depends on u at the instant, so any of its shape will do.
        estimates = self.estimates(t, observers, self.plant.no_input(y), y)
        return self.feedback(y, x, estimates), estimates

    def signals(self, t, state):
        measured = self.plant.output(state["plant"])
        y = _through(self.sensor, t, state["sensor"], measured, measured)
        fed, estimates = self.fed(t, state["plant"], y, state["observers"])
        command = self.controller(t, state["controller"], fed)
        applied = _through(self.actuator, t, state["actuator"], command, measured)
        seen = _through(self.input_sensor, t, state["input_sensor"], command, measured)
        if estimates is not None and not alike(self.plant.no_input(y), seen):
            estimates = None
        return measured, y, fed, command, applied, seen, estimates

    def init(self, t0, x):
        measured = self.plant.output(x)
        sensor = _init("sensor", self.sensor, t0, measured, measured)
        y = _through(self.sensor, t0, sensor, measured, measured)
        blind = {} if self.feedback is None else self.observers
        u = self.plant.no_input(y)
        states = {k: o.init(y, u).states for k, o in blind.items()}
        fed, _ = self.fed(t0, x, y, states)
        controller = self.controller.init(fed)
        command = jax.tree.map(jnp.asarray, self.controller(t0, controller, fed))
        actuator = _init("actuator", self.actuator, t0, command, measured)
        input_sensor = _init("input_sensor", self.input_sensor, t0, command, measured)
        seen = _through(self.input_sensor, t0, input_sensor, command, measured)
        if self.feedback is None or not alike(u, seen):
            states = {k: o.init(y, seen).states for k, o in self.observers.items()}
        return {
            "plant": x,
            "controller": controller,
            "observers": states,
            "actuator": actuator,
            "sensor": sensor,
            "input_sensor": input_sensor,
        }

    def vector_field(self, t, state, args):
        del args
        if self.span is not None:
            t = self.span.inside(t)
        measured, y, fed, command, applied, seen, _ = self.signals(t, state)
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
        _, y, _, _, _, seen, estimates = self.signals(t, state)
        if estimates is None:
            estimates = self.estimates(t, state["observers"], seen, y)
        x = state["plant"]
        return Simulation(
            t, seen, y, x, self.plant.hidden(x), estimates, state["observers"]
        )


def alike(u: PyTree, other: PyTree) -> bool:
    """Whether two inputs differ in their values only."""
    types = lambda tree: jax.tree.map(lambda x: (jnp.shape(x), jnp.result_type(x)), tree)
    return types(u) == types(other)


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
