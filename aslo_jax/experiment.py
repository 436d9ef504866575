"""The sampled closed loop: hold, integrate, measure, observe, control."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int, PyTree

from ._checks import positive, real
from .control import AbstractController
from .disturbances import AbstractDisturbance
from .observers import AbstractObserver, ObserverState
from .plants import AbstractPlant
from .solvers import runge_kutta


class Record(eqx.Module):
    """What an experiment records at `t` (s): the plant's state `x` and its `hidden` part,
    the measurement `y` and the input `u` that the observers are given (held from `t` on),
    and the `estimates` by observer name."""

    t: Float[Array, "*N"]
    x: PyTree
    hidden: Float[Array, "*N n"]
    y: PyTree
    u: PyTree
    estimates: dict[str, Any]


class Carry(eqx.Module):
    """Everything that goes on from one sample to the next; a value."""

    x: PyTree
    lag: PyTree
    controller: PyTree
    observers: dict[str, ObserverState]
    command: PyTree
    seen: PyTree


class Experiment(eqx.Module):
    """A plant under a sampled controller with observers beside it.

    - `interval`: between samples (s); the input is held in between;
    - `feedback(y, x, estimates)`: what the controller is fed; y by default. Estimates are
      then needed before there is an input, so u must have the shape of
      `plant.no_input(y)`, by default that of y;
    - `actuator`: between the controller and the plant, unseen by the observers; `sensor`:
      between the plant and everyone; `input_sensor`: between the controller and the
      observers. The last two act at the samples;
    - `initial`: the plant's first state, by default `plant.initial()`;
    - `plant_steps`: Runge-Kutta steps of order 4 in each interval.

    It is one pytree: `jax.vmap`, `jax.grad` and `eqx.tree_at` reach every parameter in it.
    """

    plant: AbstractPlant
    controller: AbstractController
    observers: dict[str, AbstractObserver]
    interval: Float[Array, ""] = eqx.field(converter=real)
    feedback: Callable[[PyTree, PyTree, dict[str, Any]], PyTree] | None = None
    actuator: AbstractDisturbance | None = None
    sensor: AbstractDisturbance | None = None
    input_sensor: AbstractDisturbance | None = None
    initial: PyTree | None = None
    plant_steps: int = eqx.field(static=True, default=1)

    def __check_init__(self):
        positive("interval", self.interval, "s")
        if self.plant_steps < 1:
            raise ValueError(
                f"Argument `plant_steps` must be at least 1, but got {self.plant_steps}."
            )
        for part in (self.sensor, self.input_sensor):
            if part is not None and jax.tree.leaves(part.init(jnp.zeros(()))):
                raise ValueError(
                    "Arguments `sensor` and `input_sensor` must have no state of their own "
                    f"in a sampled loop, but {type(part).__name__} has one; use it as "
                    "`actuator`, or in `simulate`."
                )

    def init(self) -> tuple[Carry, Record]:
        """The carry and the record at the first sample, t = 0."""
        x = self.plant.initial() if self.initial is None else self.initial
        x = jax.tree.map(jnp.asarray, x)
        t = jnp.zeros_like(self.interval)
        y = self._measure(t, x)
        # No estimate depends on u at the instant: a controller can be fed the estimates
        # before there is an input, of which only the shape is needed.
        u = self.plant.no_input(y)
        blind = {} if self.feedback is None else self._first(t, y, u)[1]
        fed = self._fed(y, x, blind)
        state = self.controller.init(fed)
        command, seen, state = self._control(t, state, fed)
        observers, estimates = self._first(t, y, seen)
        lag = None if self.actuator is None else self.actuator.init(command)
        record = Record(t, x, self.plant.hidden(x), y, seen, estimates)
        return Carry(x, lag, state, observers, command, seen), record

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
    ) -> tuple[Carry, Record]:
        """From sample k to sample k + 1, and what is recorded there."""
        x, lag = self._integrate(k * self.interval, carry)
        t = (k + 1) * self.interval
        y = self._measure(t, x)
        observers, estimates = {}, {}
        for name, observer in self.observers.items():
            observers[name], estimates[name] = observer.advance(
                carry.observers[name], carry.seen, y, prepared[name]
            )
        fed = self._fed(y, x, estimates)
        command, seen, state = self._control(t, carry.controller, fed)
        record = Record(t, x, self.plant.hidden(x), y, seen, estimates)
        return Carry(x, lag, state, observers, command, seen), record

    def run(self, steps: int, every: int = 1) -> Record:
        """Run `steps` intervals and record every `every`-th sample, the first included:
        leaves with a leading axis of length `steps // every + 1`."""
        if steps < 1 or every < 1 or steps % every:
            raise ValueError(
                "Argument `every` must divide `steps`, both at least 1, but got "
                f"steps = {steps}, every = {every}."
            )
        return _run(self, steps, every)

    def _first(self, t, y, u):
        observers = {name: o.init(y, u) for name, o in self.observers.items()}
        estimates = {
            name: o.estimate(t, observers[name], u, y) for name, o in self.observers.items()
        }
        return observers, estimates

    def _measure(self, t, x):
        y = self.plant.output(x)
        return y if self.sensor is None else self.sensor(t, None, y)

    def _fed(self, y, x, estimates):
        return y if self.feedback is None else self.feedback(y, x, estimates)

    def _control(self, t, state, fed):
        command = jax.tree.map(jnp.asarray, self.controller(t, state, fed))
        seen = command
        if self.input_sensor is not None:
            seen = self.input_sensor(t, None, command)
        rate = self.controller.vector_field(t, state, fed)
        state = jax.tree.map(lambda s, r: s + self.interval * r, state, rate)
        return command, seen, state

    def _integrate(self, t, carry):
        h = self.interval / self.plant_steps
        state = carry.x, carry.lag

        def rate(t, state):
            x, lag = state
            if self.actuator is None:
                return self.plant.vector_field(t, x, carry.command), None
            applied = self.actuator(t, lag, carry.command)
            lag_rate = self.actuator.vector_field(t, lag, carry.command)
            return self.plant.vector_field(t, x, applied), lag_rate

        for j in range(self.plant_steps):
            state = runge_kutta(rate, t + j * h, state, h)
        return state


@eqx.filter_jit
def _run(experiment: Experiment, steps: int, every: int) -> Record:
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
