"""Descriptions and calibrations of cameras: frozen records, checked as they are made.

Frames of cameras are optical: x right, y down, z ahead. The middle of the upper left pixel is
(0, 0).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.cameras.lens import check_distortion, fold_in_view
from trocar.errors import InputError
from trocar.geometry.rotations import (
    matrix_from_rotation_vector,
    rotation_vector_from_matrix,
    rotation_x,
)
from trocar.geometry.se3 import check_transform, inverse, transform

Array = NDArray[np.float64]
CameraKind = Literal["endoscope", "view"]
DistortionModel = Literal["plumb_bob", "rational_polynomial"]

#: The principal point lies in this middle part of the picture; else K is that of another size.
#: Source: our own choice; K of a picture half as wide has it at 1/4, and of calibrations of real
#: endoscopes and webcams that we looked at, all that fitted their pictures lie within.
MIDDLE = (0.3, 0.7)
#: A pixel is not this much wider than high. Source: our own choice; those of
#: television are 1.09, those of one of its half pictures 2.2.
SQUARENESS = 2.5
#: Eyes that are nearer or farther than this are not a scope's [m]. Source: our own choice; known
#: baselines are 1 to 20 mm, a person's 65 mm, and a wrong unit makes them a thousand times that.
NEAREST_EYES, FARTHEST_EYES = 1e-4, 0.2
#: Eyes look at the same things: their axes are no farther apart. Source: our own choice. [rad]
WIDEST_SQUINT = np.deg2rad(45.0)
#: Allowed bends of an endoscope. Source: the dVRK's are straight, or 30 deg up or down. [rad]
BENDS = (-np.pi / 6.0, 0.0, np.pi / 6.0)


@dataclass(frozen=True, eq=False)
class Intrinsics:
    """One eye: projection of points ahead of it to pixels.

    Attributes:
        width, height: of the picture [px]
        K: (3, 3) [px]
        distortion: (k1, k2, p1, p2, k3) or with (k4, k5, k6) too, (5,) or (8,); fewer are filled up
            with zeros. See `lens`

    Raises:
        InputError: a calibration that no camera has; what is wrong is named
    """

    width: int
    height: int
    K: Array
    distortion: Array = field(default_factory=lambda: np.zeros(5))

    def __post_init__(self) -> None:
        K, coefficients = _check_intrinsics(self.width, self.height, self.K, self.distortion)
        short = not coefficients[5:].any()
        object.__setattr__(self, "K", _frozen(K))
        object.__setattr__(self, "distortion", _frozen(coefficients[:5] if short else coefficients))

    @property
    def model(self) -> DistortionModel:
        """Name of the distortion model in ROS."""
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
    """Rotation and projection of one eye's picture that align its rows with the other eye's.

    Attributes:
        R: R_rectified_eye (3, 3)
        P: of the rectified picture (3, 4): `[[f, 0, cx, f x], [0, f, cy, 0], [0, 0, 1, 0]]` in px;
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
        _check_baseline(T)
        _check_alike(self.left.size, self.right.size)
        object.__setattr__(self, "T_left_right", _frozen(T))

    @property
    def baseline(self) -> float:
        """The distance of the eyes [m]."""
        return float(np.linalg.norm(self.T_left_right[:3, 3]))

    @property
    def eyes(self) -> tuple[Intrinsics, ...]:
        """Left and right."""
        return self.left, self.right

    @cached_property
    def mounts(self) -> tuple[Array, ...]:
        """T_camera_eye of either: the camera lies midway between them, and looks midway."""
        half = 0.5 * rotation_vector_from_matrix(self.T_left_right[:3, :3])
        T_left_camera = transform(matrix_from_rotation_vector(half), 0.5 * self.T_left_right[:3, 3])
        T_camera_left = inverse(T_left_camera)
        return _frozen(T_camera_left), _frozen(T_camera_left @ self.T_left_right)

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
        name: by which it is requested
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


def bend(angle: float) -> Array:
    """Return T_straight_bent (4, 4) of a scope that is bent by an angle, above 0 down [rad]."""
    return transform(rotation_x(-angle), np.zeros(3))


def check_bend(angle: float) -> float:
    """Return the allowed bend of a scope that an angle stands for, exactly [rad].

    Raises:
        InputError: no such scope
    """
    for known in BENDS:
        if abs(angle - known) < 1e-9:
            return known
    allowed = ", ".join(f"{np.degrees(known):.0f}" for known in BENDS)
    raise InputError(
        f"angle: got {np.degrees(angle):g} deg; allowed: {allowed} deg (down is above 0)"
    )


