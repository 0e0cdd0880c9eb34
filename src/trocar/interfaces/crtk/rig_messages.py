"""What is published of the rig as a whole: tf, the hinges of its URDF, the clock."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.records import RigDescription
from trocar.interfaces.crtk import say
from trocar.interfaces.crtk.camera_frames import moving_frames, still_frames
from trocar.interfaces.crtk.clock import Stamp
from trocar.interfaces.crtk.publishing import Figure
from trocar.interfaces.crtk.robot_model import WORLD, fixed_frames, hinge_states
from trocar.interfaces.crtk.sample import RigFigures
from trocar.interfaces.crtk.scene import object_poses
from trocar.interfaces.crtk.transport import Message
from trocar.simulation.cameras import CameraRecord

Array = NDArray[np.float64]


def tf(rig: RigFigures, stamp: Stamp) -> Message:
    """Return arms' bases and tips in the frames of their poses, and objects; nothing still."""
    found: dict[str, Message] = {}
    fixed = fixed_frames(rig.sample.rig)

    def add(parent: str, child: str, T: Array) -> None:
        if child not in found and child not in fixed and child != parent:
            found[child] = say.transform_stamped(stamp, parent, child, T)

    for rig_arm in rig.sample.rig.arms:
        arm = rig.arm(rig_arm.name)
        base, frame = arm.base
        if frame == arm.own_frame:
            add(WORLD, frame, arm.reference_in_world)
        add(frame, arm.own_frame, base)
        add(frame, rig_arm.name, arm.measured)
    for name, at in object_poses(rig.sample.scene).items():
        add(WORLD, name, at)
    for parent, name, at in moving_frames(rig.sample.rig, rig.sample.cameras):
        add(parent, name, at)
    return {"transforms": list(found.values())}


def tf_static(
    rig: RigDescription, stamp: Stamp, cameras: Mapping[str, CameraRecord] | None = None
) -> Message:
    """Return the frames that stand still: the roots of what `tf` tells, and eyes."""
    found = [(WORLD, name, at) for name, at in fixed_frames(rig).items()]
    found += still_frames(rig, cameras or {})
    return {"transforms": [say.transform_stamped(stamp, *frame) for frame in found]}


def joint_states(rig: RigFigures, stamp: Stamp) -> Message:
    """Return every hinge of the rig's URDF that follows no other."""
    arms = rig.sample.arms
    names, position, velocity = hinge_states(
        rig.sample.rig,
        {name: arm.q for name, arm in arms.items()},
        {name: arm.qd for name, arm in arms.items()},
    )
    header = {"stamp": stamp, "frame_id": ""}
    return {
        "header": header, "name": names, "position": position, "velocity": velocity, "effort": []
    }  # fmt: skip


def clock(rig: RigFigures, stamp: Stamp) -> Message:  # noqa: ARG001  as every maker
    """Return a rosgraph_msgs/Clock."""
    return {"clock": stamp}


def makers(simulated: bool) -> dict[str, Figure]:
    """Return how to make the messages of the rig; the clock's only where time is simulated."""
    return {"tf": tf, "joint_states": joint_states, **({"clock": clock} if simulated else {})}
