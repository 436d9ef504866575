"""The file of a study as a whole, and what it describes."""

import abc
import dataclasses
import functools
import tomllib
from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, Union

import numpy as np
from pydantic import Field, ValidationError, create_model

from ..._continuous import AnyExperiment, ContinuousExperiment
from ..._experiment import Experiment
from ..._studies import NAMES, ready_made
from ...machines import Study, studies
from ...metrics._base import MakeMetric
from ...schema import Positive, Table, Whole, explain, key, text_and_content
from .._names import check_names
from .._spread import Spread, names_of
from .control import Control
from .disturbances import Disturbance, chained
from .metrics import Metric
from .observers import Observer
from .shapes import check_shapes, in_continuous_time
from .spread import SpreadItem, parameter, parameter_units

MOST_STEPS = 10**9  # of a trajectory: samples in time are counted in 32 bits
MOST_KEPT = 10**5  # errors of a trajectory that are kept
MOST_PLANT_STEPS = 100  # each is traced by itself
STEPPING = ("rtol", "atol", "max_steps")  # keys of continuous time


class ConfigurationError(ValueError):
    """A study's file that cannot be used: names file, key and allowed values."""


class AbstractStudyTable(Table, abc.ABC):
    """The file of a study, of whatever machine; see [`study_table`][]."""

    title: str = key("what the study is about")
    interval: Positive = key("between samples in time", "s")
    horizon: Positive = key("how long a trajectory is", "s")
    plant_steps: Annotated[int, Field(gt=0, le=MOST_PLANT_STEPS)] = key(
        "Runge-Kutta steps in each interval",
        default=1,
        allowed=f"a whole number from 1 to {MOST_PLANT_STEPS}",
    )
    time: Literal["sampled", "continuous"] = key(
        "whether control and observers run at samples, or with the plant in one "
        "differential equation",
        default="sampled",
    )
    rtol: Positive | None = key(
        "of continuous time, the relative tolerance of a step, by default 1e-8",
        default=None,
    )
    atol: Positive | None = key(
        "of continuous time, the absolute tolerance of a step, by default 1e-10",
        default=None,
    )
    max_steps: Whole | None = key(
        "of continuous time, how many steps are tried at most, by default 100000",
        default=None,
    )
    every: Whole | None = key(
        "keep the error of one in this many samples",
        default=None,
    )
    scale: list[Positive] | None = key(
        "what each entry of the error is divided by in its norm", default=None
    )
    design: Literal["iid", "lhs", "sobol"] = key("the design", default="iid")
    machine: Any = key("the machine")
    control: Control = key("its control")
    observers: Annotated[dict[str, Observer], Field(min_length=1)] = key(
        "the observers", allowed="a table with a table for each observer"
    )
    sensor: list[Disturbance] = key("between plant and everyone", default=[])
    input_sensor: list[Disturbance] = key("between control and observers", default=[])
    actuator: list[Disturbance] = key("between control and plant", default=[])
    spread: dict[str, SpreadItem] = key("what varies", default={})
    metrics: Annotated[dict[str, Metric], Field(min_length=1)] = key(
        "what is measured", allowed="a table with a table for each metric"
    )


def study_table() -> type[AbstractStudyTable]:
    """The file of a study, whose machine is of one of the kinds that are registered."""
    return _study_table(tuple(studies().values()))


@functools.lru_cache(maxsize=8)  # tuning reads a file many times
def _study_table(kinds: tuple[Study, ...]) -> type[AbstractStudyTable]:
    tables = [
        # The keys of the machine come first, with the checks of their table.
        create_model(each.machine.__name__, __base__=(each.acting, each.machine))
        for each in kinds
    ]
    machine: Any = Annotated[Union[tuple(tables)], Field(discriminator="kind")]  # noqa: UP007
    field: Any = (machine, key("the machine"))
    return create_model("StudyTable", __base__=AbstractStudyTable, machine=field)


@dataclasses.dataclass(frozen=True)
class Configuration:
    """What a file describes, ready for [`run`][]:
    `run(c.experiment, c.spread, samples=..., key=..., **c.settings)`.

    - `experiment`, `spread`, `metrics`, `steps`, `every`, `scale`, `units`, `entries`: as
      there; `title`;
    - `content`: the file with its defaults, kept with the results.
    """

    title: str
    experiment: AnyExperiment
    spread: Spread
    metrics: dict[str, MakeMetric]
    steps: int
    every: int | None
    scale: np.ndarray | None
    units: dict[str, str]
    entries: tuple[str, ...]
    content: dict[str, Any]

    @property
    def settings(self) -> dict[str, Any]:
        """The other arguments of [`run`][]."""
        return {
            "metrics": self.metrics,
            "steps": self.steps,
            "every": self.every,
            "scale": self.scale,
            "units": self.units,
            "entries": self.entries,
            "configuration": self.content,
        }


