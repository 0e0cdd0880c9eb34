"""A plan of MTMR and PSM1 under teleoperation, in the full system."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import numpy as np

from benchmarks.genuine.psm import Commands
from benchmarks.genuine.steps import Act, Driven, Parts, Step

#: The component and what it publishes on change.
PAIR = "/MTMR_PSM1"
TOPICS = {
    f"{PAIR}/desired_state": "std_msgs/String", f"{PAIR}/current_state": "std_msgs/String",
    f"{PAIR}/following": "std_msgs/Bool", f"{PAIR}/scale": "std_msgs/Float64",
    f"{PAIR}/rotation_locked": "std_msgs/Bool", f"{PAIR}/translation_locked": "std_msgs/Bool",
    f"{PAIR}/align_mtm": "std_msgs/Bool", "/console/teleop/enabled": "std_msgs/Bool",
    "/console/teleop/scale": "std_msgs/Float64", "/MTMR/setpoint_js": "sensor_msgs/JointState",
    "/MTMR/setpoint_cp": "geometry_msgs/PoseStamped",
}  # fmt: skip
#: Posture of the master away from its singularity. [rad]
MASTER = (-0.1, 0.3, 0.1, 0.0, 0.6, 0.0, 0.0)


def follow(arm: Driven) -> Iterator[Step]:
    """Yield the way into teleoperation, motion, clutch, scale, locks, camera and the way out."""
    c = Commands(arm)

    def pedal(name: str, pressed: int) -> Act:
        return partial(arm.send, f"/console/emulate_{name}", "sensor_msgs/Joy", buttons=[pressed])

    def present() -> None:
        """Press the pedal, and pinch.

        Masters of the robot's own simulation start without (start_gripper_threshold 0), and have
        no topic for the gripper.
        """
        pedal("operator_present", 1)()
        for opening in (0.9, 0.0, 0.9):
            arm.joints("/MTMR/gripper/servo_jp", [opening])
            arm.sleep(0.4)

    def master(name: str, *shift: float) -> Iterator[Step]:
        """Move the tip of the master and record how far the instrument's tip went."""
        pose = (arm.get("/MTMR/setpoint_cp") or {})["pose"]
        at = np.array([pose["position"][k] for k in "xyz"])
        turned = [pose["orientation"][k] for k in "xyzw"]
        before, _ = arm.tip()
        yield Step(name, c.cp("/MTMR/move_cp", at + np.array(shift), turned), 2.5)
        arm.fact(f"{name}: tip", arm.tip()[0] - before)

    yield Step("L0 system/power_on", c.empty("/system/power_on"), 3.0)
    yield Step("L1 system/home", c.empty("/system/home"), 6.0)
    yield c.fix("L1")
    yield c.move("L1 back")
    yield Step("L2 move the master", c.jp("/MTMR/move_jp", MASTER), 2.5)
    yield Step("L3 operator away", pedal("operator_present", 0), 0.6)
    yield Step("L4 teleop/enable", c.bool("/console/teleop/enable", True), 3.0)
    yield Step("L5 operator present", present, 5.0)
    yield from master("L6 master 2 cm x", 0.02, 0.0, 0.0)
    yield from master("L7 master 2 cm y", 0.0, 0.02, 0.0)
    yield Step("L8 clutch", pedal("clutch", 1), 1.0)
    yield from master("L9 master 2 cm back, clutched", -0.02, 0.0, 0.0)
    yield Step("L10 clutch released", pedal("clutch", 0), 2.0)
    yield Step("L11 set_scale 0.4", c.number("/console/teleop/set_scale", 0.4), 1.0)
    yield from master("L12 master 2 cm z at 0.4", 0.0, 0.0, 0.02)
    yield Step("L13 lock_translation", c.bool(f"{PAIR}/lock_translation", True), 1.0)
    yield from master("L14 master 2 cm back, locked", 0.0, 0.0, -0.02)
    yield Step("L15 lock_translation off", c.bool(f"{PAIR}/lock_translation", False), 1.0)
    yield Step("L16 lock_rotation", c.bool(f"{PAIR}/lock_rotation", True), 1.0)
    yield Step("L17 lock_rotation off", c.bool(f"{PAIR}/lock_rotation", False), 1.0)
    yield Step("L18 operator leaves", pedal("operator_present", 0), 1.0)
    yield from master("L19 master 2 cm, no operator", 0.02, 0.0, 0.0)
    yield Step("L20 operator back", present, 3.0)
    yield Step("L21 teleop/disable", c.bool("/console/teleop/enable", False), 1.5)


PARTS: Parts = {"L": follow}
