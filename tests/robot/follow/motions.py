"""Recordings of a motion that is known at every moment, written by the rosbags library."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

rosbags = pytest.importorskip("rosbags", reason="rosbags is not installed (extra bags)")

from rosbags.rosbag1 import Writer as Writer1  # noqa: E402
from rosbags.rosbag2 import StoragePlugin  # noqa: E402
from rosbags.rosbag2 import Writer as Writer2  # noqa: E402
from rosbags.typesys import Stores, get_typestore  # noqa: E402

JOINT_STATE = "sensor_msgs/msg/JointState"
RATE_HZ = 200
#: When recordings begin [s]. Source: any moment; the dVRK's stamps are of this size.
BEGIN = 1_700_000_000
MIDDLE = {
    "PSM1": [0.4, -0.1, 0.12, 0.0, 0.0, 0.0],
    "PSM2": [-0.2, -0.2, 0.12, 0.0, 0.0, 0.0],
    "ECM": [-0.35, 0.25, 0.1275, 0.0],
}
AMPLITUDE = np.array([0.2, 0.2, 0.03, 0.5, 0.3, 0.3])
KINDS = ("ros1", "bz2", "lz4", "sqlite", "mcap")

#: (time since the beginning [s], topic, positions), and velocities and efforts where there are some
Row = tuple[float, str, Any]


def motion(arm: str, t: float) -> np.ndarray:
    """Return where an arm is, without its jaw."""
    middle = np.array(MIDDLE[arm])
    return middle + AMPLITUDE[: len(middle)] * math.sin(2.0 * math.pi * 0.8 * t)


def rows(arms: Sequence[str], seconds: float) -> Iterator[Row]:
    for k in range(round(seconds * RATE_HZ)):
        t = k / RATE_HZ
        for arm in arms:
            yield t, f"/{arm}/measured_js", motion(arm, t)
            if arm.startswith("PSM"):
                yield t, f"/{arm}/jaw/measured_js", [0.4 + 0.3 * math.sin(t)]


def write(
    path: Path,
    kind: str,
    told: Iterator[Row] | Sequence[tuple[Any, ...]],
    names: Sequence[str] | Mapping[str, Sequence[str]] = (),
) -> Path:
    """Write a bag, and return where it is; names are of joints, of all topics or by topic."""
    old = kind in ("ros1", "bz2", "lz4")
    store = get_typestore(Stores.ROS1_NOETIC if old else Stores.ROS2_HUMBLE)
    kinds, pack = store.types, store.serialize_ros1 if old else store.serialize_cdr
    if old:
        writer: Any = Writer1(path)
        if kind != "ros1":
            writer.set_compression(Writer1.CompressionFormat[kind.upper()])
    else:
        plugin = StoragePlugin.SQLITE3 if kind == "sqlite" else StoragePlugin.MCAP
        writer = Writer2(path, version=9, storage_plugin=plugin)
    known: dict[str, Any] = {}
    with writer:
        for t, topic, *values in told:
            ns = BEGIN * 1_000_000_000 + round(t * 1e9)
            stamp = kinds["builtin_interfaces/msg/Time"](*divmod(ns, 1_000_000_000))
            more = {"seq": 0} if old else {}
            header = kinds["std_msgs/msg/Header"](stamp=stamp, frame_id="", **more)
            numbers = [np.array(v, np.float64) for v in (*values, (), ())[:3]]
            joints = names.get(topic, ()) if isinstance(names, Mapping) else names
            if topic not in known:
                known[topic] = writer.add_connection(topic, JOINT_STATE, typestore=store)
            message = kinds[JOINT_STATE](header, list(joints), *numbers)
            writer.write(known[topic], ns, pack(message, JOINT_STATE))
    return next(path.glob("*.mcap")) if kind == "mcap file" else path


def write_many(path: Path, kind: str, count: int) -> Path:
    """Write a bag of one message over and over, in chunks of 100 kB where it has chunks."""
    old = kind == "ros1"
    store = get_typestore(Stores.ROS1_NOETIC if old else Stores.ROS2_HUMBLE)
    kinds = store.types
    stamp = kinds["builtin_interfaces/msg/Time"](BEGIN, 0)
    header = kinds["std_msgs/msg/Header"](stamp=stamp, frame_id="", **({"seq": 0} if old else {}))
    empty = np.zeros(0)
    message = kinds[JOINT_STATE](header, [], motion("PSM1", 0.0), empty, empty)
    data = bytes((store.serialize_ros1 if old else store.serialize_cdr)(message, JOINT_STATE))
    times = (BEGIN * 1_000_000_000 + 5_000_000 * k for k in range(count))
    if kind == "mcap":
        return _mcap(path, data, times)
    writer = Writer1(path) if old else Writer2(path, version=9)
    if isinstance(writer, Writer1):
        writer.chunk_threshold = 100_000
    writer.open()
    topic = writer.add_connection("/PSM1/measured_js", JOINT_STATE, typestore=store)
    for ns in times:
        writer.write(topic, ns, data)  # type: ignore[arg-type]
    writer.close()
    return path


def _mcap(path: Path, data: bytes, times: Iterator[int]) -> Path:
    from mcap.writer import Writer as McapWriter

    with path.open("wb") as stream:
        writer = McapWriter(stream, chunk_size=100_000)
        writer.start("ros2", "test")
        schema = writer.register_schema(JOINT_STATE, "ros2msg", b"")
        topic = writer.register_channel("/PSM1/measured_js", "cdr", schema)
        for ns in times:
            writer.add_message(topic, ns, data, ns)
        writer.finish()
    return path


def write_poses(path: Path, topic: str, kind: str, told: Iterable[tuple[float, Any]]) -> Path:
    """Write a rosbag 2 of poses, position and quaternion xyzw, (time, (7,)), of a type."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    kinds = store.types
    place = "Vector3" if kind == "TransformStamped" else "Point"
    with Writer2(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        full = f"geometry_msgs/msg/{kind}"
        connection = writer.add_connection(topic, full, typestore=store)
        for t, numbers in told:
            ns = BEGIN * 1_000_000_000 + round(t * 1e9)
            stamp = kinds["builtin_interfaces/msg/Time"](*divmod(ns, 1_000_000_000))
            header = kinds["std_msgs/msg/Header"](stamp=stamp, frame_id="")
            at = kinds[f"geometry_msgs/msg/{place}"](*map(float, numbers[:3]))
            turn = kinds["geometry_msgs/msg/Quaternion"](*map(float, numbers[3:]))
            if kind == "TransformStamped":
                pose = kinds["geometry_msgs/msg/Transform"](at, turn)
                message = kinds[full](header, "", pose)
            else:
                message = kinds["geometry_msgs/msg/Pose"](at, turn)
                if kind == "PoseStamped":
                    message = kinds[full](header, message)
            writer.write(connection, ns, store.serialize_cdr(message, full))
    return path
