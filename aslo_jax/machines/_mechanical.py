"""`kind = "mechanical"`: any mechanical system, written in Python."""

from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

import jax
from pydantic import Field, PrivateAttr, model_validator

from .._structure import Structure, structure_of
from ..schema import Table, key
from ._base import Layout, Unknowns
from ._mechanism import AbstractMechanism, layout
from ._python import load_system

OPEN = "here two coordinates, of which q2 is an angle, and two inputs: the system decides"


class MechanicalTable(Table):
    """`[machine]` of a mechanical system."""

    kind: Literal["mechanical"] = key("the kind of machine", example="mechanical")
    system: Annotated[str, Field(pattern=r"^\w+(\.\w+)*:\w+(\.\w+)*$")] = key(
        "an `AbstractMechanicalSystem`, or what returns one; Python that is run",
        example="robot:arm",
        allowed='"module:attribute", with dots where there are packages',
    )


class MechanicalDescription(AbstractMechanism[MechanicalTable]):
    """A mechanical system of one's own. Reading its description runs the module that
    `system` names, which may lie beside the TOML file.

    **Raises:** `ValueError` where the module cannot be run, or gives no mechanical system.
    """

    machine: MechanicalTable
    _system: Any = PrivateAttr(default=None)
    _form: Any = PrivateAttr(default=None)

    kind = "mechanical"
    title: ClassVar[str] = "Mechanical system"
    layout: ClassVar[Layout] = layout((False, True), 2, OPEN)
    unknowns: ClassVar[Unknowns] = Unknowns(
        refused="its parameters are in Python; use `aslo_jax.tune.calibrate` there"
    )

    @model_validator(mode="after")
    def _load(self, info):
        folder = (info.context or {}).get("folder", Path())
        self._system = load_system(self.machine.system, folder)
        try:
            self._form = structure_of(self._system)
        except ValueError as error:
            raise ValueError(f"`machine.system`, {self.machine.system}: {error}") from error
        return self

    def plant(self) -> Any:
        return self._system

    def form(self) -> Structure:
        return self._form

    def columns_of_log(self):
        q = self._system.initial().position
        inputs = jax.eval_shape(self._system.no_input, q).shape[0]
        return layout(self._system.angles or (False,) * q.shape[0], inputs)
