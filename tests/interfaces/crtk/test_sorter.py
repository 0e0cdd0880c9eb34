"""Commands over several connections are obeyed in the order in which they were sent."""

from __future__ import annotations

import itertools
import threading

from trocar.interfaces.crtk import sorter
from trocar.interfaces.crtk.sorter import Sent, Sorter, in_order


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
    made = Sorter()
    for k in (3, 1, 2):
        assert made.put(Sent("/a", (k, 0), False, lambda k=k: done.append(k)))
    made.put(Sent("/a", (4, 0), False, over.set))
    made.start()
    assert over.wait(10.0)
    made.close()
    assert done == [1, 2, 3]


def test_a_flood_is_bounded() -> None:
    made = Sorter()
    taken = [made.put(sent("move")) for _ in range(sorter.WAITING + 10)]
    assert taken == [True] * sorter.WAITING + [False] * 10
