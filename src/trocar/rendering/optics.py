"""The optics of a camera: pinholes of its eyes, distortion, and a scope's own light."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from trocar.cameras import Calibration, Intrinsics
from trocar.cameras.lens import distort, plane_from_pixels, undistort, view_bounds
from trocar.errors import InputError
from trocar.geometry.se3 import inverse
from trocar.rendering.frustum import Frustum
from trocar.rendering.lighting import Light, scope_light
from trocar.simulation.cameras import CameraRecord

Array = NDArray[np.float64]

#: Spacing of the points at which a distortion is inverted [px]; between them two Newton steps
#: square the error of interpolation twice. Source: our own choice.
COARSE = 8
#: Resolution of the picture before distortion over that of the distorted one. Source: our own
#: choice: no detail is lost where a lens magnifies by less.
FINER = 1.25
#: Rim of that picture, so that pixels at its edge have neighbours [px].
RIM = 2


@dataclass(frozen=True, eq=False)
class Pinhole:
    """An eye without distortion.

    Attributes:
        width, height: [px]
        fx, fy, cx, cy: as in K [px]
        near, far: range of depth that is seen [m]
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    near: float
    far: float

    @cached_property
    def clip(self) -> tuple[float, float, float, float]:
        """Two factors and two offsets that carry x and y over depth to -1 to 1, rows downwards."""
        return (
            2.0 * self.fx / self.width,
            2.0 * self.fy / self.height,
            (2.0 * self.cx + 1.0) / self.width - 1.0,
            (2.0 * self.cy + 1.0) / self.height - 1.0,
        )

    @cached_property
    def depths(self) -> tuple[float, float]:
        """A factor and an offset that carry depth z to z times -1 (near) to 1 (far)."""
        span = self.far - self.near
        return (self.far + self.near) / span, -2.0 * self.far * self.near / span

    def on(self, width: int, height: int) -> Pinhole:
        """Return the same eye with more pixels to the right and below."""
        return replace(self, width=width, height=height)

    def frustum(self, T_eye_reference: Array) -> Frustum:
        """Return the frustum of the eye at a pose (4, 4)."""
        return Frustum(
            T_eye_reference,
            (-0.5 - self.cx) / self.fx,
            (self.width - 0.5 - self.cx) / self.fx,
            (-0.5 - self.cy) / self.fy,
            (self.height - 0.5 - self.cy) / self.fy,
            self.near,
            max(self.fx, self.fy),
        )


def pinhole(eye: Intrinsics, near: float, far: float) -> Pinhole:
    """Return an eye as one without distortion."""
    K = eye.K
    fx, fy, cx, cy = (float(K[i, j]) for i, j in ((0, 0), (1, 1), (0, 2), (1, 2)))
    return Pinhole(eye.width, eye.height, fx, fy, cx, cy, near, far)


def wide_pinhole(eye: Intrinsics, near: float, far: float, most: int) -> Pinhole:
    """Return an eye without distortion that sees all that a distorted one sees.

    Args:
        eye: the distorted one
        near, far: [m]
        most: largest width and height [px]
    """
    left, right, top, bottom = view_bounds(eye.K, eye.width, eye.height, eye.distortion)
    fx, fy = FINER * float(eye.K[0, 0]), FINER * float(eye.K[1, 1])
    room = most - 2 * RIM
    fx, fy = min(fx, room / (right - left)), min(fy, room / (bottom - top))
    width = int(np.ceil((right - left) * fx)) + 2 * RIM
    height = int(np.ceil((bottom - top) * fy)) + 2 * RIM
    cx, cy = RIM - 0.5 - left * fx, RIM - 0.5 - top * fy
    return Pinhole(width, height, fx, fy, cx, cy, near, far)


def sources(eye: Intrinsics, wide: Pinhole) -> NDArray[np.float32]:
    """Return the pixel of the wide picture that each pixel of a distorted one shows.

    Returns:
        (height, width, 2) [px]
    """
    v, u = np.meshgrid(np.arange(eye.height), np.arange(eye.width), indexing="ij")
    target = plane_from_pixels(np.stack([u, v], axis=-1), eye.K)
    found = _first_guess(eye)
    right, down = 1e-6 * np.eye(2)
    for _ in range(2):
        at = distort(found, eye.distortion)
        along_x = (distort(found + right, eye.distortion) - at) / 1e-6
        along_y = (distort(found + down, eye.distortion) - at) / 1e-6
        det = along_x[..., 0] * along_y[..., 1] - along_x[..., 1] * along_y[..., 0]
        miss = target - at
        dx = (miss[..., 0] * along_y[..., 1] - miss[..., 1] * along_y[..., 0]) / det
        dy = (miss[..., 1] * along_x[..., 0] - miss[..., 0] * along_x[..., 1]) / det
        found = found + np.stack([dx, dy], axis=-1)
    pixels = found * [wide.fx, wide.fy] + [wide.cx, wide.cy]
    return pixels.astype(np.float32)


