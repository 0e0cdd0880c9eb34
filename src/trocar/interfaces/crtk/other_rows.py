"""The rows that belong to no single arm, in the form of `arm_rows`; names are whole."""

from __future__ import annotations

from trocar.descriptions.records import RigDescription
from trocar.interfaces.crtk.arm_rows import (
    EMPTY,
    FLOAT,
    JOINTS,
    JOY,
    MATRIX,
    STRING,
    Row,
)

SYSTEM: tuple[Row, ...] = (
    ("sub", "system/power_on", EMPTY, "", "give every arm power"),
    ("sub", "system/power_off", EMPTY, "", "take every arm's power"),
    ("sub", "system/home", EMPTY, "", "bring every arm home"),
    ("sub", "system/set_volume", FLOAT, "0 to 1", "of beeps and speech"),
    ("pub latched", "system/volume", FLOAT, "0 to 1", "of beeps and speech"),
    ("sub", "system/beep", MATRIX, "s, Hz, 0 to 1", "duration, frequency, volume"),
    ("sub", "system/string_to_speech", STRING, "", "said, in the log"),
    ("pub", "system/error", STRING, "", "what went wrong and concerns no single arm"),
    ("pub", "system/warning", STRING, "", "what was refused and concerns no single arm"),
    ("pub", "system/status", STRING, "", "what else happened"),
)

PEDALS = ("clutch", "camera", "cam_minus", "cam_plus", "bicoag", "coag")

CONSOLE: tuple[Row, ...] = (
    *(
        ("sub", f"console/{verb}", EMPTY, "", f"as system/{verb}; the name before version 2.4")
        for verb in ("power_on", "power_off", "home")
    ),
    *(
        ("pub latched", f"console/{what}", JOY, "", "0 released, 1 pressed, 2 quick tap")
        for what in ("operator_present", "clutch", "camera")
    ),
    *(
        ("sub", f"console/emulate_{what}", JOY, "", "as if it were pressed or released")
        for what in ("operator_present", "clutch", "camera")
    ),
    *(
        ("pub latched", f"footpedals/{what}", JOY, "", "0 released, 1 pressed, 2 quick tap")
        for what in PEDALS
    ),
)

#: What viewers of ROS ask for.
VIEWERS: tuple[Row, ...] = (
    ("pub tf", "tf", "tf2_msgs/TFMessage", "m, quaternion xyzw", "every frame in its parent"),
    ("pub latched", "tf_static", "tf2_msgs/TFMessage", "m, quaternion xyzw", "what stands still"),
    ("pub state", "joint_states", JOINTS, "rad, m", "every hinge of robot_description"),
    ("pub latched", "robot_description", STRING, "", "the rig as URDF"),
    ("pub clock", "clock", "rosgraph_msgs/Clock", "s", "simulated time, with --clock sim"),
)


def topics_of(rig: RigDescription) -> tuple[Row, ...]:
    """Return the rows of a rig beside those of its arms."""
    rows = VIEWERS + SYSTEM + CONSOLE
    if any(arm.arm.type == "SUJ" for arm in rig.arms):
        says = "arm in whose tip frame the poses of the others on setup joints are: ECM, PSM1, ..."
        rows += (("sub", "SUJ/set_reference_arm", STRING, "", says),)
    return rows
