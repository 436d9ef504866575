"""Scalar expressions: a node of a graph with Python's operators, to write formulas in."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..._ir.graph import Graph


class Expression:
    """A node of a graph. Numbers that meet one take its type."""

    __slots__ = ("graph", "number")

    def __init__(self, graph: Graph, number: int) -> None:
        self.graph = graph
        self.number = number

    @property
    def dtype(self) -> np.dtype:
        return self.graph.dtype(self.number)

    def __repr__(self) -> str:
        return f"Expression({self.graph.nodes[self.number]})"

    def like(self, x: Any) -> Expression:
        """The number x in the type of this expression."""
        if isinstance(x, Expression):
            return x
        return Expression(self.graph, self.graph.const(x, self.dtype))

    def op(self, op: str, *others: Any) -> Expression:
        numbers = [self.like(x).number for x in others]
        return Expression(self.graph, self.graph.op(op, self.number, *numbers))

    def __add__(self, other):
        return self.op("add", other)

    __radd__ = __add__

    def __sub__(self, other):
        return self.op("sub", other)

    def __rsub__(self, other):
        return self.like(other) - self

    def __mul__(self, other):
        return self.op("mul", other)

    __rmul__ = __mul__

    def __truediv__(self, other):
        return self.op("div", other)

    def __rtruediv__(self, other):
        return self.like(other) / self

    def __neg__(self):
        return self.op("neg")

    def __abs__(self):
        return self.op("abs")

    def __and__(self, other):
        return self.op("and", other)

    def __or__(self, other):
        return self.op("or", other)

    def __xor__(self, other):
        return self.op("xor", other)

    def __invert__(self):
        return self.op("not")

    def __lshift__(self, other):
        return self.op("shl", other)

    def __rshift__(self, other):
        return self.op("lshr" if self.dtype.kind == "u" else "ashr", other)

    def __lt__(self, other):
        return self.op("lt", other)

    def __le__(self, other):
        return self.op("le", other)

    def __gt__(self, other):
        return self.op("gt", other)

    def __ge__(self, other):
        return self.op("ge", other)

    def equals(self, other: Any) -> Expression:
        return self.op("eq", other)

    def differs(self, other: Any) -> Expression:
        return self.op("ne", other)

    def sqrt(self) -> Expression:
        return self.op("sqrt")

    def floor(self) -> Expression:
        return self.op("floor")

    def rint(self) -> Expression:
        return self.op("rint")

    def times_plus(self, factor: Any, term: Any) -> Expression:
        """`self factor + term`, rounded once."""
        numbers = self.number, self.like(factor).number, self.like(term).number
        return Expression(self.graph, self.graph.fma(*numbers))

    def near_plus(self, factor: Any, term: Any) -> Expression:
        """The same, rounded once or twice."""
        if self.graph.goal.fuses:
            return self.times_plus(factor, term)
        return self * factor + term

    def to(self, dtype: Any) -> Expression:
        return Expression(self.graph, self.graph.convert(self.number, dtype))

    def bits(self, dtype: Any) -> Expression:
        """The same bits as `dtype`."""
        return Expression(self.graph, self.graph.bitcast(self.number, dtype))


def where(which: Expression, on_true: Any, on_false: Any) -> Expression:
    """`on_true` where `which`; at least one of the two is an expression."""
    like = on_true if isinstance(on_true, Expression) else on_false
    numbers = which.number, like.like(on_true).number, like.like(on_false).number
    return Expression(which.graph, which.graph.select(*numbers))


def horner(x: Expression, coefficients: tuple[float, ...]) -> Expression:
    """The polynomial with `coefficients`, that of the highest power first."""
    total = x.like(coefficients[0])
    for c in coefficients[1:]:
        total = total.near_plus(x, c)
    return total
