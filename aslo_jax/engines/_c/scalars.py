"""Scalar operations as expressions of C."""

from collections.abc import Sequence

import numpy as np

from ..._ir.node import COMPARISONS, Node
from .types import c_type, short, unsigned
from .unit import Unit

ARITHMETIC = {"add": "+", "sub": "-", "mul": "*"}
BITWISE = {"and": "&", "or": "|", "xor": "^"}
LOGICAL = {"and": "&&", "or": "||", "xor": "!=", "eq": "==", "ne": "!="}
COMPARED = dict(zip(COMPARISONS, ("==", "!=", "<", "<=", ">", ">="), strict=True))
FUNCTIONS = ("abs", "sqrt", "floor", "ceil", "rint", "fma")
PARTIAL = ("div", "shl", "lshr", "ashr", "ones", "zeros")


def expression(unit: Unit, node: Node, source: np.dtype, x: Sequence[str]) -> str:
    """An operation on operands, each a name, a number, or an expression in brackets; the
    last of them is of type `source`."""
    op, dtype = node.op, node.dtype
    if op == "select":
        return f"{x[0]} ? {x[1]} : {x[2]}"
    if op in COMPARED:
        return f"{x[0]} {COMPARED[op]} {x[1]}"
    if op == "convert":
        return _converted(unit, dtype, source, x[0])
    if op == "bitcast":
        return _cast(unit, dtype, source, x[0])
    if op == "table":
        return f"{unit.table(node.data)}[(size_t){x[0]}]"
    if dtype.kind == "b":
        return f"!{x[0]}" if op == "not" else f"{x[0]} {LOGICAL[op]} {x[1]}"
    if dtype.kind == "f":
        return _real(unit, op, dtype, x)
    return _whole(unit, op, dtype, x)


def _real(unit: Unit, op: str, dtype: np.dtype, x: Sequence[str]) -> str:
    if op == "neg":
        return f"-{x[0]}"
    if op == "div":
        return f"{x[0]} / {x[1]}"
    if op in FUNCTIONS:
        return f"{unit.helper(op, dtype)}({', '.join(map(bare, x))})"
    return f"{x[0]} {ARITHMETIC[op]} {x[1]}"


def _whole(unit: Unit, op: str, dtype: np.dtype, x: Sequence[str]) -> str:
    """Modulo a power of two, as signed numbers of C are not."""
    kind, wide = c_type(dtype), unsigned(dtype)
    if op in PARTIAL:
        return f"{unit.helper(op, dtype)}({', '.join(map(bare, x))})"
    if op == "not":
        return f"({kind})(~({wide}){x[0]})"
    if op == "abs":
        return f"({x[0]} < 0) ? ({kind})(0u - ({wide}){x[0]}) : {x[0]}"
    if op == "neg":
        return f"({kind})(0u - ({wide}){x[0]})"
    sign = (ARITHMETIC | BITWISE)[op]
    return f"({kind})(({wide}){x[0]} {sign} ({wide}){x[1]})"


def _converted(unit: Unit, dtype: np.dtype, source: np.dtype, x: str) -> str:
    if source.kind == "b":
        one, zero = (unit.constant(dtype.type(v), dtype) for v in (1, 0))
        return f"{x} ? {one} : {zero}"
    if source.kind == "f" and dtype.kind in "iu":
        return f"{unit.helper(f'to_{short(source)}', dtype)}({bare(x)})"
    return f"({c_type(dtype)}){x}"


def _cast(unit: Unit, dtype: np.dtype, source: np.dtype, x: str) -> str:
    """The same bits as another type."""
    if source.kind == "f":
        name = f"{unit.helper('bits', source)}({bare(x)})"
        return name if dtype.kind == "i" else f"({c_type(dtype)}){name}"
    if dtype.kind == "f":
        signed = bare(x) if source.kind == "i" else f"(int{8 * dtype.itemsize}_t){x}"
        return f"{unit.helper('of_bits', dtype)}({signed})"
    return f"({c_type(dtype)}){x}"


def bare(text: str) -> str:
    """Without brackets around all of it."""
    if not (text.startswith("(") and text.endswith(")")):
        return text
    depth = 0
    for k, character in enumerate(text):
        depth += (character == "(") - (character == ")")
        if depth == 0:
            return text[1:-1] if k == len(text) - 1 else text
    return text
