"""Augmented reality: curves, areas, labels and banners drawn where they are in an image.

Items are in the world, in metres; a `View` says where an eye is and what its lens does, whether the
image is simulated, recorded or comes from a real endoscope whose arms are mirrored.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.apps.vision.images import opencv
from trocar.cameras import Intrinsics
from trocar.cameras.lens import project
from trocar.descriptions.needles import Needle
from trocar.errors import InputError
from trocar.geometry import check_transform, inverse, transform_points
from trocar.inputs import numbers
from trocar.rendering import StereoFrame

Array = NDArray[np.float64]
Picture = NDArray[np.uint8]
Colour = tuple[int, int, int]

#: Source: Okabe and Ito, 2008, lightened for dark red tissue.
GREEN, BLUE, YELLOW, ORANGE, WHITE = (
    (80, 230, 150), (90, 190, 255), (250, 230, 70), (255, 150, 40), (255, 255, 255),
)  # fmt: skip
RED: Colour = (255, 70, 60)
#: Segments are cut so that lenses bend them; nearer than this to the eye nothing is drawn [m].
PARTS, NEAR_M = 16, 0.005
#: Fractional bits of OpenCV's drawing coordinates, and pixels that they reach.
BITS, MOST_PX = 4, 20000.0


@dataclass(frozen=True, eq=False)
class View:
    """An eye: its lens, and its pose in the world at the image's stamp, (4, 4)."""

    lens: Intrinsics
    T_world_eye: Array

    def __post_init__(self) -> None:
        """Check the pose."""
        check_transform(numbers(self.T_world_eye, (4, 4), "T_world_eye"), "T_world_eye")

    @staticmethod
    def of(frame: StereoFrame, eye: int = 0) -> View:
        """Return an eye of a simulated frame."""
        return View(frame.calibration.eyes[eye], frame.T_world_camera[eye])

    def pixels(self, points: ArrayLike) -> Array:
        """Return pixels of points in the world (n, 3), NaN of those behind the eye, (n, 2)."""
        ahead = transform_points(inverse(self.T_world_eye), np.asarray(points, np.float64))
        ahead = np.where(np.asarray(ahead[..., 2:] > NEAR_M), ahead, np.nan)
        return project(ahead, self.lens.K, self.lens.distortion)


@dataclass(frozen=True, eq=False)
class Curve:
    """A line through points in the world, (n, 3) [m]; width [px]."""

    points: Array
    colour: Colour = GREEN
    width: int = 2

    def draw(self, image: Picture, view: View) -> None:
        """Draw it where it is."""
        p = np.asarray(self.points, np.float64)
        t = np.linspace(0.0, len(p) - 1.0, (len(p) - 1) * _parts(len(p)) + 1)
        k = np.minimum(t.astype(int), len(p) - 2)
        pixels = view.pixels(p[k] + (t - k)[:, None] * (p[k + 1] - p[k]))
        seen = np.asarray((np.abs(np.nan_to_num(pixels, nan=1e9)) < MOST_PX).all(axis=1))
        for run in np.split(np.arange(len(t)), np.flatnonzero(np.diff(seen)) + 1):
            if seen[run[0]] and len(run) > 1:
                opencv().polylines(image, [_fixed(pixels[run])], False, self.colour, self.width,
                                   opencv().LINE_AA, BITS)  # fmt: skip


@dataclass(frozen=True, eq=False)
class Area:
    """A flat area with corners in the world, (n, 3) [m], shining through by `alpha`."""

    points: Array
    colour: Colour = RED
    alpha: float = 0.3

    def draw(self, image: Picture, view: View) -> None:
        """Draw it where it is, if all its corners are ahead of the eye."""
        outline = Curve(np.concatenate([self.points, self.points[:1]]), self.colour)
        pixels = view.pixels(self.points)
        if (np.abs(np.nan_to_num(pixels, nan=1e9)) < MOST_PX).all():
            layer = image.copy()
            opencv().fillPoly(layer, [_fixed(pixels)], self.colour, opencv().LINE_AA, BITS)
            opencv().addWeighted(layer, self.alpha, image, 1.0 - self.alpha, 0.0, image)
        outline.draw(image, view)


@dataclass(frozen=True, eq=False)
class Label:
    """A short text beside a point in the world, (3,) [m]."""

    text: str
    point: Array
    colour: Colour = WHITE

    def draw(self, image: Picture, view: View) -> None:
        """Draw it where it is."""
        (at,) = view.pixels(np.asarray(self.point, np.float64)[None])
        if np.isfinite(at).all() and (at > 0).all() and (at < image.shape[1::-1]).all():
            _write(
                image, self.text, at + np.array([8.0, -8.0]), image.shape[0] / 1400.0, self.colour
            )


