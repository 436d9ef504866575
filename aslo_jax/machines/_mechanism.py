"""What every mechanical system has in common: positions and forces in, velocities out."""

import abc
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, ClassVar, Generic, Literal, TypeVar

import numpy as np
from jaxtyping import Float
from pydantic import Field, model_validator

from .._completions import LeastSquares, Repeat
from .._filters import LowPass
from .._guard import Guard
from .._structure import Structure, decay_rate, structure_of
from ..logs import Log, Signals
from ..observers import AbstractObserver, Unwrapped, VelocityObserver, velocity_observer
from ..plants import AbstractMechanicalSystem
from ..schema import NonNegative, Positive, Table, key
from . import _keys as keys, _lifted, offers
from ._base import (
    AbstractDescription,
    Columns,
    Layout,
    MachineError,
    Quantity,
    Rate,
    Rates,
    certified,
    in_columns,
    over_window,
    relative,
)
from ._condensed import CondensedLog
from ._frequency import cutoff_for_positions
from ._lifted import is_adaptive, is_lifted
from ._study import Explored, Study

# A certificate begins as (cutoff t)^2/3, or without least squares as (cutoff t)^2, where
# the encoder's steps are divided by t: at 12 bits, the first certified rows are 3 to 30 %
# off with 1e-2, and 6 to 70 % with 1e-3.
THRESHOLD = 1e-2
WINDOW = 100  # rows over which velocities are compared with the way

Two = Annotated[list[NonNegative], Field(min_length=2, max_length=2)]
Three = Annotated[list[NonNegative], Field(min_length=3, max_length=3)]
M = TypeVar("M", bound=Table)


_NOISE = 'with kind = "lifted_kalman" or "adaptive": standard deviation of'
_ADAPTIVE = 'with kind = "adaptive": '
_EACH = "a positive finite number, or one for each coordinate"


class VelocityObserverTable(_lifted.ObserverTable):
    """`[observer]` of a mechanical system, all optional for an ASLO. The default
    `threshold` suits encoders of 12 bits."""

    cutoff: Positive | None = keys.cutoff(example=30.0)
    completion: Literal["least-squares", "repeat"] = key(
        "how the row is solved",
        default="least-squares",
    )
    start: keys.Start = keys.start()
    gain: Positive | None = keys.gain()
    threshold: Positive = keys.threshold(THRESHOLD)
    kind: _lifted.MotorKind = _lifted.kind_key()
    output_deviation: _lifted.Deviation | None = key(
        f"{_NOISE} the noise on every sample of the positions (m, rad), of an encoder its "
        "step over sqrt(12)",
        default=None,
        example=1e-4,
        allowed=_EACH,
    )
    input_deviation: _lifted.Deviation | None = key(
        f"{_NOISE} the noise on every sample of the forces (N, N m)",
        default=None,
        example=0.1,
        allowed="a positive finite number, or one for each input",
    )
    force_deviation: _lifted.Deviation | None = key(
        f"{_NOISE} forces on the coordinates that the model does not know, in every "
        "interval (N, N m), by default none",
        default=None,
        example=0.5,
        allowed=_EACH,
    )
    prior: Positive | None = key(
        'with kind = "lifted_kalman": standard deviation of the first velocities (m/s, '
        "rad/s), by default infinite",
        default=None,
        example=2.0,
    )
    parameters: list[str] = key(
        f'{_ADAPTIVE}what is not known, by name; "push" is a constant force on each '
        "coordinate",
        default=[],
    )
    deviations: list[Positive] = key(
        f"{_ADAPTIVE}standard deviations of these, in their units",
        default=[],
    )
    drift: NonNegative = key(
        f"{_ADAPTIVE}random walk of these: deviation after a second, in their units over "
        "the root of seconds",
        default=0.0,
    )

    @model_validator(mode="after")
    def _has_noise(self):
        if not is_lifted(self):
            if self.force_deviation is not None:
                raise ValueError(
                    f'`observer.force_deviation` is for `observer.kind = "{_lifted.LIFTED}"'
                    f' or "{_lifted.ADAPTIVE}"; remove it, or set one of these'
                )
            return self
        for name, of in (
            ("output_deviation", "of the positions, of an encoder its step over sqrt(12)"),
            ("input_deviation", "of the forces"),
        ):
            if getattr(self, name) is None:
                raise ValueError(
                    f'`observer.{name}` must be given with `observer.kind = "{self.kind}"` '
                    f"of a mechanism: the standard deviation of the noise {of}"
                )
        if is_adaptive(self) and not self.parameters:
            raise ValueError(
                "`observer.parameters` must name what is not known with `observer.kind = "
                f'"{self.kind}"` of a mechanism, and `observer.deviations` by how much'
            )
        if is_adaptive(self) and len(self.deviations) != len(self.parameters):
            raise ValueError(
                "`observer.deviations` must have one entry for each of "
                f"`observer.parameters`, {len(self.parameters)}, but has "
                f"{len(self.deviations)}"
            )
        return self


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
    finds_noise: ClassVar[bool] = False
    refused: ClassVar[Mapping[str, str]] = {
        "pll_bandwidth": "its velocities come from its equations, not from a loop that "
        "follows an angle; remove it",
    }
    longest_interval: ClassVar[float] = 0.1
    memory: ClassVar[int] = WINDOW

    @abc.abstractmethod
    def plant(self) -> AbstractMechanicalSystem:
        """The system described by `[machine]`."""

    @model_validator(mode="after")
    def _knows_parameters(self):
        """Refuse parameters that the system does not have."""
        if is_adaptive(self.observer) and self.plant() is not None:
            try:
                self.state_observer({})
            except ValueError as error:
                raise ValueError(f"`observer.parameters`: {error}") from error
        return self

    def form(self) -> Structure:
        """The form of its observer."""
        return structure_of(self.plant())

    def noise_units(self) -> tuple[str, str]:
        return "m, rad", "N, N m"

    def default_rates(self, log: CondensedLog | None, stated: Mapping[str, Any]) -> Rates:
        if is_lifted(self.observer):
            return {}
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
        if is_lifted(settings):
            return _lifted.lifted_velocities(system, settings)
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
        if is_lifted(self.observer):
            return self._of_filter(estimate)
        velocities = {name: np.asarray(e.value)[:, 0] for name, e in estimate.items()}
        for name, each in estimate.items():
            velocities |= certified(each, f"_{name}")
        return velocities

    def _of_filter(self, estimate: Any) -> Columns:
        """The columns of one filter of all velocities, which are certified together."""
        names = tuple(quantity.columns[0] for quantity in self.quantities)
        found = in_columns(names, estimate.value)
        for name in names:
            found |= certified(estimate, f"_{name}")
        found |= _lifted.deviations_of(names, estimate)
        return found | _lifted.parameters_of(self.parameter_names(), estimate)

    def parameter_names(self) -> list[str]:
        """One for each entry of a parameter that is not known, those of an array with
        numbers."""
        names: list[str] = []
        for name in self.observer.parameters if is_adaptive(self.observer) else ():
            count = _lifted.entries_of(self.plant(), name)
            names += [name] if count is None else [f"{name}_{k + 1}" for k in range(count)]
        return names

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
