"""Bags of ROS 1 and ROS 2, by rosbags: every number of a message is a column called
`/topic/field`, and the instants of a topic are `/topic.t`."""

import dataclasses
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from .._extras import require
from ._error import LogError
from ._source import WIDEST, Source, of_arrays

LARGEST = 1 << 16  # bytes of a message that is read; larger ones are pictures and clouds
NAMED = "sensor_msgs/msg/JointState"  # whose arrays have a name for each entry
METADATA = "metadata.yaml"  # of a ROS 2 bag that is a folder
RESAMPLED = (
    "`Log.from_columns(interop.from_bag(PATH, CLOCK, held=[COMMANDS]))` puts the topics "
    "of commands on the instants of another"
)


@dataclasses.dataclass(frozen=True)
class Topic:
    """What is in a topic of a bag, in the order that it was received in.

    - `stamps`: instants (ns), shape `(N,)`: those of the headers, where every message has
      one, and else when it was received;
    - `columns`: of its messages, by field, each of shape `(N,)`;
    - `unusable`: what else is in it, by field, and why that is no column.
    """

    stamps: np.ndarray
    columns: dict[str, np.ndarray]
    unusable: dict[str, str]


def read_bag(path: Path) -> Source:
    """The topics of a bag, in memory. Instants are told from the first one of the bag on,
    since seconds since 1970 have no digits left for microseconds."""
    arrays: dict[str, np.ndarray] = {}
    unusable: dict[str, str] = {}
    topics = read_topics(path, unusable)
    start = min((int(t.stamps.min()) for t in topics.values()), default=0)
    clocks: dict[str, str] = {}
    known: list[tuple[str, np.ndarray]] = []  # of different clocks
    for name, topic in topics.items():
        own = f"{name}.t"
        clock = next((k for k, x in known if np.array_equal(x, topic.stamps)), own)
        if clock == own:
            known.append((own, topic.stamps))
            arrays[own] = 1e-9 * (topic.stamps - start)
            clocks[own] = own
        for field, column in topic.columns.items():
            arrays[f"{name}/{field}"] = column
            clocks[f"{name}/{field}"] = clock
        unusable |= {f"{name}/{field}": why for field, why in topic.unusable.items()}
    return of_arrays(path, arrays, unusable=unusable, clocks=clocks, resampled=RESAMPLED)


def read_topics(path: Path, unusable: dict[str, str]) -> dict[str, Topic]:
    """The topics of a bag that hold numbers; others are put into `unusable`.

    **Raises:** [`LogError`][] for a file that is no bag; `ImportError` without rosbags."""
    highlevel = require("rosbags.highlevel", "ros")
    typesys = require("rosbags.typesys", "ros")
    store = typesys.get_typestore(typesys.Stores.LATEST)
    found: dict[str, Topic] = {}
    try:
        with highlevel.AnyReader([path], default_typestore=store) as reader:
            for connection in reader.connections:
                if connection.topic in found:
                    unusable[connection.topic] = "has messages of several types"
                    del found[connection.topic]
                elif connection.topic not in unusable:
                    topic = _topic(reader, connection)
                    if isinstance(topic, Topic):
                        found[connection.topic] = topic
                    elif topic:
                        unusable[connection.topic] = topic
    except OSError:
        raise
    except Exception as error:  # struct, YAML, apsw and its own
        raise LogError(f"{path} is not a readable ROS bag: {error}") from error
    return found


def _topic(reader: Any, connection: Any) -> Topic | str:
    """The messages of a connection, or why they are not read, nothing of an empty one."""
    received, stamped = list[int](), list[int]()
    rows: list[dict[str, float]] = []
    unusable: dict[str, str] = {}
    for _, when, raw in reader.messages(connections=[connection]):
        if len(raw) > LARGEST:
            return f"has messages of {len(raw)} bytes, which are no samples"
        try:
            message = reader.deserialize(raw, connection.msgtype)
        except KeyError:
            return (
                f"has messages of the type {connection.msgtype}, which the bag does not "
                "describe; convert it to mcap where that type is known"
            )
        received.append(when)
        stamped.append(_stamp(message))
        names = message.name if connection.msgtype == NAMED else None
        rows.append(dict(_numbers(message, "", names, unusable)))
    if not rows:
        return ""
    columns = {name: np.zeros(len(rows)) for row in rows for name in row}
    for name in list(columns):
        there = [name in row for row in rows]
        if all(there):
            columns[name] = np.array([row[name] for row in rows])
        else:
            unusable[name] = f"is in {sum(there)} of {len(rows)} messages only"
            del columns[name]
    stamps = np.array(stamped if all(stamped) else received, np.int64)
    return Topic(stamps, columns, unusable)


def _stamp(message: Any) -> int:
    """The instant in the header of a message (ns); zero where it has none."""
    stamp = getattr(getattr(message, "header", None), "stamp", None)
    if stamp is None:
        return 0
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)


def _numbers(
    value: Any, path: str, names: Any, unusable: dict[str, str]
) -> Iterator[tuple[str, float]]:
    """The numbers in a message by field; entries of arrays by number, or by `names`."""
    if isinstance(value, bool | int | float | np.integer | np.floating | np.bool_):
        yield path, float(value)
    elif isinstance(value, np.ndarray | list):
        if len(value) > WIDEST:
            unusable[path] = f"has {len(value)} entries, more than {WIDEST}"
            return
        named = names if names is not None and len(names) == len(value) else None
        for k, each in enumerate(value):
            part = k if named is None else named[k]
            yield from _numbers(each, f"{path}[{part}]", None, unusable)
    elif dataclasses.is_dataclass(value):
        for field in dataclasses.fields(value):
            if field.name == "header" and not path:
                continue
            inner = f"{path}.{field.name}" if path else field.name
            yield from _numbers(getattr(value, field.name), inner, names, unusable)
