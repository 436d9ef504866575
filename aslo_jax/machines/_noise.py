"""White noise on the samples of a log, found without a model of the machine."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

ROUGHNESS = np.array([1.0, -4.0, 6.0, -4.0, 1.0]) / 70.0**0.5  # passes white noise as it is
LAGS = 4  # samples of y that a controller may answer with this u
FLOOR = 1e-3  # of the rms of a signal: what sampling and models leave
MAD = 1.4826  # a normal deviation over the median of the sizes
Groups = Sequence[Sequence[int]]


class Noise(NamedTuple):
    """Standard deviations of the noise on every sample of y and of u, one for each entry,
    and whether each is no more than the least that is ever taken for noise."""

    output: Float[np.ndarray, " p"]
    input: Float[np.ndarray, " m"]
    least_output: bool
    least_input: bool


def white_noise(
    u: Float[np.ndarray, "N m"],
    y: Float[np.ndarray, "N p"],
    u_groups: Groups,
    y_groups: Groups,
) -> Noise:
    """The noise of a log or of a piece of one; entries of a group have one deviation.

    Fourth differences take what is smooth away and keep white noise; their median does not
    see steps and outliers. The noise of y also comes back in u, through the controller, as
    voltage that is really there: what the last samples of y explain of the differences of u
    is therefore no noise. Nothing below a thousandth of the rms of a signal is taken for
    its noise, nor below the noise of its steps, where it comes in steps.
    """
    there = np.isfinite(u).all(axis=1) & np.isfinite(y).all(axis=1)
    u, y = u[there], y[there]
    rough_u, rough_y = _rough(u), _rough(y)
    of_y, least_y = _by_group(y, rough_y, y_groups)
    of_u, least_u = _by_group(u, _unexplained(rough_u, rough_y), u_groups)
    return Noise(of_y, of_u, least_y, least_u)


def pooled(pieces: Sequence[Noise]) -> Noise:
    """That of a log from those of its pieces: their medians."""
    return Noise(
        np.median([piece.output for piece in pieces], axis=0),
        np.median([piece.input for piece in pieces], axis=0),
        bool(np.median([piece.least_output for piece in pieces])),
        bool(np.median([piece.least_input for piece in pieces])),
    )


def _rough(x: Float[np.ndarray, "N k"]) -> Float[np.ndarray, "M k"]:
    if x.shape[0] < ROUGHNESS.size:
        return np.zeros((0, x.shape[1]))
    columns = [np.convolve(column, ROUGHNESS, mode="valid") for column in x.T]
    return np.stack(columns, axis=1) if columns else np.zeros((0, 0))


def _unexplained(
    rough_u: Float[np.ndarray, "M m"], rough_y: Float[np.ndarray, "M p"]
) -> Float[np.ndarray, "K m"]:
    """The part of each u that the samples of y up to then do not explain linearly."""
    count = rough_u.shape[0]
    if count < 20 * LAGS * rough_y.shape[1]:
        return rough_u
    before = [rough_y[LAGS - 1 - lag : count - lag] for lag in range(LAGS)]
    X, target = np.concatenate(before, axis=1), rough_u[LAGS - 1 :]
    left = target
    for _ in range(3):  # without the rows that are far off
        far = np.abs(left) > 4.0 * MAD * np.median(np.abs(left), axis=0) + 1e-300
        kept = ~far.any(axis=1)
        if kept.sum() < 10 * X.shape[1]:
            return left
        left = target - X @ np.linalg.lstsq(X[kept], target[kept], rcond=None)[0]
    return left


def _by_group(
    x: Float[np.ndarray, "N k"], rough: Float[np.ndarray, "M k"], groups: Groups
) -> tuple[Float[np.ndarray, " k"], bool]:
    deviations, least = np.zeros(x.shape[1]), True
    for group in groups:
        of = [k for k in group if k < x.shape[1]]
        if not of:
            continue
        found = MAD * np.median(np.abs(rough[:, of])) if rough.size else 0.0
        steps = max(_step(x[:, k]) for k in of) / 12.0**0.5
        floor = max(FLOOR * float(np.sqrt(np.mean(x[:, of] ** 2))), steps, 1e-12)
        deviations[of] = max(found, floor)
        least = least and bool(found <= floor)
    return deviations, least


def _step(x: Float[np.ndarray, " N"]) -> float:
    """The step in which a signal comes, zero where it comes in none."""
    levels = np.unique(x)
    if levels.size < 2 or levels.size > 0.5 * x.size:
        return 0.0
    gaps = np.diff(levels)
    gaps = gaps[gaps > 1e-6 * np.ptp(x)]
    return float(gaps.min()) if gaps.size else 0.0
