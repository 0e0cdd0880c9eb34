"""Somebody who looks at the page as a browser does, and draws nothing: for measurements.

python benchmarks/spectator.py http://127.0.0.1:8080
python benchmarks/spectator.py http://127.0.0.1:8080 8 20: print updates a second of the scene
over 20 s, after 8 s
"""

from __future__ import annotations

import sys
import time

import msgspec
import viser
import zstandard
from websockets.sync.client import connect
from websockets.typing import Subprotocol


def look(url: str, settle_s: float = 0.0, count_s: float = float("inf")) -> float:
    """Say where the page's camera stands, as a browser does, and take all that is sent.

    Args:
        url: of the page
        settle_s, count_s: time before updates of the scene are counted, and over which they are [s]

    Returns:
        batches of messages a second that move bodies
    """
    camera = {
        "type": "ViewerCameraMessage",
        "wxyz": (1.0, 0.0, 0.0, 0.0),
        "position": (0.0, 0.0, 0.0),
        "fov": 1.0,
        "near": 0.01,
        "far": 100.0,
        "image_height": 700,
        "image_width": 860,
        "look_at": (0.0, 0.0, 1.0),
        "up_direction": (0.0, 0.0, 1.0),
    }
    spoken = Subprotocol(f"viser-v{viser.__version__}")
    with connect(
        url.replace("http", "ws", 1),
        subprotocols=[spoken],
        compression=None,
        max_size=None,
        ping_interval=None,  # browsers send none
    ) as page:
        page.send(msgspec.msgpack.encode(camera))
        began, count = time.monotonic() + settle_s, 0
        for batch in page:
            now = time.monotonic()
            if now > began + count_s:
                break
            count += now > began and b"SetPositionMessage" in _messages(batch)
    return count / count_s


def _messages(batch: str | bytes) -> bytes:
    """Return the packed messages of a batch: its lengths, zstd, buffers."""
    assert isinstance(batch, bytes)  # noqa: S101
    size = int.from_bytes(batch[8:16], "little")
    return zstandard.ZstdDecompressor().decompress(batch[16 : 16 + size])


if __name__ == "__main__":
    print(look(sys.argv[1], *map(float, sys.argv[2:])))
