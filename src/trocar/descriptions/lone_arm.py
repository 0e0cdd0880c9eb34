"""A rig of one arm and nothing else."""

from __future__ import annotations

import numpy as np

from trocar.descriptions.records import ArmDescription, RigArm, RigDescription
from trocar.geometry.se3 import inverse, translation
from trocar.kinematics.forward import pose

#: Where a lone arm's remote centre is, z up [m]. Source: our own choice.
REMOTE_CENTRE = (0.0, 0.0, 0.3)
#: What the first arm of a type goes by; others go by their own name.
NAMES = {"PSM": "PSM1", "ECM": "ECM"}


def lone_arm_rig(arm: ArmDescription) -> RigDescription:
    """Return a rig of one arm alone in the air, at its pose "home" where it has one.

    The remote centre stands at (0, 0, 0.3) m; of an arm that has none, the root at the origin.
    """
    mechanism = arm.mechanism
    rest = np.clip(np.zeros(len(arm.joints)), mechanism.lower, mechanism.upper)
    place = np.eye(4)
    if "rcm" in mechanism.frame_index:
        place = translation(np.array(REMOTE_CENTRE)) @ inverse(
            pose(mechanism, rest, "rcm", arm.root)
        )
    name = NAMES.get(arm.type, arm.name.upper())
    placed = RigArm(name, arm, "", "", place)
    start = {"start": {name: arm.poses.get("home", rest)}}
    return RigDescription(f"lone {arm.name}", arm.title, arm.source, "", (placed,), (), start)
