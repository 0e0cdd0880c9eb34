"""How the surgeon sees the slaves: x left, y up, z away from the eyes, as on the stereo display."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from trocar.geometry.rotations import rotation_z
from trocar.geometry.se3 import inverse, transform

if TYPE_CHECKING:
    from trocar.simulation import World

Array = NDArray[np.float64]

#: The surgeon's axes in those of an image (x right, y down): both of the screen's are turned round.
R_IMAGE_VIEW = rotation_z(np.pi)
#: Without an endoscope somebody stands before the robot and looks across it at the table, against
#: the world's y. Source: our own choice, as the surgeon at full_cart_mtm's console does.
R_WORLD_VIEW = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])


def view_in_world(world: World) -> Array:
    """Return where the slaves are looked at from, T_world_view (4, 4).

    Through the rig's endoscope, bent ones included; else along an ECM's scope; else from the room.
    """
    for camera in world.rig.cameras:
        if camera.kind == "endoscope":
            seen = world.cameras()[camera.name].T_world_camera
            return seen @ transform(R_IMAGE_VIEW, np.zeros(3))
    for name, arm in world.arms.items():
        if arm.type == "ECM":
            return world.reference_pose(name) @ arm.local_measured_cp().T
    return transform(R_WORLD_VIEW, np.zeros(3))


def base_in_view(world: World, arm: str) -> Array:
    """Return an arm's own reference frame as the surgeon sees it now, (4, 4)."""
    return inverse(view_in_world(world)) @ world.reference_pose(arm)