def _first_guess(eye: Intrinsics) -> Array:
    """Return undistorted points of the plane z = 1, by interpolation between some pixels."""
    u = np.append(np.arange(0, eye.width - 1, COARSE), eye.width - 1).astype(np.float64)
    v = np.append(np.arange(0, eye.height - 1, COARSE), eye.height - 1).astype(np.float64)
    grid = np.stack(np.meshgrid(u, v), axis=-1)
    known = undistort(plane_from_pixels(grid, eye.K), eye.distortion)
    rows = _between(v, known, np.arange(eye.height))
    across = _between(u, np.swapaxes(rows, 0, 1), np.arange(eye.width))
    return np.ascontiguousarray(np.swapaxes(across, 0, 1))


def _between(knots: Array, values: Array, places: NDArray[np.int64]) -> Array:
    """Interpolate along the first axis."""
    if len(knots) == 1:
        return np.repeat(values, len(places), axis=0)
    after = np.clip(np.searchsorted(knots, places), 1, len(knots) - 1)
    share = ((places - knots[after - 1]) / (knots[after] - knots[after - 1]))[:, None, None]
    return (1.0 - share) * values[after - 1] + share * values[after]


#: Range of depth of scopes and of views [m]. Source: our own choice: without a scope's own tip, and
#: a whole room.
SCOPE_NEAR, SCOPE_FAR = 0.002, 12.0
VIEW_NEAR, VIEW_FAR = 0.02, 40.0


@dataclass(frozen=True, eq=False)
class Eye:
    """One eye: T_eye_reference (4, 4), its lens without distortion, and its frustum."""

    T_eye_reference: Array
    lens: Pinhole
    frustum: Frustum


@dataclass(frozen=True, eq=False)
class Optics:
    """A camera as it is drawn; the reference frame is the camera's, midway between its eyes.

    Attributes:
        eyes: left first
        size: width and height of each eye's picture, distorted or not [px]
        drawn: width and height of each before distortion, larger where there is one [px]
        light: the scope's own; None of a view
        places: pixel of the drawn pictures, which stand above each other, that each pixel shows,
            (eyes height, width, 2) [px]; None without distortion
        shown: calibration of the pictures
    """

    eyes: tuple[Eye, ...]
    size: tuple[int, int]
    drawn: tuple[int, int]
    light: Light | None
    places: NDArray[np.float32] | None
    shown: Calibration

    @cached_property
    def parallel(self) -> bool:
        """Whether a scope's light and both eyes look the same way, from the same depth."""
        return self.light is not None and all(
            np.abs(eye.T_eye_reference[:3, :3] - np.eye(3)).max() < 1e-9
            and abs(eye.T_eye_reference[2, 3] + self.light.at[2]) < 1e-9
            for eye in self.eyes
        )


def optics(record: CameraRecord, distortion: bool, most: int) -> Optics:
    """Return a camera as it is drawn.

    Args:
        record: the camera
        distortion: whether pictures are distorted as the calibration has it
        most: largest width and height of pictures above each other [px]

    Raises:
        InputError: more pixels than the driver allows
    """
    rig, scope = record.calibration, record.kind == "endoscope"
    width, height = rig.eyes[0].size
    if width > most or height * len(rig.eyes) > most:
        raise InputError(
            f"camera {record.name}: {width}x{height} pixels, eyes above each other, are more than"
            f" this graphics driver draws; allowed: {most} wide, {most // len(rig.eyes)} high"
        )
    near, far = (SCOPE_NEAR, SCOPE_FAR) if scope else (VIEW_NEAR, VIEW_FAR)
    bent = distortion and any(eye.distortion.any() for eye in rig.eyes)
    lenses = [
        wide_pinhole(eye, near, far, most // len(rig.eyes)) if bent else pinhole(eye, near, far)
        for eye in rig.eyes
    ]
    drawn = max(lens.width for lens in lenses), max(lens.height for lens in lenses)
    lenses = [lens.on(*drawn) for lens in lenses]
    mounts = [inverse(mount) for mount in rig.mounts]
    eyes = tuple(Eye(T, lens, lens.frustum(T)) for T, lens in zip(mounts, lenses, strict=True))
    places = None
    if bent:
        found = [sources(eye, lens) for eye, lens in zip(rig.eyes, lenses, strict=True)]
        for row, own in enumerate(found):
            own[..., 1] += row * drawn[1]
        places = np.concatenate(found)
    light = scope_light([eye.frustum for eye in eyes], far) if scope else None
    return Optics(eyes, (width, height), drawn, light, places, rig if bent else rig.undistorted())
