"""What the errors say of the parameters: curvature, deviations, flat directions."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float


class Information(NamedTuple):
    """Of `k` parameters, relative, with all other unknowns free.

    - `curvature`: of half the sum of squares, shape `(k, k)`, in units of the errors;
    - `covariance`: of the parameters, robust, of shape `(k, k)`, along what was searched;
    - `deviation`: its roots, shape `(k,)`.
    """

    curvature: Float[np.ndarray, "k k"]
    covariance: Float[np.ndarray, "k k"]
    deviation: Float[np.ndarray, " k"]

    def along(self, directions: Float[np.ndarray, "k f"]) -> Float[np.ndarray, " f"]:
        """The standard deviation along directions of unit length, infinite where flat."""
        curvature = np.einsum("kf,kl,lf->f", directions, self.curvature, directions)
        return np.where(curvature > 0, 1.0 / np.sqrt(np.maximum(curvature, 1e-300)), np.inf)

    def flat(
        self, factor: float, resolution: float, basis: Float[np.ndarray, "k r"]
    ) -> Float[np.ndarray, "k f"]:
        """The directions within `basis` along which an interval, `factor` deviations to
        both sides, is wider than `resolution`; none where every parameter has a narrower
        one."""
        values, vectors = np.linalg.eigh(basis.T @ self.curvature @ basis)
        variance = 1.0 / np.maximum(values, 1e-300)
        vectors = basis @ vectors
        deviation = np.sqrt(vectors**2 @ variance)
        wide = factor * np.sqrt(variance) > resolution
        if (factor * deviation > resolution).any():
            wide[0] = True  # the flattest, where it takes several to make one wide
        else:
            wide[:] = False
        return vectors[:, wide]


def information(
    errors: Float[np.ndarray, "N g"],
    slopes: Float[np.ndarray, "N g v"],
    basis: Float[np.ndarray, "k r"],
) -> Information:
    """The information in whitened errors with `slopes` in the parameters, which come
    first, and the other unknowns."""
    k, r = basis.shape
    along = np.concatenate([slopes[..., :k] @ basis, slopes[..., k:]], axis=2)
    size = np.sqrt(np.sum(along**2, axis=(0, 1)))
    size = np.where(size > 0, size, 1.0)
    along = along / size
    flat = along.reshape(-1, along.shape[2])
    F = flat.T @ flat
    inverse = np.linalg.pinv(F, rcond=1e-14, hermitian=True)
    variance = float(np.mean(errors**2))
    # Slopes times errors, summed over a row, are independent where errors are white; sums
    # of their products over neighbouring rows make up for it where they are not quite
    # (Newey, West, Econometrica 55, 1987).
    score = np.einsum("ngv,ng->nv", along, errors)
    spread = score.T @ score
    lags = round(score.shape[0] ** (1 / 3))
    for lag in range(1, lags + 1):
        product = score[lag:].T @ score[:-lag]
        spread += (1.0 - lag / (lags + 1)) * (product + product.T)
    robust = inverse @ spread @ inverse
    unit = np.diag(1.0 / size[:r])
    searched = basis @ unit
    covariance = searched @ robust[:r, :r] @ searched.T
    plain = searched @ (variance * inverse[:r, :r]) @ searched.T
    deviation = np.sqrt(np.maximum(np.diag(covariance), np.diag(plain)))
    # The curvature that is left when the other unknowns give way.
    own, other, mixed = F[:r, :r], F[r:, r:], F[:r, r:]
    left = own - mixed @ np.linalg.pinv(other, rcond=1e-14, hermitian=True) @ mixed.T
    whole = basis @ (np.diag(size[:r]) @ left @ np.diag(size[:r])) @ basis.T
    return Information(whole / variance, covariance, deviation)
