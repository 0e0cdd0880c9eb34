"""The folder of a recording: its buttons, its slider, and what they keep from moving."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from trocar.live import Loop
from trocar.live.player import Player
from trocar.simulation import World
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
from trocar.viewer.server import serving


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
def shown() -> Iterator[tuple[Any, Player, Loop]]:
    world = World("psm")
    loop = Loop(world)
    player = Player(loop, Turning())
    loop.watch(player)

    def folder(desk: Any) -> PlaybackFolder:
        return PlaybackFolder(desk, player)

    with serving("127.0.0.1", 0, "test") as server:
        page = Page(server, world, loop, folders=(folder,), player=player)
        desk = page.open(server)
        desk.build(1920)
        loop.start()
        try:
            yield desk, player, loop
        finally:
            loop.close()


def folder_of(desk: Any) -> Any:
    (folder,) = desk.folders
    return folder


def settled(desk: Any, player: Player, loop: Loop) -> None:
    for _ in range(2):  # what was posted, and what the tick after it shows
        loop.ask(lambda _: None).result(10.0)
    assert not player.seeks
    desk.refresh(loop.state, {})
    folder_of(desk).show(loop.state)


def paused(loop: Loop) -> None:
    from trocar.live import Command
    from trocar.simulation.journal import WORLD

    loop.post(Command(WORLD, "pause"))
    loop.ask(lambda _: None).result(10.0)


def yaw(loop: Loop) -> float:
    return float(loop.ask(lambda world: world.arm("PSM1").joints.positions()[0]).result(10.0))


@pytest.fixture
def still(shown: tuple[Any, Player, Loop]) -> tuple[Any, Player, Loop]:
    desk, player, loop = shown
    paused(loop)
    player.active = True  # ticks before the pause left it
    player.seek(5.0)
    settled(desk, player, loop)
    return shown


def test_the_slider_shows_the_moment_and_goes_to_another(still: Any) -> None:
    desk, player, loop = still
    folder = folder_of(desk)
    folder._seek(1.2)
    settled(desk, player, loop)
    assert yaw(loop) == pytest.approx(0.12, abs=1e-9)
    assert folder._slider.value == pytest.approx(1.2)
    assert "1.200 of 2.000 s" in folder._text.content and "of nobody" in folder._text.content


def test_steps_go_by_a_moment_or_a_tenth_of_a_second_and_end_at_the_ends(still: Any) -> None:
    desk, player, loop = still
    folder = folder_of(desk)
    for name, expected in ((FORTH_ONE, 5.1), (FORTH, 5.2), (BACK, 5.1), (BACK, 5.0), (BACK, 5.0)):
        folder._step(name)
        settled(desk, player, loop)
        assert player.time_s == pytest.approx(expected)


def test_while_a_recording_is_shown_no_arm_is_driven_and_time_is_not_let_flow(still: Any) -> None:
    desk, player, loop = still
    assert "a recording is shown: Continue from here" in desk.blocked("PSM1")
    assert desk.seat and not desk.watching
    folder = folder_of(desk)
    assert folder._acts.names == (PLAY, CONTINUE)
    folder._press(CONTINUE)
    settled(desk, player, loop)
    assert folder._acts.names == (RETURN,) and not desk.blocked("PSM1")
    folder._press(RETURN)
    settled(desk, player, loop)
    assert folder._acts.names == (PLAY, CONTINUE) and desk.blocked("PSM1")


def test_play_becomes_pause(still: Any) -> None:
    desk, player, loop = still
    folder = folder_of(desk)
    folder._press(PLAY)
    folder.show(loop.state)
    assert folder._acts.names[0] == PAUSE
    folder._press(PAUSE)
    assert not player.playing
