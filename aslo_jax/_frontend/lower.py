"""A jaxpr as a graph of scalar operations.

A value is an array of node numbers. Elementwise primitives work on them entry by entry
(`rules`), structural ones move them (`structural`); calls are inlined here, loops unrolled.
"""

import functools
from typing import Any

import jax
import jax.extend.core as jex
import jax.numpy as jnp
import numpy as np

from .._checks import is_concrete
from .._ir.graph import Graph
from .._ir.node import NUMBERS
from .._typing import PyTree
from .elementwise import ELEMENTWISE, Unsupported
from .entrywise import is_entrywise, looped
from .functions import FUNCTIONS, applies_function
from .large import entrywise
from .origin import described, located, with_caller
from .outlining import is_outlined, outlined
from .structural import STRUCTURAL, Value, constant, known, select

UNROLLED = 4096  # the longest loop that is unrolled


class NotFusible(ValueError):
    """A function that the fused engine cannot compile: names the primitive, the line of
    the user's code, and the alternative."""


def flatten(graph: Graph, closed: Any, inputs: list[Value]) -> list[Value]:
    """The outputs of a closed jaxpr at `inputs`, arrays of node numbers.

    **Raises:** [`NotFusible`][] where a primitive has no rule."""
    try:
        return _closed(graph, closed, inputs)
    except Unsupported as error:
        what = described(error.primitive, with_caller(error.origin))
        raise NotFusible(
            f'The fused engine cannot compile {what}: {error}. Use engine="scan", or write '
            "it with elementwise arithmetic on small arrays."
        ) from error.__cause__


def check_numbers(tree: PyTree, what: str) -> None:
    """That the leaves of a tree of shapes have types that a graph computes with.

    **Raises:** [`NotFusible`][]."""
    kind = unusual(*jax.tree.leaves(tree))
    if kind is not None:
        raise NotFusible(
            f"The fused engine does not compute with numbers of type {kind}, as {what}. "
            'Use engine="scan", or other types.'
        )


def unusual(*shaped: Any) -> str | None:
    """The type of one of some arrays, their shapes or tracers, if a graph lacks it: halves,
    complex numbers, typed random keys."""
    for x in shaped:
        dtype = getattr(x, "dtype", None)
        if dtype is not None and _is_unusual(dtype):
            return str(dtype)
    return None


@functools.cache
def _is_unusual(dtype: Any) -> bool:
    return str(dtype) not in NUMBERS


def _is_extended(dtype: Any) -> bool:
    """Whether it is a type of JAX's own, that of random keys."""
    return jnp.issubdtype(dtype, jax.dtypes.extended)


def _closed(graph: Graph, closed: Any, inputs: list[Value]) -> list[Value]:
    if not is_concrete(*closed.consts):
        raise NotFusible(
            "The fused engine cannot compile a function that closes over a value which is "
            "being traced (by jit, vmap or a derivative around it): hand it over in "
            '`parameters`, one for each, or use engine="scan".'
        )
    typed = [c for c in closed.consts if hasattr(c, "dtype") and _is_extended(c.dtype)]
    check_numbers(typed, "a constant that a function closes over has")
    consts = [constant(graph, c) for c in closed.consts]
    return _jaxpr(graph, closed.jaxpr, consts, inputs)


def _jaxpr(graph: Graph, jaxpr: Any, consts: list[Value], inputs: list[Value]) -> list:
    values: dict[Any, Value] = {}

    def read(atom: Any) -> Value:
        if isinstance(atom, jex.Literal):
            return constant(graph, np.asarray(atom.val, _dtype(atom)))
        return values[atom]

    values.update(zip(jaxpr.constvars, consts, strict=True))
    values.update(zip(jaxpr.invars, inputs, strict=True))
    for equation in _needed(jaxpr):
        arguments = [read(atom) for atom in equation.invars]
        graph.sources.append(equation)
        try:
            found = _guarded(graph, equation, arguments)
        except Unsupported as error:
            error.primitive = error.primitive or equation.primitive.name
            error.origin = located(error.origin, equation)
            raise
        finally:
            graph.sources.pop()
        values.update(zip(equation.outvars, map(np.asarray, found), strict=True))
    return [read(atom) for atom in jaxpr.outvars]


