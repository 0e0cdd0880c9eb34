"""ROS 2 joint states and poses in CDR, many instants at once.

A message has the same length at every instant. The messages of an instant are laid out once, with
gaps for their numbers, and the numbers of many instants are copied into the gaps together.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Numbers = NDArray[np.uint64]

_RULE = "=" * 80 + "\n"
_HEADER = (
    f"{_RULE}MSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n"
    f"{_RULE}MSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
)
JOINT_STATE = "sensor_msgs/msg/JointState"
POSE_STAMPED = "geometry_msgs/msg/PoseStamped"
#: Definitions in the form of MCAP's registry, "ros2msg": the message, then the types it contains.
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
    """One message: its bytes, and the places of its numbers."""

    def __init__(self, frame_id: str) -> None:
        self.data = bytearray(ENCAPSULATION)
        #: Offsets of the numbers in `data`, and the column of each in the values of an instant.
        self.gaps: list[tuple[int, int]] = []
        self.data += struct.pack("<iI", 0, 0)  # the stamp, at offset 4
        self._string(frame_id)

    def joint_state(self, names: Sequence[str], values: Sequence[Sequence[int]]) -> Cdr:
        """Append names, and gaps for the columns of positions, velocities and efforts."""
        self._count(len(names))
        for name in names:
            self._string(name)
        for columns in values:
            self._count(len(columns))
            self.numbers(columns)
        return self

    def numbers(self, columns: Sequence[int]) -> Cdr:
        """Append gaps for numbers; of a pose x, y, z and the quaternion xyzw."""
        if len(columns):
            self._align(8)
        for column in columns:
            self.gaps.append((len(self.data), column))
            self.data += bytes(8)
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


class Instants:
    """The messages of one instant, filled in for many instants at once.

    Args:
        messages: all messages of an instant
    """

    def __init__(self, messages: Sequence[Cdr]) -> None:
        ends = np.cumsum([len(m.data) for m in messages], dtype=np.intp)
        starts = np.concatenate([[0], ends[:-1]]).astype(np.intp)
        self._slices = list(map(slice, starts.tolist(), ends.tolist()))
        self._empty = np.frombuffer(b"".join(m.data for m in messages), np.uint8)
        gaps = [
            (start + offset, column)
            for start, message in zip(starts.tolist(), messages, strict=True)
            for offset, column in message.gaps
        ]
        places, self._columns = np.array(gaps, np.intp).reshape(-1, 2).T
        self._places = (places[:, None] + np.arange(8)).ravel()
        self._stamps = (starts[:, None] + len(ENCAPSULATION) + np.arange(8)).ravel()

    def fill(self, values: Array, stamps: Numbers) -> list[list[bytes]]:
        """Return the messages of k instants.

        Args:
            values: (k, numbers of an instant)
            stamps: time in their headers [ns], (k,)
        """
        count = len(values)
        out = np.tile(self._empty, (count, 1))
        numbers = np.ascontiguousarray(values[:, self._columns], "<f8")
        out[:, self._places] = numbers.view(np.uint8).reshape(count, -1)
        halves = np.stack([stamps // NANOSECONDS, stamps % NANOSECONDS], axis=1).astype("<u4")
        stamped = halves.view(np.uint8).reshape(count, 8)
        out[:, self._stamps] = np.tile(stamped, (1, len(self._slices)))
        return [[row[s] for s in self._slices] for row in map(np.ndarray.tobytes, out)]
