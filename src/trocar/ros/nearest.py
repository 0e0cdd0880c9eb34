"""The topic that a client means by a name that no arm has."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from difflib import SequenceMatcher

from trocar.ros.topic import Direction, Topic

#: {name of dVRK 1.x and before below the arm: its name since CRTK}. Source: dvrk-ros 1.7,
#: dvrk_python's arm.py and psm.py; CRTK's names in dVRK 2.0's release notes; those of 2014
#: (cartesian_pose_current and the like) in the fork samkhal/dvrk-ros, dvrk_robot; set_torque_joint
#: in nsujumnong/RBE501_dVRK_Project.
FORMER = {
    "set_position_joint": "servo_jp",
    "set_position_goal_joint": "move_jp",
    "set_position_cartesian": "servo_cp",
    "set_position_goal_cartesian": "move_cp",
    "set_effort_joint": "servo_jf",
    "set_wrench_body": "body/servo_cf",
    "set_wrench_spatial": "spatial/servo_cf",
    "set_wrench_body_orientation_absolute": "body/set_cf_orientation_absolute",
    "set_gravity_compensation": "use_gravity_compensation",
    "set_position_jaw": "jaw/servo_jp",
    "set_position_goal_jaw": "jaw/move_jp",
    "set_effort_jaw": "jaw/servo_jf",
    "set_jaw_position": "jaw/servo_jp",
    "set_robot_state": "state_command",
    "set_desired_state": "state_command",
    "state_joint_current": "measured_js",
    "state_joint_desired": "setpoint_js",
    "state_jaw_current": "jaw/measured_js",
    "state_jaw_desired": "jaw/setpoint_js",
    "position_joint_current": "measured_js",
    "position_joint_desired": "setpoint_js",
    "position_cartesian_current": "measured_cp",
    "position_cartesian_desired": "setpoint_cp",
    "position_cartesian_local_current": "local/measured_cp",
    "position_cartesian_local_desired": "local/setpoint_cp",
    "cartesian_pose_current": "measured_cp",
    "cartesian_pose_command": "servo_cp",
    "joint_position_current": "measured_js",
    "joint_effort_current": "setpoint_js",
    "set_joint_effort": "servo_jf",
    "set_torque_joint": "servo_jf",
    "robot_state_current": "operating_state",
    "gripper_position_current": "gripper/measured_js",
    "twist_body_current": "measured_cv",
    "wrench_body_current": "body/measured_cf",
    "jacobian_body": "body/jacobian",
    "jacobian_spatial": "spatial/jacobian",
    "current_state": "operating_state",
    "robot_state": "operating_state",
}
#: Names of teleoperations, whose topics are not those of an arm.
PAIR = re.compile(r"(?i)mtm[lr]?\d*_(psm|ecm)\d*")
#: Least similarity of two names, 0 to 1. Source: our own choice.
SIMILAR = 0.7


def nearest_topic(name: str, topics: Mapping[str, Topic], direction: Direction) -> str:
    """Return the served topic that a name without a leading slash stands for, "" without one.

    What a client publishes as an arm does, such as MTMR/trajectory_j/ratio beside a simulated PSM1,
    is another robot's own.

    Args:
        name: that no topic has
        topics: of the simulator, by name
        direction: "pub" of what the client subscribes to, "sub" of what it publishes
    """
    known = [one.name for one in topics.values() if one.direction == direction and not one.later]
    parts = name.split("/")
    for part in filter(PAIR.fullmatch, parts):
        known = [one for one in known if part.upper() in one.upper().split("/")]
    if direction == "sub" and any(
        one.direction == "pub" and one.name.split("/")[1:] == parts[1:] != []
        for one in topics.values()
    ):
        return ""
    for start in range(len(parts)):
        tail = "/".join(parts[start:])
        for former in (tail, _renamed(tail)):
            same = [one for one in known if one.lower() == former.lower()]
            if same:
                return same[0]
    wanted = _renamed(name)[:200]
    for start in range(1, len(parts)):
        tail = "/" + "/".join(wanted.split("/")[start:]).lower()
        ends = [one for one in known if one.lower().endswith(tail)]
        if ends:
            return _closest(wanted, ends, 0.0)
    return _closest(wanted, known, SIMILAR) or (_image(name, known) if direction == "pub" else "")


def _image(name: str, known: Sequence[str]) -> str:
    """Return the image of the eye that a name of an image has, "" without one."""
    words = re.split("[/_]", name.lower())
    if "image" not in words:
        return ""
    end = "image_raw/compressed" if words[-1] == "compressed" else "image_raw"
    ends = [f"/{side}/{end}" for side in ("left", "right") if side in words]
    return next((one for one in known if any(one.endswith(end) for end in ends)), "")


def _closest(name: str, known: Sequence[str], least: float) -> str:
    """Return the first of the most similar names, "" where none is similar enough."""
    matcher = SequenceMatcher()
    matcher.set_seq2(name.lower())
    found = ""
    for one in known:
        matcher.set_seq1(one.lower())
        if matcher.quick_ratio() > least and (ratio := matcher.ratio()) > least:
            found, least = one, ratio
    return found


def _renamed(name: str) -> str:
    before, _, last = name.rpartition("/")
    return f"{before}/{FORMER.get(last, last)}".lstrip("/")


def nobody(name: str, topics: Mapping[str, Topic], direction: Direction) -> str:
    """Return a warning about a topic without another end: "/x: ... (did you mean /y?)".

    Args:
        name, topics, direction: as of `nearest_topic`
    """
    near = nearest_topic(name, topics, direction)
    hint = f" (did you mean /{near}?)" if near else ""
    if name in topics and not topics[name].later:
        does = "subscribes to" if direction == "pub" else "publishes"
        return f"/{name}: the simulator itself {does} this topic{hint}"
    verb = "publishes" if direction == "pub" else "subscribes to"
    return f"/{name}: nothing {verb} this topic{hint}"
