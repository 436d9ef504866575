"""Extensions of griffe: what it cannot read from the source.

The constructors of equinox's modules, named tuples and pydantic's models are made by their
metaclass; and docstrings name what is public without its module.
"""

import re
from collections.abc import Mapping
from typing import Any

import griffe

SHORT = re.compile(r"\[`([\w.]+)`\]\[\]")
# Whose subclasses have a constructor of their fields, however their source names them.
KINDS = {"Module", "NamedTuple", "BaseModel"}


class Fields(griffe.Extension):
    """Gives every class the `__init__` that its metaclass makes of its fields, if any."""

    def on_package(self, *, pkg: griffe.Module, **_: Any) -> None:
        # All before the first is set: a class would inherit what its base was given.
        lacking = [each for each in _classes(pkg) if "__init__" not in each.all_members]
        for each, made in [(each, constructor(each)) for each in lacking]:
            each.set_member("__init__", made)
        # What griffe makes for dataclasses has no lines; the class is where it stands.
        for each in _classes(pkg):
            made = each.members.get("__init__")
            if isinstance(made, griffe.Function) and not made.endlineno:
                made.lineno, made.endlineno = each.lineno, each.endlineno


class ShortReferences(griffe.Extension):
    """Lets docstrings name what is public without its module, as [`Name`][]."""

    def on_package(self, *, pkg: griffe.Module, **_: Any) -> None:
        homes = public_homes(pkg)
        for each in _all(pkg):
            if each.docstring:
                each.docstring.value = in_full(each.docstring.value, homes)


def in_full(text: str, homes: Mapping[str, str]) -> str:
    """Markdown whose references have the path of what they name: `[`Name`][]` and
    `[`Name.method`][]`, for a `Name` that `homes` has."""

    def full(found: re.Match[str]) -> str:
        name, dot, method = found[1].partition(".")
        return f"[`{found[1]}`][{homes[name]}{dot}{method}]" if name in homes else found[0]

    return SHORT.sub(full, text)


def public_homes(package: griffe.Module) -> dict[str, str]:
    """Where the public names are defined that mean one thing in all public modules."""
    found: dict[str, set[str]] = {}
    modules = [package]
    for module in modules:
        inner = module.members.values()
        modules += [
            each
            for each in inner
            if isinstance(each, griffe.Module) and not each.name.startswith("_")
        ]
        for name in map(str, module.exports or ()):
            each = module.members.get(name)
            if each is not None and not isinstance(each, griffe.Module):
                found.setdefault(name, set()).add(each.canonical_path)
    return {name: min(paths) for name, paths in found.items() if len(paths) == 1}


def _all(of: griffe.Module | griffe.Class) -> list[griffe.Object]:
    inner = [each for each in of.members.values() if isinstance(each, griffe.Object)]
    deeper = [each for each in inner if isinstance(each, griffe.Module | griffe.Class)]
    return [*inner, *(each for those in deeper for each in _all(those))]


def _classes(module: griffe.Module) -> list[griffe.Class]:
    found: list[griffe.Class] = []
    for each in module.members.values():
        if isinstance(each, griffe.Module):
            found += _classes(each)
        elif isinstance(each, griffe.Class):
            found.append(each)
    return found


def has_fields(of: griffe.Class) -> bool:
    """Whether a class is below one whose metaclass makes the constructor, by the names of
    its bases."""
    bases = [str(base) for kind in (of, *of.mro()) for base in kind.bases]
    return any(base.partition("[")[0].split(".")[-1] in KINDS for base in bases)


def constructor(of: griffe.Class) -> griffe.Function:
    """`__init__` with the fields of a class and its bases, in their order; of an error,
    with what errors take."""
    fields: dict[str, griffe.Attribute] = {}
    for kind in [*reversed(of.mro()), of] if has_fields(of) else ():
        for name, each in kind.members.items():
            if isinstance(each, griffe.Attribute) and _is_field(each):
                fields[name] = each
    parameters = [
        griffe.Parameter(
            name,
            annotation=field.annotation,
            kind=griffe.ParameterKind.positional_or_keyword,
            default=default(field),
        )
        for name, field in fields.items()
        if not _given("init", field, "False")
    ]
    if any(str(base).endswith(("Error", "Exception")) for base in of.bases):
        kind = griffe.ParameterKind.var_positional
        parameters.append(griffe.Parameter("args", annotation="object", kind=kind))
    return griffe.Function(
        "__init__",
        lineno=of.lineno,
        endlineno=of.endlineno,
        parent=of,
        parameters=griffe.Parameters(
            griffe.Parameter("self", kind=griffe.ParameterKind.positional_or_keyword),
            *parameters,
        ),
        returns="None",
    )


def _is_field(each: griffe.Attribute) -> bool:
    return (
        each.annotation is not None
        and "instance-attribute" in each.labels  # griffe's word for no `ClassVar`
        and "AbstractVar" not in str(each.annotation)
        # Bare, it is an instance's to griffe.
        and not str(each.annotation).endswith("ClassVar")
        and not each.name.startswith("_")
    )


def default(field: griffe.Attribute) -> Any:
    """What a field is without an argument: of `field(default=...)` and of
    `parameter(about, unit, default)` too; that of a factory is a call of it."""
    value: Any = field.value
    if _is_call_of(value, "parameter") and len(value.arguments) >= 3:
        return value.arguments[2]
    if not _is_call_of(value, "field"):
        return value
    for each in value.arguments:
        if getattr(each, "name", "") == "default":
            return each.value
        if getattr(each, "name", "") == "default_factory":
            made = str(each.value).removeprefix("lambda: ")
            return made if made != str(each.value) else f"{made}()"
    return None


def _is_call_of(value: Any, name: str) -> bool:
    return isinstance(value, griffe.ExprCall) and (
        str(value.function).split(".")[-1] == name
    )


def _given(name: str, field: griffe.Attribute, value: str) -> bool:
    return _is_call_of(field.value, "field") and any(
        getattr(each, "name", "") == name and str(getattr(each, "value", "")) == value
        for each in field.value.arguments  # pyright: ignore[reportAttributeAccessIssue, reportOptionalMemberAccess]
    )
