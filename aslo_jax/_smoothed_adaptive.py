"""Smoothing of a log some of whose relation's parameters are unknown."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp

from ._factored import array, factored, stacked
from ._replay import Checked, run_log
from ._smoothed import smoothed
from .observers import Adaptive, AdaptiveEstimate, Lifted
from .observers._adaptive import uncertain
from .observers._lifting import matrix

TOLD = 1e3  # the tolerance of one that is only to be told from its rivals


@eqx.filter_jit
def smoothed_adaptive(
    observer: Adaptive, log: Checked, common: object, coasts: bool
) -> AdaptiveEstimate:
    """The estimates at all instants of a `log` that has been checked.

    The filter of the parameters has them from the whole log at its end. With them known, x
    is smoothed; what is not known of them moves all of it: the covariance of x is what it
    is with the parameters known, and that of its mean."""
    # Rows which are not known well enough on the way may be in the end.
    told = dataclasses.replace(observer, tolerance=jnp.asarray(TOLD))
    filtered, _ = run_log(told, log, common, 1, None, "scan", coasts)
    model = observer.law.model
    nominal = model.nominal().astype(filtered.value.dtype)
    # After a hole in which all was lost the filter begins again.
    variance = filtered.parameter_covariance[:, 0, 0]
    best = jnp.argmin(jnp.where(filtered.coasting, jnp.inf, variance))
    of_best = lambda x: x[best]
    parameters, P = of_best(filtered.parameters), of_best(filtered.parameter_covariance)

    def lifted(parameters):
        return Lifted(
            model.at(parameters / nominal - 1.0),
            observer.output_deviation,
            observer.input_deviation,
            initial=observer.initial,
        )

    # With those found, and one deviation away from them to both sides.
    U, pivots = factored(matrix(P))
    ways = (array(U, P.dtype) * jnp.sqrt(stacked(pivots, P.dtype))).T
    each = jnp.concatenate([parameters[None], parameters + ways, parameters - ways])
    known = jax.lax.map(lambda p: smoothed(lifted(p), log, common, coasts), each)
    found = jax.tree.map(lambda a: a[0], known)
    by_way = 0.5 * (known.x[1 : 1 + P.shape[0]] - known.x[1 + P.shape[0] :])
    covariance = found.covariance + jnp.einsum("kri,krj->rij", by_way, by_way)
    estimate = found._replace(covariance=covariance).judged(lifted(parameters))
    everywhere = lambda x: jnp.broadcast_to(x, (found.missing.size, *x.shape))
    return AdaptiveEstimate(
        estimate.value,
        estimate.certificate,
        estimate.coasting
        | jnp.all(filtered.coasting)
        | uncertain(estimate.certificate, observer.tolerance),
        covariance,
        parameters=everywhere(parameters),
        parameter_covariance=everywhere(P),
        held=everywhere(of_best(filtered.held)),
    )
