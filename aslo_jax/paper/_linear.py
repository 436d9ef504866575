"""A linear observer's matrices, transfer function and noise variance, from its own code."""

from typing import NamedTuple

import equinox as eqx
import numpy as np

from ..observers import AbstractObserver
from ..tune._stationary import linearised

_matrices = eqx.filter_jit(linearised)


class Realisation(NamedTuple):
    """`X' = A X + B (u, y)`, estimate `C X + D (u, y)`, as NumPy arrays."""

    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    D: np.ndarray

    def response(self, frequency: np.ndarray) -> np.ndarray:
        """From (u, y) to the estimate at each `frequency` (rad/s), shape (N, n, 2)."""
        eye = np.eye(len(self.A))
        return np.stack(
            [
                self.C @ np.linalg.solve(1j * w * eye - self.A, self.B) + self.D
                for w in frequency
            ]
        )

    def degree(self) -> int:
        """The McMillan degree: the order of a minimal realisation, which is the rank of
        the observability matrix times the controllability matrix."""
        powers = [np.linalg.matrix_power(self.A, k) for k in range(len(self.A))]
        hankel = np.vstack([self.C @ P for P in powers]) @ np.hstack(
            [P @ self.B for P in powers]
        )
        return int(np.linalg.matrix_rank(hankel, tol=1e-9 * np.abs(hankel).max()))

    def variance(self, W: float, V: float) -> float:
        """Of the error of a first-entry estimate, under white noise of two-sided
        intensities W on u and V on y; infinite where y's noise feeds through.

        Noise on the plant's input gives the error of noise on u with its sign changed,
        so W covers both.
        """
        import scipy.linalg

        if V > 0 and abs(self.D[0, 1]) > 1e-9:
            return np.inf
        noise = self.B @ np.diag([W, V]) @ self.B.T
        P = scipy.linalg.solve_continuous_lyapunov(self.A, -noise)
        return float((self.C @ P @ self.C.T)[0, 0])


def realisation(observer: AbstractObserver) -> Realisation:
    """The matrices of a linear observer of scalar u and y, by differentiating its
    `vector_field` and `estimate` at the origin."""
    return Realisation(*(np.asarray(M) for M in _matrices(observer)))
