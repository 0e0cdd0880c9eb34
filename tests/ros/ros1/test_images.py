"""The endoscope on ROS 1: a script with rospy, and ROS's own tools."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing

import pytest

from tests.ros.ros1.robot_os import ROOT, SYSTEM_PYTHON, Master, Simulator, need
from trocar.errors import TrocarError

pytest.importorskip("moderngl", reason="the extra `scope` is not there")
from trocar.rendering.context import open_context

pytestmark = pytest.mark.slow
LOOK = ROOT / "tests" / "clients" / "rospy" / "look.py"


@pytest.fixture(scope="module")
def simulator(master: Master) -> Iterator[Simulator]:
    try:
        open_context().release()
    except TrocarError as problem:
        pytest.skip(str(problem))
    with closing(Simulator(master.env, "--rig", "ecm", "--preset", "dvrk_sd_640x480")) as found:
        yield found


@pytest.mark.usefixtures("simulator")
def test_an_image_its_camera_info_and_tf_have_one_stamp(master: Master) -> None:
    need(SYSTEM_PYTHON)
    said = master.run(SYSTEM_PYTHON, str(LOOK), "/endoscope/right")
    assert "rgb8 640x480 in endoscope_right_frame: baseline 5.06 mm" in said
    assert int(said.rpartition(",")[2].split()[0]) > 20  # something is seen


@pytest.mark.usefixtures("simulator")
def test_ros_own_tools_know_the_lens_of_the_left_eye(master: Master) -> None:
    need("rostopic")
    said = master.run("rostopic", "echo", "-n", "1", "/endoscope/left/camera_info")
    assert 'frame_id: "endoscope_left_frame"' in said
    assert "588.776" in said