def read_study(path: Path | str) -> tuple[str, dict[str, Any], Configuration]:
    """The text and the content of a study's file, or of the ready-made one of that name
    (`NAMES`), and what it describes; see [`read_configuration`][]."""
    name, path = str(path), Path(path)
    if name in NAMES:
        text = ready_made(name)
        content = tomllib.loads(text)
    elif path.is_file():
        text, content = text_and_content(path, ConfigurationError)
    else:
        raise FileNotFoundError(
            f"{name} is neither a file nor a ready-made study; those are "
            f"{', '.join(NAMES)}."
        )
    try:
        return text, content, configure(content, path.parent)
    except ConfigurationError as error:
        raise ConfigurationError(f"{name}: {error}") from None


def read_configuration(path: Path | str) -> Configuration:
    """Read and check a study's TOML file, or the ready-made one of that name (`NAMES`).

    **Raises:** [`ConfigurationError`][] for text that is not TOML, and for a key that is
    missing, unknown, out of range, or does not suit the machine; `FileNotFoundError` where
    there is neither a file nor a ready-made one.
    """
    return read_study(path)[2]


def configure(content: Mapping[str, Any], folder: Path = Path()) -> Configuration:
    """What the content of a study's file describes, which lies in `folder`; see
    [`read_configuration`][]."""
    model = study_table()
    try:
        table = model.model_validate(content, context={"folder": folder})
        return _configured(table)
    except ValidationError as error:
        raise ConfigurationError(f"{explain(model, error, content)}.") from None


def experiment_in(content: Mapping[str, Any]) -> AnyExperiment:
    """The experiment of a content that differs in its numbers alone from one that was
    configured: what takes tracing to be checked, shapes for instance, is not checked again,
    which takes a tenth of the time."""
    model = study_table()
    try:
        table = model.model_validate(content)
        return _experiment(table, studies()[table.machine.kind])
    except ValidationError as error:
        raise ConfigurationError(f"{explain(model, error, content)}.") from None
    except ConfigurationError:
        raise
    except ValueError as error:
        raise ConfigurationError(str(error)) from error


def _configured(table: AbstractStudyTable) -> Configuration:
    kind = table.machine.kind
    study = studies()[kind].of_file(table.machine)
    _suits(kind, "control", table.control, lambda study: study.controls)
    for name, each in table.observers.items():
        _suits(kind, f"observers.{name}", each, lambda study: study.observers)
    for name, each in table.metrics.items():
        if not each.general:
            _suits(kind, f"metrics.{name}", each, lambda study: study.metrics)
    for place in ("sensor", "input_sensor", "actuator"):
        for k, each in enumerate(getattr(table, place)):
            if place not in each.places:
                raise ConfigurationError(
                    f'`{place}.{k}.kind`, "{each.kind}", is for '
                    f"{' and '.join(each.places)} only."
                )
    if not table.title.isprintable():
        raise ConfigurationError(
            "`title` must be text that can be printed, on one line, but is "
            f"{table.title!r}."
        )
    _check_time(table)
    ratio = table.horizon / table.interval
    if not ratio <= MOST_STEPS:
        raise ConfigurationError(
            f"`horizon` must be at most {MOST_STEPS:g} intervals, "
            f"{MOST_STEPS * table.interval:g} s, but is {table.horizon!r}."
        )
    steps = round(ratio)
    if steps < 1 or not np.isclose(steps * table.interval, table.horizon, rtol=1e-6):
        raise ConfigurationError(
            "`horizon` must be a whole number of intervals of "
            f"{table.interval:g} s, but is {table.horizon!r}."
        )
    if table.every is not None and steps % table.every:
        raise ConfigurationError(
            f"`every` must divide the {steps} samples of the horizon, but is {table.every}."
        )
    if table.every is not None and steps // table.every > MOST_KEPT:
        raise ConfigurationError(
            f"`every` must be at least {-(-steps // MOST_KEPT)}, to keep at most "
            f"{MOST_KEPT:g} errors of the {steps} samples of the horizon, but is "
            f"{table.every}."
        )
    entries, units = study.entries, study.units
    if table.scale is not None and len(table.scale) != len(entries):
        raise ConfigurationError(
            f"`scale` must hold {len(entries)} numbers, for {', '.join(entries)}, but is "
            f"{table.scale!r}."
        )
    try:
        experiment = _experiment(table, study)
        spread = Spread({n: parameter(t) for n, t in table.spread.items()}, table.design)
        check_shapes(experiment)
        check_names(table.observers, table.metrics, names_of(spread))
        metrics = {n: t.build(experiment.plant) for n, t in table.metrics.items()}
    except ValueError as error:
        raise ConfigurationError(str(error)) from error
    named = {name: each.unit(units) for name, each in table.metrics.items()}
    alike = units[0] if len(set(units)) == 1 else ""
    content = table.model_dump()
    if table.time == "sampled":  # as before there was another
        for name in ("time", *STEPPING):
            del content[name]
    return Configuration(
        title=table.title,
        experiment=experiment,
        spread=spread,
        metrics=metrics,
        steps=steps,
        every=table.every,
        scale=None if table.scale is None else np.asarray(table.scale),
        units=named
        | {"error": "1" if table.scale is not None else alike}
        | parameter_units(table.spread, type(table.machine), study.leaf_units),
        entries=entries,
        content=content,
    )