@dataclass(frozen=True)
class Banner:
    """A text across the image's upper edge."""

    text: str
    colour: Colour = WHITE

    def draw(self, image: Picture, view: View) -> None:
        """Draw it."""
        del view
        high = round(0.065 * image.shape[0])
        image[:high] = (0.35 * image[:high]).astype(np.uint8)
        at = np.array([0.4 * high, 0.72 * high])
        _write(image, self.text, at, image.shape[0] / 900.0, self.colour)


Item = Curve | Area | Label | Banner


def overlaid(image: ArrayLike, view: View, items: Iterable[Item]) -> Picture:
    """Return a copy of an image with items drawn into it.

    Raises:
        InputError: an image of another size than the eye's
    """
    picture = np.array(image, np.uint8)
    if picture.shape != (view.lens.height, view.lens.width, 3):
        raise InputError(
            f"image: got {picture.shape}; allowed: ({view.lens.height}, {view.lens.width}, 3), as"
            " its calibration has it"
        )
    for item in items:
        item.draw(picture, view)
    return picture


def axes(T: Array, length: float = 0.01) -> list[Item]:
    """Return the axes of a frame in the world, (4, 4): x red, y green, z blue."""
    ends = T[:3, 3] + length * T[:3, :3].T
    return [
        Curve(np.stack([T[:3, 3], end]), colour)
        for end, colour in zip(ends, (RED, GREEN, BLUE), strict=True)
    ]


def ghost(needle: Needle, T_world_needle: Array, colour: Colour = GREEN) -> list[Item]:
    """Return a needle's centre line, with a dot at its tip."""
    line = needle.points(np.linspace(0.0, needle.arc, 40))
    points = transform_points(T_world_needle, line)
    return [Curve(points, colour, 1), Curve(points[-2:], YELLOW, 3)]


def distance(a: ArrayLike, b: ArrayLike, colour: Colour = BLUE) -> list[Item]:
    """Return a line between two points in the world and its length in millimetres."""
    ends = np.stack([np.asarray(a, np.float64), np.asarray(b, np.float64)])
    length = float(np.linalg.norm(ends[1] - ends[0]))
    return [Curve(ends, colour, 1), Label(f"{1e3 * length:.1f} mm", ends.mean(axis=0), colour)]


def stitch(entry: ArrayLike, exit_: ArrayLike, down: ArrayLike, radius: float) -> list[Item]:
    """Return a planned stitch: the arc of a needle below two points of a surface, and both.

    Args:
        entry, exit_: in the world, (3,) [m]
        down: into the tissue, (3,)
        radius: of the needle, at least half as far as both points are apart [m]

    Raises:
        InputError: points too far apart for the needle
    """
    a, b = np.asarray(entry, np.float64), np.asarray(exit_, np.float64)
    half = 0.5 * float(np.linalg.norm(b - a))
    if not 0.0 < half <= radius:
        raise InputError(
            f"stitch: got points {2e3 * half:g} mm apart; allowed: above 0, up to {2e3 * radius:g}"
            " mm, the needle's diameter"
        )
    along = (b - a) / (2.0 * half)
    below = np.asarray(down, np.float64) - along * (along @ np.asarray(down, np.float64))
    below /= np.linalg.norm(below)
    reach = np.arcsin(half / radius)
    angles = np.linspace(-reach, reach, 30)[:, None]
    centre = 0.5 * (a + b) - below * np.sqrt(radius**2 - half**2)
    arc = centre + radius * (np.sin(angles) * along + np.cos(angles) * below)
    cross = 0.0012 * np.cross(along, below)
    marks = [Curve(np.stack([p - cross, p + cross]), ORANGE, 3) for p in (a, b)]
    return [Curve(arc, ORANGE), *marks, Label("entry", a, ORANGE), Label("exit", b, ORANGE)]


def _parts(count: int) -> int:
    return max(1, 2 * PARTS // count)


def _fixed(pixels: Array) -> NDArray[np.int32]:
    return np.round(pixels * 2**BITS).astype(np.int32)


def _write(
    image: Picture, text: str, at: Sequence[float] | Array, size: float, colour: Colour
) -> None:
    cv2: Any = opencv()
    place = int(at[0]), int(at[1])
    for shift, shade in ((1, (0, 0, 0)), (0, colour)):
        there = place[0] + shift, place[1] + shift
        cv2.putText(image, text, there, cv2.FONT_HERSHEY_SIMPLEX, size, shade, 1, cv2.LINE_AA)
