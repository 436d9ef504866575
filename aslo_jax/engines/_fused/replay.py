"""Replay of recorded logs by the fused engine: one log, or many beside each other."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ..._checks import is_concrete
from ..._typing import PyTree
from ...observers import AbstractObserver, ObserverState
from .._runtime.host import widths
from .kept import ONE, kept, key_of, shape_of
from .program import Bodies, Program


def replay_fused(
    observer: AbstractObserver[Any],
    state: ObserverState,
    u: PyTree,
    y: PyTree,
    intervals: Array | np.ndarray | None,
    coefficients: PyTree,
    substeps: int,
    common: Array | None = None,
    coasts: bool = False,
) -> tuple[Any, ObserverState]:
    """The estimates after each interval, and the last state, from the held `u` and the `y`
    at the ends of the `intervals` (s). Where these are all the same they are `None`, and
    the `coefficients` of the observer's laws are given in their place, with the `common`
    one (s) where the observer `coasts` over samples that are missing.

    Under `jax.vmap` the logs, states and observers of a batch run beside each other. It has
    no derivative."""
    arrays, rest = eqx.partition(observer, eqx.is_array)
    fixed = coefficients, common
    leaves, tree = jax.tree.flatten((arrays, state, u, y, intervals, fixed))
    run = _Replay(rest, tree, [np.ndim(x) for x in leaves], substeps, coasts)
    if is_concrete(*leaves):
        # Not `jnp.asarray`, which compiles a copy for every shape.
        return jax.device_put(run([np.asarray(x) for x in leaves]))
    shapes = run.shapes([jax.ShapeDtypeStruct(jnp.shape(x), x.dtype) for x in leaves])
    return jax.pure_callback(run, shapes, leaves, vmap_method="broadcast_all")


class _Replay:
    """The replay of a batch of logs as a function of arrays with any axes in front."""

    def __init__(
        self, rest: PyTree, tree: Any, ranks: list[int], substeps: int, coasts: bool
    ) -> None:
        self.rest, self.tree, self.ranks, self.substeps = rest, tree, ranks, substeps
        self.coasts = coasts

    def shapes(self, leaves: list[Any]) -> Any:
        arrays, state, *signals, coefficients = jax.tree.unflatten(self.tree, leaves)
        steps = jax.tree.leaves(signals[1])[0].shape[0]
        one = lambda s: jax.ShapeDtypeStruct(s.shape[1:], s.dtype)
        now = jax.tree.map(one, signals)
        final, estimate = jax.eval_shape(self._advance, arrays, state, *now, coefficients)
        whole = lambda s: jax.ShapeDtypeStruct((steps, *s.shape), s.dtype)
        return jax.tree.map(whole, estimate), final

    def _advance(self, arrays, state, u, y, h, coefficients):
        observer = eqx.combine(arrays, self.rest)
        coefficients, dt = coefficients
        if h is not None:
            coefficients = observer.allocate(state.y, u).discretise(h / self.substeps)
            dt = h
        if self.coasts:
            return observer.take(state, u, y, dt, coefficients, substeps=self.substeps)
        return observer.advance(state, u, y, coefficients, substeps=self.substeps)

    def __call__(self, leaves: list[Any]) -> Any:
        leaves = [np.asarray(x) for x in leaves]
        lead = leaves[0].shape[: leaves[0].ndim - self.ranks[0]]
        lanes = int(np.prod(lead, dtype=int))
        flat = [x.reshape(lanes, *x.shape[len(lead) :]) for x in leaves]
        estimate, final = self._run(flat, lanes)
        back = lambda x: x.reshape((*lead, *x.shape[1:]))
        return jax.tree.map(back, (estimate, final))

    def _run(self, leaves: list[np.ndarray], lanes: int) -> Any:
        arrays, state, u, y, h, coefficients = jax.tree.unflatten(self.tree, leaves)
        steps = jax.tree.leaves(y)[0].shape[1]
        signals = {"u": u, "y": y, "h": h}
        fixed = {"observer": arrays, "coefficients": coefficients}
        kind = ("shared", "log") if lanes == 1 else ("lane", "lane log")
        if lanes == 1:
            fixed, signals = jax.tree.map(lambda x: np.asarray(x[0]), (fixed, signals))
        shape = lambda tree, drop: jax.tree.map(lambda x: shape_of(x, drop), tree)
        drop = 1 if lanes > 1 else 0
        shapes = {kind[0]: shape(fixed, drop), kind[1]: shape(signals, drop + 1)}
        inputs = {kind[0]: fixed, kind[1]: signals}
        # The first state differs from lane to lane, like the one that is returned.
        shapes["lane"] = shapes.get("lane", {}) | {"state": shape(state, 1)}
        inputs["lane"] = inputs.get("lane", {}) | {"state": state}

        def advance(k, state, inputs):
            of, now = inputs[kind[0]], inputs[kind[1]]
            signals = now["u"], now["y"], now["h"]
            return self._advance(of["observer"], state, *signals, of["coefficients"])

        bodies = Bodies(
            lambda inputs: (inputs["lane"]["state"], None),
            advance,
            lambda state, inputs: state,
        )
        make = lambda: Program.of(bodies, shapes, ONE if lanes == 1 else widths())
        key = key_of(self.rest, shapes, self.tree, self.substeps, self.coasts)
        return kept(key, make)(inputs, lanes, steps)
