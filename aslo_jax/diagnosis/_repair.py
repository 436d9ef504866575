"""Logs without the rows that cannot be right."""

import dataclasses

import numpy as np
from jaxtyping import Bool, Float, Int

from ..logs import Log
from ._rows import Rows


def marked(log: Log, rows: Rows) -> Log:
    """A `log` with NaN in place of outputs and inputs that cannot be right, those of
    `rows`, which makes them missing ones."""
    u = log.u.copy()
    u[rows.inputs] = np.nan
    return dataclasses.replace(without(log, rows.outliers), u=u)


def without(log: Log, rows: Int[np.ndarray, " k"]) -> Log:
    """A log with NaN in place of the outputs of some rows."""
    y = log.y.copy()
    y[rows] = np.nan
    return dataclasses.replace(log, y=y)


def repaired(log: Log, rows: Rows) -> Log:
    """A `log` with what its neighbours say in place of outputs and inputs that cannot be
    right, those of `rows`. Over a gap the input is the mean of what a straight line from
    before to after gives to the rows that are missing.
    """
    y = _bridged(log.y, rows.outliers)
    u = _bridged(log.u, rows.inputs)
    after = np.minimum(rows.gaps + 1, u.shape[0] - 1)
    share = 0.5 * rows.missing / (rows.missing + 1.0)
    filled = u.copy()
    filled[rows.gaps] += share[:, None] * (u[after] - u[rows.gaps])
    return dataclasses.replace(log, u=filled, y=y)


def touched(rows: Rows, count: int) -> Bool[np.ndarray, " N"]:
    """Which rows of `count`, shape `(count,)`, have by `rows` an output that is made up, or
    end an interval in which the input is.
    """
    found = np.zeros(count, bool)
    for after, named in ((0, rows.outliers), (1, rows.inputs), (1, rows.gaps)):
        found[np.minimum(named + after, count - 1)] = True
    return found


def _bridged(
    x: Float[np.ndarray, "N n"], rows: Int[np.ndarray, " k"]
) -> Float[np.ndarray, "N n"]:
    """Straight lines over some rows; samples that are missing remain so."""
    if not rows.size:
        return x
    good = np.asarray(np.isfinite(x).all(axis=1))
    absent = ~good
    good[rows] = False
    if not good.any():
        return x
    at, known = np.arange(x.shape[0]), np.flatnonzero(good)
    columns = [np.interp(at, known, x[known, j]) for j in range(x.shape[1])]
    filled = np.stack(columns, axis=1)
    filled[absent] = x[absent]
    return filled
