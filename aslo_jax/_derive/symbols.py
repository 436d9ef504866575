"""The functions of a model as a graph of the engine, in which functions of one variable
stay what they are."""

import hashlib
import math
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from .._frontend.elementwise import ELEMENTWISE
from .._frontend.lower import flatten
from .._frontend.origin import Origin, described, located, with_caller
from .._ir.graph import Function, Graph
from .._ir.node import Node
from .evaluation import NUMPY, bound

# Elementwise primitives that are kept: functions with derivatives and addition theorems of
# their own, which an engine writes as polynomials and shifts of bits.
KEPT = {
    *("sin", "cos", "tan", "asin", "acos", "atan", "atan2", "sinh", "cosh", "tanh"),
    *("asinh", "acosh", "atanh", "exp", "exp2", "expm1", "log", "log1p", "logistic"),
    *("erf", "erfc", "erf_inv", "cbrt", "rsqrt", "sign", "max", "min", "rem"),
    *("lgamma", "digamma"),
}
# Whose pivots are chosen by comparisons that belong together.
ELIMINATIONS = ("lu", "lu_pivots_to_permutation", "custom_linear_solve")


class Symbolic(Graph):
    """A graph whose nodes know the equations that they come from."""

    def __init__(self) -> None:
        super().__init__()
        self._origins: list[tuple[Any, ...]] = []
        self._inputs: dict[int, frozenset[tuple[str, int]]] = {}
        self.zero = self.const(0.0, float)
        self.one = self.const(1.0, float)

    def _number(self, key: Any, node: Node) -> int:
        number = super()._number(key, node)
        if number == len(self._origins):
            self._origins.append(tuple(self.sources))
        return number

    def dot(self, *args: int) -> int:
        half = len(args) // 2
        total = self.zero
        for x, y in zip(args[:half], args[half:], strict=True):
            total = self.op("add", total, self.op("mul", x, y))
        return total

    def call(self, function: Function, *args: int) -> int:
        return self._inlined(function, args)

    def kept(self, name: str, dtype: Any, params: dict[str, Any], *args: int) -> int:
        """An operation of the name of its primitive."""
        values = [self.value(a) for a in args]
        if name in NUMPY and all(v is not None for v in values):
            return self.const(NUMPY[name](*values), dtype)
        data = tuple(sorted(params.items()))
        key = (name, np.dtype(dtype), args, data)
        return self._number(key, Node(name, np.dtype(dtype), args, data))

    def made(self, node: Node, args: tuple[int, ...]) -> int:
        if node.op in KEPT or node.op == "pow":
            return self.kept(node.op, node.dtype, dict(node.data), *args)
        return super().made(node, args)

    def inputs(self, number: int) -> frozenset[tuple[str, int]]:
        """The inputs that a node depends on, by kind, such as `x` or `y`, and place."""

        def make(n: int) -> frozenset[tuple[str, int]]:
            node = self.nodes[n]
            if node.op == "input":
                return frozenset((node.data,))
            return frozenset().union(*(self._inputs[a] for a in node.args))

        return self.followed(number, self._inputs, make)

    def eliminates(self, number: int) -> bool:
        """Whether a node is part of the solution of linear equations."""
        sources = self._origins[number]
        return any(e.primitive.name in ELIMINATIONS for e in sources)

    def described(self, number: int) -> str:
        """The primitive and the line that a node comes from, in words."""
        sources = self._origins[number]
        if not sources:
            return f"the operation `{self.nodes[number].op}`"
        found = Origin()
        for equation in reversed(sources):
            found = located(found, equation)
        return described(sources[-1].primitive.name, with_caller(found))


def _kept(name: str) -> Callable[..., int]:
    return lambda graph, dtype, params, *numbers: graph.kept(name, dtype, params, *numbers)


def _pow(graph: Symbolic, dtype: Any, params: Any, x: int, y: int) -> int:
    exponent = graph.value(y)
    if exponent is not None and abs(exponent) <= 16 and exponent == int(exponent):
        return ELEMENTWISE["integer_pow"](graph, dtype, {"y": int(exponent)}, x)
    return graph.kept("pow", dtype, params, x, graph.convert(y, graph.dtype(x)))


def _log2(graph: Symbolic, dtype: Any, params: Any, x: int) -> int:
    """A primitive since JAX 0.12; a logarithm like that of the versions before."""
    log = graph.kept("log", dtype, params, x)
    return graph.op("mul", log, graph.const(1 / math.log(2.0), dtype))


Symbolic.rules = {name: _kept(name) for name in KEPT} | {"pow": _pow, "log2": _log2}


def lowered(
    graph: Symbolic, function: Callable[..., Any], sizes: dict[str, int]
) -> list[int]:
    """The entries of what `function` returns, a tree of arrays, for the inputs of the kinds
    and `sizes` that it takes, in this order.

    **Raises:** `NotFusible` for a primitive that the engine does not know."""
    dtype = jnp.result_type(float)
    arguments = [jax.ShapeDtypeStruct((size,), dtype) for size in sizes.values()]
    closed = jax.make_jaxpr(function)(*arguments)
    inputs = [
        np.array([graph.input(float, (kind, k)) for k in range(size)], np.int64)
        for kind, size in sizes.items()
    ]
    outputs = flatten(graph, closed, inputs)
    return [graph.convert(int(n), float) for out in outputs for n in out.flatten()]


def program(graph: Graph, roots: Sequence[int]) -> "Program":
    """The nodes that `roots` need, as something to run."""
    order = graph.reachable(list(roots))
    places = {number: k for k, number in enumerate(order)}
    nodes = tuple(
        graph.nodes[n]._replace(args=tuple(places[a] for a in graph.nodes[n].args))
        for n in order
    )
    return Program(nodes, tuple(places[n] for n in roots))


def _exact(data: Any) -> Any:
    """The data of a node, in a form whose text has all its digits."""
    return data.tolist() if isinstance(data, np.ndarray | np.generic) else data


class Program:
    """Straight-line code of scalars, run by JAX; a value by its identity."""

    def __init__(self, nodes: tuple[Node, ...], roots: tuple[int, ...]) -> None:
        self.nodes = nodes
        self.roots = roots

    def __repr__(self) -> str:
        # With a digest of all of it: a study is told by its text to be the same one.
        count = sum(node.op not in ("const", "input") for node in self.nodes)
        whole = repr([(n.op, str(n.dtype), n.args, _exact(n.data)) for n in self.nodes])
        digest = hashlib.sha256(f"{whole}{self.roots}".encode()).hexdigest()[:12]
        return f"Program({count} operations, {digest})"

    def __call__(self, inputs: dict[str, Any]) -> list[Any]:
        """The entries, of arrays of `inputs` by kind; constants are plain numbers."""
        values: list[Any] = []
        for node in self.nodes:
            if node.op == "input":
                kind, place = node.data
                values.append(inputs[kind][place])
            else:
                values.append(bound(node, [values[a] for a in node.args]))
        return [values[k] for k in self.roots]
