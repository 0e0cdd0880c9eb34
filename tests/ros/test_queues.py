"""Images are delivered apart from states, the newest of each name."""

from __future__ import annotations

import threading
import time

import numpy as np

from trocar.ros.queues import APART_S, ImageQueue


def test_a_lane_delivers_the_newest_of_each_name() -> None:
    began, go_on = threading.Event(), threading.Event()
    seen: list[int] = []

    def deliver(parcel: int) -> None:
        seen.append(parcel)
        began.set()
        go_on.wait(10)

    lane = ImageQueue(deliver)
    lane.put(1, "left")
    began.wait(10)
    for parcel in (2, 3, 4):
        lane.put(parcel, "left")
    go_on.set()
    while len(seen) < 2:
        time.sleep(0.001)
    lane.close()
    assert seen == [1, 4]
    assert lane.dropped == 2


def test_a_lane_leaves_time_between_two_parcels() -> None:
    """Two raw images at once are more than a subscriber's socket holds."""
    came: list[float] = []
    lane = ImageQueue(lambda _: came.append(time.monotonic()))
    for number in range(6):
        lane.put(number, f"eye {number}")
    while len(came) < 6:
        time.sleep(0.001)
    lane.close()
    assert (np.diff(came) >= APART_S).all()
