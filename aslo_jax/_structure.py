"""Whether a mechanical system has an algebraic observer of its velocities, and of what
form: the assumptions of the paper's section 4.3, decided from M(q) and R(q) alone."""

import dataclasses
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ._checks import is_concrete
from .plants import AbstractMechanicalSystem

__all__ = [
    "INSTEAD",
    "POINTS",
    "Friction",
    "Region",
    "Structure",
    "StructureError",
    "decay_rate",
    "structure_of",
]

Friction = Literal["none", "constant", "varying"]
Region = tuple[Any, Any]  # lowest and highest coordinates, each of shape (n,)

POINTS = 64  # of the region, where M and R are looked at


class StructureError(ValueError):
    """A mechanical system that is not of the class: says which assumption fails, where,
    and what to use instead."""


@dataclasses.dataclass(frozen=True)
class Structure:
    """The form of the observer of a mechanical system's velocities.

    - `stages`: the coordinates, counted from 0, whose velocities are found first, those
      found from these, and so on. The acceleration of a coordinate needs the velocities of
      those whose inertia depends on it;
    - `friction`: for each coordinate none, `constant` (which integrates), or `varying` with
      position;
    - `constant`: for each coordinate, whether its inertia is constant.

    Source: paper, section 4.3; theory, section 5.
    """

    stages: tuple[tuple[int, ...], ...]
    friction: tuple[Friction, ...]
    constant: tuple[bool, ...]

    def __str__(self) -> str:
        steps = [", ".join(f"q{j + 1}'" for j in stage) for stage in self.stages]
        words = {
            "none": "none",
            "constant": "constant (integrable)",
            "varying": "varying with position (bounded form)",
        }
        friction = [f"q{j + 1}: {words[kind]}" for j, kind in enumerate(self.friction)]
        return f"velocities: {', then '.join(steps)}\nfriction: {', '.join(friction)}"


def structure_of(
    system: AbstractMechanicalSystem,
    region: Region | None = None,
) -> Structure:
    """Decide whether `system` is of the class, and return the form of its observer.

    M and R and their derivatives are looked at on 64 points (Sobol's sequence) of `region`,
    a pair (low, high) of coordinates, each of shape `(n,)`; by default a full turn of the
    angles and half of its size, or 0.5, on both sides of the first position for the others.

    The class is that of the paper's Assumptions 2 and 3, and more: M is diagonal, no entry
    depends on its own coordinate, and the coordinates have an order in which every entry
    depends on later ones only (the paper has two stages, with a constant upper block; its
    swapped choice is covered, as is any order of the coordinates). Constant friction of any
    form integrates; friction that varies with position must not couple coordinates.

    **Raises:** [`StructureError`][] where that does not hold.
    """
    q, M, M_slope, R, R_slope = _look(system, region)
    tolerance = float(np.finfo(M.dtype).eps) ** (2.0 / 3.0)
    n = q.shape[1]
    size = np.sqrt(np.abs(np.einsum("kii,kjj->kij", M, M)))
    _check_diagonal(q, M, size, tolerance)
    span = np.maximum(np.ptp(q, axis=0), 1.0)
    diagonal = np.einsum("kiij->kij", M_slope) * span / np.einsum("kii->ki", M)[:, :, None]
    depends = (np.abs(diagonal) > tolerance).any(axis=0)  # M[i, i] on q[j]
    for j in range(n):
        if depends[j, j]:
            raise StructureError(
                f"Assumption 2 fails: the inertia M[{j}, {j}] of q{j + 1} depends on "
                f"q{j + 1} itself, as it does at q = {_point(q, diagonal[:, j, j])}. Take "
                f"the integral of sqrt(M[{j}, {j}]) over q{j + 1} as the coordinate, whose "
                f"inertia is constant, or {INSTEAD}."
            )
    friction: tuple[Friction, ...] = tuple(
        _friction(j, q, R, R_slope, span, tolerance) for j in range(n)
    )
    constant = tuple(not bool(row.any()) for row in depends)
    return Structure(_stages(depends), friction, constant)


INSTEAD = (
    "use an observer that needs no structure, `ExtendedKalman.of_mechanical`, `HighGain` "
    "or `SuperTwisting`"
)


def decay_rate(
    system: AbstractMechanicalSystem, coordinate: int, region: Region | None = None
) -> tuple[Float[np.ndarray, "points n"], Float[np.ndarray, " points"]]:
    """Points of `region`, shape `(N, n)`, and at each, shape `(N,)`, friction over inertia
    (1/s) of a `coordinate`, counted from 0, of a mechanical `system`.
    """
    q, M, _, R, _ = _look(system, region)
    return q, R[:, coordinate, coordinate] / M[:, coordinate, coordinate]


