"""The folder of a recording: its buttons, its slider, and what they keep from moving."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import pytest

from tests.viewer.visitor import Visitor, visiting
from trocar.live import Loop
from trocar.live.player import Player
from trocar.simulation import World
from trocar.viewer.desk import Desk
from trocar.viewer.page import Page
from trocar.viewer.playback import (
    BACK,
    CONTINUE,
    FORTH,
    FORTH_ONE,
    PAUSE,
    PLAY,
    RETURN,
    PlaybackFolder,
)
from trocar.viewer.server import run_there, serving


class Turning:
    """A source of ten moments a second in which PSM1 yaws at 0.1 rad/s."""

    name, start_s, end_s, period_s, continues = "turning", 5.0, 7.0, 0.1, True
    notes = ("of nobody",)

    def nearest(self, time_s: float) -> float:
        return min(max(round(time_s, 1), self.start_s), self.end_s)

    def show(self, world: World, moment_s: float, budget_s: float) -> float:  # noqa: ARG002
        q = world.arm("PSM1").joints.positions()
        q[0] = 0.1 * (moment_s - self.start_s)
        world.set_state("PSM1", q)
        return moment_s

    def forget(self) -> None:
        """Keep nothing."""


@pytest.fixture
def shown() -> Iterator[Shown]:
    world = World("psm")
    loop = Loop(world)
    player = Player(loop, Turning())
    loop.watch(player)

    def folder(desk: Any) -> PlaybackFolder:
        return PlaybackFolder(desk, player)

    with serving("127.0.0.1", 0, "test") as server:
        page = run_there(
            server, lambda: Page(server, world, loop, folders=(folder,), player=player)
        )
        with visiting(server) as visitor:
            visitor.report()
            loop.start()
            try:
                yield Shown(page, visitor, player, loop)
            finally:
                loop.close()


@dataclass
class Shown:
    """A page that shows a recording, and who looks at it."""

    page: Page
    visitor: Visitor
    player: Player
    loop: Loop

    @property
    def desk(self) -> Desk:
        return self.page.desks[self.visitor.who]

    @property
    def acts(self) -> tuple[str, ...]:
        """The buttons that are shown."""
        return self.visitor.widget("Recording").options

    def refresh(self) -> None:
        (folder,) = self.desk.folders
        run_there(self.page.server, lambda: folder.show(self.loop.state))

    def settle(self) -> None:
        for _ in range(2):  # what was posted, and what the tick after it shows
            self.loop.ask(lambda _: None).result(10.0)
        assert not self.player.seeks
        self.refresh()


def paused(loop: Loop) -> None:
    from trocar.live import Command
    from trocar.simulation.journal import WORLD

    loop.post(Command(WORLD, "pause"))
    loop.ask(lambda _: None).result(10.0)


def yaw(loop: Loop) -> float:
    return float(loop.ask(lambda world: world.arm("PSM1").joints.positions()[0]).result(10.0))


@pytest.fixture
def still(shown: Shown) -> Shown:
    paused(shown.loop)
    shown.player.active = True  # ticks before the pause left it
    shown.player.seek(5.0)
    shown.settle()
    return shown


def test_the_slider_shows_the_moment_and_goes_to_another(still: Shown) -> None:
    still.visitor.use("Moment s", 1.2)
    still.settle()
    assert yaw(still.loop) == pytest.approx(0.12, abs=1e-9)
    assert still.visitor.widget("Moment s").value == pytest.approx(1.2)
    text = still.visitor.text("recording")
    assert "1.200 of 2.000 s" in text and "of nobody" in text
    still.player.seek(5.5)  # another browser's slider
    still.settle()
    assert still.visitor.widget("Moment s").value == pytest.approx(0.5)


def test_steps_go_by_a_moment_or_a_tenth_of_a_second_and_end_at_the_ends(still: Shown) -> None:
    for name, expected in ((FORTH_ONE, 5.1), (FORTH, 5.2), (BACK, 5.1), (BACK, 5.0), (BACK, 5.0)):
        still.visitor.use("Moment by moment", name)
        still.settle()
        assert still.player.time_s == pytest.approx(expected)


def test_while_a_recording_is_shown_no_arm_is_driven_and_time_is_not_let_flow(
    still: Shown,
) -> None:
    desk = still.desk
    assert "a recording is shown: Continue from here" in desk.blocked("PSM1")
    assert desk.seat and not desk.watching
    assert still.acts == (PLAY, CONTINUE)
    still.visitor.use("Recording", CONTINUE)
    still.settle()
    assert still.acts == (RETURN,) and not desk.blocked("PSM1")
    still.visitor.use("Recording", RETURN)
    still.settle()
    assert still.acts == (PLAY, CONTINUE) and desk.blocked("PSM1")


def test_play_becomes_pause(still: Shown) -> None:
    still.visitor.use("Recording", PLAY)
    still.refresh()
    assert still.acts[0] == PAUSE
    still.visitor.use("Recording", PAUSE)
    assert not still.player.playing
