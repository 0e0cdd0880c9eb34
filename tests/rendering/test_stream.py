"""A stream draws in its own thread: newest first, nothing queued, and the world does not notice."""

from __future__ import annotations

import threading
from collections.abc import Mapping

import numpy as np
import pytest

from trocar.errors import InputError, TrocarError
from trocar.rendering import Endoscope, StereoFrame, Stream
from trocar.simulation import World
from trocar.simulation.cameras import CameraRecord
from trocar.simulation.records import Snapshot

SMALL = "dvrk_sd_640x480"


def blank(snapshot: Snapshot) -> StereoFrame:
    picture = np.zeros((2, 2, 3), np.uint8)
    rig: object = None
    return StereoFrame(
        "endoscope", picture, None, None, None, None, {}, snapshot.time, 1, rig, np.eye(4)  # type: ignore[arg-type]
    )  # fmt: skip


@pytest.fixture
def world() -> World:
    return World("two_psm_ecm")


class Hand:
    """Draws when it is told to."""

    def __init__(self) -> None:
        self.begun, self.may = threading.Semaphore(0), threading.Semaphore(0)
        self.times: list[float] = []

    def __call__(self, snapshot: Snapshot, _: Mapping[str, CameraRecord]) -> StereoFrame:
        self.begun.release()
        assert self.may.acquire(timeout=30.0)
        self.times.append(snapshot.time)
        return blank(snapshot)


def test_snapshots_that_are_overtaken_are_dropped_and_counted(world: World) -> None:
    hand = Hand()
    with Stream(world, hand, 100.0) as stream:
        assert hand.begun.acquire(timeout=30.0)  # of time 0
        world.step(55)  # five more are due while it is drawn
        assert stream.dropped == 4 and stream.newest is None
        hand.may.release()
        assert hand.begun.acquire(timeout=30.0)
        hand.may.release()
        first = stream.wait()
        newest = first if first.time > 0.0 else stream.wait(first)
    assert newest.time == pytest.approx(0.05)
    assert hand.times == [0.0, pytest.approx(0.05)]
    assert (stream.made, stream.dropped) == (2, 4)


def test_frames_are_due_in_simulated_time_also_inside_one_long_step(world: World) -> None:
    times: list[float] = []

    def draw(snapshot: Snapshot, _: Mapping[str, CameraRecord]) -> StereoFrame:
        times.append(snapshot.time)
        return blank(snapshot)

    with Stream(world, draw, 50.0) as stream:
        world.step(1000)
    assert stream.made + stream.dropped >= 50
    assert all(abs(t * 50.0 - round(t * 50.0)) < 0.3 for t in times)


def test_a_world_that_is_reset_is_drawn_on(world: World) -> None:
    with Stream(world, lambda snapshot, _: blank(snapshot), 50.0) as stream:
        world.step(100)
        before = stream.wait()
        world.reset()
        world.step(50)
        while (frame := stream.wait(before)).time > 0.06:
            before = frame


def test_what_goes_wrong_is_told_to_whoever_asks(world: World) -> None:
    def fail(*_: object) -> StereoFrame:
        raise TrocarError("the graphics context was lost twice")

    with Stream(world, fail, 50.0) as stream, pytest.raises(TrocarError, match="lost twice"):
        stream.wait()


def test_no_frame_in_time_is_an_error_that_asks_whether_the_world_was_stepped(
    world: World,
) -> None:
    with Stream(world, lambda snapshot, _: blank(snapshot), 50.0) as stream:
        first = stream.wait()
        with pytest.raises(TrocarError, match="was the world stepped"):
            stream.wait(first, timeout_s=0.05)


@pytest.mark.parametrize("rate", [0.0, -1.0, float("nan"), float("inf"), "fast"])
def test_a_rate_that_is_none_is_rejected(world: World, rate: float) -> None:
    with pytest.raises(InputError, match=r"rate_hz: got .*; allowed: above 0"):
        Stream(world, lambda snapshot, _: blank(snapshot), rate)


@pytest.mark.usefixtures("opengl")
def test_an_endoscope_streams_and_tells_the_time_of_its_frames(world: World) -> None:
    scope = Endoscope(world, preset=SMALL)
    with scope.stream(60.0) as stream:
        frame = stream.wait()
        for _ in range(20):
            world.step(5)
        last = stream.wait(frame)
    assert 0.0 <= frame.time < last.time <= world.time
    assert (last.left.shape, stream.newest is not None) == ((480, 640, 3), True)


@pytest.mark.usefixtures("opengl")
def test_physics_is_the_same_to_the_last_bit_with_and_without_pictures() -> None:
    def moved(look: bool) -> list[bytes]:
        world = World("two_psm_ecm")
        world.arm("PSM1").move_jp(np.array([0.2, 0.1, 0.15, 0.3, 0.1, -0.1]))
        found = []
        scope = Endoscope(world, preset=SMALL) if look else None
        stream = scope.stream(100.0) if scope else None
        if stream is not None:
            stream.__enter__()
        for k in range(40):
            world.step(5)
            if scope is not None and k % 10 == 0:
                scope.capture()
            now = world.sample().arms
            found.append(b"".join(arm.q.tobytes() + arm.qd.tobytes() for arm in now.values()))
        if stream is not None:
            stream.stop()
            assert stream.made > 1
        return found

    assert moved(look=True) == moved(look=False)
