"""The leaves of a tree as members of a struct."""

import keyword
import re
from collections.abc import Iterable
from typing import Any, NamedTuple

import jax
import numpy as np

from .._typing import PyTree

# Words of C99 and C++ that no member may be called, nor a macro of the headers that are
# included or of compilers, nor what the state has besides.
RESERVED = frozenset(
    [
        "EOF",
        "NULL",
        "begun",
        "errno",
        "i386",
        "linux",
        "offsetof",
        "stderr",
        "stdin",
        "stdout",
        "unix",
        "alignas",
        "alignof",
        "and",
        "and_eq",
        "asm",
        "auto",
        "bitand",
        "bitor",
        "bool",
        "break",
        "case",
        "catch",
        "char",
        "class",
        "compl",
        "const",
        "constexpr",
        "continue",
        "decltype",
        "default",
        "delete",
        "do",
        "double",
        "dynamic_cast",
        "else",
        "enum",
        "explicit",
        "export",
        "extern",
        "false",
        "float",
        "for",
        "friend",
        "goto",
        "if",
        "inline",
        "int",
        "long",
        "mutable",
        "namespace",
        "new",
        "noexcept",
        "not",
        "not_eq",
        "nullptr",
        "operator",
        "or",
        "or_eq",
        "private",
        "protected",
        "public",
        "register",
        "reinterpret_cast",
        "restrict",
        "return",
        "short",
        "signed",
        "sizeof",
        "static",
        "static_assert",
        "static_cast",
        "struct",
        "switch",
        "template",
        "this",
        "thread_local",
        "throw",
        "true",
        "try",
        "typedef",
        "typeid",
        "typename",
        "union",
        "unsigned",
        "using",
        "virtual",
        "void",
        "volatile",
        "wchar_t",
        "while",
        "xor",
        "xor_eq",
    ]
)
OUTER = re.compile(r"\W+")


class Field(NamedTuple):
    """A member: its name in C, its shape and type, its value by default, and what it is in
    the library."""

    name: str
    shape: tuple[int, ...]
    dtype: np.dtype
    origin: str
    default: np.ndarray | None = None

    @property
    def size(self) -> int:
        return int(np.prod(self.shape, dtype=int))

    @property
    def is_array(self) -> bool:
        return self.shape != ()


def identifier(path: Iterable[Any], alone: str) -> str:
    """A path in a tree as a name of C; `alone` for that of a tree which is one leaf."""
    name = OUTER.sub("_", "_".join(map(_part, path))).strip("_")
    name = "".join(c if c.isascii() else f"u{ord(c):x}" for c in name) or alone
    if name[0].isdigit():
        name = f"{alone}_{name}"
    return f"{name}_" if name in RESERVED or keyword.iskeyword(name) else name


def _part(key: Any) -> str:
    """A part of a path; the dictionary of the states of an observer is none."""
    for name in ("name", "key", "idx"):
        if hasattr(key, name):
            part = str(getattr(key, name))
            return "" if part == "states" and name == "name" else part
    return str(key)


def fields_of(tree: PyTree, alone: str) -> list[Field]:
    """The leaves of a tree of arrays or shapes, in their order. Leaves whose names would
    be equal are numbered."""
    found: list[Field] = []
    taken: set[str] = set()
    for path, leaf in jax.tree_util.tree_flatten_with_path(tree)[0]:
        name = base = identifier(path, alone)
        number = 2
        while name in taken:
            name, number = f"{base}_{number}", number + 1
        taken.add(name)
        concrete = isinstance(leaf, np.ndarray | jax.Array | np.generic)
        default = np.asarray(leaf) if concrete else None
        origin = jax.tree_util.keystr(path).lstrip(".") or alone
        found.append(Field(name, tuple(leaf.shape), np.dtype(leaf.dtype), origin, default))
    return found
