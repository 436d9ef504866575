"""The value of a node of a graph, by NumPy at many points, and by JAX."""

from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from .._ir.folding import UFUNCS
from .._ir.node import Node

NUMPY: dict[str, Callable[..., Any]] = {
    **UFUNCS,
    "sin": np.sin,
    "cos": np.cos,
    "tan": np.tan,
    "asin": np.arcsin,
    "acos": np.arccos,
    "atan": np.arctan,
    "atan2": np.arctan2,
    "sinh": np.sinh,
    "cosh": np.cosh,
    "tanh": np.tanh,
    "exp": np.exp,
    "exp2": np.exp2,
    "expm1": np.expm1,
    "log": np.log,
    "log1p": np.log1p,
    "cbrt": np.cbrt,
    "sign": np.sign,
    "max": np.maximum,
    "min": np.minimum,
    "pow": np.power,
}
JAX: dict[str, Callable[..., Any]] = {
    "add": lambda x, y: x + y,
    "sub": lambda x, y: x - y,
    "mul": lambda x, y: x * y,
    "div": lambda x, y: x / y if _is_real(x) or _is_real(y) else jax.lax.div(x, y),
    "neg": lambda x: -x,
    "abs": jnp.abs,
    "sqrt": jnp.sqrt,
    "floor": jnp.floor,
    "ceil": jnp.ceil,
    "rint": jnp.rint,
    "and": jnp.bitwise_and,
    "or": jnp.bitwise_or,
    "xor": jnp.bitwise_xor,
    "not": jnp.invert,
    "shl": jax.lax.shift_left,
    "lshr": jax.lax.shift_right_logical,
    "ashr": jax.lax.shift_right_arithmetic,
    "ones": jax.lax.population_count,
    "zeros": jax.lax.clz,
    "eq": lambda x, y: x == y,
    "ne": lambda x, y: x != y,
    "lt": lambda x, y: x < y,
    "le": lambda x, y: x <= y,
    "gt": lambda x, y: x > y,
    "ge": lambda x, y: x >= y,
    "select": jnp.where,
    "fma": lambda x, y, z: x * y + z,
}


def _is_real(x: Any) -> bool:
    return isinstance(x, float) or jnp.issubdtype(jnp.result_type(x), jnp.floating)


def bound(node: Node, args: Sequence[Any]) -> Any:
    """The result of a node on values of JAX. Real constants are plain numbers, so that they
    take the precision of what they meet, and conversions between precisions are none."""
    if node.op == "const":
        return node.data.item() if node.dtype.kind in "fb" else node.data
    if node.op == "convert":
        if node.dtype.kind != "f":
            return jnp.asarray(args[0]).astype(node.dtype)
        (x,) = args
        return x if _is_real(x) else jnp.asarray(x).astype(jnp.result_type(float))
    if node.op == "bitcast":
        return jax.lax.bitcast_convert_type(args[0], node.dtype)
    if node.op == "table":
        return jnp.asarray(node.data)[args[0]]
    if node.op in JAX:
        return JAX[node.op](*args)
    return _primitive(node, args)


def _primitive(node: Node, args: Sequence[Any]) -> Any:
    dtype = jnp.result_type(*args)
    dtype = dtype if jnp.issubdtype(dtype, jnp.floating) else jnp.result_type(float)
    arrays = [jnp.asarray(x, dtype) for x in args]
    return getattr(jax.lax, f"{node.op}_p").bind(*arrays, **dict(node.data))


