"""The public names: every one in the `__all__` of a module whose path is public."""

import importlib
import inspect
import pkgutil
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from typing import Any

from . import PACKAGE


@dataclass(frozen=True)
class Name:
    """A public name, documented once.

    - `module`: the one on whose page it stands, which is the package itself only for what
      no other module has; `name` in it; `value`;
    - `others`: the modules besides whose `__all__` has it.
    """

    module: str
    name: str
    value: Any
    others: tuple[str, ...]

    @property
    def path(self) -> str:
        return f"{self.module}.{self.name}"

    @property
    def is_documented(self) -> bool:
        """Whether it is a function or a class of ours, with a docstring of its own."""
        is_kind = inspect.isclass(self.value) or inspect.isfunction(self.value)
        return is_kind and self.value.__module__.split(".")[0] == PACKAGE


def public_modules() -> Iterator[str]:
    """The package and all within it whose path has no leading underscore and that have an
    `__all__`."""
    package = importlib.import_module(PACKAGE)
    yield PACKAGE
    for found in pkgutil.walk_packages(package.__path__, f"{PACKAGE}."):
        if any(part.startswith("_") for part in found.name.split(".")):
            continue
        if getattr(importlib.import_module(found.name), "__all__", ()):
            yield found.name


@cache
def public_names() -> tuple[Name, ...]:
    """Every public name but modules, in the order of its modules and their `__all__`."""
    found: dict[Any, list[tuple[str, str, Any]]] = {}
    for home in public_modules():
        module = importlib.import_module(home)
        for name in module.__all__:
            value = getattr(module, name)
            if inspect.ismodule(value) or name == "__version__":
                continue
            is_kind = inspect.isclass(value) or inspect.isroutine(value)
            key = id(value) if is_kind else (home, name)
            found.setdefault(key, []).append((home, name, value))
    names = [_documented(places) for places in found.values()]
    order = {home: k for k, home in enumerate(public_modules())}
    return tuple(sorted(names, key=lambda each: (order[each.module], each.name.lower())))


def _documented(places: list[tuple[str, str, Any]]) -> Name:
    own = getattr(places[0][2], "__module__", "")
    # Of several, the one that defines it, as far as its path is public; else the first
    # below the package.
    rank = lambda place: (place[0] == PACKAGE, not own.startswith(place[0]))
    module, name, value = min(places, key=rank)
    return Name(module, name, value, tuple(p[0] for p in places if p[0] != module))
