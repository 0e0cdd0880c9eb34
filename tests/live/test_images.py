"""Pictures for all who look: when they are drawn, who gets them, and what goes wrong."""

from __future__ import annotations

import io
import logging
import threading
import time
from collections.abc import Callable

import numpy as np
import pytest
from PIL import Image

from tests.live.fake_renderer import FakeRenderer
from trocar.errors import InputError, UnknownNameError
from trocar.live import Loop
from trocar.live.images import FORMATS, DrawSchedule, Packer, Pictures, Shot
from trocar.rendering.frames import anaglyph, side_by_side
from trocar.simulation import World

RIG = "two_psm_ecm"


class Looker:
    """Somebody who looks through a camera."""

    def __init__(self, *cameras: str) -> None:
        self.cameras, self.shots = set(cameras), list[Shot]()

    def wanted(self) -> set[str]:
        return self.cameras

    def take(self, shot: Shot) -> None:
        self.shots.append(shot)


class Studio:
    """A world, and what draws it, in the hands of a test."""

    def __init__(self, renderer: FakeRenderer | None = None, **options) -> None:
        self.world = World(RIG)
        self.loop = Loop(self.world)
        self.renderer = renderer or FakeRenderer()
        self.pictures = Pictures(self.loop, lambda: self.renderer, **options)
        self.pictures.led = True
        self.pictures.start()

    def __enter__(self) -> Studio:
        return self

    def __exit__(self, *_: object) -> None:
        self.pictures.close()


def until(met: Callable[[], bool]) -> None:
    end = time.monotonic() + 10
    while not met():
        assert time.monotonic() < end, "in vain"
        time.sleep(0.002)


def test_nobody_looks_and_nothing_is_drawn() -> None:
    with Studio() as studio:
        assert studio.pictures.shoot(studio.world) == {}
        studio.pictures.add(Looker())
        assert studio.pictures.shoot(studio.world) == {}
    assert studio.renderer.drawn == 0


def test_pictures_are_drawn_in_a_thread_of_their_own_and_go_to_all_who_look() -> None:
    first, second = Looker("endoscope"), Looker("endoscope")
    with Studio() as studio:
        for looker in (first, second):
            studio.pictures.add(looker)
        assert "endoscope" in studio.pictures.shoot(studio.world, (7, 8))
        until(lambda: studio.pictures.made == 1)
    assert studio.renderer.threads == {"trocar-pictures"}
    assert studio.renderer.closed
    assert first.shots == second.shots
    assert first.shots[0].stamp == (7, 8)
    assert first.shots[0].camera == "endoscope"


def test_who_left_gets_no_picture() -> None:
    looker = Looker("endoscope")
    with Studio() as studio:
        studio.pictures.add(looker)()
        assert studio.pictures.shoot(studio.world) == {}


def test_a_renderer_that_is_too_slow_draws_the_newest_and_what_it_missed_is_counted(
    caplog: pytest.LogCaptureFixture,
) -> None:
    gate, looker = threading.Event(), Looker("endoscope")
    with Studio(FakeRenderer(gate=gate)) as studio, caplog.at_level(logging.WARNING, "trocar"):
        studio.pictures.add(looker)
        gate.set()
        studio.pictures.shoot(studio.world, (0, 1))
        until(lambda: studio.pictures.made == 1)
        gate.clear()
        studio.pictures.shoot(studio.world, (1, 0))
        until(lambda: not studio.pictures.waiting)
        for second in range(2, 100):
            studio.pictures.shoot(studio.world, (second, 0))
        assert studio.pictures.dropped == 97
        gate.set()
        until(lambda: studio.pictures.made == 3)
    assert [shot.stamp for shot in looker.shots] == [(0, 1), (1, 0), (99, 0)]
    assert [r.message for r in caplog.records if "dropped" in r.message] == [
        "rendering is slower than 60 Hz: 1 images dropped so far"
    ]


