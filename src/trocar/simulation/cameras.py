"""Poses of the cameras of a rig, as frozen records for renderers."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from trocar.cameras import Calibration, StereoCalibration
from trocar.cameras.records import CameraKind, bend, check_bend
from trocar.descriptions.records import RigDescription
from trocar.errors import InputError, OvertakenError
from trocar.geometry.rotations import matrix_from_quaternion
from trocar.geometry.se3 import transform
from trocar.modeling.joints import JointTable
from trocar.simulation.frames import Frames
from trocar.simulation.records import Snapshot

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class CameraRecord:
    """A camera at a time. Frames of cameras and eyes are optical: x right, y down, z ahead.

    Attributes:
        name: what the rig calls it
        kind: "endoscope" or "view"
        calibration: what its eyes see
        arm, frame: what it is mounted on, "" for the world
        body: index in a snapshot's positions of what carries it
        T_body_mount: where on that body, were it not bent (4, 4)
        angle: by which the scope is bent, above 0 down [rad]
        T_world_body: where that body is (4, 4)
        time: [s]
        build: as of a snapshot
    """

    name: str
    kind: CameraKind
    calibration: Calibration
    arm: str
    frame: str
    body: int
    T_body_mount: Array
    angle: float
    T_world_body: Array
    time: float
    build: int

    @property
    def stereo(self) -> bool:
        """Whether it has two eyes."""
        return isinstance(self.calibration, StereoCalibration)

    @cached_property
    def T_world_camera(self) -> Array:
        """Pose midway between the eyes in the world, (4, 4), read-only."""
        found = self.T_world_body @ self.T_body_mount
        found = found @ bend(self.angle) if self.angle else found
        found.setflags(write=False)
        return found

    @property
    def T_world_eyes(self) -> tuple[Array, ...]:
        """Pose of each eye in the world, left first, (4, 4)."""
        camera = self.T_world_camera
        return tuple(camera @ mount for mount in self.calibration.mounts)

    @property
    def T_world_left(self) -> Array:
        """Pose of the left eye, or the only one, in the world, (4, 4)."""
        return self.T_world_eyes[0]

    @property
    def T_world_right(self) -> Array:
        """Pose of the right eye, or the only one, in the world, (4, 4)."""
        return self.T_world_eyes[-1]

    def at(self, snapshot: Snapshot) -> CameraRecord:
        """Return this camera where and when a snapshot of the same world has it.

        Raises:
            OvertakenError: the rig was compiled anew between them, as when a tool is exchanged
        """
        if snapshot.build != self.build:
            raise OvertakenError(
                f"camera {self.name}: is of build {self.build} of the world, the snapshot of"
                f" {snapshot.build}; ask the world for its cameras again"
            )
        turn = matrix_from_quaternion(snapshot.quaternions[self.body])
        body = transform(turn, snapshot.positions[self.body])
        return replace(self, T_world_body=body, time=snapshot.time)

    def seeing(self, calibration: Calibration) -> CameraRecord:
        """Return this camera with other eyes in the same place.

        Raises:
            InputError: an endoscope with one eye
        """
        if self.kind == "endoscope" and not isinstance(calibration, StereoCalibration):
            raise InputError(f"camera {self.name}: an endoscope has two eyes, not one")
        return replace(self, calibration=calibration)

    def bent(self, angle: float) -> CameraRecord:
        """Return this endoscope as one that is bent: 30 deg down, -30 deg up, or straight [rad].

        Raises:
            InputError: another angle, or a camera without a bend
        """
        if self.kind != "endoscope" and angle != 0.0:
            raise InputError(f"camera {self.name}: is no endoscope; only a scope is bent")
        return replace(self, angle=check_bend(angle))


class Cameras:
    """Finds the cameras of one compiled rig, and changes nothing.

    Args:
        rig: its description
        table: where its arms are in the model
        frames: where bodies are
    """

    def __init__(self, rig: RigDescription, table: JointTable, frames: Frames) -> None:
        self._frames = frames
        self._known: list[CameraRecord] = []
        for camera in rig.cameras:
            body, mount = 0, camera.pose
            if camera.arm:
                index = table.arms[camera.arm]
                body, at = index.carrier(rig.arm(camera.arm), camera.frame)
                mount = at @ camera.pose
            self._known.append(
                CameraRecord(
                    camera.name,
                    camera.kind,
                    camera.calibration,
                    camera.arm,
                    camera.frame,
                    body,
                    mount,
                    camera.angle,
                    np.eye(4),
                    0.0,
                    0,
                )
            )

    def records(self, time: float, build: int) -> dict[str, CameraRecord]:
        """Return {name: where each is now}."""
        if not self._known:
            return {}
        shown = self._frames.bodies()
        found: dict[str, CameraRecord] = {}
        for camera in self._known:
            turn = shown.xmat[camera.body].reshape(3, 3)
            body = transform(turn, shown.xpos[camera.body])
            found[camera.name] = replace(camera, T_world_body=body, time=time, build=build)
        return found
