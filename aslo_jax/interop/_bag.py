"""Topics of a ROS bag that have different instants, on those of one of them."""

from collections.abc import Collection
from pathlib import Path

import numpy as np

from ..logs import LogError
from ..logs._ros import read_topics

__all__ = ["from_bag"]


def from_bag(
    path: Path | str,
    clock: str,
    *,
    held: Collection[str] = (),
    interpolated: Collection[str] = (),
) -> dict[str, np.ndarray]:
    """The columns of topics of a ROS bag at the instants of the topic `clock`, for
    [`Log.from_columns`][]: `t` (s, from the first row on) and `/topic/field`, shape `(N,)`.

    - `path`: of the bag, a .bag, .mcap or .db3 file or a folder with metadata.yaml;
    - `clock`: the topic with what is measured;
    - `held`: topics of commands, each of which holds until the next one. Their columns are
      means over the interval from a row to the next, as [`replay`][] takes u;
    - `interpolated`: topics of what changes steadily, such as truths, between whose
      messages straight lines are drawn; not an angle in one turn, where it jumps.

    Instants are those of the headers, where every message of a topic has one, and else when
    it was received: a delay between two computers is in them. Rows before the first message
    of another topic, or after the last one of an interpolated topic, are left out. A bag
    whose topics have equal instants is read by [`read_log`][] as it is.

    **Raises:** [`LogError`][] for a topic that is not there, or whose instants are not
    increasing; `ImportError` naming the command that installs rosbags.
    """
    unusable: dict[str, str] = {}
    topics = read_topics(Path(path), unusable)
    for name in (clock, *held, *interpolated):
        if name not in topics:
            has = ", ".join(topics) or "none"
            why = unusable.get(name, "is not there")
            raise LogError(f"{path}, topic `{name}` {why}; its topics of numbers: {has}.")
        _check_increasing(path, name, topics[name].stamps)
    stamps = topics[clock].stamps
    begin = max((topics[n].stamps[0] for n in (*held, *interpolated)), default=stamps[0])
    end = min((topics[n].stamps[-1] for n in interpolated), default=stamps[-1])
    rows = (stamps >= begin) & (stamps <= end)
    if rows.sum() < 2:
        raise LogError(
            f"{path}, topic `{clock}` has {rows.sum()} messages while the other topics "
            "have theirs, but a log needs two; leave a topic out."
        )
    start = stamps[rows][0]
    t = 1e-9 * (stamps[rows] - start)
    found = {"t": t}
    found |= {f"{clock}/{k}": x[rows] for k, x in topics[clock].columns.items()}
    for names, taken in ((held, _held), (interpolated, np.interp)):
        for name in names:
            instants = 1e-9 * (topics[name].stamps - start)
            columns = topics[name].columns
            found |= {f"{name}/{k}": taken(t, instants, x) for k, x in columns.items()}
    return found


def _held(t: np.ndarray, instants: np.ndarray, values: np.ndarray) -> np.ndarray:
    """The means over the intervals that begin at t of a signal that steps at `instants`;
    the last one is what it is then."""
    beyond = max(instants[-1], t[-1]) + 1.0
    knots = np.append(instants, beyond)
    areas = np.concatenate([[0.0], np.cumsum(values * np.diff(knots))])
    last = values[np.searchsorted(instants, t[-1], side="right") - 1]
    return np.append(np.diff(np.interp(t, knots, areas)) / np.diff(t), last)


def _check_increasing(path: Path | str, name: str, stamps: np.ndarray) -> None:
    steps = np.diff(stamps)
    if (steps <= 0).any():
        k = int(np.argmax(steps <= 0)) + 1
        raise LogError(
            f"{path}, topic `{name}`: message {k} (counted from 0) is not later than the "
            "one before; sort or repair the bag."
        )
