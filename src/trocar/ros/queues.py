"""The queue of images between the core and a transport."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from trocar.rendering.latest_only import LatestOnly

#: Time from one large message to the next: two at once may be more than a subscriber's socket
#: holds, and what is lost there comes late. Source: our own choice, by the images that
#: `trocar bench interface --transport ros2` counts. [s]
APART_S = 0.002


class ImageQueue(LatestOnly[Any]):
    """Deliver the newest image of each name in a thread of its own, so that states do not wait.

    Args:
        deliver: called with each image
    """

    def __init__(self, deliver: Callable[[Any], None]) -> None:
        def spaced(image: Any) -> None:
            deliver(image)
            time.sleep(APART_S)

        super().__init__(spaced, "trocar-images")
