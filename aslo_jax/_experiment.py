"""The sampled closed loop: hold, integrate, measure, observe, control."""

from collections.abc import Callable
from typing import Any, Generic

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from ._checks import counted, divides, function, kind, positive, real, told_apart
from ._interconnection import alike
from ._module import Module
from ._runge_kutta import runge_kutta
from ._typing import PyTree
from .control import AbstractController
from .control._base import controlled
from .disturbances import AbstractDisturbance, DisturbanceState, check_streams
from .disturbances._streams import check_disturbances
from .observers import AbstractObserver, ObserverState
from .observers._base import Est, check_observers, named
from .plants import AbstractPlant
from .plants._base import check_first

__all__ = ["Carry", "Experiment", "Record"]


class Record(Module, Generic[Est]):
    """What an experiment records at the N instants `t` (s), shape `(N,)`: the plant's state
    `x` and its `hidden` part, shape `(N, n)`, the measurement `y` and the input `u` that
    the observers are given (held from `t` on), and the `estimates` by observer name.
    """

    t: Float[Array, "*N"]
    x: PyTree
    hidden: Float[Array, "*N n"]
    y: PyTree
    u: PyTree
    estimates: dict[str, Est]


class Carry(Module):
    """Everything that goes on from one sample to the next; a value."""

    x: PyTree
    controller: PyTree
    observers: dict[str, ObserverState]
    command: PyTree
    seen: PyTree
    actuator: DisturbanceState | None
    sensor: DisturbanceState | None
    input_sensor: DisturbanceState | None


class Experiment(Module, Generic[Est]):
    """A plant under a sampled controller with observers beside it.

    - `controller`: a controller, or a function of time (s) for an open loop;
    - `interval`: between samples (s); the input is held in between;
    - `feedback(y, x, estimates)`: what the controller is fed; y by default. Estimates are
      then needed before there is an input, so u must have the shape of
      `plant.no_input(y)`, by default that of y;
    - `actuator`: between the controller and the plant, unseen by the observers; `sensor`:
      between the plant and everyone; `input_sensor`: between the controller and the
      observers. The last two act at the samples; none of their state is integrated;
    - `initial`: the plant's first state, by default `plant.initial()`;
    - `plant_steps`: Runge-Kutta steps of order 4 in each interval.

    It is one pytree: `jax.vmap`, `jax.grad` and `eqx.tree_at` reach every parameter in it.

    **Raises:** `ValueError` for an `interval` that is not positive, for `plant_steps` below
    1, for what is no plant, controller, observer or disturbance, for random disturbances
    that share a key and a stream, and when it runs, for an `initial` that is not like the
    plant's.
    """

    plant: AbstractPlant
    controller: AbstractController = eqx.field(converter=controlled)
    observers: dict[str, AbstractObserver[Est]] = eqx.field(converter=named)
    interval: Float[Array, ""] = eqx.field(converter=real)
    feedback: Callable[[PyTree, PyTree, dict[str, Any]], PyTree] | None = None
    actuator: AbstractDisturbance | None = None
    sensor: AbstractDisturbance | None = None
    input_sensor: AbstractDisturbance | None = None
    initial: PyTree | None = None
    plant_steps: int = eqx.field(static=True, default=1)

    def __check_init__(self) -> None:
        positive("interval", self.interval, "s")
        kind("plant", self.plant, AbstractPlant, hint="a plant")
        check_observers(self.observers)
        check_disturbances(self.actuator, self.sensor, self.input_sensor)
        function("feedback", self.feedback)
        if self.plant_steps < 1:
            raise ValueError(
                f"Argument `plant_steps` must be at least 1, but got {self.plant_steps}."
            )
        check_streams((self.actuator, self.sensor, self.input_sensor))

    def init(self) -> tuple[Carry, Record[Est]]:
        """The carry and the record at the first sample, t = 0."""
        x = self.plant.initial() if self.initial is None else self.initial
        x = jax.tree.map(jnp.asarray, x)
        check_first(self.plant, x)
        t = jnp.zeros_like(self.interval)
        output = self.plant.output(x)
        sensor = _at_samples("sensor", self.sensor, t, output, output)
        y, sensor = _through(self.sensor, t, sensor, output, output)
        # No estimate depends on u at the instant: a controller can be fed the estimates
        # before there is an input, of which only the shape is needed.
        u = self.plant.no_input(y)
        blind = ({}, {}) if self.feedback is None else self._first(t, y, u)
        fed = self._fed(y, x, blind[1])
        state = self.controller.init(fed)
        command, state = self._control(t, state, fed)
        input_sensor = _at_samples("input_sensor", self.input_sensor, t, command, output)
        seen, input_sensor = _through(self.input_sensor, t, input_sensor, command, output)
        known = self.feedback is not None and alike(u, seen)
        observers, estimates = blind if known else self._first(t, y, seen)
        actuator = self.actuator
        actuator = None if actuator is None else actuator.init(t, command, output)
        record = Record(t, x, self.plant.hidden(x), y, seen, estimates)
        disturbances = actuator, sensor, input_sensor
        return Carry(x, state, observers, command, seen, *disturbances), record

    def prepare(self, carry: Carry) -> dict[str, PyTree]:
        """The coefficients of every observer's laws, which depend on parameters only."""
        return {
            name: observer.allocate(carry.observers[name].y, carry.seen).discretise(
                self.interval
            )
            for name, observer in self.observers.items()
        }

    def advance(
        self, k: Int[Array, ""], carry: Carry, prepared: dict[str, PyTree]
    ) -> tuple[Carry, Record[Est]]:
        """From sample k to sample k + 1, and what is recorded there."""
        x, actuator = self._integrate(k * self.interval, carry)
        t = (k + 1) * self.interval
        output = self.plant.output(x)
        y, sensor = _through(self.sensor, t, carry.sensor, output, output)
        observers, estimates = {}, {}
        for name, observer in self.observers.items():
            observers[name], estimates[name] = observer.advance(
                carry.observers[name], carry.seen, y, prepared[name]
            )
        fed = self._fed(y, x, estimates)
        command, state = self._control(t, carry.controller, fed)
        seen, input_sensor = _through(
            self.input_sensor, t, carry.input_sensor, command, output
        )
        record = Record(t, x, self.plant.hidden(x), y, seen, estimates)
        disturbances = actuator, sensor, input_sensor
        return Carry(x, state, observers, command, seen, *disturbances), record

    def run(self, steps: int, every: int = 1) -> Record[Est]:
        """Run `steps` intervals and record every `every`-th sample, the first included:
        leaves with a leading axis of length `steps // every + 1`."""
        steps, every = counted("steps", steps), counted("every", every)
        divides(every, steps)
        told_apart(steps, self.interval)
        return _run(self, steps, every)

    def _first(self, t, y, u):
        observers = {name: o.init(y, u) for name, o in self.observers.items()}
        estimates = {
            name: o.estimate(t, observers[name], u, y) for name, o in self.observers.items()
        }
        return observers, estimates

    def _fed(self, y, x, estimates):
        return y if self.feedback is None else self.feedback(y, x, estimates)

    def _control(self, t, state, fed):
        command = jax.tree.map(jnp.asarray, self.controller(t, state, fed))
        rate = self.controller.vector_field(t, state, fed)
        state = jax.tree.map(lambda s, r: s + self.interval * r, state, rate)
        return command, state

    def _integrate(self, t, carry):
        """The plant and the actuator over the interval that begins at t."""
        h, part = self.interval / self.plant_steps, self.actuator
        before, command = carry.actuator, carry.command
        state = carry.x, None if before is None else before.continuous
        # What is held jumps at the end, where the last stage belongs to this interval yet.
        end = (t + self.interval) * (1.0 - 4.0 * jnp.finfo(self.interval.dtype).eps)

        def rate(t, state):
            x, continuous = state
            if part is None or before is None:
                return self.plant.vector_field(t, x, command), None
            inner = DisturbanceState(continuous, before.sampled)
            output = self.plant.output(x)
            at = jnp.minimum(t, end) if part.has_jumps else t
            applied = part(at, inner, command, output)
            own_rate = part.vector_field(at, inner, command, output)
            return self.plant.vector_field(t, x, applied), own_rate

        for j in range(self.plant_steps):
            state = runge_kutta(rate, t + j * h, state, h)
        x, continuous = state
        if part is None or before is None:
            return x, None
        # Its sample is that of t, from where on the command is held.
        sampled = part.update(t, before, command, self.plant.output(carry.x))
        return x, DisturbanceState(continuous, sampled)