def _needed(jaxpr: Any) -> list[Any]:
    """The equations that the results need, or that do more than to give some (dead code
    elimination)."""
    needed, found = {v for v in jaxpr.outvars if isinstance(v, jex.Var)}, []
    for equation in reversed(jaxpr.eqns):
        if equation.effects or not needed.isdisjoint(equation.outvars):
            needed.update(v for v in equation.invars if isinstance(v, jex.Var))
            found.append(equation)
    return found[::-1]


def _guarded(graph: Graph, equation: Any, arguments: list[Value]) -> list[Value]:
    """What fails within a rule is a refusal too, from which there is a way back to scan."""
    try:
        return _apply(graph, equation, arguments)
    except (Unsupported, NotFusible):
        raise
    except Exception as error:
        raise Unsupported(f"its rule fails with {type(error).__name__}: {error}") from error


def _dtype(atom: Any) -> Any:
    return atom.aval.dtype


def _apply(graph: Graph, equation: Any, arguments: list[Value]) -> list[Value]:
    name, params = equation.primitive.name, equation.params
    inner = inner_of(params)
    kind = unusual(*(v.aval for v in (*equation.invars, *equation.outvars)))
    if kind is not None and inner is None:  # of a call, the one within is named
        return _constant(
            graph, equation, arguments, Unsupported(f"its numbers have type {kind}")
        )
    rule = graph.rules.get(name) or ELEMENTWISE.get(name)
    if rule is not None:
        spread = np.broadcast_arrays(*arguments)
        aval = equation.outvars[0].aval
        kept = name in graph.rules
        calls = None if kept else entrywise(graph, rule, aval.dtype, params, spread)
        if calls is not None:
            return [calls]
        out = np.empty(aval.shape, np.int64)
        for index in np.ndindex(aval.shape):
            out[index] = rule(graph, aval.dtype, params, *(int(a[index]) for a in spread))
        return [out]
    try:
        return _by_rule(graph, equation, inner, arguments)
    except Unsupported as error:
        return _constant(graph, equation, arguments, error)


def _by_rule(graph: Graph, equation: Any, inner: Any, arguments: list[Value]) -> list:
    name = equation.primitive.name
    if applies_function(equation):
        inline = functools.partial(_closed, graph)
        return FUNCTIONS[name](inline, graph, equation, *arguments)
    for rules in (STRUCTURAL, CONTROL):
        if name in rules:
            return rules[name](graph, equation, *arguments)
    if inner is not None and is_outlined(equation):
        return outlined(
            graph, equation, lambda given: _closed(graph, inner, given), arguments
        )
    if inner is not None and is_entrywise(equation):
        calls = looped(graph, lambda other, given: _closed(other, inner, given), arguments)
        return _closed(graph, inner, arguments) if calls is None else calls
    if inner is not None:
        return _closed(graph, inner, arguments)
    raise Unsupported("it has no rule")


def _constant(
    graph: Graph, equation: Any, arguments: list[Value], otherwise: Unsupported
) -> list[Value]:
    """What an equation gives for constants: a matrix exponential, say, that depends on
    nothing but an interval. It raises what happens `otherwise`."""
    values = [known(graph, argument) for argument in arguments]
    results = [v.aval for v in equation.outvars]
    plain = not any(_is_extended(a.dtype) for a in results if hasattr(a, "dtype"))
    if not plain or any(value is None for value in values):
        raise otherwise
    return [constant(graph, x) for x in _evaluated(equation, values)]


def _evaluated(equation: Any, values: list[Any]) -> list[np.ndarray]:
    """By JAX itself."""
    inner = inner_of(equation.params)
    with jax.ensure_compile_time_eval():
        values = [jnp.asarray(value) for value in values]
        if inner is not None:
            found = jex.jaxpr_as_fun(inner)(*values)
        else:
            found = equation.primitive.bind(*values, **equation.params)
            found = found if equation.primitive.multiple_results else [found]
        return [np.asarray(each) for each in found]


