"""Names of a package whose modules are imported when they are asked for (PEP 562)."""

import importlib
import sys
from collections.abc import Callable, Mapping, Sequence
from typing import Any


def lazily(
    package: str, names: Mapping[str, Sequence[str]], modules: Sequence[str] = ()
) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """The `__getattr__` and the `__dir__` of a `package`.

    - `names` that its modules define, by module, those of the package above after a dot;
    - `modules` that are names themselves.

    What was found is kept in the package, so that it is looked up once. Beside it the
    package has the names under `TYPE_CHECKING`, for type checkers and readers.
    """
    homes = {name: module for module, those in names.items() for name in those}

    def find(name: str) -> Any:
        if name in homes:
            home = importlib.import_module(f".{homes[name]}", package)
            found = getattr(home, name)
        elif name in modules:
            found = importlib.import_module(f"{package}.{name}")
        else:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        setattr(sys.modules[package], name, found)
        return found

    def names_of_package() -> list[str]:
        return sorted({*vars(sys.modules[package]), *homes, *modules})

    return find, names_of_package