class Lots:
    """What is drawn by lot at points, so that what no point reaches is seen as well: which
    branch a choice takes, by the number of its condition, and which operand is the larger
    one. If `wild`, the numbers of steps, of tables and of comparisons too, and any number
    where there is none. Nodes that are `bound` to each other are left as they are."""

    def __init__(
        self, seed: int, count: int, wild: bool, bound: Callable[[int], bool]
    ) -> None:
        self.seed, self.count, self.wild, self.bound = seed, count, wild, bound

    def _drawn(self, number: int) -> np.random.Generator:
        return np.random.default_rng((self.seed, number))

    def sides(self, number: int) -> np.ndarray:
        """True or false, at every point."""
        return self._drawn(number).random(self.count) < 0.5

    def numbers(self, number: int) -> np.ndarray:
        """Of either sign, and none of them small."""
        rng = self._drawn(number)
        return rng.uniform(0.5, 2.0, self.count) * rng.choice([-1.0, 1.0], self.count)

    def moved(self, number: int, node: Node, args: list, value: np.ndarray) -> np.ndarray:
        """The value of a node with steps as drawn."""
        op, size = node.op, self.count
        steps = op in STEPS or _is_truncated(node, args)
        from_truth = op == "convert" and args[0].dtype == bool
        if not (self.wild and (steps or from_truth or op in ("table", "sign", "rem"))):
            return value
        rng = self._drawn(number)
        if op == "table":
            drawn = node.data[rng.integers(0, len(node.data), size)]
            return np.where(self.sides(number), drawn, value)
        if op == "sign":
            return rng.choice([-1.0, 1.0], size)
        if steps:
            return value + rng.integers(-2, 3, size).astype(value.dtype)
        if from_truth:
            return self.sides(number).astype(value.dtype)
        return value + args[1] * rng.integers(-1, 2, size)


STEPS = ("floor", "ceil", "rint")


def _is_truncated(node: Node, args: list) -> bool:
    return node.op == "convert" and node.dtype.kind in "iu" and args[0].dtype.kind == "f"


def at_points(
    nodes: Sequence[Node],
    order: Sequence[int],
    inputs: dict[Any, np.ndarray],
    lots: Lots | None,
    found: dict[int, tuple[np.ndarray, np.ndarray]],
) -> None:
    """Add to what is `found`, by number, the values of the nodes of an `order` at points,
    shape `(N,)`, and their magnitudes: what they would be, did nothing cancel. `lots`: what
    is drawn; `None` is true to the functions."""
    with np.errstate(all="ignore"):
        for number in order:
            node = nodes[number]
            args = [found[a][0] for a in node.args]
            sizes = [found[a][1] for a in node.args]
            free = lots is not None and not lots.bound(number)
            if node.op == "select":
                which = args[0]
                if lots is not None and not lots.bound(node.args[0]):
                    which = lots.sides(node.args[0])
                value = np.where(which, args[1], args[2])
                size = np.where(which, sizes[1], sizes[2])
            elif free and node.op in ("max", "min") and node.dtype.kind == "f":
                assert lots is not None
                which = lots.sides(number)
                value, size = np.where(which, *args), np.where(which, *sizes)
            else:
                value = inputs[node.data] if node.op == "input" else _value(node, args)
                if free and node.args:
                    assert lots is not None
                    value = lots.moved(number, node, args, value)
                size = _size(node, args, sizes, value)
            if lots is not None and lots.wild and value.dtype.kind == "f" and node.args:
                lost = ~(np.isfinite(value) & np.isfinite(size))
                if lost.any():
                    value = np.where(lost, lots.numbers(number), value)
                    size = np.where(lost, 1.0, size)
            found[number] = value, size


def _value(node: Node, args: Sequence[np.ndarray]) -> np.ndarray:
    if node.op == "const":
        data = node.data
        return np.asarray(data, np.float64) if node.dtype.kind == "f" else np.asarray(data)
    if node.op == "convert":
        if node.dtype.kind == "f":
            return args[0].astype(np.float64)
        return np.trunc(args[0]).astype(node.dtype)
    if node.op == "div" and node.dtype.kind == "f":
        return np.divide(*args)
    if node.op == "table":
        return node.data[np.clip(args[0], 0, len(node.data) - 1)]
    if node.op in NUMPY:
        return np.asarray(NUMPY[node.op](*args))
    return np.asarray(bound(node, args))


def _size(
    node: Node,
    args: Sequence[np.ndarray],
    sizes: Sequence[np.ndarray],
    value: np.ndarray,
) -> np.ndarray:
    if node.op in ("add", "sub"):
        return sizes[0] + sizes[1]
    if node.op == "mul":
        return sizes[0] * sizes[1]
    if node.op == "div" and node.dtype.kind == "f":
        return sizes[0] / np.abs(args[1])
    if node.op in ("neg", "convert"):
        return sizes[0]
    return np.abs(value) if value.dtype.kind == "f" else np.asarray(0.0)
