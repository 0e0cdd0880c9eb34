"""The image of a camera at one moment: both eyes, depth, ids, normals, and pictures of them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.cameras import Calibration, StereoCalibration
from trocar.cameras.lens import project
from trocar.errors import InputError, UnknownNameError
from trocar.geometry.se3 import inverse, transform_points
from trocar.inputs import check_numbers, check_whole
from trocar.simulation.records import ArmSnapshot

Array = NDArray[np.float64]
Picture = NDArray[np.uint8]
#: Weights of red, green and blue in 256ths. Source: ITU-R BT.601.
GREY = (77, 150, 29)

EYES = ("both", "left", "right", "anaglyph")
SHOWN = ("colour", "depth", "ids", "normals")
#: Colours of depth, near to far. Source: our own choice: bright near, dark far, and no hue twice.
NEAR_TO_FAR = np.array(
    [
        [255, 247, 214],
        [253, 190, 105],
        [222, 92, 78],
        [150, 50, 135],
        [72, 66, 178],
        [34, 104, 130],
    ],
    dtype=np.float64,
)
#: Brightness of the background.
BACKGROUND = 0
#: Factor that spreads consecutive ids over all hues. Source: D. E. Knuth, The Art of Computer
#: Programming 3, 6.4: multiplicative hashing.
SPREAD = np.uint32(2654435761)
#: Ratio of white in colours of ids. Source: by eye.
PALE = 0.38


@dataclass(frozen=True, eq=False)
class StereoFrame:
    """The pictures of both eyes, with ground truth; arrays are read-only.

    Frames of eyes are optical: x right, y down, z ahead; (0, 0) is the upper left pixel's middle.

    Attributes:
        camera: its name
        left, right: (height, width, 3), red, green, blue; right is None of a camera with one eye
        depth: along z of each eye, (eyes, height, width) float32 [m], inf at the background; None
            where it was not requested
        ids: object at each pixel, (eyes, height, width) int32, 0 at the background
        normals: of the surface, in each eye's frame, (eyes, height, width, 3) float32
        names: {id: "PSM1/wrist_yaw", "table", ...} of everything in the scene
        time: of the snapshot [s]
        build: as of a snapshot
        calibration: of the pictures; without distortion where they have none
        T_world_camera: each eye's pose, (eyes, 4, 4)
        exposure: of the pictures [stops]
        arms: joints of every arm at this time; empty where the snapshot has none
        visible: {object: visible ratio of its pixels, (eyes,)}, 0 to 1, NaN out of the picture, of
            the requested objects
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
        """Camera matrix of each eye, (eyes, 3, 3) [px]."""
        return np.stack([eye.K for eye in self.calibration.eyes])

    @property
    def distortion(self) -> tuple[Array, ...]:
        """Distortion of each eye: k1, k2, p1, p2, k3 and, where it has them, k4, k5, k6."""
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


def picture(frame: Any, eye: str, show: str) -> Picture:
    """Return a frame as one picture (h, w, 3), (h, 2 w, 3) of both eyes.

    Args:
        frame: with `left`, `right` (None of a camera with one eye), `depth`, `ids`, `normals`
        eye: one of EYES; of a camera with one eye it makes no difference
        show: one of SHOWN

    Raises:
        UnknownNameError: an unknown eye or content
        InputError: depth, ids or normals as an anaglyph, or that were not rendered
    """
    if eye not in EYES:
        raise UnknownNameError("eye", eye, EYES)
    if show not in SHOWN:
        raise UnknownNameError("show", show, SHOWN)
    pictures = _layers(frame, show)
    if len(pictures) == 1 or eye == "left":
        return pictures[0]
    if eye == "right":
        return pictures[1]
    if eye == "anaglyph" and show != "colour":
        raise InputError(f"--eye anaglyph: got --show {show}; allowed: colour")
    together: Callable[[Picture, Picture], Picture] = (
        anaglyph if eye == "anaglyph" else side_by_side
    )
    return together(*pictures)


def _layers(frame: Any, show: str) -> list[Picture]:
    if show == "colour":
        return [frame.left] if frame.right is None else [frame.left, frame.right]
    layers = getattr(frame, show)
    if layers is None:
        raise InputError(f"the frame was rendered without {show}")
    if show == "depth":
        ends = depth_ends(layers)
        return [depth_picture(layer, ends) for layer in layers]
    make = ids_picture if show == "ids" else normals_picture
    return [make(layer) for layer in layers]


def depth_ends(depth: NDArray[np.float32]) -> tuple[float, float]:
    """Return the least and the largest depth of arrays, 1 mm and 1 m where they have none [m]."""
    seen = depth[np.isfinite(depth) & (depth > 0.0)]
    return (float(seen.min()), float(seen.max())) if seen.size else (0.001, 1.0)


def depth_picture(depth: NDArray[np.float32], ends: tuple[float, float]) -> Picture:
    """Return depths (h, w) [m] in colours, by their logarithm between the ends [m]."""
    hit = np.isfinite(depth) & (depth > 0.0)
    near, far = np.log(ends[0]), np.log(max(ends[1], ends[0] * 1.001))
    share = (np.log(np.where(hit, depth, ends[1])) - near) / (far - near)
    places = np.linspace(0.0, 1.0, len(NEAR_TO_FAR))
    channels: list[Array] = [np.interp(share, places, channel) for channel in NEAR_TO_FAR.T]
    found = np.stack(channels, axis=-1)
    found[~hit] = BACKGROUND
    return found.astype(np.uint8)


def ids_picture(ids: NDArray[np.int32]) -> Picture:
    """Return ids (h, w) in colours, each its own; 0 is nothing."""
    spread = (ids.astype(np.uint32) * SPREAD).astype(np.float64) / 2.0**32
    hue, light = spread % 1.0, 0.62 + 0.36 * ((spread * 64.0) % 1.0)
    channels = [np.abs((6.0 * hue + shift) % 6.0 - 3.0) - 1.0 for shift in (0.0, 4.0, 2.0)]
    pure = np.clip(np.stack(channels, axis=-1), 0.0, 1.0)
    found = light[..., None] * (PALE + (1.0 - PALE) * pure)
    found[ids == 0] = BACKGROUND
    return (255.0 * found).astype(np.uint8)


def normals_picture(normals: NDArray[np.float32]) -> Picture:
    """Return normals (h, w, 3) in colours: x red, y green, z blue, from -1 to 1."""
    return np.clip(127.5 * (normals + 1.0), 0.0, 255.0).astype(np.uint8)
