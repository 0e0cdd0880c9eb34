"""Messages for people: ROS 2 joint states and poses, at a rate that eyes can follow.

All messages of one instant have the same length whatever they say. They are laid out once as bytes
with gaps, and the numbers of many instants are poured into the gaps together.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from trocar.simulation.recording.mcap_file import MESSAGE, MESSAGE_HEAD, Part

Array = NDArray[np.float64]
Numbers = NDArray[np.uint64]

_RULE = "=" * 80 + "\n"
_HEADER = (
    f"{_RULE}MSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n"
    f"{_RULE}MSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
)
JOINT_STATE = "sensor_msgs/msg/JointState"
POSE_STAMPED = "geometry_msgs/msg/PoseStamped"
#: Definitions as MCAP's registry wants them ("ros2msg"): the message, then what it is made of.
#: Source: ROS 2 common_interfaces and rcl_interfaces, field names and types.
SCHEMAS = {
    JOINT_STATE: "std_msgs/Header header\nstring[] name\nfloat64[] position\n"
    "float64[] velocity\nfloat64[] effort\n" + _HEADER,
    POSE_STAMPED: "std_msgs/Header header\ngeometry_msgs/Pose pose\n"
    + _HEADER
    + f"{_RULE}MSG: geometry_msgs/Pose\nPoint position\nQuaternion orientation\n"
    + f"{_RULE}MSG: geometry_msgs/Point\nfloat64 x\nfloat64 y\nfloat64 z\n"
    + f"{_RULE}MSG: geometry_msgs/Quaternion\nfloat64 x\nfloat64 y\nfloat64 z\nfloat64 w\n",
}
#: CDR, little endian. Source: DDS-XTYPES 1.3, section 7.6.
ENCAPSULATION = b"\x00\x01\x00\x00"
NANOSECONDS = 1_000_000_000


class Cdr:
    """One message: bytes, and where its numbers go."""

    def __init__(self, frame_id: str) -> None:
        self.data = bytearray(ENCAPSULATION)
        #: Offsets of the numbers in `data`, and which of an instant's numbers each is.
        self.gaps: list[tuple[int, int]] = []
        self.data += struct.pack("<iI", 0, 0)  # the stamp, at offset 4
        self._string(frame_id)

    def joint_state(self, names: Sequence[str], values: Sequence[Sequence[int]]) -> Cdr:
        """Go on with names, and which numbers are positions, velocities and efforts."""
        self._count(len(names))
        for name in names:
            self._string(name)
        for which in values:
            self._count(len(which))
            self._numbers(which)
        return self

    def pose(self, which: Sequence[int]) -> Cdr:
        """Go on with which numbers are x, y, z and the quaternion xyzw."""
        self._numbers(which)
        return self

    def _align(self, size: int) -> None:
        self.data += bytes(-(len(self.data) - len(ENCAPSULATION)) % size)

    def _count(self, count: int) -> None:
        self._align(4)
        self.data += struct.pack("<I", count)

    def _string(self, text: str) -> None:
        raw = text.encode() + b"\0"
        self._count(len(raw))
        self.data += raw

    def _numbers(self, which: Sequence[int]) -> None:
        if len(which):
            self._align(8)
        for index in which:
            self.gaps.append((len(self.data), index))
            self.data += bytes(8)


class Instants:
    """All messages of an instant, for any number of instants.

    Args:
        messages: (channel, message) in the order in which they are written
    """

    def __init__(self, messages: Sequence[tuple[int, Cdr]]) -> None:
        record = bytearray()
        offsets: list[int] = []
        places: list[int] = []
        which: list[int] = []
        for channel, message in messages:
            offsets.append(len(record))
            head = np.zeros(1, MESSAGE_HEAD)
            length = MESSAGE_HEAD.itemsize - 9 + len(message.data)
            head[0] = (MESSAGE, length, channel, 0, 0, 0)
            record += head.tobytes()
            places += [len(record) + offset for offset, _ in message.gaps]
            which += [index for _, index in message.gaps]
            record += message.data
        self._record = np.frombuffer(bytes(record), np.uint8)
        self._offsets = np.array(offsets, np.uint64)
        self._channels = np.array([channel for channel, _ in messages], np.uint64)
        self._which = np.array(which, np.intp)
        self._places = (np.array(places, np.intp)[:, None] + np.arange(8)).ravel()
        fields = MESSAGE_HEAD.fields or {}
        heads = np.array(offsets, np.intp)
        self._log = (heads[:, None] + fields["log"][1] + np.arange(16)).ravel()
        self._sequence = (heads[:, None] + fields["sequence"][1] + np.arange(4)).ravel()
        stamp = MESSAGE_HEAD.itemsize + len(ENCAPSULATION)
        self._stamp = (heads[:, None] + stamp + np.arange(8)).ravel()

    def part(self, values: Array, times: Numbers, stamps: Numbers, sequence: int) -> Part:
        """Pour in the numbers of m instants.

        Args:
            values: (m, numbers of an instant)
            times: when they are logged [ns], (m,)
            stamps: simulation time in the headers [ns], (m,)
            sequence: number of the first instant
        """
        count, each = len(values), len(self._offsets)
        out = np.tile(self._record, (count, 1))
        numbers = np.ascontiguousarray(values[:, self._which], "<f8")
        out[:, self._places] = numbers.view(np.uint8).reshape(count, -1)
        logged = np.stack([times, times], axis=1).astype("<u8").view(np.uint8)
        out[:, self._log] = np.tile(logged.reshape(count, -1), (1, each))
        order = np.arange(sequence, sequence + count, dtype="<u4").view(np.uint8)
        out[:, self._sequence] = np.tile(order.reshape(count, 4), (1, each))
        halves = np.stack([stamps // NANOSECONDS, stamps % NANOSECONDS], axis=1).astype("<u4")
        stamped = halves.view(np.uint8).reshape(count, 8)
        out[:, self._stamp] = np.tile(stamped, (1, each))
        begins = np.arange(count, dtype=np.uint64)[:, None] * np.uint64(out.shape[1])
        return Part(
            out.tobytes(),
            np.repeat(times, each),
            np.tile(self._channels, count),
            (begins + self._offsets).ravel(),
        )
