"""The newest item wins, items that it overtakes are counted, and closing joins the thread."""

from __future__ import annotations

import threading

import pytest

from trocar.rendering import LatestOnly


class Gate:
    """Work that waits until it may go on."""

    def __init__(self) -> None:
        self.begun, self.may = threading.Semaphore(0), threading.Semaphore(0)
        self.done: list[object] = []

    def __call__(self, item: object) -> None:
        self.begun.release()
        assert self.may.acquire(timeout=10.0)
        self.done.append(item)


def test_the_newest_wins_and_those_it_overtakes_are_counted() -> None:
    gate = Gate()
    worker = LatestOnly(gate, "test")
    assert not worker.put(1)
    assert gate.begun.acquire(timeout=10.0)
    assert [worker.put(item) for item in (2, 3, 4)] == [False, True, True]
    assert worker.waiting and not worker.idle
    gate.may.release(2)
    assert gate.begun.acquire(timeout=10.0)
    worker.close()
    assert (gate.done, worker.dropped, worker.idle) == ([1, 4], 2, True)


def test_each_key_has_its_own_newest_and_items_that_wait_together_stay_together() -> None:
    gate = Gate()
    worker = LatestOnly(gate, "test")
    worker.put("left 0", "left")
    assert gate.begun.acquire(timeout=10.0)
    for k in (1, 2):
        worker.put(f"left {k}", "left")
        worker.put(f"right {k}", "right")
    gate.may.release()
    assert gate.begun.acquire(timeout=10.0)  # of the pair 2: 3 does not part it
    assert not worker.put("right 3", "right")
    gate.may.release(3)
    for _ in range(2):
        assert gate.begun.acquire(timeout=10.0)
    worker.close()
    assert gate.done == ["left 0", "left 2", "right 2", "right 3"]
    assert worker.dropped == 2


def test_closing_ends_after_the_item_in_work_drops_those_that_wait_and_joins() -> None:
    gate, ended = Gate(), list[str]()
    worker = LatestOnly(gate, "own name", lambda: ended.append(threading.current_thread().name))
    worker.put(1)
    assert gate.begun.acquire(timeout=10.0)
    worker.put(2)
    worker.close(0.0)  # the item in work is not done yet: nobody waits for ever
    assert ended == []
    gate.may.release()
    worker.close()
    assert (gate.done, ended) == ([1], ["own name"])
    worker.put(3)
    assert gate.done == [1]


def test_nothing_is_put_and_no_thread_starts() -> None:
    worker = LatestOnly(lambda _: pytest.fail("nothing was put"), "test")
    before = threading.active_count()
    worker.close()
    assert threading.active_count() == before and worker.idle