def _look(system, region) -> tuple[np.ndarray, ...]:
    from scipy.stats import qmc  # slow to import

    if not is_concrete(*jax.tree.leaves(system)):
        raise ValueError(
            "The structure of a system cannot be decided while its parameters are traced; "
            "call `structure_of(system)` outside and pass it on."
        )
    position = np.asarray(system.initial().position)
    n = position.size
    if region is None:
        half = np.maximum(0.5 * np.abs(position), 0.5)
        angles = np.array(system.angles or (False,) * n)
        half = np.where(angles, np.pi, half)
        region = position - half, position + half
    low, high = (np.asarray(bound, position.dtype) for bound in region)
    if low.shape != (n,) or high.shape != (n,) or not (low < high).all():
        raise ValueError(
            f"Argument `region` must be a pair of bounds, low < high, of shape ({n},), but "
            f"got {low.tolist()} and {high.tolist()}."
        )
    unit = qmc.Sobol(n, scramble=False).random(POINTS) + 0.5 / POINTS
    q = (low + unit * (high - low)).astype(position.dtype)
    values = system.inertia, system.friction
    functions = [g for f in values for g in (f, jax.jacfwd(f))]
    # One program in place of one for each operation.
    found = jax.jit(lambda q: [jax.vmap(f)(q) for f in functions])(jnp.asarray(q))
    return q, *map(np.asarray, found)


def _check_diagonal(q, M, size, tolerance) -> None:
    lowest = np.einsum("kii->ki", M).min(axis=0)
    if not (np.isfinite(M).all() and (lowest > 0).all()):
        j = int(np.argmin(np.where(np.isfinite(lowest), lowest, -np.inf)))
        raise StructureError(
            f"The inertia M[{j}, {j}] must be positive, but it is not at q = "
            f"{_point(q, -M[:, j, j])}; give the `region` that the system moves in."
        )
    off = np.abs(M) / size * (1.0 - np.eye(M.shape[1]))
    k, i, j = np.unravel_index(int(off.argmax()), off.shape)
    if off[k, i, j] > tolerance:
        raise StructureError(
            "Assumption 2 fails: the inertia matrix is not diagonal, "
            f"M[{i}, {j}] = {M[k, i, j]:.4g} at q = {_point(q, off[:, i, j])}. Choose "
            f"coordinates in which it is (a relative angle may become an absolute one), or "
            f"{INSTEAD}."
        )


def _stages(depends: np.ndarray) -> tuple[tuple[int, ...], ...]:
    """The order in which velocities follow from each other: that of q[j] needs those of
    every i whose M[i, i] depends on q[j]."""
    left, known, stages = set(range(len(depends))), set(), []
    while left:
        stage = {j for j in left if set(np.flatnonzero(depends[:, j])) <= known}
        if not stage:
            pairs = [
                f"M[{i}, {i}] on q{j + 1}"
                for j in sorted(left)
                for i in np.flatnonzero(depends[:, j])
                if i in left
            ]
            raise StructureError(
                "Assumption 2 fails: no velocity can be found first, since the inertias "
                f"depend on each other's coordinates: {', '.join(pairs)}. Choose other "
                f"coordinates, or {INSTEAD}."
            )
        stages.append(tuple(sorted(stage)))
        known |= stage
        left -= stage
    return tuple(stages)


def _friction(j, q, R, R_slope, span, tolerance) -> Friction:
    largest = max(float(np.abs(R).max()), np.finfo(R.dtype).tiny)
    if np.abs(R - np.swapaxes(R, 1, 2)).max() > tolerance * largest:
        raise StructureError("The friction matrix R(q) must be symmetric, but it is not.")
    row, slope = np.abs(R[:, j]) / largest, np.abs(R_slope[:, j] * span) / largest
    if R[:, j, j].min() < -tolerance * largest:
        raise StructureError(
            f"The friction R[{j}, {j}] must not be negative, but it is at q = "
            f"{_point(q, -R[:, j, j])}."
        )
    if slope.max() <= tolerance:
        return "none" if row.max() <= tolerance else "constant"
    others = np.delete(np.arange(R.shape[1]), j)
    if others.size and row[:, others].max() > tolerance:
        i = int(others[row[:, others].max(axis=0).argmax()])
        raise StructureError(
            f"Assumption 3 fails: the friction R[{j}, {i}] couples q{j + 1} with q{i + 1}, "
            f"and row {j} of R varies with position, so that it does not integrate, for "
            f"instance at q = {_point(q, row[:, i])}. Take the coupling as constant, or "
            f"{INSTEAD}."
        )
    return "varying"


def _point(q: np.ndarray, size: np.ndarray) -> list[float]:
    """The point of q where `size` is largest in magnitude, to be read."""
    return [round(float(x), 3) for x in q[int(np.abs(size).argmax())]]
