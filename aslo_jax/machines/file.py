"""TOML files of machine descriptions: read, explained, and written as templates."""

import difflib
import tomllib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Literal, get_args, get_origin

from pydantic import BaseModel, ValidationError

from .ball_beam import BallBeamDescription
from .base import AbstractDescription, MachineError
from .interior_pmsm import InteriorPMSMDescription
from .magnetic_bearing import MagneticBearingDescription
from .mechanical import MechanicalDescription
from .pmsm import PMSMDescription
from .robotic_leg import RoboticLegDescription
from .stepper import StepperDescription
from .wrim import WRIMDescription

Kind = type[AbstractDescription[Any, Any]]

KINDS: dict[str, Kind] = {
    description.kind: description
    for description in (
        PMSMDescription,
        StepperDescription,
        InteriorPMSMDescription,
        WRIMDescription,
        MagneticBearingDescription,
        RoboticLegDescription,
        BallBeamDescription,
        MechanicalDescription,
    )
}


def read_machine(path: Path | str) -> AbstractDescription[Any, Any]:
    """Read and check the TOML file `path`; `kind = "mechanical"` runs the Python that it
    names.

    **Raises:** [`MachineError`][] for text that is not TOML, and for a key that is missing,
    unknown or out of range; `OSError` where the file cannot be opened.
    """
    path = Path(path)
    if not path.exists():
        raise FileNotFoundError(f"{path} does not exist.")
    if path.is_dir():
        raise MachineError(f"{path} is a directory, but a machine is a TOML file.")
    try:
        content = tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise MachineError(f"{path} is not valid TOML: {error}") from error
    kind = _kind(path, content)
    try:
        return kind.model_validate(content, context={"folder": path.parent})
    except ValidationError as error:
        # A key that may be of two types has a fault for each, explained alike.
        faults = dict.fromkeys(_explain(kind, fault, content) for fault in error.errors())
        raise MachineError(f"{path}: {'; '.join(faults)}.") from None


def template(kind: str) -> str:
    """An example of a description of the `kind`, as TOML with a comment for every key."""
    description = _known(kind, "Argument `kind` (option --kind)")
    machine, observer = (_tables(description)[name] for name in ("machine", "observer"))
    required = [_line(name, field) for name, field in machine.model_fields.items()]
    optional = [_line(name, field, "# ") for name, field in observer.model_fields.items()]
    return "\n".join(
        [
            f"# {description.title}. All values in SI units.",
            "[machine]",
            *required,
            "",
            "# Every key is optional.",
            "[observer]",
            *optional,
            "",
        ]
    )


def _line(name: str, field: Any, prefix: str = "") -> str:
    (example,) = field.examples
    value = _toml(field.default if example is None else example)
    choices = get_args(field.annotation) if get_origin(field.annotation) is Literal else ()
    others = [f'"{choice}"' for choice in choices if choice != field.default]
    comment = field.description
    if name == "kind":
        return f"{prefix}{name} = {value}"
    if others:
        comment += f"; or {', '.join(others)}"
    return f"{prefix}{name} = {value}".ljust(34) + f"  # {comment}"


def _toml(value: Any) -> str:
    return f'"{value}"' if isinstance(value, str) else repr(value)


def _kind(path: Path, content: Mapping[str, Any]) -> Kind:
    machine = content.get("machine")
    if not isinstance(machine, dict):
        state = "is missing" if machine is None else "must be a table"
        others = [name for name in content if name not in ("machine", "observer")]
        raise MachineError(
            f"{path}: the table `[machine]` {state}; its first key is `kind`, one of "
            f"{_choices(KINDS)}{_hint('machine', others, ', where the file has `{}`')}."
        )
    if "kind" not in machine:
        raise MachineError(
            f"{path}: `machine.kind`, the kind of machine, is missing: it must be one of "
            f"{_choices(KINDS)}."
        )
    return _known(machine["kind"], f"{path}: `machine.kind`, the kind of machine,")


def _known(kind: Any, what: str) -> Kind:
    if isinstance(kind, str) and kind in KINDS:
        return KINDS[kind]
    hint = _hint(str(kind), KINDS, "; did you mean `{}`?")
    raise MachineError(
        f"{what} must be one of {_choices(KINDS)}, but is {kind!r}{hint or '.'}"
    )


def _hint(name: str, candidates: Any, text: str) -> str:
    close = difflib.get_close_matches(name, list(candidates), n=1)
    close = close or [candidate for candidate in candidates if candidate.startswith(name)]
    return text.format(close[0]) if close else ""


def _choices(names: Any) -> str:
    return ", ".join(f'"{name}"' for name in names)


def _tables(kind: Kind) -> dict[str, type[BaseModel]]:
    return {name: field.annotation for name, field in kind.model_fields.items()}  # pyright: ignore[reportReturnType]


def _explain(kind: Kind, fault: Any, content: Mapping[str, Any]) -> str:
    """One fault that pydantic found, as a clause: key path, what is allowed, what is."""
    if fault["type"] == "value_error":  # a check of several keys, which explains itself
        return str(fault["ctx"]["error"])
    table, *keys = fault["loc"]
    tables = _tables(kind)
    if fault["type"] == "extra_forbidden":
        return _explain_extra(kind, table, *keys)
    if not keys:
        allowed = ", ".join(tables[table].model_fields)
        return f"the table `[{table}]` must be a table; its keys: {allowed}"
    field = tables[table].model_fields[keys[0]]
    notes: Any = field.json_schema_extra
    what = f"`{table}.{keys[0]}`, {field.description},"
    allowed = notes["allowed"] or _allowed(field.annotation, fault["type"])
    if fault["type"] == "missing":
        return f"{what} is missing: it must be {allowed}"
    found = content[table][keys[0]]
    because = f": {notes['because']}" if notes["because"] else ""
    return f"{what} must be {allowed}, but is {found!r}{because}"


def _allowed(annotation: Any, fault: str) -> str:
    if fault == "literal_error":
        return " or ".join(f'"{choice}"' for choice in get_args(annotation))
    return "a positive whole number" if annotation is int else "a positive finite number"


def _explain_extra(kind: Kind, table: str, key: str | None = None) -> str:
    tables = _tables(kind)
    known = list(tables if key is None else tables[table].model_fields)
    path = table if key is None else f"{table}.{key}"
    if table == "observer" and key is not None and key in kind.refused:
        return f'`{path}` is not for kind = "{kind.kind}": {kind.refused[key]}'
    hint = _hint(key or table, known, "did you mean `{}`? ")
    owners = list(_owners(table, key)) if key is not None else []
    if owners and not hint:
        hint = f"a key of {' and '.join(owners)}; "
    of = f' of kind = "{kind.kind}"' if key is not None else ""
    return f"unknown key `{path}`{of} ({hint}allowed: {', '.join(known)})"


def _owners(table: str, key: str) -> Iterator[str]:
    """The kinds that have `key` in `table`."""
    for name, kind in KINDS.items():
        if key in _tables(kind)[table].model_fields:
            yield name
