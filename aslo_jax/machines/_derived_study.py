"""`[machine]` of a system of one's own, and how it takes part in studies."""

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

import jax.numpy as jnp
import numpy as np
from pydantic import Field, PrivateAttr, model_validator

from .._completions import LeastSquares, Repeat
from .._derive.plant import ModelOfPlant, ModelPlant
from .._filters import LowPass
from .._guard import Guard
from ..derivation import Derived, Model, derive, model_of
from ..observers import AbstractObserver, ExtendedKalman
from ..plants import AbstractMechanicalSystem, AbstractModelledPlant
from ..schema import Table, hint, key
from ._python import load
from ._study import Build, Study
from .offers import refuse_keys

THRESHOLD = 1e-6  # relation's x may have many entries: a relative error of 0.1 %


def load_model(path: str, folder: Path) -> Model:
    """The model of an import `path`, `"module:attribute"`, whose module may lie in
    `folder`; of a plant that is one, that.

    **Raises:** [`MachineError`][].
    """
    wanted = Model | AbstractModelledPlant
    hint = "an `aslo_jax.Model`, or a plant that is one"
    found = load(path, folder, f"`machine.model`, {path}:", wanted, hint)
    return found if isinstance(found, Model) else model_of(found)


def load_derivable(path: str, folder: Path) -> Model | AbstractMechanicalSystem:
    """The model, a plant that is one, or the mechanical system, of an import `path`,
    `"module:attribute"`, whose module may lie in `folder`.

    **Raises:** [`MachineError`][].
    """
    wanted = Model | AbstractModelledPlant | AbstractMechanicalSystem
    hint = "an `aslo_jax.Model`, a plant that is one or an `AbstractMechanicalSystem`"
    found = load(path, folder, f"{path}:", wanted, hint)
    return model_of(found) if isinstance(found, AbstractModelledPlant) else found


class DerivedTable(Table):
    """`[machine]` of a system of one's own. Reading it runs the module that `model` names,
    which may lie beside the TOML file.

    **Raises:** `ValueError` where the module cannot be run, gives no model, or one from
    which no relation can be derived, or no state; and for a parameter that it has not.
    """

    kind: Literal["derived"] = key("the kind of machine", example="derived")
    model: Annotated[str, Field(pattern=r"^\w+(\.\w+)*:\w+(\.\w+)*$")] = key(
        "an `aslo.Model`, a plant that is one, or what returns one; Python that is run",
        example="motor:model",
        allowed='"module:attribute", with dots where there are packages',
    )
    parameters: dict[str, float] = key(
        "in place of those that the model has, by name",
        default={},
        allowed="a table of finite numbers",
    )
    _found: Any = PrivateAttr(default=None)

    @model_validator(mode="after")
    def _load(self, info):
        what = f"`machine.model`, {self.model}:"
        model = load_model(self.model, (info.context or {}).get("folder", Path()))
        refuse_others("machine.parameters", self.parameters, model.parameters, what)
        if self.parameters:
            parameters = dict(model.parameters) | self.parameters
            model = dataclasses.replace(model, parameters=parameters)
        try:
            self._found = derive(model)
        except ValueError as error:
            raise ValueError(f"{what} {error}") from error
        if not self._found.states:
            raise ValueError(
                f"{what} the relation tells of {', '.join(self._found.lifted)}, from which "
                "no state alone can be taken"
            )
        return self

    def found(self) -> Derived:
        """What was derived."""
        return self._found


def refuse_others(
    table: str, given: Mapping[str, Any], known: Mapping[str, Any], what: str
) -> None:
    """Refuse a name in a `table` that is not one that is `known`.

    **Raises:** `ValueError`.
    """
    for name in given:
        if name not in known:
            near = hint(name, known, "; did you mean `{}`?")
            raise ValueError(
                f"{what} `{table}.{name}` is no name of the model, which has "
                f"{', '.join(known) or 'none'}{near}"
            )


class ModelStart(Table):
    """What a study adds to a model."""

    initial: dict[str, float] = key(
        "the first state, by name, of which the rest is in the middle of its range",
        default={},
        allowed="a table of finite numbers",
    )


def _start(plant: Any, table: Any) -> Any:
    """The plant's first state with what the table gives in its place."""
    if not table.initial:
        return None
    own = plant.initial()
    refuse_others("machine.initial", table.initial, own, "the state:")
    return own | {name: jnp.asarray(x, float) for name, x in table.initial.items()}


def state_observer(
    found: Derived,
    cutoff: Any,
    completion: str,
    threshold: float,
    start: str,
    gain: Any = None,
) -> AbstractObserver[Any]:
    """The ASLO of the states, or with a `gain` (rad/s) the A-ASLO."""
    return found.observer(
        LowPass(cutoff),
        completion=LeastSquares() if completion == "least-squares" else Repeat(),
        guard=Guard(threshold=threshold),
        start=start,
        gain=gain,
    )


