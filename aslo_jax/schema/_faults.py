"""What is wrong with a file, from what pydantic found: the path of the key, what is
allowed, and what is there."""

import difflib
from collections.abc import Callable, Iterable, Iterator
from typing import Annotated, Any, Literal, get_args, get_origin

from pydantic import BaseModel, ValidationError

TAGS = ("kind", "distribution")
Unknown = Callable[[list[str], type[BaseModel]], str]


def hint(name: str, candidates: Iterable[str], text: str) -> str:
    """`text` with the `candidates` nearest to `name` in it, nothing where none is near."""
    candidates = list(candidates)
    close = difflib.get_close_matches(name, candidates, n=1)
    close = close or [each for each in candidates if name and each.startswith(name)]
    return text.format(close[0]) if close else ""


def choices(names: Iterable[str]) -> str:
    """The `names` in quotes, as they stand in a file."""
    return ", ".join(f'"{name}"' for name in names)


def unknown_key(path: list[str], owner: type[BaseModel]) -> str:
    """That the table `owner` has no key at `path`, and which it has."""
    known = list(owner.model_fields)
    near = hint(path[-1], known, "did you mean `{}`? ")
    return f"unknown key `{'.'.join(path)}` ({near}allowed: {', '.join(known)})"


def explain(
    model: type[BaseModel],
    error: ValidationError,
    content: Any,
    *,
    unknown: Unknown = unknown_key,
    in_full: bool = False,
) -> str:
    """Every fault as a clause.

    - `model`: of the file; `error`: that of reading the `content` of one by it;
    - `unknown(path, owner)`: what to say of a key that the table `owner` has not;
    - `in_full`: whether all is said that a number must be, not only what it lacks.
    """
    # A key that may be of two types has a fault for each, explained alike.
    clauses = (_clause(model, fault, content, unknown, in_full) for fault in error.errors())
    return "; ".join(dict.fromkeys(clauses))


def _clause(
    model: type[BaseModel], fault: Any, content: Any, unknown: Unknown, in_full: bool
) -> str:
    path, field, owner, value = _walk(model, fault, content)
    about = "" if field is None or not field.description else f", {field.description},"
    what = f"`{'.'.join(path)}`{about}"
    kind = fault["type"]
    if kind == "value_error":  # a check of several keys, which explains itself
        return str(fault["ctx"]["error"])
    if kind == "extra_forbidden":
        return unknown(path, owner)
    if kind == "missing" or field is None:
        return f"{what} is missing: it must be {_allowed(field)}"
    if kind == "union_tag_not_found":
        tag = fault["ctx"]["discriminator"].strip("'")
        allowed = choices(_tags(field.annotation))
        return f"`{'.'.join((*path, tag))}` is missing: it must be one of {allowed}"
    if kind == "union_tag_invalid":
        tag = fault["ctx"]["discriminator"].strip("'")
        found, names = fault["ctx"]["tag"], list(_tags(field.annotation))
        near = hint(found, names, "; did you mean `{}`?")
        return (
            f"`{'.'.join((*path, tag))}` must be one of {choices(names)}, but is "
            f"{found!r}{near}"
        )
    reason = (field.json_schema_extra or {}).get("because")
    because = f": {reason}" if reason else ""
    allowed = _allowed(field, None if in_full else fault)
    return f"{what} must be {allowed}, but is {value!r}{because}"


def _walk(model: Any, fault: Any, content: Any) -> tuple[list[str], Any, Any, Any]:
    """Path, field and owner of a fault, and what the file has there. Where a field may be
    of several types, pydantic's location names the type that it tried, which is no key."""
    path: list[str] = []
    field, owner, annotation = None, model, model
    place = list(fault["loc"])
    for k, item in enumerate(place):
        last = k == len(place) - 1
        if len(list(_models(annotation))) > 1 and item in _tags_of(content):
            annotation = _model(annotation, content)
            continue
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
        if field is not None and _is_described(field):
            break
    return path, field, owner, content


def _is_described(field: Any) -> bool:
    """Whether the whole value of a field is described by what its key says is `allowed`."""
    notes = field.json_schema_extra or {}
    return bool(notes.get("allowed")) and not _holds_tables(field.annotation)


def _holds_tables(annotation: Any) -> bool:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return True
    return any(map(_holds_tables, get_args(annotation)))


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


def _tags_of(content: Any) -> list[Any]:
    return [content.get(tag) for tag in TAGS] if isinstance(content, dict) else []


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
    if field is None:
        return "given"
    annotation, bounds = field.annotation, list(field.metadata)
    parts = [part for part in get_args(annotation) if part is not type(None)]
    if len(parts) == 1 and get_origin(parts[0]) is Annotated:  # one type, or nothing
        annotation, *notes = get_args(parts[0])
        bounds = [bound for note in notes for bound in getattr(note, "metadata", [note])]
    if any(type(bound).__name__ == "Gt" for bound in bounds):
        whole = annotation is int
        return "a positive whole number" if whole else "a positive finite number"
    names = {float: "a finite number", int: "a whole number", str: "a text"}
    if isinstance(annotation, type) and annotation in names:
        return names[annotation]
    return "a table" if list(_models(annotation)) else "given"
