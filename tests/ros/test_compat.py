"""Scripts that were written for dvrk_env's or dvrk-vrep's topics find them, by name and type."""

from __future__ import annotations

import numpy as np
import pytest

from tests.ros.served import Served
from trocar.errors import UnknownNameError

WANTED = ["dvrk/joint/states", "dvrk/PSM1/state_joint_current", "dvrk/PSM1/state_jaw_current"]


def value(number: float) -> dict:
    return {"data": number}


def joints(*position: float) -> dict:
    return {"position": list(position)}


@pytest.fixture(scope="module")
def gazebo() -> Served:
    return Served("psm", compat=["dvrk_env"], wanted=WANTED)


@pytest.fixture
def vrep() -> Served:
    return Served("two_psm_ecm", compat=["dvrk_vrep"], wanted=None)


def joint(served: Served, name: str) -> float:
    states = served.last("dvrk/joint/states")
    return float(states["position"][list(states["name"]).index(f"dvrk/psm1/{name}")])


def test_every_motor_of_dvrk_env_takes_three_commands(gazebo: Served) -> None:
    motors = [
        "yaw_joint", "pitch_back_joint", "main_insertion_joint", "tool_roll_joint",
        "tool_pitch_joint", "tool_yaw_joint", "tool_gripper1_joint", "tool_gripper2_joint",
    ]  # fmt: skip
    for motor in motors:
        for verb in ("SetPosition", "SetPositionTarget", "SetEffort"):
            topic = gazebo.core.topics[f"dvrk/psm1/{motor}/{verb}"]
            assert (topic.direction, topic.type) == ("sub", "std_msgs/Float64")
    assert gazebo.core.topics["dvrk/joint/states"].type == "sensor_msgs/JointState"


def test_a_target_moves_its_joint_and_no_other(gazebo: Served) -> None:
    gazebo.world.reset()
    gazebo.run(0.1)
    before = {name: joint(gazebo, name) for name in ("yaw_joint", "main_insertion_joint")}
    assert gazebo.core.receive("dvrk/psm1/pitch_back_joint/SetPositionTarget", value(0.2))
    gazebo.run(1.5)
    assert joint(gazebo, "pitch_back_joint") == pytest.approx(0.2, abs=5e-3)
    for name, was in before.items():
        assert joint(gazebo, name) == pytest.approx(was, abs=5e-3)


def test_passive_joints_of_the_linkage_turn_with_the_motor(gazebo: Served) -> None:
    for name, ratio in (("pitch_bottom_joint", -1), ("pitch_end_joint", 1)):
        assert joint(gazebo, name) == pytest.approx(ratio * joint(gazebo, "pitch_back_joint"))


def test_a_position_is_set_where_no_loop_holds_the_joint(gazebo: Served) -> None:
    gazebo.world.reset()
    assert gazebo.core.receive("dvrk/psm1/tool_roll_joint/SetPosition", value(0.7))
    gazebo.run(0.05)
    assert joint(gazebo, "tool_roll_joint") == pytest.approx(0.7, abs=1e-3)
    assert gazebo.world.arm("PSM1").joints.mode("roll") == "set"


def test_a_position_inside_a_loop_is_refused(gazebo: Served) -> None:
    assert not gazebo.core.receive("dvrk/psm1/pitch_back_joint/SetPosition", value(0.1))
    gazebo.run(0.01)
    assert "SetPositionTarget" in gazebo.last("PSM1/warning")["data"]


def test_an_effort_acts_for_one_tick(gazebo: Served) -> None:
    gazebo.world.reset()
    arm = gazebo.world.arm("PSM1")
    for _ in range(50):
        assert gazebo.core.receive("dvrk/psm1/yaw_joint/SetEffort", value(0.5))
        gazebo.run(0.001)
        assert arm.setpoint_js().effort[0] == 0.5
    pushed = float(arm.measured_js().velocity[0])
    gazebo.run(0.002)
    assert arm.setpoint_js().effort[0] == 0.0 and arm.joints.mode("yaw") == "effort"
    assert pushed > 0.01
    assert gazebo.core.receive("dvrk/psm1/yaw_joint/SetPositionTarget", value(0.0))
    gazebo.run(0.01)
    assert arm.joints.mode("yaw") == "position"


def test_both_fingers_follow_a_gripper_joint(gazebo: Served) -> None:
    gazebo.world.reset()
    assert gazebo.core.receive("dvrk/psm1/tool_gripper1_joint/SetPositionTarget", value(0.3))
    gazebo.run(1.0)
    assert joint(gazebo, "tool_gripper1_joint") == pytest.approx(0.3, abs=0.02)
    assert joint(gazebo, "tool_gripper2_joint") == joint(gazebo, "tool_gripper1_joint")


@pytest.mark.parametrize("bad", [value(np.nan), value(np.inf), {}])
def test_a_number_that_is_none_is_refused(gazebo: Served, bad: dict) -> None:
    assert not gazebo.core.receive("dvrk/psm1/yaw_joint/SetPositionTarget", bad)


def test_joints_follow_what_dvrk_vrep_desires(vrep: Served) -> None:
    goal = [0.1, -0.1, 0.14, 0.2, 0.1, -0.1]
    for _ in range(20):
        assert vrep.core.receive("dvrk/PSM1/state_joint_desired", joints(*goal))
        vrep.run(0.05)
    said = vrep.last("dvrk/PSM1/state_joint_current")
    np.testing.assert_allclose(said["position"], goal, atol=5e-3)
    assert list(said["name"]) == [] and len(said["velocity"]) == 6
    assert vrep.core.receive("dvrk/PSM2/state_jaw_desired", joints(0.4))
    vrep.run(1.0)
    assert vrep.last("dvrk/PSM2/state_jaw_current")["position"][0] == pytest.approx(0.4, abs=0.03)


def test_the_endoscope_has_four_joints(vrep: Served) -> None:
    vrep.run(0.05)
    assert len(vrep.last("dvrk/ECM/state_joint_current")["position"]) == 4
    assert not vrep.core.receive("dvrk/ECM/state_joint_desired", joints(0.0, 0.0))


def test_states_have_the_names_that_the_scene_gives_them(vrep: Served) -> None:
    vrep.run(0.05)
    assert vrep.last("dvrk/PSM1/current_state")["data"] == "READY"
    assert vrep.last("dvrk/PSM2/robot_state")["data"] == "READY"


def test_set_robot_state_brings_an_arm_home() -> None:
    vrep = Served("psm", compat=["dvrk_vrep"], wanted=None, world={"homed": False})
    vrep.run(0.05)
    assert vrep.last("dvrk/PSM1/current_state")["data"] == "uninitialized"
    assert not vrep.core.receive("dvrk/PSM1/set_robot_state", {"data": "Fly"})
    assert vrep.core.receive("dvrk/PSM1/set_robot_state", {"data": "Home"})
    vrep.run(8.0)
    assert vrep.last("dvrk/PSM1/current_state")["data"] == "READY"


def test_setup_joints_have_fifteen_names() -> None:
    served = Served("full_cart", compat=["dvrk_vrep"], wanted=None)
    served.run(0.01)
    names = list(served.last("dvrk/setup_joint/state_joint_current")["name"])
    assert len(names) == 15 and names[0] == "R_Prismatic_joint" and names[-1] == "C_Revolute_joint4"


def test_an_interface_that_nobody_had_is_refused() -> None:
    with pytest.raises(UnknownNameError, match="dvrk_env, dvrk_vrep"):
        Served("psm", compat=["gazebo"])