def _check_intrinsics(
    width: Any, height: Any, K: ArrayLike, distortion: ArrayLike
) -> tuple[Array, Array]:
    """Return K (3, 3) and eight distortion coefficients of a picture of this size.

    Raises:
        InputError: what is wrong, what was got and what is allowed
    """
    for value, key in ((width, "width"), (height, "height")):
        if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or value < 1:
            raise InputError(f"{key}: got {value!r}; allowed: a whole number of pixels above 0")
    k = _check_matrix(K)
    _check_focal_lengths(k)
    for i, (size, key, name) in enumerate(((width, "width", "cx"), (height, "height", "cy"))):
        share = (k[i, 2] + 0.5) / size
        if not MIDDLE[0] < share < MIDDLE[1]:
            low, high = (edge * size - 0.5 for edge in MIDDLE)
            raise InputError(
                f"K: {name} = {k[i, 2]:g} does not match a {key} of {size}; allowed: {low:.1f} to"
                f" {high:.1f}. Is K that of another size?"
            )
    coefficients = check_distortion(distortion)
    fold = fold_in_view(k, width, height, coefficients)
    if fold is not None:
        raise InputError(
            f"distortion: {_shown(coefficients)} folds the image inside the view, at pixel"
            f" ({fold[0]:.0f}, {fold[1]:.0f}) of {width}x{height}; allowed: one point to one pixel."
            " Calibrate with boards in the corners of the images, or with fewer coefficients"
        )
    return k, coefficients


def _check_baseline(T_left_right: Array) -> None:
    """Reject two eyes that cannot be those of one scope.

    Raises:
        InputError: what is wrong, what was got and what is allowed
    """
    shift = T_left_right[:3, 3]
    baseline = float(np.linalg.norm(shift))
    span = f"{1e3 * NEAREST_EYES:g} to {1e3 * FARTHEST_EYES:g} mm"
    if baseline == 0.0:
        raise InputError(f"baseline: got 0: both eyes are in one place; allowed: {span}")
    if not NEAREST_EYES <= baseline <= FARTHEST_EYES:
        raise InputError(
            f"baseline: got {1e3 * baseline:g} mm; allowed: {span}. Is the calibration in another"
            " unit?"
        )
    if shift[0] <= 0.0:
        raise InputError(
            f"baseline: the right eye is {-1e3 * shift[0]:g} mm left of the left one; allowed: to"
            " its right. Are the eyes exchanged? Then name the other one first"
        )
    if shift[0] < 0.5 * baseline:
        raise InputError(
            f"baseline: the right eye is at {(1e3 * shift).tolist()} mm; allowed: mostly to the"
            " right, along x"
        )
    squint = float(np.arccos(np.clip(T_left_right[2, 2], -1.0, 1.0)))
    if squint > WIDEST_SQUINT:
        raise InputError(
            f"T_left_right: the eyes look {np.degrees(squint):.0f} deg apart; allowed: up to"
            f" {np.degrees(WIDEST_SQUINT):.0f} deg"
        )


def _check_alike(left: tuple[int, int], right: tuple[int, int]) -> None:
    """Reject eyes whose pictures differ in size.

    Raises:
        InputError: both sizes are named
    """
    if left != right:
        one, other = (f"{width}x{height}" for width, height in (left, right))
        raise InputError(
            f"size: the left eye's picture is {one}, the right one's {other}; allowed: the same"
        )


def _check_matrix(K: ArrayLike) -> Array:
    try:
        k = np.array(K, dtype=np.float64)
    except (TypeError, ValueError):
        k = np.array(np.nan)
    if k.shape != (3, 3) or not np.isfinite(k).all():
        given: object = K.tolist() if isinstance(K, np.ndarray) else K
        raise InputError(f"K: got {given!r}; allowed: 3 x 3 finite numbers")
    if k[0, 1] != 0.0 or k[1, 0] != 0.0 or (k[2] != [0.0, 0.0, 1.0]).any():
        raise InputError(
            f"K: got {k.tolist()}; allowed: [[fx, 0, cx], [0, fy, cy], [0, 0, 1]] (no skew)"
        )
    return k


def _check_focal_lengths(k: Array) -> None:
    for value, name in ((k[0, 0], "fx"), (k[1, 1], "fy")):
        if value <= 0.0:
            raise InputError(f"K: focal length {name} = {value:g}; allowed: above 0")
    ratio = float(k[0, 0] / k[1, 1])
    if not 1.0 / SQUARENESS < ratio < SQUARENESS:
        raise InputError(
            f"K: fx = {k[0, 0]:g} and fy = {k[1, 1]:g} differ by {ratio:.3g}; allowed: up to"
            f" {SQUARENESS:g}"
        )


def _shown(coefficients: Array) -> str:
    last = 5 if not coefficients[5:].any() else 8
    return ", ".join(f"{value:g}" for value in coefficients[:last])


def _frozen(array: Array) -> Array:
    copy = np.array(array, dtype=np.float64)
    copy.setflags(write=False)
    return copy
