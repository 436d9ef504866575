"""A mechanical system, or a model, from an import path."""

import difflib
import importlib
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from ..plants import AbstractMechanicalSystem
from ._base import MachineError


def load_system(path: str, folder: Path) -> AbstractMechanicalSystem:
    """The mechanical system of an import path, as [`load`][] finds it."""
    hint = "an `AbstractMechanicalSystem`, for instance a `MechanicalSystem`"
    return load(path, folder, f"`machine.system`, {path}:", AbstractMechanicalSystem, hint)


def load(path: str, folder: Path, what: str, wanted: Any, hint: str) -> Any:
    """What `path`, `"package.module:attribute"`, names, or what that returns when it is
    called. Modules of `folder` come before installed ones, for this call only. `what`
    begins the messages, the `hint` says what is `wanted`.

    **Raises:** [`MachineError`][] where there is no such module or attribute, where running
    the module fails, and for what is not `wanted`.
    """
    module, _, names = path.partition(":")
    with _importable(folder):
        found = _import(module, folder, what)
        for name in names.split("."):
            found = _attribute(found, name, what)
        if callable(found) and not isinstance(found, wanted):
            found = _call(found, names, what)
    if not isinstance(found, wanted):
        raise MachineError(
            f"{what} it must be {hint}, or return one, but it is {_a(found)}"
        )
    return found


@contextmanager
def _importable(folder: Path) -> Iterator[None]:
    """`folder` first in the path of imports. Its modules are forgotten afterwards, so that
    one of the same name in another folder is not mistaken for it."""
    folder = folder.resolve()
    path, modules = list(sys.path), set(sys.modules)
    sys.path.insert(0, str(folder))
    importlib.invalidate_caches()
    try:
        yield
    finally:
        sys.path[:] = path
        for name in set(sys.modules) - modules:
            file = getattr(sys.modules[name], "__file__", None)
            if file and Path(file).is_relative_to(folder):
                del sys.modules[name]


def _import(module: str, folder: Path, what: str) -> Any:
    try:
        return importlib.import_module(module)
    except ModuleNotFoundError as error:
        lacking = str(error.name)
        if module == lacking or module.startswith(f"{lacking}."):
            raise MachineError(
                f"{what} there is no module `{lacking}`, neither in {folder.resolve()} nor "
                "installed; put it beside the TOML file or install it"
            ) from error
        raise MachineError(_failed(what, "importing it", error)) from error
    except (Exception, SystemExit) as error:  # whatever the user's code raises
        raise MachineError(_failed(what, "importing it", error)) from error


def _attribute(found: Any, name: str, what: str) -> Any:
    try:
        return getattr(found, name)
    except AttributeError:
        public = [each for each in dir(found) if not each.startswith("_")]
        close = difflib.get_close_matches(name, public, n=1)
        hint = f"; did you mean `{close[0]}`?" if close else ""
        raise MachineError(f"{what} there is no attribute `{name}` in it{hint}") from None


def _call(function: Any, names: str, what: str) -> Any:
    try:
        return function()
    except (Exception, SystemExit) as error:
        raise MachineError(_failed(what, f"calling {names}()", error)) from error


def _failed(what: str, doing: str, error: BaseException) -> str:
    return f"{what} {doing} failed with {type(error).__name__}: {error}"


def _a(found: Any) -> str:
    name = type(found).__name__
    return f"an {name}" if name[0].lower() in "aeiou" else f"a {name}"
