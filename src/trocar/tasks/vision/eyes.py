"""Both eyes of a stereo camera: projection with its derivatives, rays, and checks of images."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.cameras import StereoCalibration
from trocar.cameras.lens import (
    check_distortion,
    distort,
    distort_with_jacobian,
    plane_from_pixels,
    undistort,
)
from trocar.errors import InputError
from trocar.geometry import check_transform, inverse
from trocar.inputs import check_numbers, check_type
from trocar.tasks.vision.images import metal, opencv

Array = NDArray[np.float64]
Picture = NDArray[np.uint8]

#: Least correlation of images that are alike, and least disparity of exchanged ones. Source: our
#: own choice: two pixels of the reduced images. [, px]
ALIKE, SURE_PX = 0.5, 8.0


def checked_pose(value: ArrayLike, name: str) -> Array:
    """Return a pose (4, 4).

    Raises:
        InputError: something else
    """
    return check_transform(check_numbers(value, (4, 4), name), name)


def checked_image(value: object, size: tuple[int, int], name: str) -> Picture:
    """Return an image of a width and height as bytes, (h, w, 3).

    Raises:
        InputError: one of another size or type
    """
    try:
        image = np.asarray(value)
    except ValueError:  # rows of unequal length
        image = np.asarray(None)
    if image.dtype != np.uint8 or image.ndim != 3 or image.shape[2] != 3:
        raise InputError(
            f"{name}: got {image.dtype} {image.shape}; allowed: uint8 (height, width, 3), red,"
            " green, blue"
        )
    if image.shape[1::-1] != size:
        raise InputError(
            f"{name}: got {image.shape[1]}x{image.shape[0]}; allowed: {size[0]}x{size[1]}, the size"
            " of the calibration"
        )
    return image


class Eyes:
    """Points in the left eye's frame and pixels of either eye.

    Args:
        calibration: of both eyes, with lenses

    Attributes:
        calibration: as given
        size: width and height of an image [px]
        K: of each eye, (2, 3, 3) [px]
        T_eye_left: the left eye in the frame of each, (2, 4, 4)
        focal: mean of fx and fy of the left eye [px]
    """

    def __init__(self, calibration: StereoCalibration) -> None:
        self.calibration = check_type(calibration, StereoCalibration, "calibration")
        self.size = calibration.left.size
        self.K = np.stack([eye.K for eye in calibration.eyes])
        self.T_eye_left = np.stack([np.eye(4), inverse(calibration.T_left_right)])
        self.focal = float(0.5 * (self.K[0, 0, 0] + self.K[0, 1, 1]))
        self._distortion = tuple(eye.distortion for eye in calibration.eyes)
        self._lenses = np.stack([check_distortion(c) for c in self._distortion], axis=1)[..., None]

    def project(self, points: ArrayLike, eye: int) -> Array:
        """Return pixels of points (..., 3) in the left eye's frame, (..., 2)."""
        p = np.asarray(points, np.float64) @ self.T_eye_left[eye, :3, :3].T
        p = p + self.T_eye_left[eye, :3, 3]
        depth = np.maximum(p[..., 2:], 1e-6)
        flat = distort(p[..., :2] / depth, self._distortion[eye])
        return flat @ self.K[eye, :2, :2].T + self.K[eye, :2, 2]

    def project_with_jacobian(self, points: Array) -> tuple[Array, Array, Array]:
        """Project points (n, 3) in the left eye's frame into both eyes.

        Returns:
            pixels (2, n, 2), depths (2, n) and d pixel / d point (2, n, 2, 3)
        """
        R = self.T_eye_left[:, :3, :3]
        p = points @ R.transpose(0, 2, 1) + self.T_eye_left[:, None, :3, 3]
        depth = np.maximum(p[..., 2], 1e-6)
        flat = p[..., :2] / depth[..., None]
        by_point = np.zeros((*flat.shape, 3))
        by_point[..., 0, 0] = by_point[..., 1, 1] = 1.0 / depth
        by_point[..., 2] = -flat / depth[..., None]
        scale = self.K[:, None, :2, :2]
        if self._lenses.any():
            flat, turn = distort_with_jacobian(flat, self._lenses)
            scale = scale @ turn
        pixels = flat @ self.K[:, :2, :2].transpose(0, 2, 1) + self.K[:, None, :2, 2]
        return pixels, depth, scale @ by_point @ R[:, None]

    def flat(self, pixels: ArrayLike, eye: int) -> Array:
        """Return the points of the plane z = 1 of an eye that pixels (..., 2) show, (..., 2)."""
        return undistort(plane_from_pixels(pixels, self.K[eye]), self._distortion[eye])

    def triangulate(self, left: ArrayLike, right: ArrayLike) -> Array:
        """Return the points nearest to both rays of pixels (..., 2), left eye's frame, (..., 3).

        Raises:
            InputError: rays that do not meet ahead of the eyes (eyes exchanged?)
        """
        one = self.flat(left, 0)
        other = self.flat(right, 1)
        a = np.concatenate([one, np.ones((*one.shape[:-1], 1))], axis=-1)
        T = inverse(self.T_eye_left[1])
        b = np.concatenate([other, np.ones((*other.shape[:-1], 1))], axis=-1) @ T[:3, :3].T
        base = T[:3, 3]
        aa, bb, ab = (a * a).sum(-1), (b * b).sum(-1), (a * b).sum(-1)
        da, db = a @ base, b @ base
        det = np.maximum(aa * bb - ab * ab, 1e-15)
        s, t = (bb * da - ab * db) / det, (ab * da - aa * db) / det
        if (s <= 0.0).any() or (t <= 0.0).any():
            raise InputError(
                f"pixels {np.asarray(left).tolist()} and {np.asarray(right).tolist()}: the rays do"
                " not meet ahead of the eyes; are the eyes exchanged?"
            )
        return 0.5 * (s[..., None] * a + t[..., None] * b + base)

    def check(self, left: ArrayLike, right: ArrayLike) -> tuple[Picture, Picture]:
        """Return both images as arrays (h, w, 3) of bytes.

        Raises:
            InputError: images of another size or type than the calibration's
        """
        return (
            checked_image(left, self.size, "left image"),
            checked_image(right, self.size, "right image"),
        )

    def check_order(self, left: Picture, right: Picture) -> None:
        """Reject images of exchanged eyes, where they show enough to say so.

        Raises:
            InputError: most of the right image lies to the right of the left one's
        """
        cv2 = opencv()
        one, other = (
            cv2.resize(metal(image) + image[..., 0], None, fx=0.25, fy=0.25,
                       interpolation=cv2.INTER_AREA)
            for image in (left, right)
        )  # fmt: skip
        height, width = one.shape
        most = width // 4
        middle = one[height // 6 : -(height // 6), most : width - most]
        strip = other[height // 6 : -(height // 6)]
        scores = cv2.matchTemplate(strip, middle, cv2.TM_CCOEFF_NORMED)[0]
        best = int(scores.argmax())
        disparity = 4.0 * (most - best)
        if scores[best] > ALIKE and disparity < -SURE_PX:
            raise InputError(
                f"images: the right one is the left one moved by a disparity {disparity:g} px;"
                " allowed: above 0; are the eyes exchanged?"
            )
