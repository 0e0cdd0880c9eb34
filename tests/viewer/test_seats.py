"""Who drives: browsers of the simulator's machine, and those that they give control to."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from tests.viewer.visitor import Visitor, visiting
from trocar.live import Command, Loop
from trocar.live.access import PageAccess
from trocar.simulation import World
from trocar.viewer import Driving, Pedal
from trocar.viewer.desk import GIVE, NUMBERS_EVERY, REQUEST
from trocar.viewer.page import Page
from trocar.viewer.seats import ANSWER_S, Seats
from trocar.viewer.server import run_there, serving


def test_a_browser_of_another_machine_watches_until_a_console_gives_it_control() -> None:
    now = [0.0]
    seats = Seats(lambda: now[0])
    seats.come(1, console=False)
    assert seats.driver is None and "you watch" in seats.blocked(1)
    seats.request(1)
    now[0] += ANSWER_S + 1.0
    seats.follow()
    assert (seats.driver, seats.asking) == (None, None)  # time gives it nothing
    seats.come(2)
    assert seats.driver == 2
    seats.request(1)
    assert seats.answers(2) and not seats.answers(1)
    now[0] += ANSWER_S + 1.0
    seats.follow()
    assert seats.driver == 2
    seats.request(1)
    seats.answer(granted=True)
    assert seats.driver == 1 and seats.blocked(1) == ""


def test_a_console_answers_beside_the_driver_and_takes_control_back_at_once() -> None:
    seats = Seats()
    seats.come(2)
    seats.come(1, console=False)
    seats.come(3, console=False)
    seats.request(1)
    seats.answer(granted=True)
    seats.request(3)
    assert seats.answers(1) and seats.answers(2) and not seats.answers(3)
    seats.request(2)
    assert seats.driver == 2


def test_when_the_last_console_leaves_nobody_drives() -> None:
    seats = Seats()
    seats.come(1, console=False)
    seats.come(2)
    seats.request(1)
    seats.leave(2)
    assert seats.driver is None
    seats.come(3, console=False)
    seats.admit(3)  # its page showed the secret of the run
    assert seats.driver == 3


class Room:
    """A page that other machines reach, of a world whose commands are noted."""

    def __init__(self) -> None:
        self.world = World("psm")
        self.loop = Loop(self.world)
        self.pressed: list[bool] = []
        self.posted: list[Command] = []
        self.loop.post = self.posted.append  # type: ignore[method-assign,assignment]
        self.driving = Driving(
            "Hands",
            {"keys": [("w", "forward")]},
            str,
            websocket="ws://127.0.0.1:9090/?token=x",
            pedals=(Pedal("Clutch", self.pressed.append, lambda: False),),
        )

    @contextmanager
    def serving(self) -> Iterator[Page]:
        with serving("0.0.0.0", 0, "test", PageAccess(token="0123456789abcdef")) as server:
            yield run_there(
                server, lambda: Page(server, self.world, self.loop, driving=self.driving)
            )


@contextmanager
def looking(page: Page, query: str) -> Iterator[Visitor]:
    """Look at the page with a browser whose page has this query."""
    with visiting(page.server, query) as visitor:
        visitor.report(query=query)
        yield visitor


def test_what_a_spectator_s_browser_sends_moves_nothing() -> None:
    room = Room()
    with room.serving() as page, looking(page, page.server.page.access.watch_query) as watching:
        touch_all(watching)
        assert room.posted == [] and room.pressed == []
        with looking(page, page.server.page.access.query) as console:
            touch_all(console)
            assert len(room.posted) >= 8 and room.pressed == [True]
            run_there(page.server, page.refresh)
            watching.use("Driver", REQUEST)
            for _ in range(NUMBERS_EVERY):
                run_there(page.server, page.refresh)
            console.use("Driver", GIVE)
            for _ in range(NUMBERS_EVERY):
                run_there(page.server, page.refresh)
            room.posted.clear()
            touch_all(watching)
            assert len(room.posted) >= 8


def touch_all(visitor: Visitor) -> None:
    """Send what a browser can send of its widgets, whatever its page offers."""
    sliders = [w for w in visitor.read().widgets.values() if w.kind == "GuiSliderMessage"]
    assert len(sliders) == 7
    for slider in sliders:
        ends = slider.props["min"], slider.props["max"]
        visitor.give(slider, ends[slider.value == ends[0]])
    for label in ("Time", "All arms to", "Power", "Mode", "Clutch"):
        widget = visitor.widget(label)
        visitor.give(widget, not widget.value if label == "Clutch" else widget.options[-1])


@pytest.mark.parametrize(("console", "sends"), [(True, True), (False, False)])
def test_keys_are_sent_by_pages_of_a_console_only(console: bool, sends: bool) -> None:
    room = Room()
    with room.serving() as page:
        access = page.server.page.access
        with looking(page, access.query if console else access.watch_query) as visitor:
            assert ("srcdoc" in visitor.text("keys")) is sends
            assert ("forward" in visitor.text("mapping")) is not sends