CALLS = ("jaxpr", "call_jaxpr", "fun_jaxpr")


def inner_of(params: dict[str, Any]) -> Any:
    """The closed jaxpr of a call: jit, custom derivatives, remat."""
    for key in CALLS:
        inner = params.get(key)
        if inner is not None:
            return inner if hasattr(inner, "consts") else jex.ClosedJaxpr(inner, ())
    return None


def _of_scan(params: dict[str, Any]) -> tuple[int, int]:
    """How many constants it has, and how many numbers are carried."""
    if "num_consts" in params:
        return params["num_consts"], params["num_carry"]
    consts, carry, _ = params["ft_in"].unpack()  # since JAX 0.12
    return len(consts), len(carry)


def _scan(graph, equation, *arguments):
    p = equation.params
    length, (n, m) = p["length"], _of_scan(p)
    if length > UNROLLED:
        raise Unsupported(f"it has {length} steps, more than the {UNROLLED} unrolled")
    consts, carry, xs = arguments[:n], list(arguments[n : n + m]), arguments[n + m :]
    steps = range(length)[::-1] if p["reverse"] else range(length)
    stacked: list[Any] = [None] * length
    for k in steps:
        out = _closed(graph, p["jaxpr"], [*consts, *carry, *(np.asarray(x[k]) for x in xs)])
        carry, stacked[k] = out[:m], out[m:]
    count = len(equation.outvars) - m
    ys = [
        np.stack([row[j] for row in stacked])
        if length
        else np.empty(equation.outvars[m + j].aval.shape, np.int64)
        for j in range(count)
    ]
    return [*carry, *ys]


def _while(graph, equation, *arguments):
    p = equation.params
    nc, nb = p["cond_nconsts"], p["body_nconsts"]
    cond_consts, body_consts = arguments[:nc], arguments[nc : nc + nb]
    carry = list(arguments[nc + nb :])
    for _ in range(UNROLLED):
        (going,) = _closed(graph, p["cond_jaxpr"], [*cond_consts, *carry])
        value = graph.value(int(going))
        if value is None:
            raise Unsupported("the number of its steps is not known when it is traced")
        if not value:
            return carry
        carry = _closed(graph, p["body_jaxpr"], [*body_consts, *carry])
    raise Unsupported(f"it has more than the {UNROLLED} steps that are unrolled")


def _cond(graph, equation, which, *arguments):
    branches = equation.params["branches"]
    number = int(which)
    value = graph.value(number)
    if value is not None:
        chosen = int(np.clip(int(value), 0, len(branches) - 1))
        return _closed(graph, branches[chosen], list(arguments))
    found = [_closed(graph, branch, list(arguments)) for branch in branches]
    outs = found[-1]
    for k in range(len(branches) - 2, -1, -1):
        later = _greater(graph, number, k)
        graph.branches[later] = None
        outs = [select(graph, later, a, b) for a, b in zip(outs, found[k], strict=True)]
    return outs


def _greater(graph: Graph, which: int, k: int) -> int:
    """Whether an index of branches is greater than k; of two, that is a boolean."""
    node = graph.nodes[which]
    if k == 0 and node.op == "convert" and graph.dtype(node.args[0]) == np.bool_:
        (which,) = node.args
    if graph.dtype(which) == np.bool_:
        return which
    return graph.op("gt", which, graph.const(k, graph.dtype(which)))


def _expanded(graph, equation, *arguments):
    """A function that JAX keeps as a primitive, `jnp.searchsorted` say, by what it does."""
    does = functools.partial(equation.primitive.to_lojax, **equation.params)
    like = [jax.ShapeDtypeStruct(v.aval.shape, v.aval.dtype) for v in equation.invars]
    return _closed(graph, jax.make_jaxpr(does)(*like), list(arguments))


CONTROL = {
    "scan": _scan,
    "while": _while,
    "cond": _cond,
    "call_hi_primitive": _expanded,
}
