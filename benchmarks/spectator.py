"""Somebody who looks at the page as a browser does, and draws nothing: for measurements.

python benchmarks/spectator.py http://127.0.0.1:8080
"""

from __future__ import annotations

import sys

import msgspec
import viser
from websockets.sync.client import connect
from websockets.typing import Subprotocol


def look(url: str) -> None:
    """Say where the page's camera stands, as a browser does, and take all that is sent."""
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
        for _ in page:
            pass


if __name__ == "__main__":
    look(sys.argv[1])
