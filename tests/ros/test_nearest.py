"""Topics that nobody has: which one is meant, and one warning for each."""

from __future__ import annotations

import logging

import pytest

from trocar.live import Loop
from trocar.ros import Core
from trocar.ros.core import UNREAD
from trocar.ros.nearest import FORMER, nearest_topic, nobody
from trocar.ros.topic import Topic
from trocar.simulation import World


@pytest.fixture(scope="module")
def core() -> Core:
    return Core(Loop(World("two_psm_ecm")))


@pytest.fixture(scope="module")
def whole() -> Core:
    return Core(Loop(World("full_cart_mtm")))


@pytest.mark.parametrize(
    ("name", "direction", "meant"),
    [
        ("psm2/move_jp", "sub", "PSM2/move_jp"),
        ("PSM2/move_joints", "sub", "PSM2/move_jp"),
        ("PSM2/jaw/move", "sub", "PSM2/jaw/move_jp"),
        ("lab/robot/PSM1/servo_cp", "sub", "PSM1/servo_cp"),
        ("dvrk/PSM1/set_position_goal_joint", "sub", "PSM1/move_jp"),
        ("dvrk/PSM1/state_jaw_current", "pub", "PSM1/jaw/measured_js"),
        ("dvrk/PSM1/position_cartesian_current", "pub", "PSM1/measured_cp"),
        ("dvrk_psm/cartesian_pose_current", "pub", "PSM1/measured_cp"),
        ("dvrk_psm1/set_joint_effort", "sub", "PSM1/servo_jf"),
        ("dvrk/MTMR_PSM1/set_desired_state", "sub", ""),  # of no arm
        ("MTMR_PSM2/current_state", "pub", ""),
        ("rviz/markers", "sub", ""),
        ("MTMR/trajectory_j/ratio", "sub", ""),  # of a robot beside the simulated one
        ("x" * 5000, "sub", ""),
    ],
)
def test_the_topic_that_is_meant_is_found(core: Core, name: str, direction, meant: str) -> None:
    assert nearest_topic(name, core.topics, direction) == meant


def test_former_names_lead_to_topics_of_an_arm(whole: Core) -> None:
    known = {name.partition("/")[2] for name in whole.topics if name.startswith(("PSM1/", "MTMR/"))}
    assert set(FORMER.values()) <= known


@pytest.mark.parametrize(
    ("name", "meant"),
    [
        ("stereo/left/rectified_downscaled_image", "endoscope/left/image_raw"),
        ("camera_right/image_resized", "endoscope/right/image_raw"),
        ("rig/left/image_flipped/compressed", "endoscope/left/image_raw/compressed"),
        ("stereo/disparity_image", ""),
        ("left/arm/state", ""),
    ],
)
def test_an_image_of_an_eye_has_any_name(name: str, meant: str) -> None:
    topics = {
        one: Topic(one, "sensor_msgs/Image", "pub", "camera")
        for side in ("left", "right")
        for one in (f"endoscope/{side}/image_raw", f"endoscope/{side}/image_raw/compressed")
    }
    assert nearest_topic(name, topics, "pub") == meant
    assert nearest_topic(name, topics, "sub") == ""


def test_every_topic_is_nearest_to_itself(core: Core) -> None:
    for topic in core.topics.values():
        if not topic.later:
            assert nearest_topic(topic.name, core.topics, topic.direction) == topic.name


def test_a_warning_names_the_other_direction(core: Core) -> None:
    assert "the simulator itself publishes" in nobody("PSM1/measured_js", core.topics, "sub")
    assert "nothing subscribes" in nobody("PSM9/measured_js", core.topics, "sub")


def test_a_client_is_told_once_of_each_topic(caplog: pytest.LogCaptureFixture) -> None:
    core = Core(Loop(World("psm")))
    with caplog.at_level(logging.WARNING, "trocar"):
        for _ in range(3):
            assert core.unread(["PSM1/measured_js", "nothing/like/it", "PSM1/move_j"], "lab") == (
                "PSM1/move_jp"
            )
    assert [record.getMessage() for record in caplog.records] == [
        "lab: /PSM1/move_j: nothing subscribes to this topic (did you mean /PSM1/move_jp?)"
    ]


def test_names_without_end_are_not_all_compared(caplog: pytest.LogCaptureFixture) -> None:
    core = Core(Loop(World("psm")))
    with caplog.at_level(logging.WARNING, "trocar"):
        core.unread([f"PSM1/move_{n}" for n in range(2 * UNREAD)], "lab")
    assert len(caplog.records) == UNREAD
