"""A rig of one arm and nothing else."""

from __future__ import annotations

import numpy as np

from trocar.descriptions import ArmDescription, RigDescription
from trocar.descriptions.records import RigArm
from trocar.errors import InputError
from trocar.geometry.se3 import inverse, translation
from trocar.kinematics.forward import pose

#: Where a lone arm's remote centre is, z up [m]. Source: our own choice.
REMOTE_CENTRE = (0.0, 0.0, 0.3)
#: Arms that have a remote centre, and the name that their first one goes by.
NAMES = {"PSM": "PSM1", "ECM": "ECM"}


def lone_arm_rig(arm: ArmDescription) -> RigDescription:
    """Return a rig of one arm alone in the air.

    Raises:
        InputError: the arm is neither a PSM nor an ECM
    """
    if arm.type not in NAMES or "rcm" not in arm.mechanism.frame_index:
        raise InputError(f"{arm.name}: is a {arm.type}; allowed for a replay: a PSM or an ECM")
    mechanism, name = arm.mechanism, NAMES[arm.type]
    rest = np.clip(np.zeros(len(arm.joints)), mechanism.lower, mechanism.upper)
    place = translation(np.array(REMOTE_CENTRE)) @ inverse(pose(mechanism, rest, "rcm", arm.root))
    placed = RigArm(name, arm, "", "", place)
    start = {"start": {name: arm.poses.get("home", rest)}}
    return RigDescription(f"lone {arm.name}", arm.title, arm.source, "", (placed,), (), start)