def _check_time(table: AbstractStudyTable) -> None:
    """Refuse what is of the other `time`."""
    if table.time == "sampled":
        for name in STEPPING:
            if getattr(table, name) is not None:
                raise ConfigurationError(
                    f'`{name}` is for `time = "continuous"` only; a sampled loop takes '
                    "`plant_steps` steps in every interval."
                )
        return
    if "plant_steps" in table.model_fields_set:
        raise ConfigurationError(
            '`plant_steps` is for `time = "sampled"` only; the steps of continuous time '
            "follow `rtol` and `atol`."
        )
    for place in ("sensor", "input_sensor", "actuator"):
        for k, each in enumerate(getattr(table, place)):
            if each.sampled is not None:
                raise ConfigurationError(
                    f'`{place}.{k}.kind`, "{each.kind}", is for `time = "sampled"` only: '
                    f"{each.sampled}."
                )


def _suits(
    kind: str, path: str, table: Any, offered: Callable[[Study], Collection[str]]
) -> None:
    """Refuse a table of a kind that is not `offered` for this kind of machine."""
    owners = [name for name, study in studies().items() if table.kind in offered(study)]
    if kind not in owners:
        raise ConfigurationError(
            f'`{path}.kind`, "{table.kind}", is for {_listed(owners)}, but '
            f'`machine.kind` is "{kind}".'
        )


def _listed(names: Sequence[str]) -> str:
    return " or ".join(f'"{name}"' for name in names) or "no machine"


def _experiment(table: AbstractStudyTable, study: Study) -> AnyExperiment:
    plant = study.plant(table.machine)
    start = study.start(plant, table.machine)
    controller, feedback = table.control.build(plant)
    known = plant.initial() if start is None else start
    # Streams of random numbers that differ throughout the loop.
    first = len(table.sensor)
    second = first + len(table.input_sensor)
    observers = {
        n: _observer(study, n, t, plant, known) for n, t in table.observers.items()
    }
    around = dict(
        feedback=feedback,
        sensor=chained(table.sensor, table.interval, 0),
        input_sensor=chained(table.input_sensor, table.interval, first),
        actuator=chained(table.actuator, table.interval, second),
        initial=start,
    )
    loop = plant, controller, observers, table.interval
    if table.time == "sampled":
        return Experiment(*loop, plant_steps=table.plant_steps, **around)
    stepping = {name: getattr(table, name) for name in STEPPING}
    around |= {name: x for name, x in stepping.items() if x is not None}
    experiment = ContinuousExperiment(*loop, **around)
    observers = {n: in_continuous_time(experiment, n) for n in observers}
    return dataclasses.replace(experiment, observers=observers)


def _observer(study: Study, name: str, keys: Any, plant: Any, start: Any):
    try:
        return study.observers[keys.kind](keys, plant, start)
    except ValueError as error:
        text = str(error).removesuffix(".")
        raise ConfigurationError(f"`observers.{name}`: {text}.") from error
