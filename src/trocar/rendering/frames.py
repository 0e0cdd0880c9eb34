"""What a camera saw at one moment."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.cameras import Calibration, StereoCalibration
from trocar.cameras.lens import project
from trocar.geometry.se3 import inverse, transform_points
from trocar.inputs import check_numbers, check_whole
from trocar.simulation.records import ArmSnapshot

Array = NDArray[np.float64]
Picture = NDArray[np.uint8]
#: Weights of red, green and blue in 256ths. Source: ITU-R BT.601.
GREY = (77, 150, 29)


@dataclass(frozen=True, eq=False)
class StereoFrame:
    """The pictures of both eyes, and what is true of them; arrays are read-only.

    Frames of eyes are optical: x right, y down, z ahead; (0, 0) is the upper left pixel's middle.

    Attributes:
        camera: its name
        left, right: (height, width, 3), red, green, blue; right is None of a camera with one eye
        depth: along z of each eye, (eyes, height, width) float32 [m], inf where nothing is; None
            where it was not requested
        ids: what each pixel shows, (eyes, height, width) int32, 0 where nothing is
        normals: of the surface, in each eye's frame, (eyes, height, width, 3) float32
        names: {id: "PSM1/wrist_yaw", "table", ...} of everything in the scene
        time: of the snapshot [s]
        build: as of a snapshot
        calibration: of the pictures; without distortion where they have none
        T_world_camera: each eye's pose, (eyes, 4, 4)
        exposure: that it was taken with [stops]
        arms: joints of every arm at this time; empty where the snapshot has none
        visible: {object: share of what each eye would see of it alone, (eyes,)}, 0 to 1 and NaN out
            of its picture, of those that were requested
    """

    camera: str
    left: Picture
    right: Picture | None
    depth: NDArray[np.float32] | None
    ids: NDArray[np.int32] | None
    normals: NDArray[np.float32] | None
    names: Mapping[int, str]
    time: float
    build: int
    calibration: Calibration
    T_world_camera: Array
    exposure: float = 0.0
    arms: Mapping[str, ArmSnapshot] = field(default_factory=dict[str, ArmSnapshot])
    visible: Mapping[str, Array] = field(default_factory=dict[str, Array])

    def __repr__(self) -> str:
        """Return camera, time, size and layers in one line."""
        height, width = self.left.shape[:2]
        there = {"depth": self.depth, "ids": self.ids, "normals": self.normals}
        with_ = "".join(f", {name}" for name, values in there.items() if values is not None)
        return (
            f"<StereoFrame of {self.camera} at {self.time:g} s: {len(self.eyes)} x"
            f" {width}x{height}{with_}>"
        )

    @property
    def K(self) -> Array:
        """Of each eye, (eyes, 3, 3) [px]."""
        return np.stack([eye.K for eye in self.calibration.eyes])

    @property
    def distortion(self) -> tuple[Array, ...]:
        """Of each eye: k1, k2, p1, p2, k3 and, where it has them, k4, k5, k6."""
        return tuple(eye.distortion for eye in self.calibration.eyes)

    @property
    def baseline(self) -> float:
        """Distance of the eyes [m], 0 of a camera with one."""
        rig = self.calibration
        return rig.baseline if isinstance(rig, StereoCalibration) else 0.0

    @property
    def eyes(self) -> tuple[Picture, ...]:
        """The picture of each eye, left first."""
        return (self.left,) if self.right is None else (self.left, self.right)

    def project(self, points: ArrayLike, eye: int = 0) -> Array:
        """Return the pixels of points in the world, seen or hidden.

        Args:
            points: in the world, (..., 3) [m]
            eye: 0 left, 1 right

        Returns:
            (..., 2) [px], NaN of those behind the eye; as distorted as the picture
        """
        lens = self.calibration.eyes[check_whole(eye, "eye", 0, len(self.eyes) - 1)]
        there = check_numbers(points, (..., 3), "points [m]")
        ahead = transform_points(inverse(self.T_world_camera[eye]), there)
        return project(ahead, lens.K, lens.distortion)

    @property
    def side_by_side(self) -> Picture:
        """Both pictures in one, (height, 2 width, 3)."""
        return np.concatenate(self.eyes, axis=1)


def side_by_side(left: Picture, right: Picture) -> Picture:
    """Return both pictures in one, (h, 2 w, 3), the left eye's on the left."""
    return np.concatenate([left, right], axis=1)


def anaglyph(left: Picture, right: Picture) -> Picture:
    """Return both in one, (h, w, 3), for glasses that are red on the left and cyan on the right.

    The left eye's picture is grey, which hurts less than colours where tissue is red.
    """
    found = right.copy()
    r, g, b = (left[..., k].astype(np.uint16) for k in range(3))
    found[..., 0] = (GREY[0] * r + GREY[1] * g + GREY[2] * b) >> 8
    return found
