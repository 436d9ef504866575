"""Plants that are models, in studies: a kind is its plant and one line here."""

from typing import Any, Literal

import jax.numpy as jnp
from pydantic import create_model as typed

from .. import plants
from ..plants import AbstractModelledPlant, AbstractVectorPlant, SynchronousReluctance
from ..schema import NonNegative, Positive, Table, Whole, key
from . import motor, offers
from ._study import Study

PLANTS: dict[str, type[AbstractVectorPlant]] = {
    "buck": plants.Buck,
    "boost": plants.Boost,
    "cuk": plants.Cuk,
    "dc_motor": plants.DCMotor,
    "dc_motor_with_tachometer": plants.DCMotorWithTachometer,
    "levitation": plants.Levitation,
    "battery": plants.Battery,
    "lateral_vehicle": plants.LateralVehicle,
    "chemostat": plants.Chemostat,
    "van_der_pol": plants.VanDerPol,
    "lorenz": plants.Lorenz,
    "cart_pole": plants.CartPole,
    "drone": plants.Drone,
}
create_model: Any = typed  # of fields that are known when it runs
SIGNS: dict[str, Any] = {"+": Positive, "0": NonNegative, "": float}


def _machine(kind: str, plant: type[AbstractModelledPlant], **further: Any) -> type[Table]:
    """`[machine]` of a plant: its parameters, with its defaults."""
    fields: dict[str, Any] = {
        name: (
            SIGNS[field.metadata["sign"]],
            key(field.metadata["about"], field.metadata["unit"], default=field.default),
        )
        for name, field in plant.parameters().items()
    }
    named: Any = Literal[kind]  # pyright: ignore[reportInvalidTypeForm]
    head = {"kind": (named, key("the kind of machine", example=kind))}
    return create_model(
        f"{plant.__name__}Table", __base__=Table, **(head | fields | further)
    )


def _acting(plant: type[AbstractVectorPlant]) -> type[Table]:
    """What a study adds: the state in which it starts."""
    moving = plant.moving()
    fields: dict[str, Any] = {
        name: (float, key(f"{name} at the start", span.unit, default=first))
        for (name, span), first in zip(moving.items(), plant.first, strict=True)
    }
    start = create_model(f"{plant.__name__}Start", __base__=Table, **fields)
    initial: Any = (start, key("the first state", default=start()))
    return create_model(f"{plant.__name__}Acting", __base__=Table, initial=initial)


def _study(kind: str, plant: type[AbstractVectorPlant]) -> Study:
    units = plant.hidden_units()

    def first(made: Any, table: Any) -> Any:
        del made
        return jnp.array(list(table.initial.model_dump().values()), float)

    return Study(
        machine=_machine(kind, plant),
        acting=_acting(plant),
        entries=tuple(units),
        units=tuple(units.values()),
        plant=lambda table: plant(**table.model_dump(exclude={"kind", "initial"})),
        observers=offers.of_model(),
        controls=("open_loop", "state_feedback") if plant.inputs else ("none",),
        bound=True,
        start=first,
    )


def _reluctance() -> Study:
    machine = _machine(
        "synchronous_reluctance",
        SynchronousReluctance,
        pole_pairs=(Whole, key("number of pole pairs", default=2)),
        inertia=(Positive, key("inertia of the rotor", "kg m^2", default=0.015)),
    )
    return Study(
        machine=machine,
        acting=motor.RotorTable,
        entries=("flux_alpha", "flux_beta"),
        units=("Wb", "Wb"),
        plant=lambda table: motor.with_load(SynchronousReluctance, table),
        observers=offers.of_modelled_machine(),
        controls=("reluctance_drive",),
        bound=True,
    )


STUDIES: tuple[Study, ...] = (
    *(_study(kind, plant) for kind, plant in PLANTS.items()),
    _reluctance(),
)
