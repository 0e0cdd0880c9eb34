"""The endoscope on ROS 2, seen by a program in another process."""

from __future__ import annotations

import pytest

pytest.importorskip("cyclonedds", reason="the extra ros2 is not installed")

from tests.live.fake_renderer import FakeRenderer
from tests.ros.ros2.ros2_side import private_network, program
from trocar.descriptions.cameras import load_camera
from trocar.live import Loop
from trocar.live.images import Pictures
from trocar.live.loop import SERVER_TICK_S
from trocar.ros import Core
from trocar.ros.transports.ros2 import Ros2Transport
from trocar.simulation import World


def test_images_and_what_is_said_of_the_lens_arrive_whole_with_the_same_stamps() -> None:
    scope = load_camera("dvrk_sd_640x480")
    loop = Loop(World("ecm"), tick_s=SERVER_TICK_S)
    pictures = Pictures(loop, FakeRenderer, calibrations={"endoscope": scope})
    core, transport = Core(loop, pictures=pictures), Ros2Transport(private_network())
    core.attach(transport)
    pictures.start()
    core.start()
    loop.start()
    try:
        with program("watch", transport.where) as peer:
            told = peer.tell()
    finally:
        loop.stop()
        core.close()
        pictures.close()
    assert told["sizes"] == [[480, 640, 1920, 921_600]] * len(told["sizes"])
    assert told["frame"] == "endoscope_right_frame"
    assert told["size"] == [480, 640]
    f, baseline = told["p"][0], 5.06e-3
    assert told["p"][3] == pytest.approx(-f * baseline)
    both = {tuple(s) for s in told["images"]} & {tuple(s) for s in told["infos"]}
    assert len(both) >= 5
