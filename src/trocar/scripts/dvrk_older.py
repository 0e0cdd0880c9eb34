"""Calls of dVRK 1.x, over those of CRTK.

Source: dvrk_python of dVRK 1.7, arm.py, psm.py and mtm.py: moves return whether they ended, wait
for it (`blocking`), and go along a trajectory (`interpolate`) or straight to the set-point.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np

#: Openings of a jaw that is shut and open. Source: dvrk_python 1.7, psm.py. [rad]
SHUT, OPEN = math.radians(-20.0), math.radians(80.0)
#: {call: part of the arm, "" the arm itself, and reading}
READINGS = {
    "get_current_position": ("", "measured_cp"),
    "get_current_position_local": ("local", "measured_cp"),
    "get_desired_position": ("", "setpoint_cp"),
    "get_desired_position_local": ("local", "setpoint_cp"),
    "get_current_joint_position": ("", "measured_jp"),
    "get_current_joint_velocity": ("", "measured_jv"),
    "get_current_joint_effort": ("", "measured_jf"),
    "get_desired_joint_position": ("", "setpoint_jp"),
    "get_desired_joint_effort": ("", "setpoint_jf"),
    "get_current_wrench_body": ("body", "measured_cf"),
    "get_jacobian_body": ("body", "jacobian"),
    "get_jacobian_spatial": ("spatial", "jacobian"),
}
#: The same of a jaw or gripper, whose readings are single numbers.
END_READINGS = {
    "get_current_jaw_position": ("jaw", "measured_jp"),
    "get_current_jaw_velocity": ("jaw", "measured_jv"),
    "get_current_jaw_effort": ("jaw", "measured_jf"),
    "get_desired_jaw_position": ("jaw", "setpoint_jp"),
    "get_desired_jaw_effort": ("jaw", "setpoint_jf"),
    "get_current_gripper_position": ("gripper", "measured_jp"),
}


def older_call(arm: Any, name: str) -> Callable[..., Any] | None:
    """Return an arm's call of dVRK 1.x by its name, None without one."""
    if name in CALLS:
        return partial(CALLS[name], arm)
    part, reading = READINGS.get(name) or END_READINGS.get(name, ("", ""))
    if not reading or (part and part not in vars(arm)):
        return None
    owner: Any = getattr(arm, part) if part else arm
    read: Any = getattr(owner, reading)
    return partial(_alone, read) if name in END_READINGS else read


def _alone(read: Callable[[], Any]) -> float:
    return float(read()[0])


def _ended(handle: Any, blocking: bool) -> bool:
    return bool(handle.wait()) if blocking else True


def _to_joints(arm: Any, goal: Any, interpolate: bool, blocking: bool) -> bool:
    goal = np.asarray(goal, np.float64).ravel()
    if interpolate:
        return _ended(arm.move_jp(goal), blocking)
    arm.servo_jp(goal)
    return True


def _to_frame(arm: Any, goal: Any, interpolate: bool, blocking: bool) -> bool:
    if interpolate:
        return _ended(arm.move_cp(goal), blocking)
    arm.servo_cp(goal)
    return True


def _move(arm: Any, abs_input: Any, interpolate: bool = True, blocking: bool = True) -> bool:
    """Move to a PyKDL frame, or to a vector or rotation alone."""
    goal = arm.setpoint_cp()
    if hasattr(abs_input, "M"):
        goal = abs_input
    elif hasattr(abs_input, "GetQuaternion"):
        goal.M = abs_input
    else:
        goal.p = abs_input
    return _to_frame(arm, goal, interpolate, blocking)


def _dmove(arm: Any, delta_input: Any, interpolate: bool = True, blocking: bool = True) -> bool:
    """Move by a PyKDL vector, rotation or frame, in axes of the reference frame."""
    goal = arm.setpoint_cp()
    if hasattr(delta_input, "M"):
        goal = delta_input * goal
    elif hasattr(delta_input, "GetQuaternion"):
        goal.M, goal.p = delta_input * goal.M, delta_input * goal.p
    else:
        goal.p = goal.p + delta_input
    return _to_frame(arm, goal, interpolate, blocking)


