"""What is wrong with a file, from what pydantic found: the path of the key, what is
allowed, and what is there."""

import difflib
from collections.abc import Iterator
from typing import Any, Literal, get_args, get_origin

from pydantic import BaseModel, ValidationError

TAGS = ("kind", "distribution")


def explain(model: type[BaseModel], error: ValidationError, content: Any) -> str:
    """Every fault as a clause."""
    faults = dict.fromkeys(_clause(model, fault, content) for fault in error.errors())
    return "; ".join(faults)


def _clause(model: type[BaseModel], fault: Any, content: Any) -> str:
    path, field, owner, value = _walk(model, fault, content)
    about = "" if field is None or not field.description else f", {field.description},"
    what = f"`{'.'.join(path)}`{about}"
    kind = fault["type"]
    if kind == "value_error":
        return str(fault["ctx"]["error"])
    if kind == "extra_forbidden":
        return _unknown(path, owner)
    if kind == "missing" or field is None:
        return f"{what} is missing: it must be {_allowed(field)}"
    if kind == "union_tag_not_found":
        tag = fault["ctx"]["discriminator"].strip("'")
        allowed = ", ".join(f'"{name}"' for name in _tags(field.annotation))
        return f"`{'.'.join((*path, tag))}` is missing: it must be one of {allowed}"
    if kind == "union_tag_invalid":
        tag = fault["ctx"]["discriminator"].strip("'")
        found, names = fault["ctx"]["tag"], list(_tags(field.annotation))
        allowed = ", ".join(f'"{name}"' for name in names)
        close = difflib.get_close_matches(found, names, n=1)
        hint = f"; did you mean `{close[0]}`?" if close else ""
        return (
            f"`{'.'.join((*path, tag))}` must be one of {allowed}, but is {found!r}{hint}"
        )
    return f"{what} must be {_allowed(field, fault)}, but is {value!r}"


def _walk(model: Any, fault: Any, content: Any) -> tuple[list[str], Any, Any, Any]:
    """Path, field and owner of a fault, and what the file has there. Where a field may be
    of several types, pydantic's location names the type that it tried, which is no key."""
    path: list[str] = []
    field, owner, annotation = None, model, model
    place = list(fault["loc"])
    for k, item in enumerate(place):
        last = k == len(place) - 1
        inside = isinstance(content, dict) and item in content
        inside = inside or (isinstance(content, list) and isinstance(item, int))
        absent = last and fault["type"] == "missing"
        if not (inside or absent):
            continue
        table = _model(annotation, content)
        if table is not None:
            owner = table
            field = table.model_fields.get(str(item))
            annotation = None if field is None else field.annotation
        else:
            annotation = (get_args(annotation) or (None,))[-1]
        path.append(str(item))
        content = content[item] if inside else None
    return path, field, owner, content


def _models(annotation: Any) -> Iterator[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    elif get_origin(annotation) not in (dict, list):
        for part in get_args(annotation):
            yield from _models(part)


def _model(annotation: Any, content: Any) -> type[BaseModel] | None:
    """The table that `content` is validated as."""
    models = list(_models(annotation))
    if len(models) < 2 or not isinstance(content, dict):
        return models[0] if models else None
    for model in models:
        if any(content.get(tag) in _choices(model, tag) for tag in TAGS):
            return model
    return models[0]


def _choices(model: type[BaseModel], tag: str) -> tuple[Any, ...]:
    field = model.model_fields.get(tag)
    return () if field is None else get_args(field.annotation)


def _tags(annotation: Any) -> Iterator[str]:
    args = get_args(annotation)
    models = list(_models(annotation)) or [m for arg in args for m in _models(arg)]
    for model in models:
        for tag in TAGS:
            yield from _choices(model, tag)
            if _choices(model, tag):
                break


def _unknown(path: list[str], owner: type[BaseModel]) -> str:
    known = list(owner.model_fields)
    close = difflib.get_close_matches(path[-1], known, n=1)
    hint = f"did you mean `{close[0]}`? " if close else ""
    return f"unknown key `{'.'.join(path)}` ({hint}allowed: {', '.join(known)})"


def _allowed(field: Any, fault: Any = None) -> str:
    notes = None if field is None else field.json_schema_extra
    if notes and notes.get("allowed"):
        return notes["allowed"]
    annotation = None if field is None else field.annotation
    if get_origin(annotation) is Literal:
        return " or ".join(f'"{choice}"' for choice in get_args(annotation))
    if fault is not None:
        return str(fault["msg"]).removeprefix("Input should be ").replace("valid ", "")
    return _in_words(field)


def _in_words(field: Any) -> str:
    annotation = None if field is None else field.annotation
    if any(type(each).__name__ == "Gt" for each in getattr(field, "metadata", ())):
        whole = annotation is int
        return "a positive whole number" if whole else "a positive finite number"
    names = {float: "a finite number", int: "a whole number", str: "a text"}
    if isinstance(annotation, type) and annotation in names:
        return names[annotation]
    return "a table" if list(_models(annotation)) else "given"
