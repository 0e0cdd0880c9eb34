"""The table against what is published of the dVRK's own bridge: every topic, by name and type."""

from __future__ import annotations

from pathlib import Path

import pytest

from trocar.descriptions import load_rig
from trocar.ros.console import PEDALS
from trocar.ros.core import service_table, topic_table
from trocar.ros.topic import Topic

# What dVRK 2.4 bridges to ROS. Source: SAW ros/dvrk_robot/src/system_ROS.cpp, CISST
# mts_ros_crtk_bridge_provided.cpp and the arms' code, written down by hand.
GEOMETRY, STD, SENSOR = "geometry_msgs/", "std_msgs/", "sensor_msgs/"
ARM = {
    "pub": {
        SENSOR + "JointState": "measured_js setpoint_js gravity_compensation/setpoint_js",
        GEOMETRY + "PoseStamped": "measured_cp setpoint_cp local/measured_cp local/setpoint_cp",
        GEOMETRY + "TwistStamped": "measured_cv local/measured_cv",
        GEOMETRY + "WrenchStamped": "body/measured_cf spatial/measured_cf",
        STD + "Float64MultiArray": "body/jacobian spatial/jacobian",
        "crtk_msgs/OperatingState": "operating_state",
        STD + "String": "desired_state error warning status",
        STD + "Bool": "goal_reached",
        STD + "Float64": "trajectory_j/ratio trajectory_j/ratio_v trajectory_j/ratio_a",
    },
    "sub": {
        "crtk_msgs/StringStamped": "state_command",
        SENSOR + "JointState": "servo_jp servo_jr move_jp move_jr servo_jf",
        GEOMETRY + "PoseStamped": "servo_cp servo_cr move_cp set_base_frame",
        "crtk_msgs/CartesianState": "servo_cs",
        GEOMETRY + "WrenchStamped": "body/servo_cf spatial/servo_cf",
        "crtk_msgs/CartesianImpedance": "servo_ci",
        STD + "Empty": "hold free",
        STD + "Bool": "use_gravity_compensation body/set_cf_orientation_absolute",
        STD + "Float64": (
            "trajectory_j/set_ratio trajectory_j/set_ratio_v trajectory_j/set_ratio_a"
        ),
    },
}
PSM = {
    "pub": {
        SENSOR + "JointState": "jaw/measured_js jaw/setpoint_js",
        STD + "String": "tool_type",
        STD + "Empty": "tool_type_request",
        SENSOR + "Joy": "arm_clutch IO/arm_clutch IO/SUJ_clutch IO/adapter IO/tool",
    },
    "sub": {
        SENSOR + "JointState": "jaw/servo_jp jaw/move_jp jaw/servo_jf",
        STD + "String": "set_tool_type",
        STD + "Bool": "emulate_adapter_present emulate_tool_present",
    },
}
ECM = {
    "pub": {
        STD + "String": "endoscope_type",
        SENSOR + "Joy": "arm_clutch IO/arm_clutch IO/SUJ_clutch",
    },
    "sub": {STD + "String": "set_endoscope_type"},
}
MTM = {
    "pub": {
        SENSOR + "JointState": "gripper/measured_js",
        STD + "Empty": "gripper/pinch",
        STD + "Bool": "gripper/closed orientation_locked",
    },
    "sub": {GEOMETRY + "Quaternion": "lock_orientation", STD + "Empty": "unlock_orientation"},
}
SUJ = {
    "pub": {
        SENSOR + "JointState": "measured_js",
        GEOMETRY + "PoseStamped": "measured_cp local/measured_cp",
        "crtk_msgs/OperatingState": "operating_state",
    },
    "sub": {"crtk_msgs/StringStamped": "state_command", SENSOR + "JointState": "servo_jp move_jp"},
}
ALONE = {
    "pub": {
        STD + "Float64": "system/volume console/teleop/scale",
        STD + "Bool": "console/teleop/enabled",
        STD + "String": "console/teleop/selected console/teleop/unselected",
        SENSOR + "Joy": (
            "console/operator_present console/clutch console/camera footpedals/clutch"
            " footpedals/camera footpedals/cam_minus footpedals/cam_plus footpedals/bicoag"
            " footpedals/coag footpedals/mono"
        ),
    },
    "sub": {
        STD + "Empty": "system/power_on system/power_off system/home",
        STD + "Float64": "system/set_volume console/teleop/set_scale",
        STD + "Float64MultiArray": "system/beep",
        STD + "String": (
            "system/string_to_speech SUJ/set_reference_arm console/teleop/select"
            " console/teleop/unselect"
        ),
        STD + "Bool": "console/teleop/enable",
        SENSOR + "Joy": (
            "console/emulate_operator_present console/emulate_clutch console/emulate_camera"
        ),
    },
}
TELEOPERATION = {
    "pub": {
        STD + "String": "current_state desired_state",
        STD + "Bool": "following",
        STD + "Float64": "scale",
    },
    "sub": {"crtk_msgs/StringStamped": "state_command", STD + "Float64": "set_scale"},
}
LOCKS = {
    "pub": {
        SENSOR + "Joy": "rotation_locked translation_locked",
        STD + "Bool": "align_mtm",
        GEOMETRY + "QuaternionStamped": "alignment_offset",
        GEOMETRY + "PoseStamped": "MTM/measured_cp PSM/setpoint_cp",
        GEOMETRY + "TwistStamped": "MTM/measured_cv",
    },
    "sub": {
        STD + "Bool": "lock_rotation lock_translation set_align_MTM",
        GEOMETRY + "WrenchStamped": "following/mtm/body/servo_cf",
    },
}
SCOPE = {"pub": {GEOMETRY + "PoseStamped": "ECM/measured_cp MTML/measured_cp MTMR/measured_cp"}}
OUR_OWN_OF_SETUP_JOINTS = (
    "desired_state",
    "goal_reached",
    "error",
    "warning",
    "status",
    "potentiometers/measured_js",
    "lock_brakes",
    "brakes_locked",
)
SERVICES = {
    "forward_kinematics": "crtk_msgs/QueryForwardKinematics",
    "local/forward_kinematics": "crtk_msgs/QueryForwardKinematics",
    "inverse_kinematics": "crtk_msgs/QueryInverseKinematics",
    "operating_state": "crtk_msgs/TriggerOperatingState",
    "crtk_version": "std_srvs/Trigger",
    "actuator_to_joint_position": "cisst_msgs/ConvertFloat64Array",
}
OWNERS = [
    *((f"PSM{k}/", part) for k in (1, 2, 3) for part in (ARM, PSM)),
    *(("ECM/", part) for part in (ARM, ECM)),
    *((f"{name}/", part) for name in ("MTML", "MTMR") for part in (ARM, MTM)),
    *((f"SUJ/{name}/", SUJ) for name in ("PSM1", "PSM2", "PSM3", "ECM")),
    ("", ALONE),
    ("MTMR_PSM1/", TELEOPERATION),
    ("MTMR_PSM1/", LOCKS),
    ("MTML_MTMR_ECM/", TELEOPERATION),
    ("MTML_MTMR_ECM/", SCOPE),
]
TOOLS, VIEW = ("MTMR_PSM1", "MTML_PSM2", "MTML_PSM3"), ("ECM", "MTML", "MTMR")
PUBLISHED = {
    (before + key, kind, direction)
    for before, part in OWNERS
    for direction, rows in part.items()
    for kind, keys in rows.items()
    for key in keys.split()
}