def slowest_of(found: Derived, completion: str) -> float:
    """The rate (rad/s) that the filter must be above."""
    return found.slowest * (0.5 if completion == "repeat" else 1.0)


def _offers(found: Derived) -> dict[str, Build]:
    """The observers of a derived model, by kind."""
    n = len(found.model.outputs)

    def algebraic(keys: Any, plant: Any, start: Any) -> AbstractObserver:
        del plant, start
        refuse_keys(keys, "velocity_cutoff", "forgetting")
        if not isinstance(keys.cutoff, float):
            raise ValueError("`cutoff` must be a number: no speed is known that it follows")
        slowest = slowest_of(found, keys.completion)
        if keys.cutoff <= slowest:
            raise ValueError(
                f"`cutoff` must be above {slowest:.4g} rad/s, by the fastest mode of the "
                f"model, but is {keys.cutoff:.4g}"
            )
        threshold = THRESHOLD if keys.threshold is None else keys.threshold
        gain = getattr(keys, "gain", None)
        return state_observer(
            found, keys.cutoff, keys.completion, threshold, keys.start, gain
        )

    def kalman(keys: Any, plant: ModelPlant, start: Any) -> AbstractObserver:
        refuse_keys(keys, "voltage")
        of = keys.process, keys.measurement, keys.drift
        return extended_kalman(plant, start, *of)

    def lifted(keys: Any, plant: Any, start: Any) -> AbstractObserver:
        del plant, start
        whole = lambda x, count: jnp.broadcast_to(jnp.asarray(x, float), (count,))
        return found.kalman_filter(
            whole(keys.output_deviation, n),
            whole(keys.input_deviation, len(found.model.inputs)),
            prior=keys.prior,
            threshold=keys.threshold,
        )

    return {
        "aslo": algebraic,
        "a-aslo": algebraic,
        "kalman": kalman,
        "lifted_kalman": lifted,
    }


def extended_kalman(
    plant: ModelPlant,
    start: Mapping[str, Any],
    process: Any,
    measurement: Any,
    drift: Any = None,
) -> ExtendedKalman:
    """The extended Kalman filter of a model: outputs that are states begin as in `start`,
    known to a thousandth of their range, what is not measured in the middle of its range,
    known to half of that.

    - `process`: two-sided intensities of the noise on the derivatives of the state, what
      is not measured first, over the squares of half the ranges (1/s), as
      [`ExtendedKalman.of_plant`][] has them: one number or a list with one for each;
    - `measurement`: of that on the outputs (their units squared, s), likewise;
    - `drift`: beside one number for the others, that of unknown parameters (1/s), whose
      half range is half of their value.
    """
    code, model = plant.code, plant.code.derived.model
    ranges = model.ranges | dict(model.outputs)
    half = np.array([0.5 * (ranges[n][1] - ranges[n][0]) for n in code.names])
    measured = np.arange(half.size) >= len(code.states)
    middle = plant.vector(plant.initial())
    first = jnp.where(measured, plant.vector(start), middle)
    spread = np.where(measured, 1e-3, 1.0) * half

    def entries(name: str, value: Any, names: tuple[str, ...]) -> Any:
        given = jnp.asarray(value, float)
        if given.shape not in ((), (len(names),)):
            raise ValueError(
                f"`{name}` must be a number, or a list of {len(names)}, for "
                f"{', '.join(names)}, but is {value!r}"
            )
        return jnp.broadcast_to(given, (len(names),))

    relative = entries("process", process, code.names)
    if drift is not None:
        if isinstance(process, list):
            raise ValueError(
                "`drift` must be left out beside a list, whose entries for "
                f"{', '.join(model.unknown) or 'unknown parameters'} it would change"
            )
        unknown = jnp.asarray([name in model.unknown for name in code.names])
        relative = jnp.where(unknown, drift, relative)
    return ExtendedKalman(
        ModelOfPlant(plant),
        jnp.diag(relative * half**2),
        jnp.diag(entries("measurement", measurement, code.outputs)),
        first,
        jnp.diag(jnp.asarray(spread**2)),
    )


def _of(table: Any) -> Study:
    """The study of the model that a table names."""
    found: Derived = table.found()
    unit = found.model.unit
    leaves = {f"plant.parameters.{name}": unit(name) for name in found.model.known}
    every = (*found.model.ranges, *found.model.outputs)
    return dataclasses.replace(
        STUDY,
        entries=found.states,
        units=tuple(map(unit, found.states)),
        observers=_offers(found),
        leaf_units=leaves | {f"initial.{name}": unit(name) for name in every},
    )


def _unresolved(keys: Any, plant: Any, start: Any) -> AbstractObserver:
    raise NotImplementedError


STUDY = Study(
    machine=DerivedTable,
    acting=ModelStart,
    entries=(),
    units=(),
    plant=lambda table: table.found().plant(),
    start=_start,
    observers=dict.fromkeys(("aslo", "a-aslo", "kalman", "lifted_kalman"), _unresolved),
    controls=("open_loop",),
    of=_of,
)
