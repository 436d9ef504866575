"""Unconstrained coordinates of chosen leaves: logarithms of what is positive, bounds."""

from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float

from .._typing import PyTree, Scale

Bound = tuple[float | None, float | None]

# How far inside a bound a start on the bound is moved, as a part of the way to the other.
_INSIDE = 1e-6


class Coordinates:
    """From a vector z without constraints to the chosen leaves of a tree and back.

    A leaf that is positive at the start goes by its logarithm q, another by its multiple q
    of its size there (of one where it starts at zero). Bounds bend z smoothly:
    between two of them `q = m + w tanh((z - m)/w)`, m being their middle and w half their
    distance in q, so that z and q agree to first order there; past a single one
    `q = low + softplus(z - low)`, and likewise from above.
    """

    def __init__(
        self,
        tree: PyTree,
        where: Callable[[PyTree], Any],
        bounds: Bound | Sequence[Bound | None] | None,
        scale: Scale | Sequence[Scale],
    ) -> None:
        leaves = where(tree)
        self.single = eqx.is_array_like(leaves)
        self.leaves = [jnp.asarray(x) for x in ([leaves] if self.single else leaves)]
        for x in self.leaves:
            if not jnp.issubdtype(x.dtype, jnp.floating):
                raise ValueError(
                    "Argument `where` must select leaves of real numbers, but got one of "
                    f"type {x.dtype}."
                )
        self.tree, self.where = tree, where
        start, self._unravel = ravel_pytree(self.leaves)
        self.start, self.dtype = np.asarray(start, float), start.dtype
        if not (self.start.size and np.isfinite(self.start).all()):
            raise ValueError(
                "Argument `where` must select at least one number, all of them finite, but "
                f"got {self.start.tolist()}."
            )
        self.log = self._spread(self._logarithmic(scale))
        size = np.abs(self.start)
        self.scale = np.where(self.log | (size == 0.0), 1.0, size)
        low, high = self._limits(bounds)
        self.low, self.high = self._inner(low, -np.inf), self._inner(high, np.inf)

    @property
    def size(self) -> int:
        """How many numbers there are."""
        return self.start.size

    # -- there and back ------------------------------------------------------------------

    def placed(self, z: Float[Array, " P"]) -> PyTree:
        """The tree with the leaves that z stands for."""
        x = self.values(z).astype(self.dtype)
        leaves = self._unravel(x)
        return eqx.tree_at(self.where, self.tree, leaves[0] if self.single else leaves)

    def values(self, z: Float[Array, " P"]) -> Float[Array, " P"]:
        """The leaves that z stands for, one after the other."""
        low, high = np.isfinite(self.low), np.isfinite(self.high)
        # What is not used must be finite too, or its derivative is not a number.
        a, b = np.where(low, self.low, 0.0), np.where(high, self.high, 0.0)
        both = low & high
        m, w = np.where(both, 0.5 * (a + b), 0.0), np.where(both, 0.5 * (b - a), 1.0)
        q = jnp.select(
            [both, low, high],
            [
                m + w * jnp.tanh((z - m) / w),
                a + jax.nn.softplus(z - a),
                b - jax.nn.softplus(b - z),
            ],
            z,
        )
        return jnp.where(self.log, jnp.exp(jnp.where(self.log, q, 0.0)), q * self.scale)

    def inverse(self, x: Float[np.ndarray, " P"]) -> Float[np.ndarray, " P"]:
        """The z of given leaves, which must be within the bounds."""
        q = self._inner(np.asarray(x, float), np.nan)
        z = q.copy()
        for k, (low, high) in enumerate(zip(self.low, self.high, strict=True)):
            if np.isfinite(low) and np.isfinite(high):
                middle, half = 0.5 * (low + high), 0.5 * (high - low)
                part = np.clip((q[k] - middle) / half, -1.0 + _INSIDE, 1.0 - _INSIDE)
                z[k] = middle + half * np.arctanh(part)
            elif np.isfinite(low):
                z[k] = low + np.log(np.expm1(max(q[k] - low, _INSIDE)))
            elif np.isfinite(high):
                z[k] = high - np.log(np.expm1(max(high - q[k], _INSIDE)))
        return z

    def starts(self, count: int) -> Float[np.ndarray, "starts P"]:
        """The tree's own start, and Sobol points of the box that the bounds span. Where a
        positive leaf has no bound, the box reaches a factor of ten from its start."""
        first = self.inverse(self.start)[None]
        if count == 1:
            return first
        from scipy.stats import qmc

        q = self._inner(self.start, np.nan)
        low = np.where(np.isfinite(self.low), self.low, q - np.log(10.0))
        high = np.where(np.isfinite(self.high), self.high, q + np.log(10.0))
        unbounded = ~(self.log | (np.isfinite(self.low) & np.isfinite(self.high)))
        if unbounded.any():
            raise ValueError(
                "Argument `bounds` must give two bounds for every leaf that is not "
                "positive, for other starts to be drawn from, but "
                f"{int(unbounded.sum())} of {self.size} numbers have none; or use "
                "`starts=1`."
            )
        sobol = qmc.Sobol(self.size, scramble=False)
        sobol.fast_forward(1)  # past the corner
        points = low + (high - low) * sobol.random(count - 1)
        outer = np.where(self.log, np.exp(points), points * self.scale)
        return np.vstack([first, *(self.inverse(x)[None] for x in outer)])

    # -- what was asked for --------------------------------------------------------------

    def _inner(self, x: np.ndarray, outside: float) -> np.ndarray:
        """q of x; what has no logarithm is `outside`."""
        positive = self.log & (x > 0)
        logarithm = np.log(np.where(positive & np.isfinite(x), x, 1.0))
        logarithm = np.where(np.isposinf(x), np.inf, logarithm)
        return np.where(self.log, np.where(positive, logarithm, outside), x / self.scale)

    def _spread(self, each: Sequence[Any]) -> np.ndarray:
        """One entry for each leaf, as one for each number."""
        return np.repeat(np.asarray(each), [x.size for x in self.leaves])

    def _logarithmic(self, scale: Scale | Sequence[Scale]) -> list[bool]:
        names = [scale] * len(self.leaves) if isinstance(scale, str) else list(scale)
        if len(names) != len(self.leaves) or set(names) - {"auto", "log", "linear"}:
            raise ValueError(
                'Argument `scale` must be "auto", "log" or "linear", or one of these for '
                f"each of the {len(self.leaves)} leaves, but got {scale!r}."
            )
        chosen = []
        for name, x in zip(names, self.leaves, strict=True):
            positive = bool(jnp.all(x > 0))
            if name == "log" and not positive:
                raise ValueError(
                    'Argument `scale` must not be "log" for a leaf that is not positive, '
                    f"but got {np.asarray(x).tolist()}."
                )
            chosen.append(positive and name != "linear")
        return chosen

    def _limits(self, bounds) -> tuple[np.ndarray, np.ndarray]:
        if bounds is None:
            pairs: list[Bound] = [(None, None)] * len(self.leaves)
        elif self.single and len(bounds) == 2 and not isinstance(bounds[0], Sequence):
            pairs = [(bounds[0], bounds[1])]
        else:
            pairs = [(None, None) if pair is None else tuple(pair) for pair in bounds]
        if len(pairs) != len(self.leaves):
            raise ValueError(
                f"Argument `bounds` must give a pair for each of the {len(self.leaves)} "
                f"leaves, but got {len(pairs)}."
            )
        low = self._spread([-np.inf if a is None else float(a) for a, _ in pairs])
        high = self._spread([np.inf if b is None else float(b) for _, b in pairs])
        if not ((low < high) & (low <= self.start) & (self.start <= high)).all():
            raise ValueError(
                "Argument `bounds` must have the start between them, but got "
                f"{pairs} for {self.start.tolist()}."
            )
        return low, high
