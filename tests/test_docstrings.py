"""Whoever asks for help on a public name finds each parameter, shape and error there."""

import ast
import dataclasses
import importlib
import inspect
import pkgutil
import re
import textwrap
from collections.abc import Iterator
from functools import cache
from types import UnionType
from typing import Any, Union, get_args, get_origin, get_type_hints

from jaxtyping import AbstractArray

import aslo_jax

# What Python's own protocols ask for, and nobody catches.
PROTOCOL = {"AssertionError", "AttributeError", "NotImplementedError"}


def public_modules() -> Iterator[str]:
    """The package and all within it whose path has no leading underscore."""
    yield aslo_jax.__name__
    for found in pkgutil.walk_packages(aslo_jax.__path__, f"{aslo_jax.__name__}."):
        if not any(part.startswith("_") for part in found.name.split(".")):
            yield found.name


@cache
def public_names() -> dict[str, Any]:
    """The functions and classes of all public modules, each by the first of its names."""
    found: dict[int, tuple[str, Any]] = {}
    for home in public_modules():
        module = importlib.import_module(home)
        for name in getattr(module, "__all__", ()):
            value = getattr(module, name)
            if (inspect.isclass(value) or inspect.isfunction(value)) and is_ours(value):
                found.setdefault(id(value), (f"{home}.{name}", value))
    return dict(found.values())


def is_ours(value: Any) -> bool:
    return value.__module__.split(".")[0] == "aslo_jax"


def own(value: Any) -> str:
    return inspect.cleandoc(vars(value).get("__doc__") or "")


def documentation(value: Any) -> str:
    """The docstring; of a class, those of its bases in this package besides."""
    if not inspect.isclass(value):
        return inspect.getdoc(value) or ""
    return "\n\n".join(own(base) for base in value.__mro__ if is_ours(base))


def parameters(value: Any) -> dict[str, Any]:
    """What `value` is called or made with, each name with its annotation."""
    if dataclasses.is_dataclass(value):
        names = [field.name for field in dataclasses.fields(value) if field.init]
    elif inspect.isclass(value) and hasattr(value, "model_fields"):
        names = list(value.model_fields)
    elif inspect.isclass(value) and not hasattr(value, "_fields"):
        value = vars(value).get("__init__")
        names = list(inspect.signature(value).parameters)[1:] if value else []
    else:
        names = list(inspect.signature(value).parameters)
    try:
        hints = get_type_hints(value) if names else {}
    except NameError:  # a name for type checkers only
        hints = inspect.get_annotations(value)
    return {name: hints.get(name) for name in names if not name.startswith("_")}


def has_axes(annotation: Any) -> bool:
    """Whether it may be an array that is no scalar; a random key has a shape of its own."""
    if get_origin(annotation) in (Union, UnionType):
        return any(has_axes(part) for part in get_args(annotation))
    is_array = inspect.isclass(annotation) and issubclass(annotation, AbstractArray)
    return is_array and annotation is not aslo_jax.random.Key and annotation.dim_str != ""


def passages(parameter: str, text: str) -> list[str]:
    """The paragraphs and list entries of a docstring that name a parameter as code."""
    quoted = re.compile(rf"`[^`]*\b{re.escape(parameter)}\b[^`]*`")
    return [part for part in re.split(r"\n\s*\n|\n(?=\s*- )", text) if quoted.search(part)]


def errors(source: ast.AST) -> set[str]:
    """The errors that are raised by name."""
    thrown = [node.exc for node in ast.walk(source) if isinstance(node, ast.Raise)]
    kinds = [error.func for error in thrown if isinstance(error, ast.Call)]
    return {kind.id for kind in kinds if isinstance(kind, ast.Name)} - PROTOCOL


def untold_errors(value: Any) -> set[str]:
    """The errors that neither a docstring with **Raises:** nor that of its class tells."""
    if "**Raises:**" in documentation(value):
        return set()
    tree = ast.parse(textwrap.dedent(inspect.getsource(value))).body[0]
    if not isinstance(tree, ast.ClassDef):
        return errors(tree)
    return set().union(
        *(
            errors(part)
            for part in tree.body
            if not isinstance(part, ast.FunctionDef)
            or "**Raises:**" not in (inspect.getdoc(vars(value).get(part.name)) or "")
        )
    )


def faults(of: Any) -> dict[str, Any]:
    return {name: found for name, value in public_names().items() if (found := of(value))}


def test_modules_are_found_by_walking():
    assert {"aslo_jax.filters", "aslo_jax.tune.losses"} <= set(public_modules())
    assert len(public_names()) > 200


def test_every_name_has_a_docstring():
    assert not faults(lambda value: not own(value) and not inspect.getdoc(value))


def test_the_names_of_abstract_classes_say_so():
    """What has no meaning of its own cannot be made."""

    def misnamed(value: Any) -> bool:
        abstract = inspect.isclass(value) and inspect.isabstract(value)
        return abstract != value.__name__.startswith("Abstract")

    assert not faults(misnamed)


def test_every_parameter_is_named():
    def unnamed(value: Any) -> list[str]:
        text = documentation(value)
        return [name for name in parameters(value) if not passages(name, text)]

    assert not faults(unnamed)


def test_every_array_has_a_shape():
    def shapeless(value: Any) -> list[str]:
        text = documentation(value)
        return [
            name
            for name, annotation in parameters(value).items()
            if has_axes(annotation)
            and not any("shape" in part for part in passages(name, text))
        ]

    assert not faults(shapeless)


def test_every_error_is_told():
    assert not faults(untold_errors)
