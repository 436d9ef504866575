"""TOML files of machine descriptions: read, explained, and written as templates."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ValidationError

from ..schema import choices, explain, hint, read_toml, template_lines, unknown_key
from ._base import AbstractDescription, MachineError
from ._registry import KINDS as KINDS, Kind, known_kind


def read_machine(path: Path | str) -> AbstractDescription:
    """Read and check the TOML file `path`; the kinds `"mechanical"` and
    `"derived"` run the Python that they name.

    **Raises:** [`MachineError`][] for text that is not TOML, and for a key that is missing,
    unknown or out of range; `OSError` where the file cannot be opened.
    """
    path = Path(path)
    if not path.exists():
        raise FileNotFoundError(f"{path} does not exist.")
    if path.is_dir():
        raise MachineError(f"{path} is a directory, but a machine is a TOML file.")
    content = read_toml(path, MachineError)
    kind = _kind(path, content)
    try:
        return kind.model_validate(content, context={"folder": path.parent})
    except ValidationError as error:
        unknown = lambda place, owner: _unknown(kind, place, owner)
        faults = explain(kind, error, content, unknown=unknown, in_full=True)
        raise MachineError(f"{path}: {faults}.") from None


def machine_of(content: Mapping[str, Any], folder: Path = Path()) -> AbstractDescription:
    """The machine of a study's file, its `content`, without what acts on it there, as
    [`read_machine`][] gives it; the file lies in `folder`.

    **Raises:** [`MachineError`][] for a kind of machine that has no logs.
    """
    machine = content["machine"]
    kind = known_kind(machine["kind"], "`machine.kind` of a machine with a log")
    table: Any = kind.model_fields["machine"].annotation
    known = {k: v for k, v in machine.items() if k in table.model_fields}
    return kind.model_validate({"machine": known}, context={"folder": folder})


def template(kind: str) -> str:
    """An example of a description of the `kind`, as TOML with a comment for every key."""
    description = known_kind(kind, "Argument `kind` (option --kind)")
    tables: Any = _tables(description)
    lines = template_lines(tables["calibration"], "# ")
    head = ["", "# Of `aslo-jax calibrate`.", "# [calibration]"]
    calibrated = [] if description.unknowns.refused else [*head, *lines]
    return "\n".join(
        [
            f"# {description.title}. All values in SI units.",
            "[machine]",
            *template_lines(tables["machine"]),
            "",
            "# Every key is optional.",
            "[observer]",
            *template_lines(tables["observer"], "# "),
            *calibrated,
            "",
        ]
    )


def _kind(path: Path, content: Mapping[str, Any]) -> Kind:
    machine = content.get("machine")
    if not isinstance(machine, dict):
        state = "is missing" if machine is None else "must be a table"
        others = [
            name for name in content if name not in ("machine", "observer", "calibration")
        ]
        raise MachineError(
            f"{path}: the table `[machine]` {state}; its first key is `kind`, one of "
            f"{choices(KINDS)}{hint('machine', others, ', where the file has `{}`')}."
        )
    if "kind" not in machine:
        raise MachineError(
            f"{path}: `machine.kind`, the kind of machine, is missing: it must be one of "
            f"{choices(KINDS)}."
        )
    kind = known_kind(machine["kind"], f"{path}: `machine.kind`, the kind of machine,")
    if not isinstance(content.get("observer", {}), dict):
        allowed = ", ".join(_tables(kind)["observer"].model_fields)
        raise MachineError(
            f"{path}: the table `[observer]` must be a table; its keys: {allowed}."
        )
    return kind


def _tables(kind: Kind) -> dict[str, type[BaseModel]]:
    return {name: field.annotation for name, field in kind.model_fields.items()}  # pyright: ignore[reportReturnType]


def _unknown(kind: Kind, path: list[str], owner: type[BaseModel]) -> str:
    """What to say of a key that is not one of this kind."""
    table, *keys = path
    if len(keys) != 1:
        return unknown_key(path, owner)
    (key,), name = keys, ".".join(path)
    if table == "observer" and key in kind.refused:
        return f'`{name}` is not for kind = "{kind.kind}": {kind.refused[key]}'
    known = list(owner.model_fields)
    near = hint(key, known, "did you mean `{}`? ")
    owners = list(_owners(table, key))
    if owners and not near:
        near = f"a key of {' and '.join(owners)}; "
    return (
        f'unknown key `{name}` of kind = "{kind.kind}" ({near}allowed: {", ".join(known)})'
    )


def _owners(table: str, key: str) -> Iterator[str]:
    """The kinds that have `key` in `table`."""
    for name, kind in KINDS.items():
        if key in _tables(kind)[table].model_fields:
            yield name
