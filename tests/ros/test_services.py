"""Services answer as the arm does."""

from __future__ import annotations

import numpy as np
import pytest

from tests.ros.asking import HOME, joints, quaternion, state, xyz
from tests.ros.served import Served
from trocar.errors import InputError
from trocar.kinematics.links import link_pose
from trocar.ros.message_fields import pose

Q = [0.1, -0.1, 0.15, 0.3, 0.2, -0.2]


@pytest.fixture(scope="module")
def served() -> Served:
    return Served("two_psm_ecm", wanted=())


def test_the_pose_of_all_joints_is_the_tips(served):
    arm = served.world.arm("PSM1")
    answer = served.core.call("PSM1/forward_kinematics", {"jp": Q})
    assert answer["result"]
    np.testing.assert_allclose(pose(answer, "cp"), arm.forward_kinematics(Q).matrix, atol=1e-12)
    base = arm.local.base_frame()[0]
    assert np.abs(base - np.eye(4)).max() > 0.01  # else local and not would be the same
    local = served.core.call("PSM1/local/forward_kinematics", {"jp": np.array(Q)})
    np.testing.assert_allclose(base @ pose(local, "cp"), pose(answer, "cp"), atol=1e-12)


@pytest.mark.parametrize("count", range(6))
def test_the_length_of_the_vector_picks_the_link(served, count):
    arm = served.world.arm("PSM1")
    answer = served.core.call("PSM1/local/forward_kinematics", {"jp": Q[:count]})
    wanted = link_pose(arm.description.mechanism, arm.description.inverse_kinematics, Q[:count])
    np.testing.assert_allclose(pose(answer, "cp"), wanted, atol=1e-12)


def test_inverse_kinematics_in_the_arms_own_frame_gives_the_joints_back(served):
    """Forward kinematics is in the frame of measured_cp.

    Source: mtsIntuitiveResearchKitArm.cpp:2337, :2353, 9e535e6.
    """
    there = served.core.call("PSM1/local/forward_kinematics", {"jp": Q})["cp"]
    for seed in (Q, HOME):
        answer = served.core.call("PSM1/inverse_kinematics", {"cp": there, "jp": seed})
        assert answer["result"]
        np.testing.assert_allclose(answer["jp"], Q, atol=1e-9)


@pytest.mark.parametrize(
    ("service", "request_"),
    [
        ("forward_kinematics", {"jp": [0.0] * 7}),
        ("forward_kinematics", {"jp": [float("nan")]}),
        ("forward_kinematics", {}),
        ("local/forward_kinematics", {"jp": "abc"}),
        (
            "inverse_kinematics",
            {"cp": {"position": xyz(0.0, 0.0, 0.0005), "orientation": quaternion()}, "jp": HOME},
        ),
        (
            "inverse_kinematics",
            {"cp": {"position": xyz(0.0, 0.0, 0.0), "orientation": quaternion(w=0.0)}, "jp": HOME},
        ),
    ],
)
def test_what_has_no_answer_says_why(served, service, request_):
    answer = served.core.call(f"PSM1/{service}", request_)
    assert not answer["result"]
    assert answer["message"]


@pytest.mark.parametrize("count", [0, 5, 7])
def test_inverse_kinematics_needs_as_many_joints_as_the_arm_has(served, count):
    """Source: mtsIntuitiveResearchKitArm.cpp:2330-2333, 9e535e6."""
    there = served.core.call("PSM1/local/forward_kinematics", {"jp": Q})["cp"]
    answer = served.core.call("PSM1/inverse_kinematics", {"cp": there, "jp": [0.1] * count})
    assert not answer["result"]
    assert answer["message"] == "incorrect number of joints"


def test_the_operating_state_has_a_stamp(served):
    answer = served.core.call("ECM/operating_state", {})["operating_state"]
    assert (answer["state"], answer["is_homed"], answer["is_busy"]) == ("ENABLED", True, False)
    assert answer["header"]["stamp"] > (0, 0)


def test_an_arm_that_commands_wait_for_is_busy():
    served = Served(wanted=(), world={"homed": False})
    served.world.set_state("PSM1", np.array([0.4, *Q[1:], 0.0]))
    served.core.receive("PSM1/state_command", state("enable"))
    served.core.receive("PSM1/state_command", state("home"))
    served.core.receive("PSM1/move_jp", joints(*HOME))
    served.run(0.1)
    assert served.core.call("PSM1/operating_state", {})["operating_state"]["is_busy"]


def test_the_version_is_crtks(served):
    assert served.core.call("PSM1/crtk_version", {}) == {"success": True, "message": "1.1.0"}


def test_actuators_turn_joints_by_the_tools_coupling(served):
    # Source: SAW share/tool/LARGE_NEEDLE_DRIVER_400006.json.
    answer = served.core.call("PSM1/actuator_to_joint_position", {"input": [0.1] * 7})
    np.testing.assert_allclose(
        answer["output"],
        [0.1, 0.1, 0.1, -0.15632, 0.10186, 0.1 * (2 * 0.6089 - 0.8306), 0.0],
        atol=1e-12,
    )
    with pytest.raises(InputError, match="allowed: 7 actuators"):
        served.core.call("PSM1/actuator_to_joint_position", {"input": [0.1]})


def test_actuators_of_a_master_hang_on_each_other():
    served = Served("mtm", wanted=())
    answer = served.core.call(
        "MTML/actuator_to_joint_position", {"input": [0.0, 0.1, 0.3] + [0.0] * 4}
    )
    np.testing.assert_allclose(answer["output"][2:4], [0.2, -0.2 * 0.6697])


def test_a_running_loop_answers_in_time_and_a_strange_question_does_not_stop_it():
    served = Served(wanted=())
    served.loop.start()
    try:
        assert served.core.call("PSM1/forward_kinematics", {"jp": Q})["result"]
        with pytest.raises(InputError, match="allowed: a list of numbers"):
            served.core.call("PSM1/actuator_to_joint_position", {"input": {}})
        with pytest.raises(ZeroDivisionError):
            served.loop.ask(lambda _: 1 / 0).result(5.0)
        assert served.loop.running
    finally:
        served.loop.close()
