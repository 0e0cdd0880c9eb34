"""Messages of the page: their time, their count, and when they leave."""

from __future__ import annotations

import logging

import pytest

from trocar.viewer.notices import IN_STATUS, LASTS_S, SHOWN, Notices, html_of

log = logging.getLogger("trocar")


class Clock:
    """A clock that a test sets."""

    def __init__(self) -> None:
        self.now = 1000.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def clock() -> Clock:
    return Clock()


def texts(notices: Notices) -> list[str]:
    return [notice.text for notice in notices.newest_first]


def test_the_last_warnings_are_kept_newest_first(clock: Clock) -> None:
    notices = Notices(clock)
    with notices.listening():
        for k in range(SHOWN + 2):
            log.warning("clipped %d", k)
        log.info("not a warning")
    log.warning("nobody listens")
    assert texts(notices) == [f"clipped {k}" for k in range(SHOWN + 1, 1, -1)]


def test_a_message_that_comes_again_is_counted_with_those_held_back(clock: Clock) -> None:
    notices = Notices(clock)
    with notices.listening():
        log.warning("clipped")
        log.warning("other")
        clock.now += 5.0
        log.warning("clipped (127 more such since)")
    newest = notices.newest_first[0]
    assert (newest.text, newest.count, newest.at_s) == ("clipped", 129, 1005.0)
    assert "(129 times)" in html_of(notices.newest_first)


def test_a_message_leaves_some_time_after_it_came_last(clock: Clock) -> None:
    notices = Notices(clock)
    with notices.listening():
        log.warning("clipped")
        clock.now += LASTS_S - 1.0
        log.warning("clipped")
    clock.now += LASTS_S - 1.0
    notices.follow({"PSM1": True})
    assert texts(notices) == ["clipped"]
    clock.now += 2.0
    notices.follow({"PSM1": True})
    assert texts(notices) == []


def test_a_message_about_an_arm_stays_until_that_arm_can_move_again(clock: Clock) -> None:
    notices = Notices(clock)
    notices.follow({"PSM1": True, "PSM2": True})
    with notices.listening():
        log.warning("PSM1: FAULT: yaw strayed")
        log.warning("PSM10: unreachable")
    notices.follow({"PSM1": False, "PSM2": True})
    clock.now += 3 * LASTS_S
    notices.follow({"PSM1": False, "PSM2": True})
    assert texts(notices) == ["PSM1: FAULT: yaw strayed"]
    notices.follow({"PSM1": True, "PSM2": True})
    assert texts(notices) == []


def test_a_message_with_other_measured_numbers_is_the_same_one(clock: Clock) -> None:
    notices = Notices(clock)
    with notices.listening():
        for arm, missed_mm in (("PSM1", 0.36), ("PSM2", 0.5), ("PSM1", 37.93)):
            log.warning("%s: the goal is missed by %.2f mm", arm, missed_mm)
    assert [(notice.text, notice.count) for notice in notices.newest_first] == [
        ("PSM1: the goal is missed by 37.93 mm", 2),
        ("PSM2: the goal is missed by 0.50 mm", 1),
    ]


def test_what_stands_in_a_status_line_is_no_message(clock: Clock) -> None:
    notices = Notices(clock)
    with notices.listening():
        log.warning("rendering is slower than 60 Hz", extra=IN_STATUS)
    assert texts(notices) == []
