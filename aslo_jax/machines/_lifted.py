"""The Kalman filters of a machine's relation, where `[observer]` asks for one."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Annotated, Any, Literal

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from pydantic import Field, model_validator

from .._guard import Guard
from ..derivation import Derived, StateObserver
from ..observers import Adaptive, AdaptiveVelocities, Lifted, LiftedVelocities
from ..observers._motion import PUSH, leaf_of
from ..plants import AbstractMechanicalSystem
from ..schema import Positive, Table, key

LIFTED, ADAPTIVE = "lifted_kalman", "adaptive"
FILTERS = (LIFTED, ADAPTIVE)
THRESHOLD = 0.9  # as that of `Lifted`
NO_EFFECT = ("cutoff", "rotor_cutoff", "forgetting", "gain", "completion", "start")
ObserverKind = Literal["aslo", "lifted_kalman"]
MotorKind = Literal["aslo", "lifted_kalman", "adaptive"]
Parameter = Literal["resistance", "magnet_flux"]
Deviation = Positive | Annotated[list[Positive], Field(min_length=1)]
HELD = "held"
OF_ADAPTIVE = ("parameters", "deviations", "drift", "hold", "bank", "tolerance")
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


def adaptive_keys(
    parameters: Sequence[str] = ("resistance", "magnet_flux"),
    deviations: Sequence[float] = (0.1, 0.02),
) -> tuple[Any, ...]:
    """`parameters`, `deviations`, `drift`, `hold`, `bank` and `tolerance`."""
    of = f'with kind = "{ADAPTIVE}": '
    return (
        key(f"{of}what is not known, that with the bank first", default=list(parameters)),
        key(f"{of}relative standard deviations of these", default=list(deviations)),
        key(
            f"{of}relative random walk of these: deviation after a second",
            "1/sqrt(s)",
            default=0.0,
        ),
        key(
            f"{of}relative deviation of the first of these above which they may be held",
            default=0.03,
        ),
        key(f"{of}how many values of the first of these", default=11),
        key(
            f"{of}relative deviation of the flux above which the estimate is flagged",
            default=0.01,
        ),
    )


class ObserverTable(Table):
    """`[observer]` of a machine whose relation a Kalman filter takes too: with the keys
    `kind`, `output_deviation`, `input_deviation` and `prior`."""

    @model_validator(mode="after")
    def _have_effect(self):
        given = {k for k in self.model_fields_set if getattr(self, k) is not None}
        if not is_adaptive(self):
            for name in OF_ADAPTIVE:
                # A template has them, as they are by default.
                field = type(self).model_fields.get(name)
                if name in given and field and getattr(self, name) != field.default:
                    raise ValueError(_is_for(name, ADAPTIVE))
        if not is_lifted(self):
            for name in ("output_deviation", "input_deviation", "prior"):
                if name in given:
                    raise ValueError(_is_for(name, LIFTED))
            return self
        for name in (*NO_EFFECT, *(("prior", "threshold") if is_adaptive(self) else ())):
            if name in given:
                raise ValueError(no_effect(name, kind_of(self)))
        if is_adaptive(self):
            return self
        if limit_of(self) >= 1.0:
            raise ValueError(
                f'`observer.threshold` must be below 1 with `observer.kind = "{LIFTED}"`, '
                f"whose certificate is, but is {limit_of(self)!r}"
            )
        return self


def _is_for(name: str, kind: str) -> str:
    return f'`observer.{name}` is for `observer.kind = "{kind}"`; remove it, or set that'


def no_effect(name: str, kind: str = LIFTED) -> str:
    """Why a key of `[observer]` is refused beside a Kalman filter."""
    return (
        f'`observer.{name}` has no effect with `observer.kind = "{kind}"`, which has the '
        "noise of the log in place of rates; remove it"
    )


def kind_of(settings: Any) -> str:
    """What `[observer]` asks for."""
    return getattr(settings, "kind", "aslo")


def is_lifted(settings: Any) -> bool:
    """Whether `[observer]` asks for a Kalman filter, of known or of unknown parameters."""
    return kind_of(settings) in FILTERS


def is_adaptive(settings: Any) -> bool:
    """Whether `[observer]` asks for that with unknown parameters."""
    return kind_of(settings) == ADAPTIVE


def limit_of(settings: Any) -> float:
    """The certificate below which the estimate coasts."""
    by_default = is_lifted(settings) and "threshold" not in settings.model_fields_set
    return THRESHOLD if by_default else settings.threshold


def _refuse_unknown_noise(settings: Any) -> None:
    for name in ("output_deviation", "input_deviation"):
        if getattr(settings, name) is None:
            raise ValueError(
                f"`observer.{name}` must be given, or found from a log: use the machine "
                "that its `with_noise_of(log)` returns."
            )


def lifted(relation: Callable[..., Any], settings: Any) -> Lifted | Adaptive:
    """The Kalman filter of a relation, its parameters known or not.

    **Raises:** `ValueError` without deviations.
    """
    _refuse_unknown_noise(settings)
    array = lambda x: jnp.asarray(x, float)
    if is_adaptive(settings):
        return adaptive(relation, settings)
    return Lifted(
        relation,
        array(settings.output_deviation),
        array(settings.input_deviation),
        prior=settings.prior,
        guard=Guard(limit_of(settings)),
    )


def lifted_states(found: Derived, settings: Any) -> StateObserver:
    """The Kalman filter of a derived relation, as an observer of states.

    **Raises:** `ValueError` without deviations."""
    _refuse_unknown_noise(settings)
    deviations = (
        jnp.broadcast_to(jnp.asarray(given, float), (len(names),))
        for given, names in (
            (settings.output_deviation, found.model.outputs),
            (settings.input_deviation, found.model.inputs),
        )
    )
    if is_adaptive(settings):
        return found.adaptive_filter(
            *deviations,
            parameters=settings.parameters,
            deviations=tuple(settings.deviations),
            drift=settings.drift,
            hold=settings.hold,
            bank=settings.bank,
            tolerance=settings.tolerance,
        )
    return found.kalman_filter(*deviations, threshold=limit_of(settings))


def adaptive(relation: Callable[..., Any], settings: Any) -> Adaptive:
    """The Kalman filter of a relation some of whose parameters are unknown, with the
    settings of a machine's file or a study's."""
    return Adaptive(
        relation,
        jnp.asarray(settings.output_deviation, float),
        jnp.asarray(settings.input_deviation, float),
        tuple(settings.parameters),
        tuple(settings.deviations),
        settings.drift,
        settings.hold,
        settings.bank,
        tolerance=settings.tolerance,
    )


def lifted_velocities(
    system: AbstractMechanicalSystem, settings: Any
) -> LiftedVelocities | AdaptiveVelocities:
    """The Kalman filter of all velocities of a mechanical system, its parameters known or
    not, with the settings of a machine's file or a study's."""
    noise = settings.output_deviation, settings.input_deviation
    force = settings.force_deviation
    if not is_adaptive(settings):
        guard = Guard(limit_of(settings))
        return LiftedVelocities(system, *noise, force, settings.prior, guard=guard)
    names, drift = tuple(settings.parameters), settings.drift
    return AdaptiveVelocities(
        system,
        *noise,
        names,
        settings.deviations,
        [drift] * len(names) if drift else None,
        force,
    )


def entries_of(system: AbstractMechanicalSystem, name: str) -> int | None:
    """How many entries a parameter of a system has; `None` of a number."""
    if name == PUSH:
        return int(system.initial().position.shape[0])
    shape = np.shape(leaf_of(system, name))
    return int(np.prod(shape)) if shape else None


def parameters_of(
    names: Sequence[str], estimate: Any
) -> dict[str, Float[np.ndarray, " N"]]:
    """The columns of the parameters that an estimate has found, by their `names`, their
    deviations, and whether they are held."""
    if not names:
        return {}
    found: dict[str, Any] = {}
    variances = np.diagonal(np.asarray(estimate.parameter_covariance), axis1=1, axis2=2)
    for k, name in enumerate(names):
        found[name] = np.asarray(estimate.parameters)[:, k]
        found[f"deviation_{name}"] = np.sqrt(np.maximum(variances[:, k], 0.0))
    return found | {HELD: np.asarray(estimate.held).astype(float)}


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
