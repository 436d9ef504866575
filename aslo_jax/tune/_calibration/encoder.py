"""How far the angle of a record is ahead of the flux of the magnet, which a calibrated
machine knows."""

from typing import Any

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Float

from ..._replay import replay
from .imperfections import seen
from .predict import relations_of, residual
from .problem import Problem
from .relative import Observers, trusted
from .start import typical_cutoff
from .whiten import Signals

NAME = "encoder_offset"


def check_angle(
    model: Any, angle: Any, t: Float[np.ndarray, " N"]
) -> Float[np.ndarray, " N"]:
    """The `angle` of a record (rad), which an encoder offset needs."""
    if angle is None:
        raise ValueError(
            f"Argument `fit` (option --fit) must not have {NAME} for a log without an "
            "angle; give it (argument `angle`, electrical; on the command line --frame dq)."
        )
    if not _one_inductance(model):
        raise ValueError(
            f"Argument `fit` (option --fit) must not have {NAME} for a machine without a "
            "magnet and one inductance; leave it out."
        )
    found = np.asarray(angle, float)
    if found.shape != t.shape or not np.isfinite(found).all():
        raise ValueError(
            f"Argument `angle` must be finite and of shape {t.shape}, one electrical angle "
            f"(rad) for each row, but has shape {found.shape}."
        )
    return found


def encoder_offset(
    problem: Problem,
    v: Float[np.ndarray, " v"],
    log: tuple[np.ndarray, np.ndarray, np.ndarray],
    angle: Float[np.ndarray, " N"],
    cutoff: float | None,
) -> float:
    """The angle (rad) that the record is ahead of the magnet, on average.

    - `v`: the unknowns that were found;
    - `log`: `t` (s), `u` and `y` as they are recorded."""
    parameters, (t, *recorded) = problem.parameters, log
    signals: Any = Signals._make((np.diff(t), *recorded))
    if cutoff is None:
        cutoff = typical_cutoff(relations_of(parameters.model.model) or (), signals)
    observers = Observers(cutoff)

    def lead(q: np.ndarray) -> np.ndarray:
        """The unit vectors of the angle over that of the magnet, and their weights."""
        (observer,) = observers(parameters.place(q).model)
        (_, u, y), _, _ = seen(parameters, signals, q)
        estimate = replay(observer, t, u, y, engine="auto")
        magnet = np.asarray(_magnets(observer.relation, estimate.value, u, y))
        vector = magnet[:, 0] + 1j * magnet[:, 1]
        weight = trusted(estimate, t, observer) / np.maximum(np.abs(vector), 1e-300)
        return weight * np.exp(1j * angle) * np.conj(vector)

    q = np.array(v[: len(parameters.names)])
    return float(np.angle(np.sum(lead(q))))


@eqx.filter_jit
def _magnets(relation, x, u, y):
    # Of `1/2 |x|^2 = L i'x + d` the gradient is that flux.
    return jax.vmap(lambda x, u, y: residual(relation(u, y), x)[1])(x, u, y)


def _one_inductance(model: Any) -> bool:
    """Whether a model has one inductance, and one resistance in series with it."""
    relations: Any = relations_of(model) or ()
    scalar = lambda x: x is not None and np.ndim(x) == 0
    names = ("inductance", "resistance")
    return len(relations) == 1 and all(
        scalar(getattr(relations[0], name, None)) for name in names
    )
