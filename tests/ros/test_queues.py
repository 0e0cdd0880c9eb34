"""Images wait for no other, and commands over several connections are applied in order."""

from __future__ import annotations

import itertools
import threading
import time

import numpy as np

from trocar.ros.queues import APART_S, WAITING, ImageQueue, ReorderBuffer, Sent, in_order


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


def sent(name: str, stamp: int = 0, peer: str = "/a") -> Sent:
    state = name in ("enable", "home")
    return Sent(peer, (stamp, 0) if stamp else None, state, lambda: name)


def obeyed(*commands: Sent) -> list[str]:
    return [command.obey() for command in in_order(commands)]


def test_stamps_tell_the_order_however_they_arrive() -> None:
    burst = sent("enable", 1), sent("home", 2), sent("move", 3), sent("hold", 4)
    for order in itertools.permutations(burst):
        assert obeyed(*order) == ["enable", "home", "move", "hold"]


def test_without_stamps_the_operating_state_comes_first_and_each_topic_keeps_its_order() -> None:
    states, moves = [sent("enable"), sent("home")], [sent("move"), sent("move on")]
    for places in itertools.combinations(range(4), 2):
        a, b = iter(states), iter(moves)
        mixed = [next(a) if k in places else next(b) for k in range(4)]
        assert obeyed(*mixed) == ["enable", "home", "move", "move on"]


def test_the_stamps_of_one_sender_are_nothing_to_another() -> None:
    assert obeyed(sent("late", 9), sent("early", 1, "/b")) == ["late", "early"]
    assert obeyed(sent("move", 5), sent("home")) == ["home", "move"], "one has no stamp"


def test_what_comes_within_a_moment_is_sorted_and_all_of_it_is_obeyed() -> None:
    done: list[int] = []
    over = threading.Event()
    made = ReorderBuffer()
    for k in (3, 1, 2):
        assert made.put(Sent("/a", (k, 0), False, lambda k=k: done.append(k)))
    made.put(Sent("/a", (4, 0), False, over.set))
    made.start()
    assert over.wait(10.0)
    made.close()
    assert done == [1, 2, 3]


def test_a_flood_is_bounded() -> None:
    made = ReorderBuffer()
    taken = [made.put(sent("move")) for _ in range(WAITING + 10)]
    assert taken == [True] * WAITING + [False] * 10
