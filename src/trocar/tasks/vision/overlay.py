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

from trocar.cameras import Intrinsics
from trocar.cameras.lens import project
from trocar.descriptions.needles import Needle
from trocar.errors import InputError
from trocar.geometry import inverse, transform_points
from trocar.inputs import check_numbers, check_type, check_whole
from trocar.rendering import StereoFrame
from trocar.tasks.vision.eyes import checked_image, checked_pose
from trocar.tasks.vision.images import opencv

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
#: Source: OpenCV draws nothing wider (MAX_THICKNESS is 32767); our own choice. [px]
WIDEST_PX = 1000


@dataclass(frozen=True, eq=False)
class View:
    """An eye: its lens, and its pose in the world at the image's stamp, (4, 4)."""

    lens: Intrinsics
    T_world_eye: Array

    def __post_init__(self) -> None:
        """Check the lens and the pose."""
        check_type(self.lens, Intrinsics, "lens")
        object.__setattr__(self, "T_world_eye", checked_pose(self.T_world_eye, "T_world_eye"))

    @staticmethod
    def of(frame: StereoFrame, eye: int = 0) -> View:
        """Return an eye of a simulated frame."""
        check_whole(eye, "eye", 0, len(check_type(frame, StereoFrame, "frame").eyes) - 1)
        return View(frame.calibration.eyes[eye], frame.T_world_camera[eye])

    def pixels(self, points: ArrayLike) -> Array:
        """Return pixels of points in the world (n, 3), NaN of those behind the eye, (n, 2)."""
        at = check_numbers(points, (-1, 3), "points [m]")
        ahead = transform_points(inverse(self.T_world_eye), at)
        ahead = np.where(np.asarray(ahead[..., 2:] > NEAR_M), ahead, np.nan)
        return project(ahead, self.lens.K, self.lens.distortion)


@dataclass(frozen=True, eq=False)
class Curve:
    """A line through points in the world, (n, 3) [m]; width [px]."""

    points: Array
    colour: Colour = GREEN
    width: int = 2

    def __post_init__(self) -> None:
        """Check points, colour and width."""
        _check_outline(self, 2)
        check_whole(self.width, "width [px]", 1, WIDEST_PX)

    def draw(self, image: Picture, view: View) -> None:
        """Draw it where it is."""
        p = self.points
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

    def __post_init__(self) -> None:
        """Check corners, colour and alpha."""
        _check_outline(self, 3)
        check_numbers(self.alpha, (), "alpha", 0.0, 1.0)

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

    def __post_init__(self) -> None:
        """Check text, point and colour."""
        _check_text(self)
        object.__setattr__(self, "point", check_numbers(self.point, (3,), "point [m]"))

    def draw(self, image: Picture, view: View) -> None:
        """Draw it where it is."""
        (at,) = view.pixels(self.point[None])
        if np.isfinite(at).all() and (at > 0).all() and (at < image.shape[1::-1]).all():
            _write(
                image, self.text, at + np.array([8.0, -8.0]), image.shape[0] / 1400.0, self.colour
            )


@dataclass(frozen=True)
class Banner:
    """A text across the image's upper edge."""

    text: str
    colour: Colour = WHITE

    def __post_init__(self) -> None:
        """Check text and colour."""
        _check_text(self)

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
        InputError: an image of another size or type than the eye's, or something that is no item
    """
    picture = checked_image(image, check_type(view, View, "view").lens.size, "image").copy()
    for item in items if isinstance(items, Iterable) else [items]:  # pyright: ignore[reportUnnecessaryIsInstance]  public input
        if not isinstance(item, Item):  # pyright: ignore[reportUnnecessaryIsInstance]  public input
            raise InputError(f"item: got {item!r:.200}; allowed: a Curve, Area, Label or Banner")
        item.draw(picture, view)
    return picture


def axes(T: Array, length: float = 0.01) -> list[Item]:
    """Return the axes of a frame in the world, (4, 4): x red, y green, z blue."""
    pose = checked_pose(T, "T")
    ends = pose[:3, 3] + check_numbers(length, (), "length [m]") * pose[:3, :3].T
    return [
        Curve(np.stack([T[:3, 3], end]), colour)
        for end, colour in zip(ends, (RED, GREEN, BLUE), strict=True)
    ]


def ghost(needle: Needle, T_world_needle: Array, colour: Colour = GREEN) -> list[Item]:
    """Return a needle's centre line, with a dot at its tip."""
    line = check_type(needle, Needle, "needle").points(np.linspace(0.0, needle.arc, 40))
    points = transform_points(checked_pose(T_world_needle, "T_world_needle"), line)
    return [Curve(points, colour, 1), Curve(points[-2:], YELLOW, 3)]


def distance(a: ArrayLike, b: ArrayLike, colour: Colour = BLUE) -> list[Item]:
    """Return a line between two points in the world and its length in millimetres."""
    ends = np.stack([check_numbers(p, (3,), name) for p, name in ((a, "a [m]"), (b, "b [m]"))])
    length = float(np.linalg.norm(ends[1] - ends[0]))
    return [Curve(ends, colour, 1), Label(f"{1e3 * length:.1f} mm", ends.mean(axis=0), colour)]


def stitch(entry: ArrayLike, exit_: ArrayLike, down: ArrayLike, radius: float) -> list[Item]:
    """Return a planned stitch: the arc of a needle below two points of a surface, and both.

    Args:
        entry, exit_: in the world, (3,) [m]
        down: into the tissue, (3,)
        radius: of the needle, at least half as far as both points are apart [m]

    Raises:
        InputError: points too far apart for the needle, or along which `down` is
    """
    a, b, down = (
        check_numbers(value, (3,), name)
        for value, name in ((entry, "entry [m]"), (exit_, "exit_ [m]"), (down, "down"))
    )
    half = 0.5 * float(np.linalg.norm(b - a))
    check_numbers(radius, (), "radius [m]", 0.0)
    if not 0.0 < half <= radius:
        raise InputError(
            f"stitch: got points {2e3 * half:g} mm apart; allowed: above 0, up to {2e3 * radius:g}"
            " mm, the needle's diameter"
        )
    along = (b - a) / (2.0 * half)
    below = down - along * (along @ down)
    if not np.linalg.norm(below) > 1e-6 * np.linalg.norm(down):
        raise InputError(f"down: got {down.tolist()}; allowed: not along the stitch")
    below /= np.linalg.norm(below)
    reach = float(np.arcsin(half / radius))
    angles = np.linspace(-reach, reach, 30)[:, None]
    centre = 0.5 * (a + b) - below * np.sqrt(radius**2 - half**2)
    arc = centre + radius * (np.sin(angles) * along + np.cos(angles) * below)
    cross = 0.0012 * np.cross(along, below)
    marks = [Curve(np.stack([p - cross, p + cross]), ORANGE, 3) for p in (a, b)]
    return [Curve(arc, ORANGE), *marks, Label("entry", a, ORANGE), Label("exit", b, ORANGE)]


def _check_outline(item: Curve | Area, least: int) -> None:
    """Check points and colour, and keep them as an array."""
    points = check_numbers(item.points, (-1, 3), "points [m]")
    if len(points) < least:
        raise InputError(f"points [m]: got {len(points)}; allowed: {least} or more")
    object.__setattr__(item, "points", points)
    check_numbers(item.colour, (3,), "colour", 0, 255)


def _check_text(item: Label | Banner) -> None:
    check_type(item.text, str, "text")
    check_numbers(item.colour, (3,), "colour", 0, 255)


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
