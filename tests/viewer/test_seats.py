"""Who drives: browsers of the simulator's machine, and those that they give control to."""

from __future__ import annotations

import json
from types import SimpleNamespace
from typing import Any

import pytest

from trocar.live import Command, Loop
from trocar.live.access import PageAccess
from trocar.simulation import World
from trocar.viewer import Driving, Pedal
from trocar.viewer.desk import GIVE, REQUEST, Desk
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

    def open(self, page: Page, who: int, query: str) -> Desk:
        """Open the page as a browser whose page has this query."""
        desk = page.open(page.server, who)
        desk._channel.receive(json.dumps({"width": 1920, "frames": None, "query": query}))
        return desk


def test_what_a_spectator_s_browser_sends_moves_nothing() -> None:
    room = Room()
    with serving("0.0.0.0", 0, "test", PageAccess(token="0123456789abcdef")) as server:
        page = run_there(server, lambda: Page(server, room.world, room.loop, driving=room.driving))
        access = server.page.access
        watching = run_there(server, lambda: room.open(page, 0, access.watch_query))
        touch_all(watching)
        assert room.posted == [] and room.pressed == []
        console = run_there(server, lambda: room.open(page, 1, access.query))
        touch_all(console)
        assert len(room.posted) >= 8 and room.pressed == [True]
        run_there(server, lambda: (watching._press_seat(REQUEST), console._press_seat(GIVE)))
        run_there(server, lambda: [d._show_controls(room.loop.state) for d in (watching, console)])
        room.posted.clear()
        touch_all(watching)
        assert len(room.posted) >= 8


def touch_all(desk: Desk) -> None:
    """Send what a browser can send of its widgets, whatever its page offers."""
    assert desk.panel is not None and desk.panel.controls is not None and desk._hands is not None
    controls = desk.panel.controls
    pedals = [setting.handle for _, setting in desk._hands._pedals]
    for handle in (*controls.sliders.handles, controls._mode.handle, *pedals):
        send(handle, True if handle in pedals else handle.value)
    for buttons in (desk.panel._time, desk.panel._poses, controls._power):
        send(buttons._handle, buttons.names[0])


def send(handle: Any, value: object) -> None:
    event = SimpleNamespace(client_id=7, target=SimpleNamespace(value=value))
    for act in handle._impl.update_cb:
        run(act(event))


def run(work: Any) -> None:
    """Run a coroutine that waits for nothing."""
    with pytest.raises(StopIteration):
        work.send(None)


@pytest.mark.parametrize(("console", "sends"), [(True, True), (False, False)])
def test_keys_are_sent_by_pages_of_a_console_only(
    console: bool, sends: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    framed: list[int] = []
    monkeypatch.setattr(
        "trocar.viewer.driving._frame", lambda *_: framed.append(1) or "<p>keys</p>"
    )
    room = Room()
    with serving("0.0.0.0", 0, "test", PageAccess(token="0123456789abcdef")) as server:
        page = run_there(server, lambda: Page(server, room.world, room.loop, driving=room.driving))
        access = server.page.access
        query = access.query if console else access.watch_query
        run_there(server, lambda: room.open(page, 0, query))
    assert bool(framed) is sends