@pytest.fixture(scope="module")
def table() -> dict[str, Topic]:
    return {topic.name: topic for topic in topic_table(load_rig("full_cart_mtm"))}


def test_the_table_misses_nothing_that_the_dvrk_has(table: dict[str, Topic]) -> None:
    ours = {(t.name, t.type, t.direction) for t in table.values()}
    assert not PUBLISHED - ours


#: rospy's own, of every node.
BY_ROSPY = {("rosout", "rosgraph_msgs/Log", "pub")}


def genuine() -> set[tuple[str, str, str]]:
    """Return what the dVRK's own software lists: (name, type, direction)."""
    found: set[tuple[str, str, str]] = set()
    for line in Path(__file__).with_name("genuine_topics.txt").read_text().splitlines():
        if not line.startswith("#"):
            kind, prefixes, names = (part.split() for part in line.split("|"))
            places = [f"{prefix}/" for prefix in prefixes] or [""]
            found |= {(place + name, kind[1], kind[0]) for place in places for name in names}
    return found


def test_every_topic_of_the_dvrks_own_software_is_there_with_its_type(
    table: dict[str, Topic],
) -> None:
    ours, theirs = {(t.name, t.type, t.direction) for t in table.values()}, genuine()
    assert len(theirs) == 477
    assert theirs - ours == BY_ROSPY
    types = {(name, direction): kind for name, kind, direction in theirs}
    same = [t for t in table.values() if (t.name, t.direction) in types]
    assert [t.name for t in same if types[t.name, t.direction] != t.type] == []


