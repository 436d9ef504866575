"""What the errors say of the parameters: curvature, deviations, flat directions."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

BLOCKS = 25  # of a record, whose slopes are summed


class Information(NamedTuple):
    """Of `k` parameters, relative, with all other unknowns free.

    - `curvature`: of half the sum of squares, shape `(k, k)`, in units of the errors;
    - `deviation`: standard deviation of each, shape `(k,)`, robust;
    - `inflation`: its square over that of white errors, at least one, shape `(k,)`.
    """

    curvature: Float[np.ndarray, "k k"]
    deviation: Float[np.ndarray, " k"]
    inflation: Float[np.ndarray, " k"]

    def flat(self, wide: float) -> Float[np.ndarray, "k f"]:
        """The directions along which a standard deviation is above `wide`, and, where
        that is so of a parameter but of no direction, the flattest."""
        values, vectors = np.linalg.eigh(self.curvature)
        variance = 1.0 / np.maximum(values, 1e-300)
        found = np.sqrt(variance) > wide
        if (self.deviation > wide).any():
            found[0] = True
        return vectors[:, found]

    def moved(self, step: Float[np.ndarray, " k"], wide: float) -> float:
        """The largest of the parts of a `step` along directions with a standard deviation
        of at most `wide`, in such deviations."""
        values, vectors = np.linalg.eigh(self.curvature)
        known = values * wide**2 >= 1.0
        parts = np.abs(vectors.T @ step) * np.sqrt(np.maximum(values, 0.0))
        return float(np.max(parts[known], initial=0.0))


def normalised(slopes: Float[np.ndarray, "N v"]) -> tuple[np.ndarray, np.ndarray]:
    """Columns of size one, and what their sizes were."""
    size = np.sqrt(np.sum(slopes**2, axis=0))
    size = np.where(size > 0, size, 1.0)
    return slopes / size, size


def information(
    errors: Float[np.ndarray, "N g"],
    slopes: Float[np.ndarray, "N g v"],
    k: int,
    prior: Float[np.ndarray, " v"],
) -> Information:
    """The information in whitened errors with `slopes` in the parameters, the first `k`,
    and the other unknowns; `prior` is the curvature that is known beforehand.

    Slopes times errors are independent from row to row where the model is right. Where it
    is not, errors are correlated over as long as what causes them: the spread of their
    sums over blocks of the record, each longer than that, tells the deviation."""
    rows = errors.shape[0]
    variance = float(np.mean(errors**2))
    flat, size = normalised(slopes.reshape(-1, slopes.shape[2]))
    F = flat.T @ flat + np.diag(variance * prior / size**2)
    inverse = np.linalg.pinv(F, rcond=1e-15, hermitian=True)
    score = np.einsum("ngv,ng->nv", flat.reshape(slopes.shape), errors)
    plain = variance * np.diag(inverse)
    robust = np.diag(inverse @ spread(score, rows) @ inverse)
    inflation = np.maximum(robust / plain, 1.0)[:k]
    own, other, mixed = F[:k, :k], F[k:, k:], F[:k, k:]
    left = own - mixed @ np.linalg.pinv(other, rcond=1e-15, hermitian=True) @ mixed.T
    curvature = left * np.outer(size[:k], size[:k]) / variance
    deviation = np.sqrt(plain[:k] * inflation) / size[:k]
    return Information(curvature, deviation, inflation)


def spread(score: Float[np.ndarray, "N v"], rows: int) -> Float[np.ndarray, "v v"]:
    """The covariance of the sum of `score` over a record: from the sums of blocks."""
    blocks = max(2, min(BLOCKS, rows // 20))
    edges = np.linspace(0, score.shape[0], blocks + 1).astype(int)[:-1]
    sums = np.add.reduceat(score, edges, axis=0)
    # A t distribution of so few blocks is wider than a normal one.
    return sums.T @ sums * (1.0 + 2.5 / blocks)
