"""How far the angle of a record is ahead of the flux of the magnet, which a calibrated
machine knows."""

from typing import Any

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Float

from ..._replay import replay
from .imperfections import seen
from .information import Information, spread
from .predict import relations_of, residual
from .problem import Problem
from .relative import Observers, trusted
from .start import typical_cutoff
from .whiten import Signals

NAME = "encoder_offset"
STEP = 1e-4  # of a parameter, between two angles of which the slope is taken


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
    known: Information,
    log: tuple[np.ndarray, np.ndarray, np.ndarray],
    angle: Float[np.ndarray, " N"],
    cutoff: float | None,
) -> tuple[float, float]:
    """The angle (rad) that the record is ahead of the magnet, and its standard deviation:
    from the spread over blocks of the record, and from that of the parameters.

    - `v`, `known`: the unknowns that were found, and what is known of them;
    - `log`: `t` (s), `u` and `y` as they are recorded."""
    parameters, (t, *recorded) = problem.parameters, log
    signals: Any = Signals._make((np.diff(t), *recorded))
    k, every = len(problem.found), len(parameters.names)
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

    q = np.array(v[:every])
    rows = lead(q)
    mean = np.sum(rows)
    off = (rows * np.conj(mean)).imag[:, None] / np.abs(mean) ** 2
    variance = float(spread(off, len(rows))[0, 0])
    slope = np.zeros(k)
    for j in range(k):
        ends = [np.sum(lead(q + side * STEP * np.eye(every)[j])) for side in (1, -1)]
        slope[j] = np.angle(ends[0] * np.conj(ends[1])) / (2.0 * STEP)
    inverse = np.linalg.pinv(known.curvature, hermitian=True)
    variance += float(slope @ inverse @ slope) * float(np.max(known.inflation))
    return float(np.angle(mean)), float(np.sqrt(variance))


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
