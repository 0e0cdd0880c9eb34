"""Recordings of real arms in rosbag 1, rosbag 2 and MCAP: /<ARM>/measured_js, read as it comes."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions import ArmDescription
from trocar.errors import LogError, MissingExtraError
from trocar.recording import mcap_messages

Array = NDArray[np.float64]

ROSBAG1 = b"#ROSBAG V2.0"
MCAP = b"\x89MCAP0\r\n"
MEASURED = "/measured_js"
JAW = "/jaw/measured_js"
JOINT_STATES = ("sensor_msgs/msg/JointState", "sensor_msgs/JointState")
#: A sample that lies this much after the one before is no motion that could be filled in evenly.
#: Source: our own choice. [s]
LONGEST_GAP_S = 1.0
NANOSECONDS = 1e-9


class Bag(NamedTuple):
    """A bag that is open: {topic: type}, and (time of logging [ns], message) of a topic."""

    topics: Mapping[str, str]
    messages: Callable[[str], Iterator[tuple[int, Any]]]


@dataclass(frozen=True, eq=False)
class Samples:
    """What a topic holds: (k,) [s], names, and (k, n) each; effort None where none was recorded."""

    time: Array
    names: tuple[str, ...]
    position: Array
    velocity: Array | None
    effort: Array | None


def is_bag(path: str | Path) -> bool:
    """Tell whether something looks like a rosbag 1 file, a rosbag 2 folder, or an MCAP file."""
    where = Path(path).expanduser()
    if where.is_dir():
        return (where / "metadata.yaml").is_file()
    if not where.is_file():
        return False
    with where.open("rb") as stream:
        head = stream.read(len(ROSBAG1))
    return head == ROSBAG1 or head.startswith(MCAP)


def read_bag(
    path: str | Path, arm: ArmDescription, rate_hz: float, topic: str | None = None
) -> tuple[Array, bool]:
    """Read what an arm did, at even times, in its public joints.

    The samples between two that were recorded are filled in evenly. Where the bag has no
    velocities they are the differences of positions. The jaw has a topic of its own on the dVRK;
    without it, it stays closed.

    Args:
        path: the bag
        arm: whose recording it is, with the tool that was mounted
        rate_hz: of the rows that are wanted [Hz]
        topic: of the joint states; the bag's only one that fits the arm when omitted

    Returns:
        (k, 3, n) positions, velocities, efforts [rad or m, per s, N m or N], and whether the bag
        has efforts; zeros stand for those that it has not

    Raises:
        LogError: no bag, no such topic, or joint states that this arm does not have
        MissingExtraError: rosbags is not installed
    """
    file = str(path)
    with _opened(Path(path).expanduser(), file) as bag:
        chosen = _topic(bag, file, arm, topic)
        own = _samples(bag, file, chosen)
        jaw_topic = chosen.removesuffix(MEASURED) + JAW
        jaw = _samples(bag, file, jaw_topic) if jaw_topic in bag.topics else None
    joints = arm.mechanism.joint_names
    wanted = joints[: len(joints) - arm.has_jaw]
    columns = _order(file, chosen, own.names, joints, wanted)
    time = np.arange(own.time[0], own.time[-1] + 1e-9, 1.0 / rate_hz)
    rows = np.zeros((len(time), 3, len(joints)))
    rows[:, :, : len(columns)] = _even(own, time)[:, :, columns]
    if arm.has_jaw and len(columns) < len(joints) and jaw is not None:
        rows[:, :, len(columns) :] = _even(jaw, time)[:, :, :1]
    return rows, own.effort is not None


def _even(samples: Samples, time: Array) -> Array:
    """Return samples at other times, (k, 3, n)."""
    velocity = samples.velocity
    if velocity is None:
        velocity = np.gradient(samples.position, samples.time, axis=0)
    effort = np.zeros_like(samples.position) if samples.effort is None else samples.effort
    table = np.stack([samples.position, velocity, effort], axis=1)
    flat = table.reshape(len(table), -1)
    filled = [np.interp(time, samples.time, column) for column in flat.T]
    return np.stack(filled, axis=1).reshape(len(time), 3, -1)


def _order(
    file: str, topic: str, names: Sequence[str], joints: Sequence[str], wanted: Sequence[str]
) -> list[int]:
    """Return which column of a topic is which joint of the arm."""
    for expected in (joints, wanted):
        if set(names) == set(expected):
            return [list(names).index(name) for name in expected]
    if len(names) in (len(joints), len(wanted)):  # other names for the same joints
        return list(range(len(names)))
    raise LogError(
        file,
        f"{topic}: got {len(names)} joints ({', '.join(names)}); allowed: {len(wanted)}"
        f" ({', '.join(wanted)})",
    )


def _topic(bag: Bag, file: str, arm: ArmDescription, topic: str | None) -> str:
    """Return the topic to read."""
    found = sorted(
        name
        for name, kind in bag.topics.items()
        if kind in JOINT_STATES and name.endswith(MEASURED) and not name.endswith(JAW)
    )
    if topic is not None:
        if topic not in bag.topics:
            known = ", ".join(found) or "none"
            raise LogError(file, f"has no topic {topic!r}; joint states are in: {known}")
        return topic
    fitting = [name for name in found if name.strip("/").upper().startswith(arm.type)]
    if len(fitting) == 1:
        return fitting[0]
    if not found:
        raise LogError(file, f"holds no joint states; allowed: a topic /{arm.type}.../measured_js")
    raise LogError(
        file,
        f"{len(fitting)} topics fit a {arm.type}; name one (--topic): {', '.join(found)}",
    )


def _samples(bag: Bag, file: str, topic: str) -> Samples:
    """Read a topic to its end."""
    times: list[float] = []
    values: list[tuple[Any, Any, Any]] = []
    names: tuple[str, ...] = ()
    for logged, message in bag.messages(topic):
        stamp = message.header.stamp
        at = stamp.sec + NANOSECONDS * stamp.nanosec or NANOSECONDS * logged
        if times and at <= times[-1]:
            if at == times[-1]:
                continue
            raise LogError(file, f"{topic}: time goes back", len(times) + 1)
        if times and at - times[-1] > LONGEST_GAP_S:
            gap = f"a gap of {at - times[-1]:.3g} s after {times[-1] - times[0]:.3f} s"
            raise LogError(file, f"{topic}: {gap}; allowed: {LONGEST_GAP_S:g} s", len(times) + 1)
        names = names or tuple(message.name) or tuple(map(str, range(len(message.position))))
        if len(message.position) != len(names):
            raise LogError(
                file,
                f"{topic}: got {len(message.position)} positions; allowed: {len(names)}",
                len(times) + 1,
            )
        times.append(at)
        values.append((message.position, message.velocity, message.effort))
    if len(times) < 2:
        raise LogError(file, f"{topic}: got {len(times)} samples; allowed: 2 or more")
    position = np.array([v[0] for v in values], np.float64)
    if not np.isfinite(position).all():
        row = int(np.argmin(np.isfinite(position).all(axis=1)))
        raise LogError(file, f"{topic}: positions must be finite", row + 1)
    velocity, effort = (
        np.array([v[k] for v in values], np.float64)
        if all(len(v[k]) == len(names) for v in values)
        else None
        for k in (1, 2)
    )
    return Samples(np.array(times), names, position, velocity, effort)


@contextmanager
def _opened(path: Path, file: str) -> Iterator[Bag]:
    """Open a bag of any kind."""
    try:
        from rosbags.highlevel import AnyReader, AnyReaderError
        from rosbags.serde import SerdeError
        from rosbags.typesys import Stores, get_typestore
    except ImportError as error:
        raise MissingExtraError("rosbags", "bags", "reading a bag") from error
    store = get_typestore(Stores.ROS2_HUMBLE)
    try:
        if not path.is_dir() and path.suffix != ".bag":  # a file without a rosbag 2's folder
            topics = {told.topic: told.schema for told in mcap_messages(path)}
            yield Bag(topics, lambda topic: _mcap_messages(path, topic, store.deserialize_cdr))
            return
        with AnyReader([path], default_typestore=store) as reader:
            topics = {c.topic: c.msgtype for c in reader.connections}

            def messages(topic: str) -> Iterator[tuple[int, Any]]:
                chosen = [c for c in reader.connections if c.topic == topic]
                for connection, logged, raw in reader.messages(chosen):
                    yield logged, reader.deserialize(raw, connection.msgtype)

            yield Bag(topics, messages)
    except LogError:
        raise
    except (AnyReaderError, SerdeError, OSError, ValueError, KeyError, AssertionError) as error:
        raise LogError(file, f"cannot be read as a bag: {error}") from error


def _mcap_messages(
    path: Path, topic: str, decode: Callable[[bytes, str], Any]
) -> Iterator[tuple[int, Any]]:
    for told in mcap_messages(path):
        if told.topic == topic:
            yield told.time, decode(told.data, told.schema)
