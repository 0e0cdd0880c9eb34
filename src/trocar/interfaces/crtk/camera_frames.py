"""Where cameras are in tf: each eye has a frame, x right, y down, z ahead.

An eye at an arm's tip stands still in the arm's frame, and one of the room in the world; both are
told once. Others are told with every picture.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np
from numpy.typing import NDArray

from trocar.cameras.records import bend
from trocar.descriptions.records import RigDescription
from trocar.interfaces.crtk.image_rows import eyes_of, frame_name
from trocar.interfaces.crtk.robot_model import WORLD
from trocar.kinematics.forward import pose
from trocar.kinematics.mechanism import Mechanism
from trocar.simulation.cameras import CameraRecord

Array = NDArray[np.float64]
#: Parent, child, and the child's pose in the parent (4, 4).
Frame = tuple[str, str, Array]


def still_frames(rig: RigDescription, cameras: Mapping[str, CameraRecord]) -> Iterator[Frame]:
    """Return the frames of eyes that stand still in the world or at a tip."""
    for name, record in cameras.items():
        parent = _carrier(rig, record)
        if parent:
            T_parent_camera = _mounted(rig, record)
            yield from _eyes(parent, record, T_parent_camera, name)


def moving_frames(rig: RigDescription, cameras: Mapping[str, CameraRecord]) -> Iterator[Frame]:
    """Return the frames of eyes on other links, in the world."""
    for name, record in cameras.items():
        if not _carrier(rig, record):
            yield from _eyes(WORLD, record, record.T_world_camera, name)


def _carrier(rig: RigDescription, record: CameraRecord) -> str:
    """Return the frame of tf in which a camera stands still, "" where there is none."""
    if not record.arm:
        return WORLD
    mechanism = rig.arm(record.arm).arm.mechanism
    together = _moved_by(mechanism, record.frame) == _moved_by(mechanism, mechanism.tip)
    return record.arm if together else ""


def _moved_by(mechanism: Mechanism, frame: str) -> int:
    """Return the last frame before this one, or it, that moves in its parent."""
    chain = mechanism.chain(frame)
    return next((i for i in reversed(chain) if mechanism.frames[i].motion != "fixed"), chain[0])


def _mounted(rig: RigDescription, record: CameraRecord) -> Array:
    """Return the pose of a camera in the frame of tf that carries it, (4, 4)."""
    described = next(camera for camera in rig.cameras if camera.name == record.name)
    T_frame_camera = described.pose @ bend(record.angle)
    if not record.arm:
        return T_frame_camera
    mechanism = rig.arm(record.arm).arm.mechanism
    still = np.zeros(len(mechanism.joints))
    return pose(mechanism, still, record.frame, mechanism.tip) @ T_frame_camera


def _eyes(parent: str, record: CameraRecord, T_parent_camera: Array, name: str) -> Iterator[Frame]:
    for eye, mount in zip(eyes_of(record.kind), record.calibration.mounts, strict=True):
        yield parent, frame_name(name, eye), T_parent_camera @ mount
