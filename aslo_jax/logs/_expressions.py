"""Arithmetic over the columns of a file, such as `Time*1e-3`."""

import ast
import math
import re
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from ._error import LogError

LONGEST = 500  # characters
CONSTANTS = {"pi": math.pi}
FUNCTIONS: dict[str, Callable[..., Any]] = {
    "abs": np.abs,
    "cos": np.cos,
    "sin": np.sin,
    "sqrt": np.sqrt,
}
OPERATORS: dict[type, Callable[..., Any]] = {
    ast.Add: np.add,
    ast.Sub: np.subtract,
    ast.Mult: np.multiply,
    ast.Div: np.divide,
    ast.Pow: np.power,
    ast.UAdd: np.positive,
    ast.USub: np.negative,
}


class Expression:
    """An arithmetic expression over columns: numbers, `pi`, + - * / **, parentheses, `abs`,
    `cos`, `sin`, `sqrt`, and names of columns, as they are where they are names of Python
    or such with points between (`log.t`), within backticks others.

    - `names`: the columns that it names, in order.

    **Raises:** `LogError` for anything else.
    """

    def __init__(self, text: str):
        self.text = text
        quoted: dict[str, str] = {}

        def placed(found: re.Match) -> str:
            return quoted.setdefault(found[1], f"_column_{len(quoted)}_")

        plain = re.sub(r"`([^`]+)`", placed, text)
        self._columns = {place: name for name, place in quoted.items()}
        try:
            if len(text) > LONGEST:
                raise ValueError(f"it has more than {LONGEST} characters")
            self._tree = ast.parse(plain.strip(), mode="eval").body
            found: dict[str, None] = {}
            self._check(self._tree, found)
        except (
            SyntaxError,
            ValueError,
            OverflowError,
            RecursionError,
            MemoryError,
        ) as error:
            raise LogError(
                f"`{text}` is not an arithmetic expression over columns: {error}; it may "
                f"have numbers, pi, + - * / **, {', '.join(FUNCTIONS)}, and names of "
                "columns, within backticks where they have blanks or signs"
            ) from None
        self.names = tuple(found)

    def _check(self, node: ast.AST, found: dict[str, None]) -> None:
        match node:
            case ast.BinOp(left=left, op=op, right=right) if type(op) in OPERATORS:
                self._check(left, found)
                self._check(right, found)
            case ast.UnaryOp(op=op, operand=operand) if type(op) in OPERATORS:
                self._check(operand, found)
            case ast.Call(func=ast.Name(id=name), args=[argument], keywords=[]) if (
                name in FUNCTIONS
            ):
                self._check(argument, found)
            case ast.Constant(value=(int() | float()) as value):
                if isinstance(value, bool):
                    raise ValueError(f"it has `{value}`")
                float(value)  # which a whole number may be too large for
            case ast.Name(id=name):
                if name not in CONSTANTS:
                    found.setdefault(self._columns.get(name, name))
            case ast.Attribute() if _is_path(node):
                found.setdefault(ast.unparse(node))
            case _:
                raise ValueError(f"it has `{ast.unparse(node)}`")

    def __call__(self, columns: Mapping[str, Any]) -> Any:
        """The values, of what `columns` holds for each of the `names`."""
        with np.errstate(all="ignore"):  # what is not finite is found in the log
            return self._value(self._tree, columns)

    def _value(self, node: ast.AST, columns: Mapping[str, Any]) -> Any:
        match node:
            case ast.BinOp(left=left, op=op, right=right):
                return OPERATORS[type(op)](
                    self._value(left, columns), self._value(right, columns)
                )
            case ast.UnaryOp(op=op, operand=operand):
                return OPERATORS[type(op)](self._value(operand, columns))
            case ast.Call(func=ast.Name(id=name), args=[argument]):
                return FUNCTIONS[name](self._value(argument, columns))
            case ast.Constant(value=(int() | float()) as value):
                return float(value)
            case ast.Name(id=name) if name in CONSTANTS:
                return CONSTANTS[name]
            case ast.Name(id=name):
                return columns[self._columns.get(name, name)]
            case ast.Attribute():
                return columns[ast.unparse(node)]
        raise AssertionError(node)


def _is_path(node: ast.AST) -> bool:
    """Whether it is a name such as `log.current.alpha`, of a field of a struct."""
    while isinstance(node, ast.Attribute):
        node = node.value
    return isinstance(node, ast.Name) and not node.id.startswith("_column_")
