"""Samples that are missing: what stands in for them, and what is remembered meanwhile."""

import dataclasses
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from .._typing import PyTree

# What a hole costs an estimate, relative to it, is about the square of its length in time
# constants of the filter times these, and is forgotten as the filter forgets: measured on
# motors at default cutoffs, 0.1 to 12 rad, with u and without.
BLIND, UNMEASURED = 1.4, 0.7
DOUBT = 0.05  # of the estimate: an error above which it is flagged


class Gap(eqx.Module):
    """What is remembered of the samples before this one, in case one is missing.

    - `u`: the last input that was finite, zero before there is one;
    - `waited`: since the last finite y (s), infinite before there is one, shape `()`;
    - `weight`: that of the last interval, 1 unless samples are missing, shape `()`;
    - `lost`: the length of the hole until now, in time constants, shape `()`;
    - `doubt`: the error that holes have left, relative to the estimate, shape `()`.
    """

    u: PyTree
    waited: Float[Array, ""]
    weight: Float[Array, ""]
    lost: Float[Array, ""]
    doubt: Float[Array, ""]

    @classmethod
    def before(cls, u: PyTree, y: PyTree) -> tuple["Gap", PyTree]:
        """At the first sample, and the y to start from. One that is missing is taken for 1,
        where fewer models are singular than at 0, until the first that is not."""
        there = finite(y)
        kind = jnp.result_type(float, *jax.tree.leaves(y))
        waited = jnp.where(there, 0.0, jnp.inf).astype(kind)
        weight = jnp.where(there, 1.0, 0.0).astype(kind)
        one = jax.tree.map(jnp.ones_like, y)
        none = jnp.zeros_like(waited)
        return cls(zeros(u), waited, weight, none, none), either(there, y, one)

    def after(self, u: PyTree) -> "Gap":
        """An interval over which nothing is missing."""
        return Gap(u, self.waited, self.weight, self.lost, self.doubt)


class Sample(NamedTuple):
    """A sample made whole: `u` over the interval, `left` and `y` at its ends; whether it is
    `missing`, or the `first` one, over whose interval nothing is known either; the weights
    of this interval and of the one before; whether u is missing, `blind`; and what is
    remembered."""

    u: PyTree
    left: PyTree
    y: PyTree
    missing: Bool[Array, ""]
    first: Bool[Array, ""]
    weights: tuple[Float[Array, ""], Float[Array, ""]]
    blind: Bool[Array, ""]
    gap: Gap


def whole(gap: Gap, before: PyTree, u: PyTree, y: PyTree, dt: Any, kept: Any) -> Sample:
    """The sample `u`, `y` after `dt` seconds, held where it is missing. `before` is the y
    that held until now: where y comes back, the interval begins on the line that joins the
    two. `kept` is what a filter remembers over these seconds, by its slowest part and as a
    whole; `None` without one."""
    u_there, y_there = finite(u), finite(y)
    u, y = either(u_there, u, gap.u), either(y_there, y, before)
    begun = jnp.isfinite(gap.waited)
    first = y_there & ~begun
    waited = jnp.where(begun, gap.waited, 0.0)
    passed = waited + jnp.asarray(dt, waited.dtype)
    part = jnp.where(y_there, jnp.where(first, 1.0, waited / passed), 0.0)
    left = jax.tree.map(lambda a, b: a + part.astype(a.dtype) * (b - a), before, y)
    missing = ~(u_there & y_there) | first
    elapsed = jnp.where(y_there, 0.0, jnp.where(begun, passed, jnp.inf))
    # After a long hole its mean slope says little of the last interval.
    weight = jnp.where(missing, 0.0, 1.0 - part)
    weights = weight, jnp.where(first, 1.0, gap.weight)
    lost, doubt = gap.lost, gap.doubt
    if kept is not None:
        slowest, kept = (jnp.asarray(x, doubt.dtype) for x in kept)
        length = (1.0 - slowest) * jnp.where(u_there, UNMEASURED, BLIND)
        broken = ~(u_there & y_there)
        passed = lost + jnp.where(broken, length, 0.0)
        doubt = kept * doubt + jnp.where(y_there, passed**2, 0.0)
        lost = jnp.where(y_there, 0.0, passed)
        forgets = first | ~begun
        lost, doubt = jnp.where(forgets, 0.0, lost), jnp.where(forgets, 0.0, doubt)
    now = Gap(u, elapsed, weight, lost, doubt)
    return Sample(u, left, y, missing, first, weights, ~u_there, now)


def marked(estimate: PyTree, missing: Bool[Array, ""], kind: type) -> PyTree:
    """Every estimate in a tree coasting where a sample is missing."""
    is_one = lambda e: isinstance(e, kind)

    def mark(e: Any) -> Any:
        if not is_one(e):
            return e
        # Before the first sample a model may be singular where it is evaluated.
        value = jnp.where(missing & ~jnp.isfinite(e.value), 0.0, e.value)
        return dataclasses.replace(e, value=value, coasting=e.coasting | missing)

    return jax.tree.map(mark, estimate, is_leaf=is_one)


def finite(signal: PyTree) -> Bool[Array, ""]:
    """Whether every entry is finite."""
    there = jnp.asarray(True)
    for leaf in jax.tree.leaves(signal):
        there = there & jnp.all(jnp.isfinite(leaf))
    return there


def either(there: Bool[Array, ""], a: PyTree, b: PyTree) -> PyTree:
    return jax.tree.map(lambda a, b: jnp.where(there, a, b), a, b)


def zeros(tree: PyTree) -> PyTree:
    return jax.tree.map(jnp.zeros_like, tree)
