"""The protocol of every kind of machine description."""

import abc
import inspect
from collections.abc import Callable, Mapping
from typing import Any, ClassVar, Generic, TypeVar, get_args

import numpy as np
from jaxtyping import Array, Float

from .._choices import CompletionName, FilterStart
from .._completions import LeastSquares, Repeat
from .._guard import Guard
from ..diagnosis import Circle
from ..logs import Log, Signals
from ..observers import AbstractObserver, AlgebraicObserver, Asymptotic
from ..plants import AbstractPlant
from ..schema import Table, is_rate, unit_of
from ._condensed import CondensedLog, Condensing, blocks
from ._keys import CalibrationTable
from ._layout import Layout as Layout, Quantity as Quantity, Unknowns as Unknowns
from ._lifted import NO_EFFECT, is_adaptive, is_lifted, kind_of, no_effect
from ._noise import Groups, Noise, pooled, white_noise
from ._rates import Rate, Rates, low_pass
from ._study import Study

Columns = dict[str, np.ndarray]


class MachineError(ValueError):
    """A machine description that cannot be used: names file, key and allowed values."""


FROM_THE_LOG = ("cutoff", "pll_bandwidth")


M = TypeVar("M", bound=Table)
O = TypeVar("O", bound=Table)


class AbstractDescription(Table, abc.ABC, Generic[M, O]):
    """A machine description, as [`read_machine`][] reads it: the tables `[machine]` and
    `[observer]`, and what they mean for a log.

    A kind has one final class. Its `[machine]` begins with the key `kind`, its `[observer]`
    has the key `threshold`, the certificate below which the estimate coasts. It states

    - `kind`: as in `machine.kind`; `title`: the same in words;
    - `layout`: columns in and out, an example of them where the file decides how many;
    - `motion`: what a log in which nothing is observable lacks, as a question;
    - `residual`: the formula of what [`AbstractDescription.residuals`][] returns;
    - `refused`: keys of `[observer]` that other kinds have and this one cannot, and why;
    - `longest_interval` (s): a median interval above it makes one doubt the unit of `t`;
    - `memory`: on how many rows before it a row of the residuals depends;
    - `unknowns`: what a calibration may find; `telling`: what a log of this kind needs to
      determine it, and what tells it from errors of the record;
    - `study`: how the kind takes part in studies, `None` where it does not;
    - `finds_noise`: whether a Kalman filter may leave its deviations to the log.

    **Raises:** [`MachineError`][] for a key that its kind refuses, and where a rate is to
    be chosen for a log that is not given; `TypeError` for a kind that is defined without
    `kind` or `threshold`.
    """

    machine: M
    observer: O
    calibration: CalibrationTable = CalibrationTable()

    kind: ClassVar[str]
    title: ClassVar[str]
    layout: ClassVar[Layout]
    motion: ClassVar[str]
    residual: ClassVar[str]
    refused: ClassVar[Mapping[str, str]]
    longest_interval: ClassVar[float]
    memory: ClassVar[int] = 0
    unknowns: ClassVar[Unknowns] = Unknowns(refused="its description offers no parameters")
    telling: ClassVar[tuple[str, str]] = (
        "direct current, torque and speed that vary, or a standstill with current besides",
        "a log that varies more, of a motor in the direct current,",
    )
    study: ClassVar[Study | None] = None
    finds_noise: ClassVar[bool] = True

    @classmethod
    def __pydantic_init_subclass__(cls, **settings: Any) -> None:
        """Refuse a final class that lacks what every user of descriptions asks for.

        **Raises:** `TypeError`.
        """
        if inspect.isabstract(cls):
            return
        machine, observer = (
            cls.model_fields[n].annotation for n in ("machine", "observer")
        )
        field = getattr(machine, "model_fields", {}).get("kind")
        if field is None or get_args(field.annotation) != (cls.kind,):
            raise TypeError(
                f"`[machine]` of {cls.__name__} must have the key `kind` of the type "
                f'Literal["{cls.kind}"].'
            )
        if "threshold" not in getattr(observer, "model_fields", {}):
            raise TypeError(
                f"`[observer]` of {cls.__name__} must have the key `threshold`, the "
                "certificate below which the estimate coasts."
            )

    @abc.abstractmethod
    def plant(self) -> AbstractPlant:
        """The plant described by `[machine]`."""

    @abc.abstractmethod
    def default_rates(self, log: CondensedLog | None, stated: Mapping[str, Any]) -> Rates:
        """The rates of the observer that are not `stated`, where there are defaults for
        them without a log or, if there is one, `condensed`, with it. Refuses a stated rate
        that does not suit the log."""

    @abc.abstractmethod
    def state_observer(self, rates: Mapping[str, Rate]) -> AbstractObserver[Any]:
        """The observer, with the rates that [`AbstractDescription.rates`][] chooses. Its
        input and output are u and y of a log with `signals`."""

    @abc.abstractmethod
    def columns(self, estimate: Any, log: Log) -> Columns:
        """The table of estimates, each column of shape `(N,)`: what the `quantities` need,
        and `certificate` and `coasting` (0 or 1) with every suffix. `estimate` is what the
        observer returns, with a leading axis of length `N`."""

    @abc.abstractmethod
    def truth(self, log: Log) -> Columns:
        """The truth of a log by the names of the table of estimates."""

    @abc.abstractmethod
    def residuals(self, columns: Columns, log: Log) -> Columns:
        """How far the estimates are from an equation that holds for the true states and
        was not used to the full, by the name of the quantity: relative, shape `(N,)`."""

    def circles(self) -> tuple[Circle, ...]:
        """What every right log of this machine satisfies beyond what its observer uses, to
        tell a wrong one; by default nothing is known."""
        return ()

    def positions(self, log: Log) -> Columns:
        """The positions that a log measures whose derivatives are estimated, by the column
        of the derivative; by default there are none."""
        del log
        return {}

    def operation(self, columns: Columns, log: Log) -> dict[str, float]:
        """How a machine that turns was run in a log, told from its table of estimates:
        `speed`, mean and mechanical (rad/s), `swing`, the amplitude of a sine with the same
        variation of it (rad/s), and `torque`, what is left of the mean of that of its
        currents after accelerating the rotor (N m); friction and load take that. The speed
        is positive, the torque positive where it is in its direction. Empty by default, and
        where too few rows are certified."""
        del columns, log
        return {}

    def columns_of_log(self) -> Layout:
        """The `layout` of this machine's logs."""
        return self.layout

    def followed(self) -> Callable[[Any, Any, Any], tuple[Any, Any]] | None:
        """What makes of u, y and an estimate the signals of the phase-locked loop of a
        drive, an angle (rad, wrapped) among them, as `connect` of a [`Staged`][] observer;
        `None` where the kind has none."""
        return None

    def offered(self) -> Unknowns:
        """What a calibration of this machine may find; by default the `unknowns` of its
        kind."""
        return self.unknowns

    def constants(self) -> Mapping[str, Any]:
        """The values, by name, of what a calibration may find: numbers, or lists."""
        return self.machine.model_dump(exclude={"kind"})

    def constant_units(self) -> Mapping[str, str]:
        """The units of the `constants`, by name."""
        return {k: unit_of(f) for k, f in type(self.machine).model_fields.items()}

    def in_file(self, values: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
        """New `values` of the constants, by table of the file and key."""
        return {"machine": dict(values)}

    def fitted(self, log: Log, given: Mapping[str, float]) -> Any:
        """What a calibration fits to a `log`, by default the plant; rates that are `given`
        (rad/s) are those of an observer."""
        del log, given
        return self.plant()

    def leaf(self, model: Any, name: str) -> Any:
        """A constant in the tree of what is `fitted`."""
        return getattr(model, name)

    def parameter_names(self) -> list[str]:
        """The names of the unknown parameters that its observer finds, one for each column
        of them."""
        settings: Any = self.observer
        return list(settings.parameters) if is_adaptive(settings) else []

    def noise_units(self) -> tuple[str, str]:
        """The units of the noise of y and of u."""
        return "A", "V"

    @property
    def pole_pairs(self) -> int | None:
        """The number of pole pairs of its `[machine]`, if it has any."""
        return getattr(self.machine, "pole_pairs", None)

    @property
    def signals(self) -> Signals:
        """The columns of a log, in and for scoring."""
        return self.columns_of_log().signals

    @property
    def quantities(self) -> tuple[Quantity, ...]:
        """What is estimated."""
        return self.columns_of_log().quantities

    def suffixes(self) -> list[str]:
        """Those of the columns `certificate` and `coasting`."""
        return self.columns_of_log().suffixes()

    def condensed(self, log: Log) -> CondensedLog:
        """Of a log, or of a piece of one, what `default_rates` looks at where a rate is not
        stated, in as few columns as it takes: of a long log they are all that is held in
        memory. By default nothing but the instants."""
        nothing = np.zeros((log.t.size, 0))
        return CondensedLog(log.t, nothing, nothing, {})

    def rates(
        self, log: Log | None = None, given: Mapping[str, float] | None = None
    ) -> Rates:
        """The rates of the observer by their keys in `[observer]`: those `given` (rad/s),
        then those of the file, then the defaults, for which a cutoff may need the `log`."""
        if log is None:
            return self.rates_of(None, given)
        condensing = Condensing(self.condensed)
        condensing.add(log)
        return self.rates_of(condensing.result(log.t), given)

    def noise_groups(self) -> tuple[Groups, Groups]:
        """Which entries of u, and of y, have noise of one deviation; by default all."""
        of = self.signals
        inputs = range(len(of.inputs) + len(of.optional))
        return (tuple(inputs),), (tuple(range(len(of.outputs))),)

    @property
    def lacks_noise(self) -> bool:
        """Whether its observer is a Kalman filter and the file leaves it to the log which
        deviations the noise has."""
        names = ("output_deviation", "input_deviation")
        unknown = any(getattr(self.observer, name, 0.0) is None for name in names)
        return is_lifted(self.observer) and unknown

    def with_noise(
        self, found: Noise
    ) -> "tuple[AbstractDescription[M, O], dict[str, str]]":
        """The same with deviations `found` in the log where the file has none; and why
        each, by its key."""
        least = "the least that is taken for noise, a thousandth of the rms or a step"
        reasons, filled = {}, {}
        for name, values, is_least in (
            ("output_deviation", found.output, found.least_output),
            ("input_deviation", found.input, found.least_input),
        ):
            if getattr(self.observer, name) is None:
                filled[name] = [float(x) for x in values]
                reasons[name] = f"found from the log{f': {least}' if is_least else ''}"
        observer = self.observer.model_copy(update=filled)
        return self.model_copy(update={"observer": observer}), reasons

    def with_noise_of(self, log: Log) -> "AbstractDescription[M, O]":
        """[`AbstractDescription.with_noise`][] of a log in memory, where that lacks."""
        if not self.lacks_noise:
            return self
        of, groups = blocks(log.t.size), self.noise_groups()
        found = pooled([white_noise(log.u[k], log.y[k], *groups) for k in of])
        return self.with_noise(found)[0]

    def stated(self, given: Mapping[str, float] | None = None) -> dict[str, Any]:
        """The rates that are `given` (rad/s) or in the file, by their keys: numbers, or
        tables of those that follow the speed."""
        given = {} if given is None else given
        known = [k for k, f in type(self.observer).model_fields.items() if is_rate(f)]
        for name in given:
            if name not in known:
                reason = self.refused.get(name, f"its rates are {', '.join(known)}")
                raise MachineError(
                    f'`{name}` is not for a machine of the kind "{self.kind}": {reason}.'
                )
            if is_lifted(self.observer) and name in NO_EFFECT:
                reason = no_effect(name, kind_of(self.observer))
                raise MachineError(reason.replace("observer.", "", 1) + ".")
        in_file = {k: getattr(self.observer, k) for k in known}
        return {k: v for k, v in (in_file | dict(given)).items() if v is not None}

    def chooses(self, given: Mapping[str, float] | None = None) -> bool:
        """Whether `default_rates` looks at the columns of `condensed`: where a rate that it
        may choose for the log, the cutoff or that of a loop, is not stated."""
        fields = type(self.observer).model_fields
        return any(k in fields and k not in self.stated(given) for k in FROM_THE_LOG)

    def rates_of(
        self, condensed: CondensedLog | None, given: Mapping[str, float] | None = None
    ) -> Rates:
        """[`AbstractDescription.rates`][] of a log that is `condensed`."""
        stated = self.stated(given)
        chosen = self.default_rates(condensed, stated)
        if is_lifted(self.observer):
            chosen = {k: rate for k, rate in chosen.items() if k not in NO_EFFECT}
        elif "cutoff" not in stated | chosen:
            raise MachineError(
                "Argument `log` must be given where neither `given` nor `[observer]` has "
                "a `cutoff`: it is then chosen for the log."
            )
        every = {k: Rate(v) for k, v in stated.items()} | chosen
        fields = type(self.observer).model_fields
        return {k: every[k] for k in fields if k in every}


def algebraic(
    relation: Callable,
    cutoff: Rate | float,
    *,
    threshold: float,
    completion: CompletionName = "least-squares",
    start: FilterStart = "exact",
    gain: Rate | None = None,
    forgetting: Rate | None = None,
) -> AbstractObserver:
    """The ASLO with a filter of a `cutoff` (rad/s, or that follows the speed), or with a
    `gain` (rad/s) the A-ASLO; the least squares forget at the rate `forgetting`, by default
    the cutoff."""
    pace = cutoff.value if isinstance(cutoff, Rate) else cutoff
    rate = None if forgetting is None else low_pass(forgetting.value, relation)
    observer = AlgebraicObserver(
        relation,
        low_pass(pace, relation),
        completion=LeastSquares(rate) if completion == "least-squares" else Repeat(),
        guard=Guard(threshold=threshold),
        start=start,
    )
    return observer if gain is None else Asymptotic(observer, gain.constant)


def in_columns(
    names: tuple[str, ...], values: Float[np.ndarray, "N n"] | Float[Array, "N n"]
) -> Columns:
    """The columns of `values` by name."""
    return dict(zip(names, np.asarray(values).T, strict=True))


def certified(estimate: Any, suffix: str = "") -> Columns:
    """The columns `certificate` and `coasting` of an estimate."""
    return {
        f"certificate{suffix}": np.asarray(estimate.certificate),
        f"coasting{suffix}": np.asarray(estimate.coasting).astype(np.uint8),
    }


def length(*vector: Float[np.ndarray, " N"]) -> Float[np.ndarray, " N"]:
    """The Euclidean length of vectors, given entry by entry."""
    return np.sqrt(np.sum(np.square(vector), axis=0))


def relative(
    x: Float[np.ndarray, " N"], size: Float[np.ndarray, " N"]
) -> Float[np.ndarray, " N"]:
    """`|x| / size`, infinite where `size` is zero."""
    return np.divide(np.abs(x), size, out=np.full(x.shape, np.inf), where=size > 0)


def over_window(steps: Float[np.ndarray, " n"], window: int) -> Float[np.ndarray, " N"]:
    """The sum of the last steps at every row, of as many as there are up to `window`."""
    total = np.concatenate([[0.0], np.cumsum(steps)])
    rows = np.arange(total.size)
    return total - total[np.maximum(rows - window, 0)]
