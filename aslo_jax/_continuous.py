"""A loop in continuous time for batches and studies, recorded at even instants."""

from collections.abc import Callable
from typing import Any, Generic, NamedTuple

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp

from ._checks import function, kind, number, positive
from ._experiment import Experiment, Record
from ._interconnection import Interconnection
from ._jumps import between_jumps, span
from ._module import Module
from ._typing import PyTree
from .control import AbstractController
from .control._base import controlled, held_input
from .disturbances import AbstractDisturbance, check_streams
from .disturbances._streams import check_disturbances
from .observers import AbstractObserver
from .observers._base import Est, check_observers, named
from .plants import AbstractPlant
from .plants._base import check_first

__all__ = ["ContinuousExperiment"]


class ContinuousExperiment(Module, Generic[Est]):
    """A plant, a controller and observers in continuous time, as [`simulate`][] has them,
    for [`run_batch`][] and studies: what is recorded, and what metrics are given, are its
    signals at every `interval` (s), which has no other part in the loop.

    - `plant`, `controller`, `observers`, `feedback`, `actuator`, `sensor`, `input_sensor`,
      `initial`: as of [`simulate`][]; random disturbances are held over intervals of their
      own, and need no state that is updated at samples;
    - `rtol`, `atol`: the tolerance of a step's error, `atol + rtol |x|` in each state;
      `max_steps`: that are tried at most.

    By the engine `"fused"` every run has steps of its own; `"scan"` runs it by diffrax.

    **Raises:** `ValueError` for an `interval` or a tolerance that is no positive number,
    for what is no plant, controller, observer or disturbance, and for random disturbances
    that share a key and a stream.
    """

    plant: AbstractPlant
    controller: AbstractController = eqx.field(converter=controlled)
    observers: dict[str, AbstractObserver[Est]] = eqx.field(converter=named)
    interval: float = eqx.field(static=True)
    feedback: Callable[[PyTree, PyTree, dict[str, Any]], PyTree] | None = None
    actuator: AbstractDisturbance | None = None
    sensor: AbstractDisturbance | None = None
    input_sensor: AbstractDisturbance | None = None
    initial: PyTree | None = None
    rtol: float = eqx.field(static=True, default=1e-8)
    atol: float = eqx.field(static=True, default=1e-10)
    max_steps: int = eqx.field(static=True, default=100_000)

    def __check_init__(self) -> None:
        for name, unit in (("interval", "s"), ("rtol", "1"), ("atol", "of the states")):
            number(name, getattr(self, name), unit)
            positive(name, getattr(self, name), unit)
        kind("plant", self.plant, AbstractPlant, hint="a plant")
        check_observers(self.observers)
        check_disturbances(self.actuator, self.sensor, self.input_sensor)
        function("feedback", self.feedback)
        check_streams((self.actuator, self.sensor, self.input_sensor))

    def begun(self, steps: int) -> tuple[Interconnection, PyTree]:
        """The loop over so many intervals, and the first state of the plant."""
        disturbances = self.actuator, self.sensor, self.input_sensor
        held = *disturbances, held_input(self.controller)
        within = span(held, 0.0, steps * self.interval)
        parts = *disturbances, self.feedback, within
        x0 = self.plant.initial() if self.initial is None else self.initial
        check_first(self.plant, x0)
        x0 = jax.tree.map(jnp.asarray, x0)
        return Interconnection(self.plant, self.controller, self.observers, *parts), x0

    def run(self, steps: int) -> Record[Est]:
        """Its record at 0, 1, ... `steps` intervals, by diffrax: leaves with a leading axis
        of length `steps + 1`."""
        return self.integrated(steps)[0]

    def integrated(
        self, steps: int, integrands: Callable[[Record[Est]], PyTree] | None = None
    ) -> tuple[Record[Est], PyTree]:
        """The same, and the integrals of `integrands(record)`, a tree, up to there."""
        loop, x0 = self.begun(steps)
        both = Beside(loop, integrands)
        dtype = jnp.result_type(float)
        start = jnp.zeros((), dtype)
        ts = jnp.arange(steps + 1, dtype=dtype) * self.interval
        control = diffrax.PIDController(rtol=self.rtol, atol=self.atol)
        solution = diffrax.diffeqsolve(
            diffrax.ODETerm(lambda t, y, args: both.rate(t, y)),
            diffrax.Tsit5(),
            start,
            ts[-1],
            None,
            both.init(start, x0),
            saveat=diffrax.SaveAt(
                ts=ts, fn=lambda t, y, args: (recorded(loop, t, y[0]), y[1])
            ),
            stepsize_controller=between_jumps(control, loop.span, 0.0, None),
            adjoint=diffrax.ForwardMode(),
            max_steps=self.max_steps,
            throw=False,
        )
        assert solution.ys is not None
        return jax.tree.map(_nothing, solution.ys)


class Beside(NamedTuple):
    """A loop with integrals beside its states, of `integrands(record)`, a tree, without any
    if that is None."""

    loop: Interconnection
    integrands: Callable[[Record[Any]], PyTree] | None

    def init(self, t0: Any, x0: PyTree) -> tuple[PyTree, PyTree]:
        """At the first instant, from the plant's state."""
        state = self.loop.init(t0, x0)
        return state, jax.tree.map(jnp.zeros_like, self._rates(t0, state))

    def rate(self, t: Any, both: tuple[PyTree, PyTree]) -> tuple[PyTree, PyTree]:
        """The derivative of both."""
        return self.loop.vector_field(t, both[0], None), self._rates(t, both[0])

    def _rates(self, t: Any, state: PyTree) -> PyTree:
        if self.integrands is None:
            return None
        return self.integrands(recorded(self.loop, t, state))


AnyExperiment = Experiment[Any] | ContinuousExperiment[Any]


def recorded(loop: Interconnection, t: Any, state: PyTree) -> Record[Any]:
    """What an experiment records."""
    s = loop.record(t, state, None)
    return Record(s.t, s.x, s.hidden, s.y, s.u, s.estimates)


def _nothing(x: Any) -> Any:
    """What has not been reached is infinite in diffrax, and NaN here."""
    if not jnp.issubdtype(x.dtype, jnp.floating):
        return x
    return jnp.where(jnp.isinf(x), jnp.nan, x)
