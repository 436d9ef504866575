"""Samples that are missing in a log, for a diagnosis, which needs whole ones."""

import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float, Int

from ..logs import Log
from ._circle import Circle

FAR = 12.0  # times the median distance from the rows around
TURN = 0.4  # rad: over holes in which a signal turns by less a straight line will do


def absent_rows(log: Log) -> Bool[np.ndarray, " N"]:
    """Which rows of a `log` have a sample that is not finite, shape `(N,)`."""
    return ~np.asarray(np.isfinite(log.u).all(axis=1) & np.isfinite(log.y).all(axis=1))


def beside_holes(log: Log, absent: Bool[np.ndarray, " N"]) -> Int[np.ndarray, " k"]:
    """Rows near a hole whose outputs cannot be right: far from the known rows around. A
    straight line over the hole would begin there."""
    near = np.convolve(absent, np.ones(5))[2:-2] > 0.5  # of a short log, too
    return _far(log.y, near)


def _far(x: Float[np.ndarray, "N n"], near: Bool[np.ndarray, " N"]) -> np.ndarray:
    known = np.flatnonzero(np.isfinite(x).all(axis=1))
    if not near.any() or not x.shape[1] or known.size < 16:
        return np.zeros(0, int)
    x = x[known]
    inner = slice(2, -2)
    around = [x[2 + k : x.shape[0] - 2 + k] for k in (-2, -1, 1, 2)]
    size = lambda z: np.abs(z).max(axis=-1)
    middle = np.median(around, axis=0)
    off = np.minimum(size(x[inner] - around[1]), size(x[inner] - around[2]))
    off = np.minimum(off, size(x[inner] - middle))
    limit = max(FAR * np.median(off), 0.3 * np.quantile(size(x), 0.9))
    rows = known[inner]
    return rows[(off > limit) & near[rows]]


def bridged(log: Log, absent: Bool[np.ndarray, " N"]) -> Log:
    """The `log` with straight lines over what is missing, the rows `absent`, shape `(N,)`;
    zero where nothing is there."""
    if not absent.any():
        return log
    return dataclasses.replace(log, u=_lines(log.u), y=_lines(log.y))


def long_holes(
    log: Log, absent: Bool[np.ndarray, " N"], circles: Sequence[Circle]
) -> Bool[np.ndarray, " N"]:
    """Of the rows that are missing, and were bridged in `log`, those of holes too long for
    straight lines."""
    broken = np.zeros(absent.size, bool)
    if not absent.any() or absent.all():
        return absent.copy()
    for circle in circles:
        turn = _turn(circle.signals(log.u, log.y)[1][~absent])
        edges = np.flatnonzero(np.diff(np.r_[False, absent, False])).reshape(-1, 2)
        for first, last in edges:
            if (last - first + 1) * turn > TURN or last - first > 10:
                broken[first:last] = True
    return broken


def _turn(y: np.ndarray) -> float:
    """By how much a signal turns from row to row (rad), noise apart."""
    ahead = lambda k: np.vdot(y[:-k], y[k:]).real
    if y.size < 8 or not np.vdot(y, y).real > 0:
        return 0.0
    return float(np.arccos(np.clip(ahead(3) / max(ahead(1), 1e-300), -1.0, 1.0)) / 8**0.5)


def _lines(x: Float[np.ndarray, "N n"]) -> Float[np.ndarray, "N n"]:
    """A row is missing as a whole, as it is to an observer."""
    there = np.isfinite(x).all(axis=1)
    if there.all():
        return x
    if not there.any():
        return np.zeros_like(x)
    at = np.arange(x.shape[0])
    columns = [np.interp(at, at[there], column[there]) for column in x.T]
    return np.stack(columns, axis=1)