def _move_joint(arm: Any, abs_pos: Any, interpolate: bool = True, blocking: bool = True) -> bool:
    return _to_joints(arm, abs_pos, interpolate, blocking)


def _dmove_joint(arm: Any, delta_pos: Any, interpolate: bool = True, blocking: bool = True) -> bool:
    goal = arm.setpoint_jp() + np.asarray(delta_pos, np.float64).ravel()
    return _to_joints(arm, goal, interpolate, blocking)


def _move_some(
    arm: Any, abs_pos: Any, indices: Any, interpolate: bool = True, blocking: bool = True
) -> bool:
    goal = np.array(arm.setpoint_jp())
    goal[np.atleast_1d(indices)] = abs_pos
    return _to_joints(arm, goal, interpolate, blocking)


def _dmove_some(
    arm: Any, delta_pos: Any, indices: Any, interpolate: bool = True, blocking: bool = True
) -> bool:
    goal = np.array(arm.setpoint_jp())
    goal[np.atleast_1d(indices)] += delta_pos
    return _to_joints(arm, goal, interpolate, blocking)


def _move_jaw(arm: Any, angle: float, interpolate: bool = True, blocking: bool = True) -> bool:
    return _to_joints(arm.jaw, [angle], interpolate, blocking)


def _close_jaw(arm: Any, interpolate: bool = True, blocking: bool = True) -> bool:
    return _move_jaw(arm, SHUT, interpolate, blocking)


def _open_jaw(arm: Any, interpolate: bool = True, blocking: bool = True) -> bool:
    return _move_jaw(arm, OPEN, interpolate, blocking)


def _insert(arm: Any, depth: float, interpolate: bool = True, blocking: bool = True) -> bool:
    return _move_some(arm, depth, 2, interpolate, blocking)


def _insert_by(arm: Any, depth: float, interpolate: bool = True, blocking: bool = True) -> bool:
    return _dmove_some(arm, depth, 2, interpolate, blocking)


def _set_effort(arm: Any, effort: Any) -> bool:
    arm.servo_jf(np.asarray(effort, np.float64).ravel())
    return True


def _set_jaw_effort(arm: Any, effort: float) -> bool:
    return _set_effort(arm.jaw, [effort])


def _push_body(arm: Any, force: Sequence[float]) -> None:
    arm.body.servo_cf(np.array([*force[:3], 0.0, 0.0, 0.0]))


def _push_spatial(arm: Any, force: Sequence[float]) -> None:
    arm.spatial.servo_cf(np.array([*force[:3], 0.0, 0.0, 0.0]))


def _use_absolute_axes(arm: Any, absolute: bool) -> None:
    arm.body_set_cf_orientation_absolute(absolute)


def _compensate_gravity(arm: Any, gravity_compensation: bool) -> None:
    arm.use_gravity_compensation(gravity_compensation)


def _joint_count(arm: Any) -> int:
    return len(arm.setpoint_jp())


def _shutdown(arm: Any) -> None:
    arm.disable()


CALLS: dict[str, Callable[..., Any]] = {
    "move": _move,
    "dmove": _dmove,
    "move_joint": _move_joint,
    "dmove_joint": _dmove_joint,
    "move_joint_one": _move_some,
    "move_joint_some": _move_some,
    "dmove_joint_one": _dmove_some,
    "dmove_joint_some": _dmove_some,
    "move_jaw": _move_jaw,
    "close_jaw": _close_jaw,
    "open_jaw": _open_jaw,
    "insert_tool": _insert,
    "dinsert_tool": _insert_by,
    "set_effort_joint": _set_effort,
    "set_effort_jaw": _set_jaw_effort,
    "set_wrench_body_force": _push_body,
    "set_wrench_spatial_force": _push_spatial,
    "set_wrench_body_orientation_absolute": _use_absolute_axes,
    "set_gravity_compensation": _compensate_gravity,
    "get_joint_number": _joint_count,
    "shutdown": _shutdown,
}
