"""Bags of ROS as logs, written by rosbags."""

from pathlib import Path

import numpy as np
import pytest
from exported_motor import LOG, MOTOR, command

import aslo_jax as aslo
from aslo_jax import interop
from aslo_jax.logs import Log, LogError, read_log
from aslo_jax.machines import read_machine

rosbags = pytest.importorskip("rosbags.typesys")
from rosbags.rosbag1 import Writer as Writer1  # noqa: E402
from rosbags.rosbag2 import StoragePlugin, Writer as Writer2  # noqa: E402

EPOCH = 1_700_000_000_000_000_000  # ns
STATE = """
std_msgs/Header header
float64[2] u
drive_msgs/Current measured
string note
"""
TYPES = {
    "drive_msgs/msg/State": STATE,
    "drive_msgs/msg/Current": "float32 i_alpha\nfloat32 i_beta",
}


def store(edition="ROS2_HUMBLE"):
    found = rosbags.get_typestore(rosbags.Stores[edition])
    for name, text in TYPES.items():
        found.register(rosbags.get_types_from_msg(text, name))
    return found


def header(types, ns):
    stamp = types["builtin_interfaces/msg/Time"](sec=ns // 10**9, nanosec=ns % 10**9)
    kind = types["std_msgs/msg/Header"]
    extra = {"seq": 0} if "seq" in kind.__dataclass_fields__ else {}
    return kind(stamp=stamp, frame_id="", **extra)


def write(path: Path, topics, plugin=StoragePlugin.MCAP, types=None, version=9):
    """A bag of `topics`, each a type and `(received, message)`."""
    one = path.suffix == ".bag"
    types = types or store("ROS1_NOETIC" if one else "ROS2_HUMBLE")
    writer = Writer1(path) if one else Writer2(path, version=version, storage_plugin=plugin)
    serialize = types.serialize_ros1 if one else types.serialize_cdr
    with writer:
        for name, (kind, messages) in topics.items():
            connection = writer.add_connection(name, kind, typestore=types)
            for ns, make in messages:
                writer.write(connection, ns, serialize(make(types.types), kind))
    return path


def state(k):
    ns = EPOCH + 200_000 * k
    # What differs in every row, and a time of receipt that is late by no constant.
    u, i = (1.0 + k, -2.0 * k), (0.5 * k, 3.0 - k)

    def make(types):
        current = types["drive_msgs/msg/Current"](*i)
        kind = types["drive_msgs/msg/State"]
        return kind(header=header(types, ns), u=np.array(u), measured=current, note="x")

    return ns + 70_000 * (k % 3), make


DRIVE = {"/drive/state": ("drive_msgs/msg/State", [state(k) for k in range(40)])}


def assert_is_drive(log):
    k = np.arange(40)
    np.testing.assert_allclose(log.t, 2e-4 * k, rtol=0, atol=1e-12)
    np.testing.assert_array_equal(log.u, np.stack([1.0 + k, -2.0 * k], axis=1))
    np.testing.assert_array_equal(log.y, np.stack([0.5 * k, 3.0 - k], axis=1))


@pytest.mark.parametrize("what", ["mcap", "db3", "folder", "bag"])
def test_a_bag_of_one_topic_is_a_log(tmp_path, what):
    """At the instants of the headers, and without the digits that 1970 costs."""
    if what == "bag":
        path = write(tmp_path / "run.bag", DRIVE)
    else:
        plugin = StoragePlugin.SQLITE3 if what == "db3" else StoragePlugin.MCAP
        path = write(tmp_path / "run", DRIVE, plugin)
        path = path if what == "folder" else next(path.glob(f"*.{what}"))
    assert_is_drive(read_log(path))


def number(kind, value):
    return lambda types: types[f"std_msgs/msg/{kind}"](value)


def split(command_at, measured_at):
    """Voltages and currents in topics of numbers, which have no headers."""
    topics = {}
    for name, instants in (("u", command_at), ("i", measured_at)):
        for phase, sign in (("alpha", 1.0), ("beta", -1.0)):
            messages = [
                (EPOCH + int(ns), number("Float64", sign * (k + 1.0)))
                for k, ns in enumerate(instants)
            ]
            topics[f"/drive/{name}_{phase}"] = ("std_msgs/msg/Float64", messages)
    return topics


def test_topics_of_other_instants_are_refused_with_the_way_out(tmp_path):
    path = write(
        tmp_path / "run", split(100_000 * np.arange(9), 100_000 * np.arange(9) + 5)
    )
    columns = {f"{n}_{p}": f"/drive/{n}_{p}/data" for n in "ui" for p in ("alpha", "beta")}
    with pytest.raises(LogError, match=r"each of which may be `t`; say which"):
        read_log(path, columns=columns)
    columns["t"] = "/drive/i_alpha.t"
    with pytest.raises(LogError, match=r"`/drive/u_alpha.t`, which are not .*from_bag\("):
        read_log(path, columns=columns)


def test_commands_between_samples_are_means_over_intervals(tmp_path):
    """Those of a row over the interval that begins there, as u is."""
    commands, samples = 1e5 * np.array([0, 12, 25, 31]), 1e5 * np.array([5, 15, 25, 35, 45])
    path = write(tmp_path / "run", split(commands, samples))
    held = ["/drive/u_alpha", "/drive/u_beta"]
    found = interop.from_bag(
        path, "/drive/i_alpha", held=held, interpolated=["/drive/i_beta"]
    )
    # From 5 to 15: 1 until 12, then 2; to 25: 2; to 35: 3 until 31, then 4.
    expected = np.array([(7 * 1 + 3 * 2) / 10, 2.0, (6 * 3 + 4 * 4) / 10, 4.0, 4.0])
    np.testing.assert_allclose(found["/drive/u_alpha/data"], expected, rtol=1e-12)
    np.testing.assert_allclose(found["/drive/u_beta/data"], -expected, rtol=1e-12)
    np.testing.assert_allclose(found["t"], 1e-4 * 10 * np.arange(5), rtol=1e-12)
    names = {f"{n}_{p}": f"/drive/{n}_{p}/data" for n in "ui" for p in ("alpha", "beta")}
    log = Log.from_columns(found, columns=names)
    np.testing.assert_allclose(log.u[:, 0], expected, rtol=1e-12)
    with pytest.raises(LogError, match=r"`/x` is not there; its topics .* /drive/u_alpha"):
        interop.from_bag(path, "/x")
    path = write(tmp_path / "apart", split(1e5 * np.arange(3), 1e5 * np.arange(7, 9)))
    with pytest.raises(LogError, match="`/drive/u_beta` has 0 messages while"):
        interop.from_bag(path, "/drive/u_beta", held=["/drive/i_beta"])


def test_what_is_no_column(tmp_path):
    """Text, pictures, arrays whose length changes, and messages that nobody describes."""

    def array(k):
        return lambda types: types["std_msgs/msg/Float64MultiArray"](
            types["std_msgs/msg/MultiArrayLayout"]([], 0), np.arange(float(k))
        )

    big = number("String", "x" * 70_000)
    topics = DRIVE | {
        "/text": ("std_msgs/msg/String", [(EPOCH, number("String", "hello"))]),
        "/picture": ("std_msgs/msg/String", [(EPOCH, big)]),
        "/array": (
            "std_msgs/msg/Float64MultiArray",
            [(EPOCH + k, array(k)) for k in (1, 2)],
        ),
    }
    path = write(tmp_path / "run", topics)
    columns = {"t": "/drive/state.t"}
    assert_is_drive(read_log(path, columns=columns))
    for column, said in {
        "/array/data[1]": "is in 1 of 2 messages only",
        "/picture": "has messages of 7000[0-9]+ bytes",
    }.items():
        with pytest.raises(LogError, match=said):
            read_log(path, columns=columns | {"u_alpha": column})
    # ROS 2 before Iron wrote no definitions into its databases.
    path = write(tmp_path / "old", DRIVE, StoragePlugin.SQLITE3, version=8)
    import sqlite3

    with sqlite3.connect(next(path.glob("*.db3"))) as database:
        database.execute("delete from message_definitions")
    database.close()
    with pytest.raises(LogError, match="drive_msgs/msg/State, which the bag does not"):
        read_log(path)
    broken = tmp_path / "broken.mcap"
    broken.write_bytes(b"no bag")
    with pytest.raises(LogError, match="not a readable ROS bag"):
        read_log(broken)
    (tmp_path / "empty").mkdir()
    with pytest.raises(LogError, match=r"or a ROS 2 bag with metadata\.yaml"):
        read_log(tmp_path / "empty")


def test_joints_go_by_their_names(tmp_path):
    def joints(order, ns):
        def make(types):
            values = {"hip": 1.0, "knee": 2.0}
            kind = types["sensor_msgs/msg/JointState"]
            position = np.array([values[name] for name in order])
            empty = np.zeros(0)
            return kind(header(types, ns), list(order), position, empty, empty)

        return make

    orders = [("hip", "knee"), ("knee", "hip")]
    messages = [(EPOCH + k, joints(x, EPOCH + k)) for k, x in enumerate(orders)]
    path = write(tmp_path / "run", {"/legs": ("sensor_msgs/msg/JointState", messages)})
    found = interop.from_bag(path, "/legs")
    np.testing.assert_array_equal(found["/legs/position[hip]"], [1.0, 1.0])
    np.testing.assert_array_equal(found["/legs/position[knee]"], [2.0, 2.0])


def test_the_recorded_motor_in_a_bag_is_estimated_as_from_its_file(tmp_path):
    log = read_log(LOG)
    rows = slice(0, 300)

    def row(t, u, i):
        ns = EPOCH + round(t * 1e9)

        def make(types):
            kind = types["drive_msgs/msg/State"]
            current = types["drive_msgs/msg/Current"](*i)
            return kind(header=header(types, ns), u=u, measured=current, note="")

        return ns, make

    rows = [row(*each) for each in zip(log.t[rows], log.u[rows], log.y[rows], strict=True)]
    double = TYPES | {"drive_msgs/msg/Current": "float64 i_alpha\nfloat64 i_beta"}
    types = rosbags.get_typestore(rosbags.Stores.ROS2_HUMBLE)
    for name, text in double.items():
        types.register(rosbags.get_types_from_msg(text, name))
    path = write(tmp_path / "run", {"/m": ("drive_msgs/msg/State", rows)}, types=types)
    (mcap,) = path.glob("*.mcap")
    out = tmp_path / "out.csv"
    assert command("estimate", mcap, "--machine", MOTOR, "--out", out) == 0
    found = np.genfromtxt(out, delimiter=",", names=True)
    machine = read_machine(MOTOR)
    observer = machine.state_observer(machine.rates())
    expected = aslo.replay(
        observer, log.t[:300], log.u[:300], log.y[:300], substeps=4
    ).value
    # Stamps are whole nanoseconds.
    flux = np.stack([found["flux_alpha"], found["flux_beta"]], axis=1)
    np.testing.assert_allclose(flux, expected, atol=1e-6)
