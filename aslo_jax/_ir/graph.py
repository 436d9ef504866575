"""A graph of scalar operations: each is kept once, and constants are folded."""

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any, NamedTuple, TypeVar

import numpy as np

from .folding import FOLD, converted, fused
from .goal import MACHINE_CODE, Goal
from .node import BOOL, COMMUTES, COMPARISONS, Node
from .several import Several

Value = TypeVar("Value")


class Function(NamedTuple):
    """A function of scalars: a graph whose inputs have the slots `("argument", k)`."""

    graph: "Graph"
    result: int


class Graph:
    """Nodes by number, in an order in which every node follows its arguments.

    `rules` of elementwise primitives are before the usual ones; `sources` are the equations
    that are being lowered, the outermost first.
    """

    rules: Mapping[str, Callable[..., int]] = MappingProxyType({})

    def __init__(self, goal: Goal = MACHINE_CODE) -> None:
        self.goal = goal
        self.nodes: list[Node] = []
        self.sources: list[Any] = []
        self.branches: dict[int, None] = {}  # conditions that were branches in the source
        self._numbers: dict[Any, int] = {}
        self._moving: list[bool] = []  # whether nodes change over time
        self._functions: dict[Any, Function] = {}
        self._several: dict[Any, Several] = {}
        self._places: dict[int, tuple[Several, int, Several]] = {}
        self.outlined: dict[Any, Any] = {}  # functions that stay functions (`outlining`)

    def __getstate__(self) -> dict[str, Any]:
        """Without what is by the identity of objects, which others have elsewhere."""
        return vars(self) | {"_places": {}, "outlined": {}}

    def const(self, value: Any, dtype: Any) -> int:
        dtype = np.dtype(dtype)
        value = np.asarray(value, dtype)[()]
        return self._number(
            ("const", dtype, value.tobytes()), Node("const", dtype, (), value)
        )

    def input(self, dtype: Any, slot: Any) -> int:
        dtype = np.dtype(dtype)
        return self._number(("input", dtype, slot), Node("input", dtype, (), slot))

    def value(self, number: int) -> Any:
        """The value of a constant node, and `None` of any other."""
        node = self.nodes[number]
        return node.data if node.op == "const" else None

    def dtype(self, number: int) -> np.dtype:
        return self.nodes[number].dtype

    def op(self, op: str, *args: int) -> int:
        """An operation whose result has the type of its first argument; comparisons give
        booleans."""
        dtype = BOOL if op in COMPARISONS else self.dtype(args[0])
        values = [self.value(a) for a in args]
        if op in FOLD and all(v is not None for v in values):
            with np.errstate(all="ignore"):
                return self.const(FOLD[op](*values), dtype)
        if len(set(args)) == 1 < len(args) and self.dtype(args[0]).kind != "f":
            if op in COMPARISONS:
                return self.const(op in ("eq", "le", "ge"), BOOL)
            if op == "xor":
                return self.const(0, dtype)
        simple = self._simplified(op, args, values)
        if simple is not None:
            return simple
        if op in COMMUTES and args[0] > args[1]:
            args = (args[1], args[0])
        return self._number((op, dtype, args), Node(op, dtype, args))

    def select(self, which: int, on_true: int, on_false: int) -> int:
        value = self.value(which)
        if value is not None:
            return on_true if value else on_false
        # A choice that has been made is not made again.
        chosen, other = self.nodes[on_true], self.nodes[on_false]
        if chosen.op == "select" and chosen.args[0] in self._all_of(which, "and"):
            on_true = chosen.args[1]
        if other.op == "select" and other.args[0] in self._all_of(which, "or"):
            on_false = other.args[2]
        if on_true == on_false:
            return on_true
        args = (which, on_true, on_false)
        dtype = self.dtype(on_true)
        if dtype == BOOL and (self.value(on_true), self.value(on_false)) == (True, False):
            return which
        return self._number(("select", dtype, args), Node("select", dtype, args))

    def _all_of(self, number: int, op: str) -> set[int]:
        """A boolean and those that it joins by `and`, or by `or`."""
        node = self.nodes[number]
        inner = node.args if node.op == op and node.dtype == BOOL else ()
        return {number, *inner}.union(*(self._all_of(a, op) for a in inner))

    def fma(self, x: int, y: int, z: int) -> int:
        """`x y + z`, rounded once."""
        dtype, args = self.dtype(x), (x, y, z)
        values = [self.value(a) for a in args]
        if dtype == np.float64 and all(v is not None and np.isfinite(v) for v in values):
            with np.errstate(all="ignore"):
                return self.const(fused(*values), dtype)
        return self._number(("fma", dtype, args), Node("fma", dtype, args))

    def convert(self, x: int, dtype: Any) -> int:
        """The number x as `dtype`; a float becomes an integer by truncation, that next to
        it where it is out of range, and zero where it is no number."""
        dtype = np.dtype(dtype)
        if self.dtype(x) == dtype:
            return x
        if dtype == BOOL:
            return self.op("ne", x, self.const(0, self.dtype(x)))
        value = self.value(x)
        if value is not None:
            with np.errstate(all="ignore"):
                return self.const(converted(value, dtype), dtype)
        return self._number(("convert", dtype, (x,)), Node("convert", dtype, (x,)))

    def bitcast(self, x: int, dtype: Any) -> int:
        dtype = np.dtype(dtype)
        if self.dtype(x) == dtype:
            return x
        value = self.value(x)
        if value is not None:
            return self.const(np.asarray(value).view(dtype), dtype)
        return self._number(("bitcast", dtype, (x,)), Node("bitcast", dtype, (x,)))

    def table(self, values: np.ndarray, index: int) -> int:
        """The entry of a table of constants, shape `(n,)`, at a whole number in [0, n)."""
        place = self.value(index)
        if place is not None:
            return self.const(values[int(place)], values.dtype)
        key = ("table", values.dtype, values.tobytes(), (index,))
        return self._number(key, Node("table", values.dtype, (index,), values))

    def dot(self, *args: int) -> int:
        """The sum of the products of real numbers, a row of them and then a vector, from
        the first to the last: one operation, which many rows do in one loop."""
        dtype, values = self.dtype(args[0]), [self.value(a) for a in args]
        if all(v is not None for v in values):
            row, vector = np.array(values, dtype).reshape(2, -1)
            with np.errstate(all="ignore"):
                return self.const(np.dot(row, vector), dtype)
        return self._number(("dot", dtype, args), Node("dot", dtype, args))

    def call(self, function: Function, *args: int) -> int:
        """A function of real numbers: one operation, which many do in one loop."""
        if all(self.value(a) is not None for a in args):
            return self._inlined(function, args)
        handed = function.graph.nodes[function.result]
        if handed.op == "input":  # a sum with zero, for instance
            return args[handed.data[1]]
        # Equal functions are one, also in another process.
        content = *function.graph._numbers, function.result
        function = self._functions.setdefault(content, function)
        dtype = function.graph.dtype(function.result)
        key = ("call", dtype, args, content)
        return self._number(key, Node("call", dtype, args, function))

    def parts(self, function: Several, *args: int) -> list[int]:
        """The results of a function, which are computed together."""
        return [self.part(function, k, args) for k in range(len(function.results))]

    def part(self, function: Several, k: int, args: tuple[int, ...]) -> int:
        """One of the results of a function."""
        known = self._places.get(id(function))
        if known is None:  # equal functions are one
            content: Any = *function.graph._numbers, *function[1:]
            one = self._several.setdefault(content, function)
            which = list(self._several).index(content)
            # With the function itself, so that nothing else comes to have its number.
            known = self._places[id(function)] = one, which, function
        one, which, _ = known
        node = Node("part", one.graph.dtype(one.results[k]), args, (one, k))
        return self._number((*node[:3], which, k), node)

    def _inlined(self, function: Function, args: tuple[int, ...]) -> int:
        found: dict[int, int] = {}
        for number in function.graph.reachable([function.result]):
            node = function.graph.nodes[number]
            if node.op == "const":
                found[number] = self.const(node.data, node.dtype)
            elif node.op == "input":
                found[number] = args[node.data[1]]
            else:
                found[number] = self.made(node, tuple(found[a] for a in node.args))
        return found[function.result]

    def again(self, number: int, args: tuple[int, ...]) -> int:
        """The operation of a node on other arguments, of the same types."""
        node = self.nodes[number]
        return number if args == node.args else self.made(node, args)

    def made(self, node: Node, args: tuple[int, ...]) -> int:
        """The operation of a node, which may be one of another graph, on arguments."""
        if node.op == "select":
            return self.select(*args)
        if node.op in ("fma", "dot"):
            return getattr(self, node.op)(*args)
        if node.op in ("call", "table"):
            return getattr(self, node.op)(node.data, *args)
        if node.op == "part":
            function, k = node.data
            return self.part(function, k, args)
        if node.op in ("convert", "bitcast"):
            return getattr(self, node.op)(args[0], node.dtype)
        return self.op(node.op, *args)

    def _number(self, key: Any, node: Node) -> int:
        number = self._numbers.get(key)
        if number is None:
            number = self._numbers[key] = len(self.nodes)
            self.nodes.append(node)
        return number

    def _simplified(self, op: str, args: tuple[int, ...], values: list[Any]) -> int | None:
        """What needs no operation. `0 x` stays, since x may be infinite or no number; the
        sign of a zero may be lost."""
        if len(args) == 1:
            inner = self.nodes[args[0]]
            if op in ("neg", "not") and inner.op == op:
                return inner.args[0]
            if op == "neg" and inner.dtype.kind == "f" and inner.op == "sub":
                return self.op("sub", *inner.args[::-1])
            return None
        x, y = args
        a, b = values
        signs = self._signs(op, x, y)
        if signs is not None:
            return signs
        if op == "add":
            return (
                y if a is not None and a == 0 else x if b is not None and b == 0 else None
            )
        if op == "sub":
            if b is not None and b == 0:
                return x
            return self.op("neg", y) if a is not None and a == 0 else None
        if op == "mul":
            for value, other in ((a, y), (b, x)):
                if value is not None and value == 1:
                    return other
                if value is not None and value == -1:
                    return self.op("neg", other)
            product = self._product(a, y)
            return self._product(b, x) if product is None else product
        if op == "div":
            if b is not None and b == 1:
                return x
            whole = self.dtype(y).kind in "iu"
            if whole and b is not None and b in (0, -1):
                return self.const(~b, self.dtype(y)) if b == 0 else self.op("neg", x)
            # A product is many times as fast, and as right but for the last bit.
            if b is not None and a is None and b.dtype.kind == "f":
                with np.errstate(all="ignore"):
                    inverse = b.dtype.type(1.0) / b
                if min(abs(inverse), abs(b)) >= np.finfo(b.dtype).tiny:
                    return self.op("mul", x, self.const(inverse, b.dtype))
            inverts = self.goal.inverts and b is None and not whole
            if inverts and self._moves(x) and not self._moves(y):
                return self.op("mul", x, self.op("div", self.const(1, self.dtype(y)), y))
        if op in ("and", "or") and x == y:
            return x
        if self.dtype(x) == BOOL and op in ("and", "or"):
            for value, constant, other in ((a, x, y), (b, y, x)):
                if value is not None:
                    return other if bool(value) == (op == "and") else constant
        return None

    def _signs(self, op: str, x: int, y: int) -> int | None:
        """Of real numbers, one of which is a negative: with the sign after the operation,
        or as a part of it, both of which are exact."""
        left, right = (
            self.nodes[n].args[0] if self.nodes[n].op == "neg" else None for n in (x, y)
        )
        if self.dtype(x).kind != "f" or (left is None and right is None):
            return None
        if op in ("mul", "div"):
            whole = self.op(op, x if left is None else left, y if right is None else right)
            both = left is not None and right is not None
            return whole if both else self.op("neg", whole)
        if op in ("add", "sub") and right is not None:
            return self.op("sub" if op == "add" else "add", x, right)
        if op == "add" and left is not None:
            return self.op("sub", y, left)
        if op == "sub" and left is not None:
            return self.op("neg", self.op("add", left, y))
        return None

    def _product(self, value: Any, other: int) -> int | None:
        """Of a constant and a product with a constant: the product with one constant."""
        node = self.nodes[other]
        if value is None or node.op != "mul" or node.dtype.kind != "f":
            return None
        for inner, rest in (node.args, node.args[::-1]):
            if self.value(inner) is not None:
                with np.errstate(all="ignore"):
                    both = value * self.value(inner)
                # Where it is out of range, the products one by one need not be.
                if np.finfo(node.dtype).tiny <= abs(both) < np.inf:
                    return self.op("mul", self.const(both, node.dtype), rest)
        return None

    def _moves(self, number: int) -> bool:
        known = self._moving
        for node in self.nodes[len(known) :]:
            known.append(node.varies([(known[a], False) for a in node.args])[0])
        return self._moving[number]

    def size(self, root: int) -> int:
        """How many operations a node takes, those that it needs included."""
        return sum(self.nodes[n].size for n in self.reachable([root]))

    def followed(
        self, number: int, known: dict[int, Value], make: Callable[[int], Value]
    ) -> Value:
        """What `make` gives for a node from what is `known` of its arguments, and has given
        for these before it."""
        left = [number]
        while number not in known:
            n = left[-1]
            missing = [a for a in self.nodes[n].args if a not in known]
            left += missing
            if not missing:
                known[n] = make(n)
                left.pop()
        return known[number]

    def reachable(self, roots: list[int]) -> list[int]:
        """The nodes that `roots` need, themselves included, arguments first."""
        roots = list(roots)
        needed = bytearray(max(roots, default=-1) + 1)
        for number in roots:
            needed[number] = True
        last: tuple[int, ...] = ()  # the results of a function share their arguments
        for number in range(len(needed) - 1, -1, -1):
            if needed[number]:
                args = self.nodes[number].args
                if args is not last:
                    for a in args:
                        needed[a] = True
                    last = args
        return np.flatnonzero(np.frombuffer(needed, bool)).tolist()
