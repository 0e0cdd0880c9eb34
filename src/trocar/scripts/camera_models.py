"""Pixels and rays of camera infos, with the names of image_geometry.

Source of names and behaviour: the public documentation of image_geometry (ROS 1 Noetic, ROS 2
Humble and Kilted, which writes the same names with underscores).
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from trocar.cameras.lens import distort, pixels_from_plane, plane_from_pixels, undistort

Array = NDArray[np.float64]
T = TypeVar("T", bound=type)


def with_underscores(kind: T) -> T:
    """Give each method its name with underscores, too: project_pixel_to_3d_ray."""
    for name, method in list(vars(kind).items()):
        if not name.startswith("_") and name != name.lower():
            spelled = re.sub(r"(?<=[a-z])(?=[A-Z3])|(?<=3d)(?=[A-Z])", "_", name).lower()
            setattr(kind, "get_tf_frame" if spelled == "tf_frame" else spelled, method)
    return kind


@with_underscores
class PinholeCameraModel:
    """A camera, of a sensor_msgs/CameraInfo; pixels are of the rectified image but where said."""

    def __init__(self) -> None:
        self.K: Array | None = None
        self.D: Array | None = None
        self.R: Array | None = None
        self.P: Array | None = None
        self.full_K: Array | None = None
        self.full_P: Array | None = None
        self.width: int | None = None
        self.height: int | None = None
        self.binning_x: int | None = None
        self.binning_y: int | None = None
        self.raw_roi: Any = None
        self.tf_frame: str | None = None
        self.stamp: Any = None

    def fromCameraInfo(self, msg: Any) -> None:
        """Take over a camera info, of ROS 1 or 2."""
        fields = [getattr(msg, name, None) for name in "KDRP"]
        if fields[0] is None:
            fields = [getattr(msg, name) for name in "kdrp"]
        K, D, R, P = (np.array(field, np.float64) for field in fields)
        self.full_K, self.full_P = K.reshape(3, 3), P.reshape(3, 4)
        self.D, self.R = D, R.reshape(3, 3)  # pyright: ignore[reportConstantRedefinition]
        self.width, self.height = msg.width, msg.height
        self.binning_x, self.binning_y = max(1, msg.binning_x), max(1, msg.binning_y)
        self.raw_roi, self.stamp = msg.roi, msg.header.stamp
        self.tf_frame = msg.header.frame_id
        cut = np.array([[1.0, 0.0, -msg.roi.x_offset], [0.0, 1.0, -msg.roi.y_offset], [0, 0, 1]])
        cut = np.diag([1.0 / self.binning_x, 1.0 / self.binning_y, 1.0]) @ cut
        own = np.column_stack([cut @ self.full_P[:, :3], self.full_P[:, 3]])
        own[:2, 3] /= self.binning_x, self.binning_y
        self.K, self.P = cut @ self.full_K, own  # pyright: ignore[reportConstantRedefinition]

    def rectifyPoint(self, uv_raw: Sequence[float]) -> Array:
        """Return the rectified pixel of a pixel of the raw image, (2,) [px]."""
        x, y = undistort(plane_from_pixels(np.asarray(uv_raw), _of(self.K)), _of(self.D))
        u, v, w = _of(self.P)[:, :3] @ _of(self.R) @ (x, y, 1.0)
        return np.array([u / w, v / w])

    def rectifyImage(self, raw: Any, rectified: Any) -> Any:
        """Write the rectified image of a raw one, (h, w) or (h, w, channels), and return it."""
        height, width = rectified.shape[:2]
        v, u = np.mgrid[:height, :width].astype(np.float64)
        rays = np.stack([u, v, np.ones_like(u)], axis=-1) @ np.linalg.inv(_of(self.P)[:, :3]).T
        rays = rays @ _of(self.R)  # turned back
        seen = distort(rays[..., :2] / rays[..., 2:], _of(self.D))
        rectified[...] = _between(np.asarray(raw), pixels_from_plane(seen, _of(self.K)))
        return rectified

    def project3dToPixel(self, point: Sequence[float]) -> tuple[float, float]:
        """Return the pixel of a point in the camera's frame; NaN at a depth of 0."""
        x, y, w = (_of(self.P) @ (*point[:3], 1.0)).tolist()
        return (x / w, y / w) if w else (math.nan, math.nan)

    def projectPixelTo3dRay(self, uv: Sequence[float]) -> tuple[float, float, float]:
        """Return the direction from the camera to a pixel, of length 1."""
        x, y = (uv[0] - self.cx()) / self.fx(), (uv[1] - self.cy()) / self.fy()
        norm = math.sqrt(x * x + y * y + 1.0)
        return x / norm, y / norm, 1.0 / norm

    def getDeltaU(self, deltaX: float, Z: float) -> float:
        """Return the pixels across that a length [m] takes at a depth [m]."""
        return self.fx() * deltaX / Z if Z else math.inf

    def getDeltaV(self, deltaY: float, Z: float) -> float:
        """Return the pixels down that a length [m] takes at a depth [m]."""
        return self.fy() * deltaY / Z if Z else math.inf

    def getDeltaX(self, deltaU: float, Z: float) -> float:
        """Return the length [m] of pixels across at a depth [m]."""
        return Z * deltaU / self.fx()

    def getDeltaY(self, deltaV: float, Z: float) -> float:
        """Return the length [m] of pixels down at a depth [m]."""
        return Z * deltaV / self.fy()

    def fullResolution(self) -> tuple[int | None, int | None]:
        """Return width and height of the whole image [px]."""
        return self.width, self.height

    def intrinsicMatrix(self) -> Array:
        """Return K, (3, 3) [px]."""
        return _of(self.K).copy()

    def distortionCoeffs(self) -> Array:
        """Return the distortion, (n, 1)."""
        return _of(self.D).reshape(-1, 1).copy()

    def rotationMatrix(self) -> Array:
        """Return R, (3, 3)."""
        return _of(self.R).copy()

    def projectionMatrix(self) -> Array:
        """Return P, (3, 4) [px]."""
        return _of(self.P).copy()

    def fullIntrinsicMatrix(self) -> Array:
        """Return K of the whole image, (3, 3) [px]."""
        return _of(self.full_K).copy()

    def fullProjectionMatrix(self) -> Array:
        """Return P of the whole image, (3, 4) [px]."""
        return _of(self.full_P).copy()

    def cx(self) -> float:
        """Return the x of the principal point [px]."""
        return float(_of(self.P)[0, 2])

    def cy(self) -> float:
        """Return the y of the principal point [px]."""
        return float(_of(self.P)[1, 2])

    def fx(self) -> float:
        """Return the focal length across [px]."""
        return float(_of(self.P)[0, 0])

    def fy(self) -> float:
        """Return the focal length down [px]."""
        return float(_of(self.P)[1, 1])

    def Tx(self) -> float:
        """Return -fx times the eye's distance from the left one [px m]."""
        return float(_of(self.P)[0, 3])

    def Ty(self) -> float:
        """Return -fy times the eye's distance from the left one [px m]."""
        return float(_of(self.P)[1, 3])

    def fovX(self) -> float:
        """Return the field of view across [rad]."""
        return 2.0 * math.atan((self.width or 0) / (2.0 * self.fx()))

    def fovY(self) -> float:
        """Return the field of view down [rad]."""
        return 2.0 * math.atan((self.height or 0) / (2.0 * self.fy()))

    def tfFrame(self) -> str | None:
        """Return the frame of the points."""
        return self.tf_frame


