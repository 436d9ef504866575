"""Smoothing of a log: each estimate from what came before and after it."""

from typing import overload

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike

from . import _choices
from ._checked_log import checked_log
from ._checks import is_concrete, one_of, unlike
from ._derive.observer import StateObserver
from ._smoothed import Smoothed, smoothed
from ._smoothed_adaptive import smoothed_adaptive
from ._typing import Missing, PyTree
from .observers import AbstractObserver, Adaptive, AdaptiveEstimate, Estimate, Lifted


@overload
def smooth(
    observer: Adaptive,
    t: ArrayLike,
    u: PyTree[ArrayLike],
    y: PyTree[ArrayLike],
    *,
    missing: Missing = "refuse",
) -> AdaptiveEstimate: ...
@overload
def smooth(
    observer: AbstractObserver,
    t: ArrayLike,
    u: PyTree[ArrayLike],
    y: PyTree[ArrayLike],
    *,
    missing: Missing = "refuse",
) -> Estimate: ...


def smooth(
    observer: AbstractObserver,
    t: ArrayLike,
    u: PyTree[ArrayLike],
    y: PyTree[ArrayLike],
    *,
    missing: Missing = "refuse",
) -> Estimate:
    """The estimate at every instant of a log from the whole log, later samples too:
    fixed-interval smoothing on the Kalman filter of a relation.

    - `observer`: a [`Lifted`][], an [`Adaptive`][], or that of the states of a model by a
      Kalman filter ([`aslo_jax.derivation.Derived.kalman_filter`][]);
    - `t`, shape `(N,)`; `u` and `y`, as of [`replay`][];
    - `missing`: as of [`replay`][]. With `"coast"` a row of a hole is flagged, and its
      covariance is that of what the log tells from both sides; across a hole over which
      all is lost neither side is told of the other.

    The filter runs forward, and the information of what follows backward; each estimate
    weighs the two. Beside the filter's the error of a motor's flux is 1.2 to 1.4 times
    smaller, and the start of the log is as good as the rest. The parameters of an
    [`Adaptive`][] are those that it has found at the end of the log, in every row; what is
    not known of them is in each covariance.

    **Returns:** an [`Estimate`][] whose leaves have a leading axis of length `N`, with the
    covariance of each value; of an [`Adaptive`][] an [`AdaptiveEstimate`][]. It coasts
    where the whole log does not tell what x is. Differentiable; `jax.vmap` maps it.

    **Raises:** `ValueError` for another observer, for an [`Adaptive`][] whose parameters
    drift, and as [`replay`][].

    Source: Rauch, Tung, Striebel 1965, doi:10.2514/3.3166, in the form of two filters,
    which needs no inverse of a covariance: Fraser, Potter 1969,
    doi:10.1109/TAC.1969.1099196.
    """
    inner = observer.observer if isinstance(observer, StateObserver) else observer
    if not isinstance(inner, Lifted | Adaptive):
        raise unlike("observer", inner, "a `Lifted` or an `Adaptive`")
    one_of("missing", missing, _choices.Missing)
    log, common = checked_log(t, u, y, missing=missing)
    coasts = missing == "coast"
    if isinstance(inner, Adaptive):
        found = smoothed_adaptive(_constant(inner), log, common, coasts)
        if not isinstance(observer, StateObserver):
            return found
        return jax.vmap(observer.decoded)(found, jnp.asarray(log[2]))
    found = smoothed(inner, log, common, coasts)
    whole = found.judged(inner)
    return (
        _decoded(observer, whole, found) if isinstance(observer, StateObserver) else whole
    )


def _decoded(observer: StateObserver, of: Estimate, found: Smoothed) -> Estimate:
    """The estimates of the states of a model from those of the relation's x."""
    _, y = found.signals
    states = jax.vmap(observer.decoded)(of, y)
    if observer.guard is None:
        return states
    known = jax.vmap(observer.guard.certified)(states.certificate)
    return eqx.tree_at(lambda e: e.coasting, states, states.coasting | ~known)


def _constant(observer: Adaptive) -> Adaptive:
    """The observer, whose parameters must not drift."""
    drifts = (
        "Argument `observer` must have parameters that are constant, `drift=0`, to be "
        "smoothed, but they drift."
    )
    if not is_concrete(observer.drift):
        return eqx.error_if(observer, jnp.any(observer.drift > 0.0), drifts)
    if np.any(np.asarray(observer.drift) > 0.0):
        raise ValueError(drifts)
    return observer
