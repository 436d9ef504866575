"""Elementwise primitives of JAX as operations on scalars."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from .._ir.graph import Graph
from .libm import bits, error, exponential, hyperbolic, power, trigonometric
from .libm.expression import Expression, where
from .origin import Origin


class Unsupported(Exception):
    """Why a primitive has no graph; its name and where it comes from, once known."""

    primitive = ""
    origin = Origin()


Rule = Callable[..., int]
ELEMENTWISE: dict[str, Rule] = {}


def rule(*names: str) -> Callable[[Rule], Rule]:
    def register(function: Rule) -> Rule:
        for name in names:
            ELEMENTWISE[name] = function
        return function

    return register


def _formula(name: str, formula: Callable[..., Expression]) -> None:
    """A rule from a formula on expressions of floating-point type."""

    def apply(graph, dtype, params, *numbers):
        xs = [Expression(graph, n) for n in numbers]
        if xs[0].dtype.kind != "f":
            raise Unsupported(f"it has no rule for {xs[0].dtype}")
        return formula(*xs).number

    ELEMENTWISE[name] = apply


def _plain(name: str, op: str) -> None:
    ELEMENTWISE[name] = lambda graph, dtype, params, *numbers: graph.op(op, *numbers)


for _name, _op in {
    "add": "add",
    "add_any": "add",
    "sub": "sub",
    "mul": "mul",
    "div": "div",
    "and": "and",
    "or": "or",
    "xor": "xor",
    "not": "not",
    "eq": "eq",
    "ne": "ne",
    "lt": "lt",
    "le": "le",
    "gt": "gt",
    "ge": "ge",
    "sqrt": "sqrt",
    "floor": "floor",
    "ceil": "ceil",
    "neg": "neg",
    "shift_left": "shl",
    "shift_right_logical": "lshr",
    "shift_right_arithmetic": "ashr",
    "population_count": "ones",
    "clz": "zeros",
}.items():
    _plain(_name, _op)

for _name, _f in {
    "sin": trigonometric.sin,
    "cos": trigonometric.cos,
    "tan": trigonometric.tan,
    "asin": trigonometric.asin,
    "acos": trigonometric.acos,
    "atan": trigonometric.atan,
    "atan2": trigonometric.atan2,
    "sinh": hyperbolic.sinh,
    "cosh": hyperbolic.cosh,
    "tanh": hyperbolic.tanh,
    "asinh": hyperbolic.asinh,
    "acosh": hyperbolic.acosh,
    "atanh": hyperbolic.atanh,
    "exp": exponential.exp,
    "exp2": exponential.exp2,
    "expm1": exponential.expm1,
    "log": exponential.log,
    # As XLA rounds it; JAX before 0.11 has no such primitive, and divides logarithms.
    "log2": lambda x: exponential.log(x) * (1.0 / math.log(2.0)),
    "log1p": exponential.log1p,
    "logistic": exponential.logistic,
    "erf": error.erf,
    "erfc": error.erfc,
    "erf_inv": error.erf_inv,
    "cbrt": power.cbrt,
    "nextafter": bits.nextafter,
    "rsqrt": lambda x: 1.0 / x.sqrt(),
    "is_finite": lambda x: abs(x) < math.inf,
}.items():
    _formula(_name, _f)


@rule("stop_gradient", "copy", "copy_p", "real")
def _same(graph: Graph, dtype: Any, params: Any, x: int) -> int:
    return x


@rule("reduce_precision")
def _reduce_precision(graph: Graph, dtype: Any, params: Any, x: int) -> int:
    info = np.finfo(dtype)
    bits = params["exponent_bits"], params["mantissa_bits"]
    if bits[0] < info.iexp or bits[1] < info.nmant:
        raise Unsupported(
            f"it leaves {bits[0]} bits of the exponent and {bits[1]} of the mantissa"
        )
    return x


@rule("square")
def _square(graph: Graph, dtype: Any, params: Any, x: int) -> int:
    return graph.op("mul", x, x)


@rule("one_minus_square")
def _one_minus_square(graph: Graph, dtype: Any, params: Any, x: int) -> int:
    """In the derivatives of JAX 0.12; rounded as XLA rounds it."""
    one = graph.const(1, dtype)
    return graph.op("mul", graph.op("add", one, x), graph.op("sub", one, x))


@rule("polynomial")
def _polynomial(graph: Graph, dtype: Any, params: Any, x: int, *coefficients: int) -> int:
    """Of `jnp.polyval` and in `erf` of JAX 0.12; from the constant term on."""
    *lower, value = coefficients
    for coefficient in reversed(lower):
        value = graph.op("add", graph.op("mul", value, x), coefficient)
    return value


@rule("abs")
def _abs(graph: Graph, dtype: Any, params: Any, x: int) -> int:
    return x if np.dtype(dtype).kind in "ub" else graph.op("abs", x)


@rule("sign")
def _sign(graph: Graph, dtype: Any, params: Any, x: int) -> int:
    e = Expression(graph, x)
    positive = where(e > 0, e.like(1), 0)
    if e.dtype.kind == "u":
        return positive.number
    signed = where(e < 0, e.like(-1), positive)
    return (where(e.differs(e), e, signed) if e.dtype.kind == "f" else signed).number


@rule("max")
def _max(graph: Graph, dtype: Any, params: Any, x: int, y: int) -> int:
    return _extreme(graph, "gt", x, y)


@rule("min")
def _min(graph: Graph, dtype: Any, params: Any, x: int, y: int) -> int:
    return _extreme(graph, "lt", x, y)


def _extreme(graph: Graph, op: str, x: int, y: int) -> int:
    """x where it is further out or no number, and y otherwise, which may be none too."""
    dtype = graph.dtype(x)
    if dtype == np.bool_:
        return graph.op("or" if op == "gt" else "and", x, y)
    out = graph.op(op, x, y)
    value = graph.value(x)
    if dtype.kind == "f" and (value is None or np.isnan(value)):
        out = graph.op("or", out, graph.op("ne", x, x))
    return graph.select(out, x, y)


@rule("clamp")
def _clamp(graph: Graph, dtype: Any, params: Any, low: int, x: int, high: int) -> int:
    return _extreme(graph, "lt", _extreme(graph, "gt", x, low), high)


@rule("round")
def _round(graph: Graph, dtype: Any, params: Any, x: int) -> int:
    if int(params["rounding_method"]) == 1:
        return graph.op("rint", x)
    e = Expression(graph, x)  # half away from zero
    down = abs(e).floor()
    away = where(abs(e) - down >= 0.5, down + 1.0, down)
    return where(e < 0, -away, away).number


@rule("select_n")
def _select_n(graph: Graph, dtype: Any, params: Any, which: int, *cases: int) -> int:
    if graph.dtype(which) == np.bool_:
        return graph.select(which, cases[1], cases[0])
    out = cases[-1]
    for k in range(len(cases) - 2, -1, -1):
        here = graph.op("le", which, graph.const(k, graph.dtype(which)))
        out = graph.select(here, cases[k], out)
    return out


@rule("convert_element_type")
def _convert(graph: Graph, dtype: Any, params: Any, x: int) -> int:
    return graph.convert(x, params["new_dtype"])


@rule("bitcast_convert_type")
def _bitcast(graph: Graph, dtype: Any, params: Any, x: int) -> int:
    new = np.dtype(params["new_dtype"])
    if new.itemsize != graph.dtype(x).itemsize:
        raise Unsupported("it changes the width of the type")
    return graph.bitcast(x, new)


@rule("rem")
def _rem(graph: Graph, dtype: Any, params: Any, x: int, y: int) -> int:
    if np.dtype(dtype).kind == "f":
        return power.rem(Expression(graph, x), Expression(graph, y)).number
    quotient = graph.op("div", x, y)
    return graph.op("sub", x, graph.op("mul", quotient, y))


@rule("pow")
def _pow(graph: Graph, dtype: Any, params: Any, x: int, y: int) -> int:
    exponent = graph.value(y)
    if exponent is not None and abs(exponent) <= 16 and exponent == int(exponent):
        return _integer_pow(graph, dtype, {"y": int(exponent)}, x)
    if np.dtype(dtype).kind != "f":
        raise Unsupported("its exponent, a whole number, is not known when it is traced")
    y = graph.convert(y, graph.dtype(x))
    return power.power(Expression(graph, x), Expression(graph, y)).number


@rule("integer_pow")
def _integer_pow(graph: Graph, dtype: Any, params: Any, x: int) -> int:
    left, out, square = abs(params["y"]), None, x
    while left:
        if left & 1:
            out = square if out is None else graph.op("mul", out, square)
        left >>= 1
        square = graph.op("mul", square, square) if left else square
    if out is None:
        return graph.const(1, dtype)
    return graph.op("div", graph.const(1, dtype), out) if params["y"] < 0 else out
