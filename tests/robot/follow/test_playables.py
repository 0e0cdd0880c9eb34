"""Moments of recordings, shown in a world: those of the file, in whatever order."""

from __future__ import annotations

import threading
from pathlib import Path

import numpy as np
import pytest

from trocar.descriptions import load_arm
from trocar.descriptions.rigs import lone_arm_rig
from trocar.errors import LogError
from trocar.live import Command, Loop
from trocar.live.player import Playable, Player
from trocar.recording import open_recording, record
from trocar.robot.follow import PlayedLog, RepeatedRecording
from trocar.robot.recordings import read_arm_motion
from trocar.simulation import World
from trocar.simulation.journal import WORLD

pytest.importorskip("mcap")
GOAL = [0.3, 0.2, 0.15, 0.4, 0.2, -0.3]
AT_ONCE = 1e9


def recorded(file: Path) -> Path:
    """Record a move, a table of set-points, a reset, and another tool."""
    world = World("psm")
    arm = world.arm("PSM1")
    with record(world, file):
        arm.move_jp(GOAL)
        world.step(700)
        table = arm.setpoint_js().position + np.linspace(0.0, 0.05, 120)[:, None]
        whole = np.column_stack([table, np.zeros(120)])
        world.play({"PSM1": whole[:, : len(arm.joints.lower)]}, every=5)
        world.reset()
        arm.move_to("home")
        world.step(900)
        world.exchange_tool("PSM1", "PROGRASP_FORCEPS:420093")
        arm.move_jp(GOAL)
        world.step(600)
    return file


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return recorded(tmp_path_factory.mktemp("films") / "run.mcap")


def test_the_moment_shown_is_that_of_the_recording(file: Path) -> None:
    played = RepeatedRecording(file)
    about = open_recording(file)
    rows = {
        row: block.values[0, :, k].astype(float)
        for block in about.blocks()
        for k, row in enumerate(range(block.first, block.first + len(block.times)))
    }
    assert len(rows) == about.rows
    generator = np.random.default_rng(3)
    order = [about.rows - 1, 0, 1, 700, 701, *generator.integers(0, about.rows, 12).tolist()]
    for row in order:
        shown = played.show(
            played.world, played.nearest(played.start_s + row * played.period_s), AT_ONCE
        )
        assert shown == pytest.approx(played.start_s + row * played.period_s, abs=1e-9)
        here = played.world.arm("PSM1").joints.positions()
        assert here.astype(np.float32).astype(float) == pytest.approx(rows[row], abs=1e-9)
    assert played.notes == ()


def test_motion_goes_on_from_a_moment_as_it_was_recorded(file: Path) -> None:
    played = RepeatedRecording(file)
    played.show(played.world, played.nearest(0.9), AT_ONCE)
    played.show(played.world, played.nearest(0.2), AT_ONCE)
    played.world.step(300)
    ours = played.world.arm("PSM1").joints.positions()
    played.forget()
    played.show(played.world, played.nearest(0.5), AT_ONCE)
    assert played.world.arm("PSM1").joints.positions().tolist() == ours.tolist()


def test_a_motion_that_differs_from_the_file_is_reported(file: Path) -> None:
    played = RepeatedRecording(file)
    played.world.arm("PSM1").joints.set_gains("yaw", p=1.0)
    played.show(played.world, played.nearest(played.end_s), AT_ONCE)
    assert any("differs from the recorded one at 0.5" in note for note in played.notes)


def test_a_torn_recording_is_played_up_to_where_it_ends_and_says_so(
    file: Path, tmp_path: Path
) -> None:
    torn = tmp_path / "torn.mcap"
    torn.write_bytes(file.read_bytes()[:-9000])
    played = RepeatedRecording(torn)
    assert played.end_s < RepeatedRecording(file).end_s
    assert any("breaks off" in note for note in played.notes)
    torn.write_bytes(file.read_bytes()[:400])
    with pytest.raises(LogError, match=r"torn\.mcap"):
        RepeatedRecording(torn)


