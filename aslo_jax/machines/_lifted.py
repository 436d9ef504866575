"""The Kalman filter of a machine's relation, where `[observer]` asks for it."""

from collections.abc import Callable, Iterator, Mapping
from typing import Annotated, Any, Literal

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from pydantic import Field, model_validator

from .._guard import Guard
from ..observers import Lifted
from ..schema import Positive, Table, key

LIFTED = "lifted_kalman"
THRESHOLD = 0.9  # as that of `Lifted`
NO_EFFECT = ("cutoff", "rotor_cutoff", "forgetting", "gain", "completion", "start")
ObserverKind = Literal["aslo", "lifted_kalman"]
Deviation = Positive | Annotated[list[Positive], Field(min_length=1)]
ALLOWED = "a positive finite number, or one for each column"


def kind_key() -> Any:
    return key("the kind of observer", default="aslo")


def deviation_key(of: str, example: float) -> Any:
    return key(
        f'with kind = "{LIFTED}": standard deviation of the noise on every sample of the '
        f"{of}, in its unit, by default found from the log",
        default=None,
        example=example,
        allowed=ALLOWED,
    )


def prior_key(example: float) -> Any:
    return key(
        f'with kind = "{LIFTED}": standard deviation of the first belief of the flux, by '
        "default infinite",
        "Wb",
        default=None,
        example=example,
    )


class ObserverTable(Table):
    """`[observer]` of a machine whose relation a Kalman filter takes too: with the keys
    `kind`, `output_deviation`, `input_deviation` and `prior`."""

    @model_validator(mode="after")
    def _have_effect(self):
        given = {k for k in self.model_fields_set if getattr(self, k) is not None}
        if not is_lifted(self):
            for name in ("output_deviation", "input_deviation", "prior"):
                if name in given:
                    raise ValueError(
                        f'`observer.{name}` is for `observer.kind = "{LIFTED}"`; remove '
                        "it, or set that"
                    )
            return self
        for name in NO_EFFECT:
            if name in given:
                raise ValueError(no_effect(name))
        if limit_of(self) >= 1.0:
            raise ValueError(
                f'`observer.threshold` must be below 1 with `observer.kind = "{LIFTED}"`, '
                f"whose certificate is, but is {limit_of(self)!r}"
            )
        return self


def no_effect(name: str) -> str:
    """Why a key of `[observer]` is refused beside the Kalman filter."""
    return (
        f'`observer.{name}` has no effect with `observer.kind = "{LIFTED}"`, which has the '
        "noise of the log in place of rates; remove it"
    )


def is_lifted(settings: Any) -> bool:
    """Whether `[observer]` asks for the Kalman filter."""
    return getattr(settings, "kind", "aslo") == LIFTED


def limit_of(settings: Any) -> float:
    """The certificate below which the estimate coasts."""
    by_default = is_lifted(settings) and "threshold" not in settings.model_fields_set
    return THRESHOLD if by_default else settings.threshold


def lifted(relation: Callable[..., Any], settings: Any) -> Lifted:
    """The Kalman filter of a relation.

    **Raises:** `ValueError` without deviations.
    """
    for name in ("output_deviation", "input_deviation"):
        if getattr(settings, name) is None:
            raise ValueError(
                f"`observer.{name}` must be given, or found from a log: use the machine "
                "that its `with_noise_of(log)` returns."
            )
    array = lambda x: jnp.asarray(x, float)
    return Lifted(
        relation,
        array(settings.output_deviation),
        array(settings.input_deviation),
        prior=settings.prior,
        guard=Guard(limit_of(settings)),
    )


def deviations_of(
    names: tuple[str, ...], estimate: Any
) -> dict[str, Float[np.ndarray, " N"]]:
    """The columns `deviation_*` of an estimate, where it has a covariance."""
    if estimate.covariance is None:
        return {}
    variances = np.diagonal(np.asarray(estimate.covariance), axis1=1, axis2=2)
    sizes = np.sqrt(np.maximum(variances, 0.0)).T
    return {f"deviation_{name}": x for name, x in zip(names, sizes, strict=True)}


def turning_deviation(
    estimate: Any, magnet: Float[np.ndarray, "N 2"], noise: Any
) -> Float[np.ndarray, " N"]:
    """That of the angle of `magnet`, the flux less some current, of which `noise` is the
    deviation (rad). The noise of that current moves the flux along the magnet, the angle is
    moved by what is across: the two are apart."""
    size = np.maximum(np.linalg.norm(magnet, axis=1), np.finfo(float).tiny)
    across = np.stack([-magnet[:, 1], magnet[:, 0]], axis=1) / size[:, None]
    of_flux = np.einsum("ki,kij,kj->k", across, np.asarray(estimate.covariance), across)
    of_current = np.sum((across * np.asarray(noise)) ** 2, axis=1)
    return np.sqrt(np.maximum(of_flux + of_current, 0.0)) / size


def said_of(
    settings: Any, units: tuple[str, str], found: Mapping[str, str]
) -> Iterator[str]:
    """Lines for a summary on the noise of y and u, of which `units` are; `found`: where it
    comes from, by key."""
    for name, unit in zip(("output_deviation", "input_deviation"), units, strict=True):
        value = np.atleast_1d(getattr(settings, name))
        text = ", ".join(dict.fromkeys(f"{x:.3g}" for x in value))
        reason = f" ({found[name]})" if name in found else ""
        yield f"  {name} {text} {unit}{reason}"
