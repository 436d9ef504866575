"""Inputs that belong to another interval than the one a log gives them to."""

import dataclasses
from collections.abc import Iterable, Iterator, Sequence

import numpy as np
from jaxtyping import Complex, Float

from ..logs import Log

MOST = 8  # rows that an input may be moved by


def shift_of(voltage: str) -> float:
    """The rows by which inputs are moved for the word `voltage`, which says when they hold:
    0 for `held`, 1/2 for `instant`, N for `delayed=N`, which may be negative, and whole or
    half.

    **Raises:** `ValueError` for anything else.
    """
    name, equals, number = voltage.partition("=")
    if voltage in ("held", "instant"):
        return {"held": 0.0, "instant": 0.5}[voltage]
    try:
        shift = float(number) if name == "delayed" and equals else np.nan
    except ValueError:
        shift = np.nan
    if not abs(shift) <= MOST or 2.0 * shift != round(2.0 * shift):
        raise ValueError(
            "Argument `voltage` (option --voltage) must be held, instant or delayed=N with "
            f"N whole or half and at most {MOST} (rows), but is {voltage!r}."
        )
    return shift


def moved(u: Complex[np.ndarray, " N"], shift: float) -> Complex[np.ndarray, " N"]:
    """Voltages of `shift` rows later; by half a row, the direction between those of two
    neighbours and their mean length."""
    rows, low = np.arange(u.size), int(np.floor(shift))
    at = lambda k: u[np.clip(rows + k, 0, rows.size - 1)]
    if shift == low:
        return at(low)
    a, b = at(low), at(low + 1)
    mean, length = 0.5 * (a + b), 0.5 * (np.abs(a) + np.abs(b))
    # Where neighbours oppose each other it is noise that turns, not the voltage.
    turns = np.abs(mean) > 0.7 * length
    return np.where(turns, mean * length / np.maximum(np.abs(mean), 1e-300), mean)


def retimed(log: Log, shift: float, pairs: Sequence[tuple[int, int]] = ((0, 1),)) -> Log:
    """A `log` whose inputs are moved: row k gets those of row `k + shift`.

    - `shift`: how late the inputs are (rows); 1/2 where they are those of the instants of
      their rows; at the ends of the log the first and the last input are repeated;
    - `pairs`: the columns of u that are alpha and beta of one vector, which turns.
    """
    return dataclasses.replace(log, u=_moved(log.u, shift, pairs))


def retimed_pieces(
    pieces: Iterable[Log], shift: float, pairs: Sequence[tuple[int, int]]
) -> Iterator[Log]:
    """[`retimed`][], with its `shift` (rows) and `pairs`, of a log that comes in `pieces`,
    each beginning with the last row of the one before.
    """
    if not shift:
        yield from pieces
        return
    reach = MOST + 2
    before: np.ndarray | None = None
    held: Log | None = None
    for piece in pieces:
        if held is not None:
            yield _within(before, held, piece.u[1 : reach + 1], shift, pairs)
            before = held.u[:-1] if before is None else np.vstack([before, held.u[:-1]])
            before = before[-reach:]
        held = piece
    if held is not None:
        yield _within(before, held, held.u[:0], shift, pairs)


def _within(before, log: Log, after, shift: float, pairs) -> Log:
    before = log.u[:0] if before is None else before
    moved = _moved(np.vstack([before, log.u, after]), shift, pairs)
    return dataclasses.replace(log, u=moved[len(before) : len(before) + log.t.size])


def _moved(
    u: Float[np.ndarray, "N m"], shift: float, pairs: Sequence[tuple[int, int]]
) -> Float[np.ndarray, "N m"]:
    out = (
        np.stack([_between(u[:, j], shift) for j in range(u.shape[1])], axis=1)
        if u.shape[1]
        else u
    )
    for a, b in pairs:
        if max(a, b) < u.shape[1]:
            z = moved(u[:, a] + 1j * u[:, b], shift)
            out[:, a], out[:, b] = np.real(z), np.imag(z)
    return out


def _between(x: Float[np.ndarray, " N"], shift: float) -> Float[np.ndarray, " N"]:
    rows, low = np.arange(x.size), int(np.floor(shift))
    at = lambda k: x[np.clip(rows + k, 0, rows.size - 1)]
    return at(low) if shift == low else 0.5 * (at(low) + at(low + 1))
