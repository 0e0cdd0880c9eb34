"""The full-rate states: every joint in every physics period, packed without losing a digit.

A block is one message: the length of its head (4 bytes), its head (JSON), then the numbers. They
are float32, all values of a joint in a row, and lossless after that: of the values' bits each row
keeps the difference to the value before (int32, wrapping), and the bytes of all differences stand
sorted by significance, which is what a compressor likes.
"""

from __future__ import annotations

import hashlib
import json
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trocar.errors import InputError

Array = NDArray[np.float64]
Single = NDArray[np.float32]

#: Hexadecimal digits of a fingerprint. SHA-256 since processors have instructions for it: half of
#: what BLAKE2b takes (measured).
DIGEST_LENGTH = 32


@dataclass(frozen=True, eq=False)
class PackedBlock:
    """Joint values of some periods in a row.

    Attributes:
        layout: number of the layout that says whose columns these are
        first: number of the first row since the recording began
        times: simulation time of each row, (k,) [s]
        values: positions, velocities, efforts, set-points, (4, n_joints, k)
        digest: of the rows of the physics state that they come from, in full precision
    """

    layout: int
    first: int
    times: Array
    values: Single
    digest: str


def digest(rows: Array) -> str:
    """Return a fingerprint of rows of the physics state: it differs where one bit does."""
    return hashlib.sha256(np.ascontiguousarray(rows).data).hexdigest()[:DIGEST_LENGTH]


def single(values: Array) -> Single:
    """Return values as they are stored; what is beyond float32 becomes infinite."""
    with np.errstate(over="ignore"):
        return values.astype("<f4")


def pack(block: PackedBlock) -> bytes:
    """Return a block as the data of a message."""
    head = {
        "layout": block.layout,
        "first": block.first,
        "shape": list(block.values.shape),
        "digest": block.digest,
    }
    text = json.dumps(head).encode()
    bits = np.ascontiguousarray(block.values).view("<i4")
    change = np.diff(bits, axis=-1, prepend=np.int32(0)).astype("<i4", copy=False)
    planes = np.ascontiguousarray(change).view(np.uint8).reshape(-1, 4).T
    times = np.ascontiguousarray(block.times, "<f8")
    return b"".join([struct.pack("<I", len(text)), text, times.tobytes(), planes.tobytes()])


def unpack(data: bytes) -> PackedBlock:
    """Return a block from the data of a message.

    Raises:
        InputError: the data are no block
    """
    try:
        (length,) = struct.unpack_from("<I", data)
        head: Mapping[str, Any] = json.loads(data[4 : 4 + length])
        shape = tuple(int(n) for n in head["shape"])
        quantities, joints, count = shape
        at = 4 + length + 8 * count
        times = np.frombuffer(data, "<f8", count, 4 + length)
        planes = np.frombuffer(data, np.uint8, 4 * quantities * joints * count, at)
        change = np.ascontiguousarray(planes.reshape(4, -1).T).view("<i4").reshape(shape)
        bits = np.cumsum(change, axis=-1, dtype=np.int32)
        return PackedBlock(
            int(head["layout"]),
            int(head["first"]),
            times.astype(np.float64),
            bits.view("<f4"),
            str(head["digest"]),
        )
    except (KeyError, TypeError, ValueError, struct.error) as error:
        raise InputError(f"a block of states is damaged: {error}") from error
