"""A table of a TOML file, and its keys."""

from typing import Annotated, Any, ClassVar

from .._extras import missing

try:
    from pydantic import BaseModel, ConfigDict, Field
except ModuleNotFoundError as error:
    raise missing("pydantic", "cli") from error


class Table(BaseModel):
    """A table of a file: unknown keys, text for a number, NaN are refused."""

    model_config: ClassVar[ConfigDict] = ConfigDict(
        extra="forbid", strict=True, frozen=True, allow_inf_nan=False
    )


Positive = Annotated[float, Field(gt=0)]
NonNegative = Annotated[float, Field(ge=0)]
Whole = Annotated[int, Field(gt=0)]
Numbers = float | Annotated[list[float], Field(min_length=1)]


def key(
    description: str,
    unit: str = "",
    *,
    default: Any = ...,
    example: Any = None,
    allowed: str | None = None,
    because: str = "",
) -> Any:
    """A key of a table.

    - `description`: in words, for messages and templates; `default`: its value where a file
      has none, without which it is required;
    - `unit`: of a number, in SI; a key of `[observer]` in rad/s is a rate of the observer;
    - `example`: what [`template_lines`][] writes, by default the default;
    - `allowed`, `because`: for messages, where the type alone does not tell.
    """
    full = f"{description} ({unit})" if unit else description
    notes = {"unit": unit, "allowed": allowed, "because": because}
    return Field(
        default=default, description=full, examples=[example], json_schema_extra=notes
    )


def is_rate(field: Any) -> bool:
    """Whether a `field` of a table is a rate (rad/s)."""
    return unit_of(field) == "rad/s"


def unit_of(field: Any) -> str:
    """The unit of a `field` of a table, empty where it has none."""
    notes = field.json_schema_extra
    return str(notes["unit"]) if notes else ""
