"""The declared kinks of a traced vector field: their switching functions, and the field
with their sides held.

A side is a number that is added to a switching function: large where it is held to be
positive or not, and otherwise 0."""

from collections.abc import Sequence
from typing import Any

import jax.extend.core as jex
import jax.numpy as jnp
import numpy as np

from ..._frontend.lower import inner_of
from ..._kinks import NAME


def switches(closed: Any, within: bool = False) -> int:
    """How many switching functions a closed jaxpr declares, or is, `within` a function that
    is declared: without a trace of it, since most systems have none."""
    total = 0
    for equation in closed.jaxpr.eqns:
        inner, name = _inlined(equation), equation.primitive.name
        if inner is not None:
            total += switches(inner, within or _declared(equation))
        elif within and name in RULES and _is_real(equation.invars[0].aval):
            total += equation.outvars[0].aval.size * (2 if name == "clamp" else 1)
    return total


def switched(closed: Any, given: Sequence[Any], sides: Any) -> tuple[list[Any], Any]:
    """What a closed jaxpr gives with the sides of its switching functions, shape `(m,)`,
    and the functions' values, shape `(m,)`."""
    run = _Switched(sides)
    outs = run.closed(closed, given)
    values = jnp.concatenate([jnp.ravel(g).astype(sides.dtype) for g in run.values])
    most = float(jnp.finfo(sides.dtype).max) ** 0.5  # a limit may be infinite
    return outs, jnp.clip(values, -most, most)


LOOPS = ("scan", "while", "cond")  # which stay as they are


def _inlined(equation: Any) -> Any:
    """The closed jaxpr of a call that is no loop."""
    return None if equation.primitive.name in LOOPS else inner_of(equation.params)


def _declared(equation: Any) -> bool:
    return equation.params.get("name") == NAME


def _is_real(x: Any) -> bool:
    return jnp.issubdtype(jnp.result_type(x), jnp.floating)


class _Switched:
    """A run of a jaxpr, which takes one side after another."""

    def __init__(self, sides: Any) -> None:
        self.sides, self.count, self.values = sides, 0, []

    def closed(self, closed: Any, given: Sequence[Any], within: bool = False) -> list[Any]:
        """The outputs; `within` a function that is declared."""
        jaxpr = closed.jaxpr
        values = dict(zip(jaxpr.constvars, closed.consts, strict=True))
        values |= dict(zip(jaxpr.invars, given, strict=True))

        def read(atom: Any) -> Any:
            if isinstance(atom, jex.Literal):
                aval: Any = atom.aval
                return np.asarray(atom.val, aval.dtype)
            return values[atom]

        for equation in jaxpr.eqns:
            found = self._applied(equation, [read(a) for a in equation.invars], within)
            values |= dict(zip(equation.outvars, found, strict=True))
        return [read(atom) for atom in jaxpr.outvars]

    def _applied(self, equation: Any, given: list[Any], within: bool) -> Sequence[Any]:
        primitive, inner = equation.primitive, _inlined(equation)
        if inner is not None:
            return self.closed(inner, given, within or _declared(equation))
        rule = RULES.get(primitive.name) if within else None
        if rule is not None and _is_real(given[0]):
            return [rule(self, *given)]
        found = primitive.bind(*given, **equation.params)
        return found if primitive.multiple_results else [found]

    def positive(self, g: Any) -> Any:
        """Whether a switching function is positive, or is held to be."""
        first, self.count = self.count, self.count + int(np.size(g))
        self.values.append(g)
        return g + self.sides[first : self.count].reshape(jnp.shape(g)) > 0


def _larger(run: _Switched, x: Any, y: Any) -> Any:
    return jnp.where(run.positive(x - y), x, y)


def _smaller(run: _Switched, x: Any, y: Any) -> Any:
    return jnp.where(run.positive(y - x), x, y)


def _magnitude(run: _Switched, x: Any) -> Any:
    return jnp.where(run.positive(x), x, -x)


def _sign(run: _Switched, x: Any) -> Any:
    one = jnp.ones_like(x)
    return jnp.where(run.positive(x), one, -one)


RULES = {
    "gt": lambda run, x, y: run.positive(x - y),
    "ge": lambda run, x, y: ~run.positive(y - x),
    "lt": lambda run, x, y: run.positive(y - x),
    "le": lambda run, x, y: ~run.positive(x - y),
    "max": _larger,
    "min": _smaller,
    "clamp": lambda run, low, x, high: _smaller(run, _larger(run, x, low), high),
    "abs": _magnitude,
    "sign": _sign,
}
