"""Arms with the rotation of their bases in the world, which gives the direction of gravity."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions import ArmDescription, RigDescription, load_arm, load_rig
from trocar.descriptions.mounting import rig_with_tool
from trocar.descriptions.rig_frames import Places
from trocar.errors import InputError
from trocar.geometry.rotations import matrix_from_rpy

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class StandingArm:
    """An arm and the rotation of its base.

    Attributes:
        arm: the arm with its tool
        turn: rotation of its reference frame (the base of `measured_cp`) in the world, (3, 3)
        name: of the arm in its rig, "" without one
    """

    arm: ArmDescription
    turn: Array
    name: str = ""

    @property
    def up(self) -> Array:
        """Direction against gravity in the arm's reference frame, (3,)."""
        return self.turn[2].copy()


def standing_arm(
    arm: str | Path | None = "psm",
    tool: str | Path | None = None,
    rig: str | Path | RigDescription | None = None,
    base_rpy: Sequence[float] | None = None,
) -> StandingArm:
    """Load an arm, alone or as a rig has it.

    Args:
        arm: a built-in arm or the path of a description; with a rig, the arm's name in it, None for
            its only arm that is no setup joints
        tool: the mounted tool; None: the description's or the rig's
        rig: where the arm stands, setup joints at the rig's pose "start"; None: nowhere
        base_rpy: rotation of the arm's reference frame in the world about its fixed axes x, y, z,
            (3,) [rad]; None: as the rig has it, upright without one

    Raises:
        InputError: a rig and a rotation, angles that are not finite, or a rig of several arms
        UnknownNameError, DescriptionError: the arm, the tool or the rig
    """
    if rig is None:
        return StandingArm(load_arm(arm or "psm", tool), _turn(base_rpy))
    if base_rpy is not None:
        raise InputError("base_rpy: got a rotation and a rig; allowed: one of them")
    found = rig if isinstance(rig, RigDescription) else load_rig(rig)
    names = [one.name for one in found.arms if one.arm.type != "SUJ"]
    if arm is None and len(names) != 1:
        raise InputError(
            f"rig {found.name}: has {len(names)} arms; allowed: the name of one (--arm) of"
            f" {', '.join(names)}"
        )
    name = names[0] if arm is None else str(arm)
    found = found if tool is None else rig_with_tool(found, name, tool)
    described = found.arm(name).arm
    start = found.poses["start"]
    return StandingArm(
        described, Places(found, lambda one: start[one]).reference_pose(name)[:3, :3], name
    )


def _turn(base_rpy: Sequence[float] | None) -> Array:
    """Return the rotation of three angles."""
    if base_rpy is None:
        return np.eye(3)
    angles = np.asarray(base_rpy, dtype=np.float64)
    if angles.shape != (3,) or not np.isfinite(angles).all():
        raise InputError(f"base_rpy: got {angles.tolist()}; allowed: three finite angles")
    return matrix_from_rpy(*angles)
