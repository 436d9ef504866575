"""What every mechanical system has in common: positions and forces in, velocities out."""

import abc
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, ClassVar, Generic, Literal, TypeVar

import numpy as np
from jaxtyping import Float
from pydantic import Field

from .._completions import LeastSquares, Repeat
from .._filters import LowPass
from .._guard import Guard
from .._structure import Structure, decay_rate, structure_of
from ..logs import Log, Signals
from ..observers import AbstractObserver, Unwrapped, VelocityObserver, velocity_observer
from ..plants import AbstractMechanicalSystem
from ..schema import NonNegative, Positive, Table, key
from . import _keys as keys, offers
from ._base import (
    AbstractDescription,
    Columns,
    Layout,
    MachineError,
    Quantity,
    Rate,
    Rates,
    certified,
    over_window,
    relative,
)
from ._condensed import CondensedLog
from ._frequency import cutoff_for_positions
from ._study import Explored, Study

# A certificate begins as (cutoff t)^2/3, or without least squares as (cutoff t)^2, where
# the encoder's steps are divided by t: at 12 bits, the first certified rows are 3 to 30 %
# off with 1e-2, and 6 to 70 % with 1e-3.
THRESHOLD = 1e-2
WINDOW = 100  # rows over which velocities are compared with the way

Two = Annotated[list[NonNegative], Field(min_length=2, max_length=2)]
Three = Annotated[list[NonNegative], Field(min_length=3, max_length=3)]
M = TypeVar("M", bound=Table)


class VelocityObserverTable(Table):
    """`[observer]` of a mechanical system, all optional. The default `threshold` suits
    encoders of 12 bits."""

    cutoff: Positive | None = keys.cutoff(example=30.0)
    completion: Literal["least-squares", "repeat"] = key(
        "how the row is solved",
        default="least-squares",
    )
    start: keys.Start = keys.start()
    gain: Positive | None = keys.gain()
    threshold: Positive = keys.threshold(THRESHOLD)


class MotionStart(Table):
    """The state in which a mechanism starts; what is left out is that of the plant."""

    position: list[float] | None = key("coordinates (m, rad)", default=None)
    velocity: list[float] | None = key("their rates (m/s, rad/s)", default=None)


class MotionTable(Table):
    """What a study adds to a mechanism."""

    initial: MotionStart = key("the first state", default=MotionStart())


def study(
    machine: type[Table],
    plant: Any,
    velocities: dict[str, str],
    control: str,
    *,
    bound: bool = False,
    explored: Explored | None = None,
) -> Study:
    """How a mechanism takes part in studies: `plant` is the class of its plant,
    `velocities` are the units of what is estimated, by name."""
    return Study(
        machine=machine,
        acting=MotionTable,
        entries=tuple(velocities),
        units=tuple(velocities.values()),
        plant=lambda table: plant(**table.model_dump(exclude={"kind", "initial"})),
        observers=offers.of_mechanism(threshold=THRESHOLD),
        controls=(control,),
        bound=bound,
        explored=explored,
    )


def layout(angles: Sequence[bool], inputs: int, note: str = "") -> Layout:
    """The columns of a system with as many coordinates as `angles`, which tells of each
    whether it is an angle, and as many `inputs`."""
    numbers = range(1, len(angles) + 1)
    about = (
        "angles in rad, which may wrap; other positions in m; torques in N m, forces in N"
    )
    signals = Signals(
        inputs=tuple(f"u{k}" for k in range(1, inputs + 1)),
        outputs=tuple(f"q{j}" for j in numbers),
        truth=tuple(f"qdot{j}_true" for j in numbers),
        note="; ".join(filter(None, (about, note))),
    )
    quantities = [
        Quantity(
            f"velocity {j}",
            (f"qdot{j}",),
            "rad/s" if angle else "m/s",
            suffix=f"_qdot{j}",
        )
        for j, angle in zip(numbers, angles, strict=True)
    ]
    return Layout(signals, tuple(quantities))