def _at_samples(
    name: str, part: AbstractDisturbance | None, t: Any, signal: PyTree, output: PyTree
) -> DisturbanceState | None:
    """The first state of a disturbance that acts at the samples only."""
    if part is None:
        return None
    state = part.init(t, signal, output)
    if jax.tree.leaves(state.continuous):
        raise ValueError(
            f"Argument `{name}` must have no state that is integrated in a sampled loop, "
            f"but {type(part).__name__} has one; use it as `actuator`, or in `simulate`."
        )
    return state


def _through(
    part: AbstractDisturbance | None, t: Any, state: Any, signal: PyTree, output: PyTree
) -> tuple[PyTree, DisturbanceState | None]:
    """The disturbed signal of a sample, and the state for the next one."""
    if part is None:
        return signal, None
    sampled = part.update(t, state, signal, output)
    after = DisturbanceState(state.continuous, sampled)
    return part(t, state, signal, output), after


@eqx.filter_jit
def _run(experiment: Experiment[Est], steps: int, every: int) -> Record[Est]:
    carry, first = experiment.init()
    prepared = experiment.prepare(carry)

    def one(carry, k):
        return experiment.advance(k, carry, prepared)

    def block(carry, k):
        # The samples passed over, then the one recorded.
        def quiet(j, carry):
            return one(carry, k + j)[0]

        carry = jax.lax.fori_loop(0, every - 1, quiet, carry)
        return one(carry, k + every - 1)

    starts = jnp.arange(0, steps, every)
    _, rest = jax.lax.scan(one if every == 1 else block, carry, starts)
    return jax.tree.map(lambda a, b: jnp.concatenate([a[None], b]), first, rest)