def log(file: Path) -> Path:
    t = np.arange(200) / 100.0
    q = np.column_stack([0.3 * np.sin(t + k) for k in range(6)])
    q[:, 2] = 0.12 + 0.02 * np.sin(t)
    names = ["yaw", "pitch", "insertion", "roll", "wrist_pitch", "wrist_yaw", "jaw"]
    head = ",".join(["time", *(f"{name}_position" for name in names)])
    table = np.column_stack([t, q, 0.3 + 0.1 * np.sin(t)])
    np.savetxt(file, table, delimiter=",", header=head, comments="")
    return file


def test_the_moment_shown_of_a_log_has_the_joints_of_its_row(tmp_path: Path) -> None:
    arm = load_arm("psm")
    motion = read_arm_motion(log(tmp_path / "log.csv"), arm)
    world = World(lone_arm_rig(arm))
    name = next(iter(world.arms))
    played = PlayedLog(world, {name: motion})
    for row in (150, 3, 199, 0):
        time_s = played.nearest(float(motion.times[row]))
        assert played.show(world, time_s, AT_ONCE) == time_s == motion.times[row]
        assert world.arm(name).joints.positions() == pytest.approx(motion.rows[row, 0], abs=1e-9)


def test_a_long_log_keeps_every_nth_row(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("trocar.robot.follow.playables.MOST_ROWS", 50)
    arm = load_arm("psm")
    motion = read_arm_motion(log(tmp_path / "log.csv"), arm)
    world = World(lone_arm_rig(arm))
    played = PlayedLog(world, {next(iter(world.arms)): motion})
    assert played.period_s == pytest.approx(0.04)


class Clock:
    """Wall time that passes when a test says so."""

    def __init__(self) -> None:
        self.t = 0.0

    def now(self) -> float:
        return self.t

    def sleep(self, seconds: float, until: threading.Event | None = None) -> None:  # noqa: ARG002
        self.t += seconds


def playing(played: Playable, world: World) -> tuple[Loop, Player, Clock]:
    clock = Clock()
    loop = Loop(world, clock=clock)
    player = Player(loop, played)
    loop.watch(player)
    loop.post(Command(WORLD, "pause"))
    loop.tick()
    return loop, player, clock


def ticks(loop: Loop, clock: Clock, seconds: float) -> None:
    for _ in range(round(seconds / loop.tick_s)):
        clock.t += loop.tick_s
        loop.tick()


def test_a_recording_is_played_at_its_speed_and_stops_at_its_end(file: Path) -> None:
    played = RepeatedRecording(file)
    loop, player, clock = playing(played, played.world)
    player.play()
    ticks(loop, clock, 0.4)
    assert player.time_s == pytest.approx(0.4, abs=0.006)
    assert played.world.time == pytest.approx(player.time_s)
    player.speed = 0.1
    ticks(loop, clock, 0.5)
    assert player.time_s == pytest.approx(0.45, abs=0.012)
    player.pause()
    before = player.time_s
    ticks(loop, clock, 0.1)
    assert player.time_s == before
    player.seek(played.end_s - 0.05)
    player.speed = 1.0
    player.play()
    ticks(loop, clock, 0.3)
    assert (player.time_s, player.playing) == (played.end_s, False)


def test_a_branch_leaves_the_recording_until_one_comes_back(file: Path) -> None:
    played = RepeatedRecording(file)
    loop, player, clock = playing(played, played.world)
    player.seek(0.3)
    ticks(loop, clock, 0.1)
    there = played.world.arm("PSM1").joints.positions()
    player.leave()
    ticks(loop, clock, 0.2)
    assert not player.active
    assert played.world.time == pytest.approx(0.5, abs=0.011)
    player.come_back()
    ticks(loop, clock, 0.05)
    assert player.active
    assert played.world.arm("PSM1").joints.positions().tolist() == there.tolist()


def test_a_slow_log_is_played_row_by_row(tmp_path: Path) -> None:
    arm = load_arm("psm")
    motion = read_arm_motion(log(tmp_path / "log.csv"), arm)
    world = World(lone_arm_rig(arm))
    played = PlayedLog(world, {next(iter(world.arms)): motion})
    loop, player, clock = playing(played, world)
    player.speed = 0.1
    player.play()
    ticks(loop, clock, 1.0)
    assert player.time_s == pytest.approx(0.1, abs=0.011)