def test_a_picture_is_taken_when_it_is_due_and_would_be_drawn_soon(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    now = 0.0
    monkeypatch.setattr("trocar.live.images.time.perf_counter", lambda: now)
    schedule = DrawSchedule()
    for _ in range(100):  # it learns that drawing takes 20 ms
        schedule.begin()
        now += 0.020
        schedule.end()
    assert not schedule.starts(due=False)
    assert schedule.starts(due=True) and not schedule.owed
    schedule.begin()
    now += 0.010
    assert not schedule.starts(due=True) and schedule.owed  # it would wait
    now += 0.008
    assert not schedule.starts(due=False, free=False)  # another one waits
    assert schedule.starts(due=False) and not schedule.owed
    now += 1.0
    assert schedule.starts(due=True)  # this one takes longer than usual: it will not for ever


def test_what_is_due_while_another_is_owed_is_dropped_and_counted() -> None:
    gate, looker = threading.Event(), Looker("endoscope")
    with Studio(FakeRenderer(gate=gate)) as studio:
        studio.pictures.add(looker)
        assert studio.pictures.takes(due=True)
        studio.pictures.shoot(studio.world, (0, 0))
        studio.pictures.shoot(studio.world, (1, 0))  # one is drawn, one waits, or one is dropped
        dropped = studio.pictures.dropped
        until(lambda: not studio.pictures.waiting or studio.pictures.dropped == dropped)
        studio.pictures.shoot(studio.world, (2, 0))
        before = studio.pictures.dropped
        assert not studio.pictures.takes(due=True)
        assert studio.pictures.dropped == before  # it is owed
        assert not studio.pictures.takes(due=True)
        assert studio.pictures.dropped == before + 1
        gate.set()
        until(lambda: studio.pictures.idle)
        assert studio.pictures.takes(due=False)


def test_without_a_graphics_library_there_is_one_warning_and_the_simulation_goes_on(
    caplog: pytest.LogCaptureFixture,
) -> None:
    with Studio(FakeRenderer(fails_after=0)) as studio, caplog.at_level(logging.WARNING, "trocar"):
        studio.pictures.add(Looker("endoscope"))
        studio.pictures.shoot(studio.world)
        until(lambda: bool(studio.pictures.failure))
        assert studio.pictures.shoot(studio.world) == {}
        studio.world.step(10)
    assert [r.message for r in caplog.records] == ["no images: no OpenGL"]


def test_a_picture_of_a_tool_that_is_gone_is_dropped_and_those_after_it_come() -> None:
    looker = Looker("endoscope")
    with Studio(FakeRenderer(refuses=3)) as studio:
        studio.pictures.add(looker)
        for count in range(5):
            studio.pictures.shoot(studio.world, (count, 1))
            until(lambda: studio.pictures.idle)
        assert not studio.pictures.failure
    assert [shot.stamp for shot in looker.shots] == [(3, 1), (4, 1)]
    assert studio.pictures.dropped == 3


def test_what_can_never_be_drawn_is_said() -> None:
    with Studio(FakeRenderer(refuses=100)) as studio:
        studio.pictures.add(Looker("endoscope"))
        for _ in range(8):
            studio.pictures.shoot(studio.world)
            until(lambda: studio.pictures.idle)
        assert studio.pictures.failure == "of another build"


def test_nobody_who_leads_and_pictures_come_at_their_rate() -> None:
    looker = Looker("endoscope")
    with Studio(rate_hz=50.0) as studio:
        studio.pictures.led = False
        studio.pictures.add(looker)
        studio.loop.start(0.5)
        studio.loop.wait()
    assert 10 <= len(looker.shots) + studio.pictures.dropped <= 27


def test_a_camera_may_have_other_eyes_than_the_rig_says() -> None:
    wide = World("ecm").cameras()["endoscope"].calibration.resized(320, 180)
    looker = Looker("endoscope")
    with Studio(calibrations={"endoscope": wide}) as studio:
        studio.pictures.add(looker)
        studio.pictures.shoot(studio.world)
        until(lambda: studio.pictures.made == 1)
    assert looker.shots[0].calibration is wide
    assert looker.shots[0].eye("right").shape == (180, 320, 3)


def test_a_picture_is_packed_once_for_all_who_ask() -> None:
    looker = Looker("endoscope")
    with Studio() as studio:
        studio.pictures.add(looker)
        studio.pictures.shoot(studio.world)
        until(lambda: studio.pictures.made == 1)
    (shot,) = looker.shots
    assert shot.packed("left") is shot.packed("left")


@pytest.mark.parametrize("rate", [0.0, -1.0, float("nan"), float("inf")])
def test_a_rate_that_is_none_is_refused(rate: float) -> None:
    with pytest.raises(InputError, match="camera rate"):
        Pictures(Loop(World("psm")), FakeRenderer, rate)


# ------------------------------------------------------------------ packing, two eyes in one


@pytest.mark.parametrize("kind", FORMATS)
def test_a_packed_picture_is_the_picture(kind: str) -> None:
    rows, columns = np.mgrid[0:48, 0:64]
    picture = np.stack([rows * 5, columns * 4, rows + columns], axis=-1).astype(np.uint8)
    packer = Packer(kind)
    for part in (picture, picture[:24], picture):  # a smaller one leaves nothing of the larger
        image = Image.open(io.BytesIO(packer.pack(part)))
        assert image.format == kind.upper()
        error = np.abs(np.asarray(image).astype(int) - part).max()
        assert error <= (0 if kind == "png" else 12)


def test_a_format_that_nobody_packs_is_refused() -> None:
    with pytest.raises(UnknownNameError, match="jpeg, png"):
        Packer("gif")


def test_packing_works_without_files_in_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr("os.memfd_create", raising=False)
    assert Packer().pack(np.zeros((4, 4, 3), np.uint8)).startswith(b"\xff\xd8")


def test_red_glass_sees_the_left_eyes_picture_and_cyan_glass_the_right_ones() -> None:
    left, right = np.full((2, 3, 3), 200, np.uint8), np.full((2, 3, 3), 40, np.uint8)
    found = anaglyph(left, right)
    assert (found[..., 0] == 200).all()
    assert (found[..., 1:] == 40).all()
    assert side_by_side(left, right).shape == (2, 6, 3)


def test_a_picture_that_comes_again_is_packed_once_unless_somebody_can_write_to_it() -> None:
    packer, pictures = Packer(), [np.full((8, 8, 3), k, np.uint8) for k in range(6)]
    for picture in pictures[:5]:
        picture.setflags(write=False)
    first = [packer.pack(picture) for picture in pictures[:4]]
    again = [packer.pack(picture) for picture in pictures[:4]]
    assert all(one is other for one, other in zip(first, again, strict=True))
    packer.pack(pictures[4])
    assert packer.pack(pictures[0]) is not first[0]  # forgotten meanwhile
    before = packer.pack(pictures[5])
    pictures[5][:] = 200
    assert packer.pack(pictures[5]) != before


def test_a_camera_that_can_never_be_drawn_is_told_of_at_once() -> None:
    with Studio(FakeRenderer(refuses=1, refusal=InputError)) as studio:
        studio.pictures.add(Looker("endoscope"))
        studio.pictures.shoot(studio.world)
        until(lambda: bool(studio.pictures.failure))
