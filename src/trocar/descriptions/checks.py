"""What must hold across the blocks of an arm's file."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from trocar.descriptions.records import ArmDescription
from trocar.errors import DescriptionError

#: Ratios in a file are decimal numbers of about sixteen digits.
INVERSE_TOLERANCE = 1e-9


def check_arm(arm: ArmDescription) -> None:
    """Reject names that nobody has, gains that are missing, and contradictions.

    Raises:
        DescriptionError: naming file, key, what was got and what is allowed
    """
    joints, frames = arm.mechanism.joint_names, tuple(arm.mechanism.frame_index)
    for name in joints:
        if joints.count(name) > 1:
            raise DescriptionError(arm.file, "joint", f"got {name!r} a second time")
    for joint in arm.joints[:-1]:
        if joint.spring is not None:
            raise DescriptionError(
                arm.file, f"joint {joint.name}.spring", "allowed: on the last joint only"
            )
    for model, entries in arm.friction.items():
        for name in entries:
            check_name(arm.file, f"friction.{model}", name, dict.fromkeys((*joints, *frames)))
    for name in arm.rotor:
        check_name(arm.file, "rotor", name, frames)
    for preset in arm.control.values():
        for name in preset.pid:
            check_name(arm.file, f"control.{preset.name}.pid", name, joints)
        lacking = [name for name in joints if name not in preset.pid]
        if lacking:
            raise DescriptionError(
                arm.file, f"control.{preset.name}.pid", f"has no gains for {', '.join(lacking)}"
            )
    _check_poses(arm)
    _check_drives(arm)


def check_name(file: str, key: str, name: str, known: Iterable[str]) -> None:
    """Reject a name that is not known.

    Raises:
        DescriptionError: with the known names
    """
    known = tuple(known)
    if name not in known:
        raise DescriptionError(file, key, f"got {name!r}; allowed: {', '.join(known)}")


def _check_poses(arm: ArmDescription) -> None:
    lower, upper = arm.mechanism.lower, arm.mechanism.upper
    for name, q in arm.poses.items():
        if (q < lower).any() or (q > upper).any():
            raise DescriptionError(
                arm.file,
                f"pose {name}",
                f"got {q.tolist()}; allowed: {lower.tolist()} to {upper.tolist()}",
            )


def _check_drives(arm: ArmDescription) -> None:
    """Reject drives and couplings that are not each other's inverse."""
    mechanism = arm.mechanism
    for row, joint in enumerate(mechanism.joints):
        moved = sum(w * mechanism.ratios[mechanism.frame_index[f]] for f, w in joint.drive)
        if np.abs(moved - np.eye(len(mechanism.joints))[row]).max() > INVERSE_TOLERANCE:
            frame, weight = joint.drive[0]
            raise DescriptionError(
                arm.file,
                f"joint {joint.name}.drive",
                f"got {frame} = {weight:g}, but {frame} moves by"
                f" {dict(mechanism.frame(frame).couplings)}; allowed: the inverse",
            )