def test_topics_that_the_dvrk_does_not_have_are_served(table: dict[str, Topic]) -> None:
    suj = {
        f"SUJ/{name}/{key}"
        for name in ("PSM1", "PSM2", "PSM3", "ECM")
        for key in OUR_OWN_OF_SETUP_JOINTS
    }
    old = {f"console/{verb}" for verb in ("power_on", "power_off", "home")}
    told = {f"system/{what}" for what in ("error", "warning", "status")}
    hands = {"MTML/gripper/servo_jp", "MTMR/gripper/servo_jp"}
    viewers = {"tf", "tf_static", "joint_states", "robot_description", "clock"}
    teleops = {
        f"{name}/{what}"
        for name in ("MTMR_PSM1", "MTML_MTMR_ECM")
        for what in ("error", "warning", "status")
    }
    velocities = {f"{n}/servo_jv" for n in ("PSM1", "PSM2", "PSM3", "ECM", "MTML", "MTMR")}
    pedals = {f"footpedals/emulate_{pedal}" for pedal in PEDALS}
    ours = suj | old | told | hands | viewers | teleops | velocities | pedals
    assert not ours - set(table)


def test_services_are_those_of_the_dvrk() -> None:
    found = {s.name: s.type for s in service_table(load_rig("full_cart_mtm")) if s.arm == "PSM1"}
    assert found == {f"PSM1/{key}": kind for key, kind in SERVICES.items()}


def test_set_points_wait_alone_and_everything_that_counts_waits_in_line(
    table: dict[str, Topic],
) -> None:
    for topic in table.values():
        if topic.direction == "sub":
            verb = topic.key.split("/")[-1]
            newest = verb.startswith("servo_") and verb != "servo_cr"
            assert topic.depth == (1 if newest else 64), topic.name


def test_only_teleoperation_is_left_to_who_serves_it(table: dict[str, Topic]) -> None:
    later = {t.name.split("/")[0] for t in table.values() if t.later}
    assert later == {"console", "stats", "MTMR_PSM1", "MTML_PSM2", "MTML_PSM3", "MTML_MTMR_ECM"}
    assert all("teleop" in t.name for t in table.values() if t.later and t.name[:4] == "cons")


def test_states_that_late_subscribers_need_are_latched(table: dict[str, Topic]) -> None:
    for name in ("operating_state", "tool_type", "trajectory_j/ratio", "desired_state"):
        assert table[f"PSM1/{name}"].latched
    assert not any(t.latched for t in table.values() if t.rate == "state" or t.direction == "sub")


def test_every_row_says_what_it_is(table: dict[str, Topic]) -> None:
    for topic in table.values():
        assert topic.help, topic.name
        assert "/" in topic.type
        assert not topic.name.startswith("/")
