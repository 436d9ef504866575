"""An example of a table, as TOML with a comment for every key."""

from typing import Any, Literal, get_args, get_origin

from ._table import Table


def template_lines(table: type[Table], prefix: str = "") -> list[str]:
    """A line for every key of a `table`, with its example, each after the `prefix`."""
    return [_line(name, field, prefix) for name, field in table.model_fields.items()]


def _line(name: str, field: Any, prefix: str) -> str:
    (example,) = field.examples
    value = _toml(field.default if example is None else example)
    is_choice = get_origin(field.annotation) is Literal
    choices = get_args(field.annotation) if is_choice else ()
    others = [f'"{choice}"' for choice in choices if choice != field.default]
    comment = field.description
    if name == "kind" and len(choices) < 2:
        return f"{prefix}{name} = {value}"
    if others:
        comment += f"; or {', '.join(others)}"
    return f"{prefix}{name} = {value}".ljust(34) + f"  # {comment}"


def _toml(value: Any) -> str:
    return f'"{value}"' if isinstance(value, str) else repr(value)
