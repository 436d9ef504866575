"""What the functions of a file have in common: helpers, tables, functions of scalars."""

import numpy as np

from ..._ir.graph import Function
from .helpers import helper
from .types import c_type, literal, short


class Unit:
    """The static parts of a file whose symbols begin with `prefix`, each once, in an order
    in which every one follows what it needs."""

    def __init__(self, prefix: str) -> None:
        self.prefix = prefix
        self.parts: list[str] = []
        self._helpers: set[tuple[str, np.dtype]] = set()
        self._tables: dict[tuple[str, bytes], str] = {}
        self.functions: dict[int, str] = {}
        self._kept: list[Function] = []  # whose identities are keys

    def helper(self, name: str, dtype: np.dtype) -> str:
        """The name in C of one of the `helpers`."""
        if (name, dtype) not in self._helpers:
            self._helpers.add((name, dtype))
            made = helper(name, dtype, self.prefix)
            for needed in made.needs:
                self.helper(*needed)
            self.parts.append(made.text)
        return f"{self.prefix}_{name}_{short(dtype)}"

    def table(self, values: np.ndarray) -> str:
        """The name of constants, shape `(n,)`."""
        key = values.dtype.name, values.tobytes()
        if key not in self._tables:
            name = self._tables[key] = f"{self.prefix}_table{len(self._tables)}"
            entries = [self.constant(x, values.dtype) for x in values]
            lines = ",\n".join(
                "    " + ", ".join(entries[k : k + 4]) for k in range(0, len(entries), 4)
            )
            kind = c_type(values.dtype)
            self.parts.append(
                f"static const {kind} {name}[{len(values)}] = {{\n{lines}\n}};"
            )
        return self._tables[key]

    def constant(self, value: np.generic, dtype: np.dtype) -> str:
        """A number as an expression; one that is not finite by its bits."""
        if dtype.kind != "f" or np.isfinite(value):
            return literal(value, dtype)
        whole = np.dtype(f"i{dtype.itemsize}")
        bits = literal(np.asarray(value, dtype).view(whole)[()], whole)
        return f"{self.helper('of_bits', dtype)}({bits})"

    def named(self, function: Function) -> str | None:
        """The name of a function of scalars, once it has one."""
        return self.functions.get(id(function))

    def add(self, function: Function, text: str, name: str) -> None:
        """A function of scalars, and its text."""
        self._kept.append(function)
        self.functions[id(function)] = name
        self.parts.append(text)
