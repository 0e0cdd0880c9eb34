"""What is known of a camera: frozen records, checked as they are made.

Frames of cameras are optical: x right, y down, z ahead. The middle of the upper left pixel is
(0, 0).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.cameras.checks import check_alike, check_baseline, check_intrinsics
from trocar.geometry.rotations import matrix_from_rotation_vector, rotation_vector_from_matrix
from trocar.geometry.se3 import check_transform, inverse, transform

Array = NDArray[np.float64]
CameraKind = Literal["endoscope", "view"]
DistortionModel = Literal["plumb_bob", "rational_polynomial"]


@dataclass(frozen=True, eq=False)
class Intrinsics:
    """One eye: how points ahead of it become pixels.

    Attributes:
        width, height: of the picture [px]
        K: (3, 3) [px]
        distortion: (k1, k2, p1, p2, k3) or with (k4, k5, k6) too, (5,) or (8,); fewer are filled up
            with zeros. See `geometry.lens`

    Raises:
        InputError: a calibration that no camera has; what is wrong is named
    """

    width: int
    height: int
    K: Array
    distortion: Array = field(default_factory=lambda: np.zeros(5))

    def __post_init__(self) -> None:
        K, coefficients = check_intrinsics(self.width, self.height, self.K, self.distortion)
        short = not coefficients[5:].any()
        object.__setattr__(self, "K", _frozen(K))
        object.__setattr__(self, "distortion", _frozen(coefficients[:5] if short else coefficients))

    @property
    def model(self) -> DistortionModel:
        """What ROS calls the distortion."""
        return "plumb_bob" if len(self.distortion) == 5 else "rational_polynomial"

    @property
    def fov(self) -> tuple[float, float]:
        """The angles that the picture spans, across and down, without distortion [rad]."""
        K = self.K
        ends = [(-0.5 - K[i, 2], size - 0.5 - K[i, 2]) for i, size in enumerate(self.size)]
        across, down = (
            float(np.arctan(b / K[i, i]) - np.arctan(a / K[i, i])) for i, (a, b) in enumerate(ends)
        )
        return across, down

    @property
    def size(self) -> tuple[int, int]:
        """Width and height [px]."""
        return self.width, self.height

    def undistorted(self) -> Intrinsics:
        """Return the same eye behind a lens that does not distort, itself where it does not."""
        if not self.distortion.any():
            return self
        return Intrinsics(self.width, self.height, self.K)

    def resized(self, width: int, height: int) -> Intrinsics:
        """Return the same eye with more or fewer pixels; the picture's edges stay."""
        across, down = width / self.width, height / self.height
        K = np.diag([across, down, 1.0]) @ self.K
        K[:2, 2] += (0.5 * across - 0.5, 0.5 * down - 0.5)
        return Intrinsics(width, height, K, self.distortion)


@dataclass(frozen=True, eq=False)
class Rectification:
    """How a picture is turned so that the rows of two eyes agree.

    Attributes:
        R: R_rectified_eye (3, 3)
        P: of the rectified picture (3, 4): [[f, 0, cx, f x], [0, f, cy, 0], [0, 0, 1, 0]] [px];
            x is the left eye's place in this one's frame: 0, or -baseline of the right eye [m]
    """

    R: Array
    P: Array

    def __post_init__(self) -> None:
        object.__setattr__(self, "R", _frozen(self.R))
        object.__setattr__(self, "P", _frozen(self.P))


@dataclass(frozen=True, eq=False)
class MonoCalibration:
    """A camera with one eye.

    Attributes:
        eye: its intrinsics
        name: what it is called, where it has a name
        source: where the numbers are from
        title: for people
    """

    eye: Intrinsics
    name: str = ""
    source: str = ""
    title: str = ""

    @property
    def baseline(self) -> float:
        """0: there is one eye."""
        return 0.0

    @property
    def eyes(self) -> tuple[Intrinsics, ...]:
        """The one."""
        return (self.eye,)

    @property
    def mounts(self) -> tuple[Array, ...]:
        """T_camera_eye: the eye is the camera."""
        return (np.eye(4),)

    def undistorted(self) -> MonoCalibration:
        """Return the same camera behind a lens that does not distort."""
        eye = self.eye.undistorted()
        return self if eye is self.eye else replace(self, eye=eye)

    def resized(self, width: int, height: int) -> MonoCalibration:
        """Return the same camera with more or fewer pixels."""
        return replace(self, eye=self.eye.resized(width, height))


@dataclass(frozen=True, eq=False)
class StereoCalibration:
    """A camera with two eyes.

    Attributes:
        left, right: their intrinsics
        T_left_right: the right eye in the left one's frame, (4, 4) [m]
        name: what it is called, where it has a name
        source: where the numbers are from
        rectification: of left and right, where the calibration's file says it; None: computed, see
            `rectification.rectified`
        title: for people

    Raises:
        InputError: eyes in one place, one metre apart, exchanged, looking apart, or with pictures
            of two sizes
    """

    left: Intrinsics
    right: Intrinsics
    T_left_right: Array
    name: str = ""
    source: str = ""
    rectification: tuple[Rectification, Rectification] | None = None
    title: str = ""

    def __post_init__(self) -> None:
        T = check_transform(self.T_left_right, "T_left_right")
        check_baseline(T)
        check_alike(self.left.size, self.right.size)
        object.__setattr__(self, "T_left_right", _frozen(T))

    @property
    def baseline(self) -> float:
        """The distance of the eyes [m]."""
        return float(np.linalg.norm(self.T_left_right[:3, 3]))

    @property
    def eyes(self) -> tuple[Intrinsics, ...]:
        """Left and right."""
        return self.left, self.right

    @property
    def mounts(self) -> tuple[Array, ...]:
        """T_camera_eye of either: the camera lies midway between them, and looks midway."""
        half = 0.5 * rotation_vector_from_matrix(self.T_left_right[:3, :3])
        T_left_camera = transform(matrix_from_rotation_vector(half), 0.5 * self.T_left_right[:3, 3])
        T_camera_left = inverse(T_left_camera)
        return T_camera_left, T_camera_left @ self.T_left_right

    def undistorted(self) -> StereoCalibration:
        """Return the same camera behind lenses that do not distort."""
        left, right = self.left.undistorted(), self.right.undistorted()
        if left is self.left and right is self.right:
            return self
        return replace(self, left=left, right=right)

    def resized(self, width: int, height: int) -> StereoCalibration:
        """Return the same camera with more or fewer pixels; it is rectified anew."""
        left, right = self.left.resized(width, height), self.right.resized(width, height)
        return replace(self, left=left, right=right, rectification=None)


Calibration = StereoCalibration | MonoCalibration


@dataclass(frozen=True, eq=False)
class CameraDescription:
    """A camera that a rig places.

    Attributes:
        name: what it is asked for by
        kind: "endoscope" (at the end of an arm's scope) or "view"
        arm: name of the arm that carries it, "" for the world
        frame: the frame of that arm that it stands on, "" for the world
        pose: T_frame_camera (4, 4): where it looks from were it not bent
        angle: by which an endoscope is bent: above 0 it looks down, below 0 up [rad]
        calibration: what it sees
        source: where the numbers are from
    """

    name: str
    kind: CameraKind
    arm: str
    frame: str
    pose: Array
    angle: float
    calibration: Calibration
    source: str


def _frozen(array: Array) -> Array:
    copy = np.array(array, dtype=np.float64)
    copy.setflags(write=False)
    return copy
