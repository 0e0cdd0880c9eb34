"""Pictures that are really drawn while a world runs: after an exchange of tools."""

from __future__ import annotations

import time

import numpy as np
import pytest

from trocar.errors import TrocarError
from trocar.live import Command, Loop
from trocar.live.images import Pictures, Shot
from trocar.simulation import World

pytest.importorskip("moderngl", reason="the extra `scope` is not there")
from trocar.rendering import Renderer, Series
from trocar.rendering.context import open_context


@pytest.fixture(scope="module", autouse=True)
def opengl() -> None:
    try:
        open_context().release()
    except TrocarError as problem:
        pytest.skip(str(problem))


class Looker:
    def __init__(self) -> None:
        self.shots: list[Shot] = []

    def wanted(self) -> set[str]:
        return {"endoscope"}

    def take(self, shot: Shot) -> None:
        self.shots.append(shot)


def drawn(loop: Loop, rate_hz: float = 30.0) -> Pictures:
    def shapes() -> tuple:
        return loop.ask(lambda w: (w.snapshot(arms=False).build, w.shapes())).result()

    scope = loop.world.cameras()["endoscope"].calibration.resized(320, 180)
    return Pictures(
        loop, lambda: Series(Renderer(shapes)), rate_hz, calibrations={"endoscope": scope}
    )


def test_pictures_go_on_when_a_tool_is_exchanged_and_show_the_new_one() -> None:
    loop, looker = Loop(World("two_psm_ecm")), Looker()
    pictures = drawn(loop)
    pictures.add(looker)
    pictures.start()
    loop.start()

    def wait_for(build: int) -> Shot:
        end = time.monotonic() + 60
        while not any(shot.frame.build >= build for shot in looker.shots[-3:]):
            assert time.monotonic() < end, pictures.failure
            time.sleep(0.02)
        return looker.shots[-1]

    before = wait_for(1)
    for arm in ("PSM1", "PSM2"):
        loop.post(Command(arm, "set_tool_type", {"name": "none"}))
    after = wait_for(3)
    loop.close()
    pictures.close()
    assert not pictures.failure
    mean = [shot.eye("left").astype(float) for shot in (before, after)]
    assert np.abs(mean[0] - mean[1]).max() > 20


def test_the_motion_is_the_same_to_the_last_bit_whether_somebody_looks() -> None:
    def moved(look: bool) -> np.ndarray:
        world = World("two_psm_ecm")
        # at full speed it would be over before a picture is drawn
        loop = Loop(world, tick_s=0.005, speed="realtime" if look else "max")
        pictures, looker = drawn(loop, 200.0), Looker()
        if look:
            pictures.add(looker)
            pictures.start()
        loop.post(Command("ECM", "move_jp", {"q": (0.2, 0.1, 0.12, 0.3)}))
        loop.start(2.0)
        loop.wait()
        pictures.close()
        assert bool(looker.shots) == look
        return world.snapshot().positions

    assert (moved(True) == moved(False)).all()