class AbstractMechanism(AbstractDescription[M, VelocityObserverTable], abc.ABC, Generic[M]):
    """A mechanical system: the velocity of every coordinate, with a certificate of its own,
    from positions and forces."""

    observer: VelocityObserverTable = VelocityObserverTable()

    motion = "is the log longer than one over the cutoff?"
    residual: ClassVar[str] = (
        "| change of q - integral of qdot | / integral of |qdot|, in 100 rows"
    )
    refused: ClassVar[Mapping[str, str]] = {
        "kind": "its velocities come one after the other, from relations of their own; "
        "remove it, or use `LiftedVelocities` in Python",
        "pll_bandwidth": "its velocities come from its equations, not from a loop that "
        "follows an angle; remove it",
    }
    longest_interval: ClassVar[float] = 0.1
    memory: ClassVar[int] = WINDOW

    @abc.abstractmethod
    def plant(self) -> AbstractMechanicalSystem:
        """The system described by `[machine]`."""

    def form(self) -> Structure:
        """The form of its observer."""
        return structure_of(self.plant())

    def default_rates(self, log: CondensedLog | None, stated: Mapping[str, Any]) -> Rates:
        fastest = self._fastest_decay()
        if "cutoff" in stated:
            if stated["cutoff"] <= fastest:
                raise MachineError(
                    f"the cutoff must be above {fastest:.4g} rad/s, friction over inertia "
                    f"of a coordinate whose friction varies, but is "
                    f"{stated['cutoff']:.4g}; raise --cutoff or `observer.cutoff`."
                )
            return {}
        if log is None:
            return {}
        cutoff, why = cutoff_for_positions(log.t, self.unwrapped(log))
        if cutoff < 2.0 * fastest:
            cutoff, why = 2.0 * fastest, "twice the varying friction over its inertia"
        return {"cutoff": Rate(cutoff, why)}

    def condensed(self, log: Log) -> CondensedLog:
        return CondensedLog(log.t, np.zeros((log.t.size, 0)), log.y, {})

    def _fastest_decay(self) -> float:
        """The largest varying friction over its inertia (1/s), zero where there is none."""
        friction = enumerate(self.form().friction)
        decays = [decay_rate(self.plant(), j)[1] for j, f in friction if f == "varying"]
        return max((float(decay.max()) for decay in decays), default=0.0)

    def state_observer(self, rates: Mapping[str, Rate]) -> AbstractObserver[Any]:
        settings, system = self.observer, self.plant()
        gain = rates.get("gain")
        averaged = settings.completion == "least-squares"
        whole = velocity_observer(
            system,
            LowPass(rates["cutoff"].constant),
            gain=None if gain is None else gain.constant,
            form=self.form(),
            completion=LeastSquares() if averaged else Repeat(),
            guard=Guard(threshold=settings.threshold),
            start=settings.start,
        )
        inner = whole.observer if isinstance(whole, Unwrapped) else whole
        assert isinstance(inner, VelocityObserver)
        each = inner.velocities
        return Unwrapped(each, system.angles) if any(system.angles) else each

    def columns(self, estimate: Any, log: Log) -> Columns:
        velocities = {name: np.asarray(e.value)[:, 0] for name, e in estimate.items()}
        for name, each in estimate.items():
            velocities |= certified(each, f"_{name}")
        return velocities

    def truth(self, log: Log) -> Columns:
        return {name.removesuffix("_true"): column for name, column in log.truth.items()}

    def residuals(self, columns: Columns, log: Log) -> Columns:
        found, steps = {}, np.diff(log.t)
        for quantity, q in zip(self.quantities, self.unwrapped(log).T, strict=True):
            velocity = columns[quantity.columns[0]]
            mean = 0.5 * (velocity[1:] + velocity[:-1]) * steps
            error = over_window(np.diff(q) - mean, WINDOW)
            size = over_window(np.abs(mean), WINDOW)
            found[quantity.name] = relative(error, size)
        return found

    def positions(self, log):
        each = zip(self.quantities, self.unwrapped(log).T, strict=True)
        return {quantity.columns[0]: q for quantity, q in each}

    def unwrapped(self, log: Log) -> Float[np.ndarray, "N n"]:
        """The positions of a log, its angles unwrapped."""
        angles = self.plant().angles or (False,) * log.y.shape[1]
        columns = zip(log.y.T, angles, strict=True)
        return np.stack([np.unwrap(q) if angle else q for q, angle in columns], axis=1)
