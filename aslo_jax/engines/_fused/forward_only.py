"""The derivatives that a fused run does not have: refused where they are asked for, since
what JAX says of its callbacks does not tell what to do."""

from typing import Any, NoReturn

from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir, partial_eval

REVERSE = (
    "The fused engine has forward derivatives only, but a reverse or linearised one was "
    "asked for (jax.grad, jax.vjp, jax.jacrev, jax.linearize). Use jax.jvp or jax.jacfwd, "
    'or engine="scan", of `simulate` "diffrax".'
)
SECOND = (
    "The fused engine has first derivatives only, but the derivative of one was asked for "
    '(jax.hessian, jax.jacfwd of jax.jacfwd). Use engine="scan", of `simulate` "diffrax".'
)


def forward_only(rate: Any) -> Any:
    """A tangent as it is. Reverse derivatives evaluate what follows from it later than the
    values, which one run cannot: they are refused."""
    return _rate.bind(rate)


def _evaluated(trace: Any, rate: Any) -> Any:
    """Where a function is split into what is known and what follows from tangents."""
    if rate.is_known():
        return _rate.bind(rate.pval.get_known())
    raise NotImplementedError(REVERSE)


def second(primals: Any, tangents: Any) -> NoReturn:
    """The derivative of a derivative."""
    raise NotImplementedError(SECOND)


_rate = Primitive("aslo_jax_rate")
_rate.def_impl(lambda x: x)
_rate.def_abstract_eval(lambda x: x)
batching.primitive_batchers[_rate] = lambda x, axes: (_rate.bind(*x), *axes)
mlir.register_lowering(_rate, mlir.lower_fun(lambda x: x, multiple_results=False))
ad.primitive_jvps[_rate] = second
partial_eval.custom_partial_eval_rules[_rate] = _evaluated