@with_underscores
class StereoCameraModel:
    """Two eyes whose rectified rows are the same."""

    def __init__(self) -> None:
        self.left, self.right = PinholeCameraModel(), PinholeCameraModel()

    def fromCameraInfo(self, left_msg: Any, right_msg: Any) -> None:
        """Take over the camera infos of both eyes."""
        self.left.fromCameraInfo(left_msg)
        self.right.fromCameraInfo(right_msg)

    def tfFrame(self) -> str | None:
        """Return the frame of the points, the left eye's."""
        return self.left.tf_frame

    def project3dToPixel(
        self, point: Sequence[float]
    ) -> tuple[tuple[float, float], tuple[float, float]]:
        """Return the pixels of a point in the left and right image."""
        return self.left.project3dToPixel(point), self.right.project3dToPixel(point)

    def projectPixelTo3d(
        self, left_uv: Sequence[float], disparity: float
    ) -> tuple[float, float, float]:
        """Return the point of a left pixel with a disparity [px]; 0, 0, 0 without one."""
        seen = disparity - (self.left.cx() - self.right.cx())
        if not seen:
            return 0.0, 0.0, 0.0
        Z = -self.right.Tx() / seen
        x = (left_uv[0] - self.left.cx()) / self.left.fx()
        y = (left_uv[1] - self.left.cy()) / self.left.fy()
        return x * Z, y * Z, Z

    def getZ(self, disparity: float) -> float:
        """Return the depth [m] of a disparity [px]."""
        return -self.right.Tx() / disparity if disparity else math.inf

    def getDisparity(self, Z: float) -> float:
        """Return the disparity [px] of a depth [m]."""
        return -self.right.Tx() / Z if Z else math.inf


def _of(value: Array | None) -> Array:
    """Return a part of the camera info.

    Raises:
        ValueError: no camera info came yet
    """
    if value is None:
        raise ValueError("image_geometry: call fromCameraInfo first")
    return value


def _between(image: NDArray[Any], pixels: Array) -> NDArray[Any]:
    """Return an image at pixels (..., 2), filled in linearly; 0 outside."""
    height, width = image.shape[:2]
    u, v = pixels[..., 0], pixels[..., 1]
    inside = (u > -1.0) & (v > -1.0) & (u < width) & (v < height)
    u, v = np.where(inside, u, 0.0), np.where(inside, v, 0.0)
    left, top = np.floor(u).astype(int), np.floor(v).astype(int)
    padded = np.pad(image, [(1, 1), (1, 1), *[(0, 0)] * (image.ndim - 2)])
    found = np.zeros((*u.shape, *image.shape[2:]))
    for down, right in ((0, 0), (0, 1), (1, 0), (1, 1)):
        across, along = np.abs(1 - right - (u - left)), np.abs(1 - down - (v - top))
        weight = (across * along * inside).reshape(*u.shape, *[1] * (image.ndim - 2))
        found += weight * padded[top + 1 + down, left + 1 + right]
    whole: bool = image.dtype.kind in "iu"
    return np.asarray(np.round(found) if whole else found, image.dtype)
