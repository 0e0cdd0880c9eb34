"""A needle's pose from both eyes' images, by profiles across its centre line.

Poses are T_left_needle (4, 4), the needle's frame as `descriptions.needles.Needle` has it, in the
left eye's. Small changes of a pose are (translation, rotation about the circle's centre), (6,), in
the left eye's axes.

A colour direction separates the wire from what is beside it; along it the images become evidence:
1 on the needle, 0 beside. Profiles across the predicted centre line, matched with a box of the
wire's width between two rims, give offsets in pixels. The ends of the arc say the roll alone: their
disparity is too coarse for depth.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trocar.apps.vision.eyes import Eyes, Picture
from trocar.apps.vision.images import between, filtered_rows, smoothed_columns, weighed
from trocar.descriptions.needles import Needle
from trocar.geometry import matrix_from_rotation_vector, rotation_vector_from_matrix, skew

Array = NDArray[np.float64]
Floats = NDArray[np.float32]
#: A straight part of the tool in the left eye's frame: start, end (3,) and radius [m].
Rod = tuple[Array, Array, float]

#: Profiles of each eye along the arc. Source: our own choice; 4 px apart at 80 mm and 1280x720.
PROFILES = 56
#: Neighbouring profiles are averaged, so that many are worth one. Source: our own choice; the share
#: makes a profile's standard deviation hold: prototypes, and `python -m benchmarks vision`.
SMOOTH, WORTH = 5, 0.4
#: Spacing of a profile's samples, and width of the rims beside the wire [px]. Source: our own
#: choice.
STEP, RIM = 0.5, 3.0
#: Standard deviation of a profile's offset [px]. Source: measured on rendered tissue, 0.05 to 0.3;
#: 0.5 leaves room for jaws and shadows.
SIGMA_PX = 0.5
#: How far ends are looked for, and spacing of samples along the arc [m]. Source: our own choice.
REACH_M, ALONG_M = 0.0024, 0.00006
#: Standard deviation of an end's place, as an angle [rad]; and how thick the point is where it can
#: no more be seen [px]. Source: measured on rendered needles.
END_RAD, POINT_PX = np.deg2rad(1.5), 1.2
#: Evidence is cut off here: glints and shadows. Source: our own choice.
DARK, BRIGHT = -0.6, 1.6


class Colours(NamedTuple):
    """A direction in colour (3,), its values on the needle and beside it, and their separation."""

    direction: Array
    inside: float
    outside: float
    separation: float


class Rows(NamedTuple):
    """Offsets of profiles, left eye's first.

    Attributes:
        offset: from the predicted centre line to the seen one [px]
        jacobian: d offset / d pose, (n, 6)
        normal: the direction of the profile in the image, (n, 2)
        weight: 0 to 1
    """

    offset: Array
    jacobian: Array
    normal: Array
    weight: Array


class Ends(NamedTuple):
    """Angles by which visible ends lie further along the arc than predicted, and their weights."""

    angle: Array
    weight: Array


class Quality(NamedTuple):
    """How well a pose explains the images.

    Attributes:
        share: of profiles that show the needle where the pose has it, of both eyes
        worst: the same of the eye with fewer
        rms: of their offsets [px]
    """

    share: float
    worst: float
    rms: float


class _View(NamedTuple):
    """Evidence of one eye about the needle, and the pixel of its upper left corner."""

    evidence: Floats
    corner: Array


class _Line(NamedTuple):
    """Points of the arc in one eye: pixels, depths, d pixel / d point, normals, px per metre."""

    points: Array
    pixels: Array
    depths: Array
    jacobian: Array
    normals: Array
    stretch: Array


def moved(T: Array, x: Array) -> Array:
    """Return a pose after a small change (6,)."""
    found = T.copy()
    found[:3, 3] += x[:3]
    found[:3, :3] = matrix_from_rotation_vector(x[3:6]) @ T[:3, :3]
    return found


def change(T: Array, other: Array) -> Array:
    """Return the small change that leads from a pose to another, (6,)."""
    turn = rotation_vector_from_matrix(other[:3, :3] @ T[:3, :3].T)
    return np.concatenate([other[:3, 3] - T[:3, 3], turn])


class NeedleFit:
    """Compares poses of a needle with images.

    Args:
        eyes: the cameras
        needle: its dimensions
    """

    def __init__(self, eyes: Eyes, needle: Needle) -> None:
        self.eyes, self.needle = eyes, needle
        self.angles = np.linspace(0.0, needle.arc, PROFILES + 2)[1:-1]
        self._halves = needle.half_width(self.angles)
        self._around = np.linspace(0.0, 2.0 * np.pi, 48, endpoint=False)

    # ------------------------------------------------------------------ images

    def colours(self, images: Sequence[Picture], T: Array) -> Colours:
        """Return the colour direction that separates the needle from what is beside it."""
        inside: list[Array] = []
        outside: list[Array] = []
        for eye in range(2):
            line = self._line(T, self.angles[::2], eye)
            half = self._halves[::2] * self.eyes.focal / line.depths
            for share in (-0.4, 0.0, 0.4):
                at = line.pixels + (share * half)[:, None] * line.normals
                inside.append(between(images[eye], at).astype(np.float64))
            for beyond in (-6.0, -4.0, -2.5, 2.5, 4.0, 6.0):
                at = line.pixels + (np.sign(beyond) * half + beyond)[:, None] * line.normals
                outside.append(between(images[eye], at).astype(np.float64))
        one, other = np.concatenate(inside), np.concatenate(outside)
        middle, beside = np.median(one, axis=0), np.median(other, axis=0)
        scatter = (
            np.cov(np.clip(one - middle, -25.0, 25.0).T)
            + np.cov(np.clip(other - beside, -25.0, 25.0).T)
            + 25.0 * np.eye(3)
        )
        direction = np.asarray(np.linalg.solve(scatter, middle - beside), np.float64)
        direction = direction / (float(np.linalg.norm(direction)) + 1e-12)
        levels = float(middle @ direction), float(beside @ direction)
        spread = float(np.sqrt(direction @ scatter @ direction))
        contrast = abs(levels[0] - levels[1]) / spread if spread else 0.0  # images of one colour
        return Colours(direction, *levels, contrast)

    def metallic(self, images: Sequence[Picture], T: Array) -> Colours:
        """Return colours of metal on tissue, for a pose that may be off by more than the wire.

        The brightest of (G + B - R) / 2 about the pose are taken for the needle, as many as it
        covers.
        """
        direction = np.array([-1.0, 1.0, 1.0]) / np.sqrt(3.0)
        width, height = self.eyes.size
        values: list[Array] = []
        covered = 0.0
        for eye in range(2):
            line = self._line(T, self._around, eye)
            low = np.clip(np.floor(line.pixels.min(axis=0)) - 10, 0, (width - 2, height - 2))
            high = np.clip(np.ceil(line.pixels.max(axis=0)) + 10, low + 1, (width, height))
            (left, top), (right, bottom) = low.astype(int), high.astype(int)
            part = images[eye][top:bottom:2, left:right:2].reshape(-1, 3)
            values.append(part.astype(np.float64) @ direction)
            length = np.mean(line.stretch) * self.needle.length
            covered += 0.25 * length * self.needle.wire * self.eyes.focal / np.mean(line.depths)
        both = np.concatenate(values)
        share = float(np.clip(0.5 * covered / len(both), 0.002, 0.3))
        outside, inside = np.quantile(both, [0.5, 1.0 - share])
        rest = both[both < inside]
        spread = (float(np.std(rest)) if rest.size else 0.0) + 5.0  # plain images have no rest
        return Colours(direction, float(inside), float(outside), float(inside - outside) / spread)

    def views(
        self, images: Sequence[Picture], T: Array, colours: Colours, margin: float
    ) -> list[_View]:
        """Return evidence in both eyes up to a margin about a needle's whole circle [px]."""
        width, height = self.eyes.size
        gain = 1.0 / (colours.inside - colours.outside + 1e-9)
        found: list[_View] = []
        for eye in range(2):
            pixels = self.eyes.project(self._on(T, self._around), eye)
            low = np.clip(np.floor(pixels.min(axis=0) - margin), 0, (width - 2, height - 2))
            high = np.clip(np.ceil(pixels.max(axis=0) + margin), low + 1, (width - 1, height - 1))
            (left, top), (right, bottom) = low.astype(int), high.astype(int) + 1
            part = np.ascontiguousarray(images[eye][top:bottom, left:right])
            evidence = weighed(part, gain * colours.direction, -gain * colours.outside)
            found.append(_View(np.clip(evidence, DARK, BRIGHT), low))
        return found

    # ------------------------------------------------------------------ measurements

    def rows(
        self, views: Sequence[_View], T: Array, length: float, rods: Sequence[Rod] = ()
    ) -> Rows:
        """Return offsets along profiles that reach so far to both sides [px]."""
        found: list[tuple[Array, Array, Array, Array]] = []
        for eye in range(2):
            line = self._line(T, self.angles, eye)
            half = float(np.median(self._halves * self.eyes.focal / line.depths))
            half = max(half, 0.5)
            ends = length + half + RIM + 2.0
            places = np.arange(-ends, ends + 0.5 * STEP, STEP)
            at = line.pixels[:, None] + places[:, None] * line.normals[:, None, :]
            profile = self._sample(views[eye], at)
            profile = smoothed_columns(profile, SMOOTH)
            inside = filtered_rows(profile, _box(-half, half))
            side = filtered_rows(profile, _box(-0.5 * RIM, 0.5 * RIM))
            shift = round((half + 0.5 * RIM) / STEP)
            low, high = shift, len(places) - shift
            inside = inside[:, low:high]
            before, after = side[:, low - shift : high - shift], side[:, low + shift : high + shift]
            places = places[low:high]
            keep = np.abs(places) <= length + 0.5 * STEP
            score = (inside - 0.5 * (before + after))[:, keep]
            beside = np.maximum(before, after)[:, keep]
            places = places[keep]
            best = score.argmax(axis=1)
            row, k = np.arange(len(score)), np.clip(best, 1, len(places) - 2)
            a, b, c = score[row, k - 1], score[row, k], score[row, k + 1]
            bend = np.minimum(a - 2.0 * b + c, -1e-6)
            offset = places[k] + STEP * np.clip(0.5 * (a - c) / bend, -1.0, 1.0)
            weight = (
                np.clip((b - 0.3) / 0.3, 0.0, 1.0)
                * np.clip((0.75 - beside[row, k]) / 0.25, 0.0, 1.0)
                * ((best > 0) & (best < len(places) - 1))
                * self._inside(line.pixels, length + 2.0)
                * self._uncovered(line.pixels, eye, rods)
            )
            arm = line.points - T[:3, 3]
            by_pose = np.concatenate([line.jacobian, -line.jacobian @ skew(arm)], axis=2)
            jacobian = (line.normals[:, None, :] @ by_pose)[:, 0]
            found.append((offset.astype(np.float64), jacobian, line.normals, weight))
        return Rows(*(np.concatenate(parts) for parts in zip(*found, strict=True)))

    def ends(self, views: Sequence[_View], T: Array, rods: Sequence[Rod] = ()) -> Ends:
        """Return where the ends of the arc are seen."""
        needle, found = self.needle, Ends(np.zeros(4), np.zeros(4))
        s = np.arange(-REACH_M, REACH_M, ALONG_M)
        for row, (eye, tip) in enumerate((e, t) for e in range(2) for t in (False, True)):
            sign = 1.0 if tip else -1.0
            angles = (needle.arc if tip else 0.0) + sign * s / needle.radius
            line = self._line(T, angles, eye)
            half = 0.5 * needle.wire * self.eyes.focal / line.depths
            across = (0.0 if tip else 0.45) * np.maximum(half, 1.0)
            at = line.pixels + np.array([-1.0, 0.0, 1.0])[:, None, None] * (
                across[:, None] * line.normals
            )
            there = np.clip(self._sample(views[eye], at).mean(axis=0), -0.3, 1.3) - 0.5
            sums = np.cumsum(there)
            j = int(sums.argmax())
            if not 6 < j < len(s) - 7:
                continue
            contrast = float(
                there[j - 11 if j > 11 else 0 : j + 1].mean() - there[j + 1 : j + 13].mean()
            )
            middle = line.pixels[j : j + 1]
            if contrast < 0.55 or not (
                self._inside(middle, 3.0)[0] and self._uncovered(middle, eye, rods)[0]
            ):
                continue
            thin = POINT_PX / (needle.wire * self.eyes.focal / line.depths[j])
            seen = s[j] + 0.5 * ALONG_M + (needle.taper * thin if tip else 0.0)
            found.angle[row] = sign * seen / needle.radius
            # Ends of an arc that is seen from its edge are less certain.
            found.weight[row] = contrast * line.stretch[j] * line.depths[j] / self.eyes.focal
        return found

    def roll(self, views: Sequence[_View], T: Array, limit: float = np.pi) -> Array:
        """Return a pose turned about its own axis so that the arc covers the most evidence."""
        count = 360
        angles = np.arange(count) * 2.0 * np.pi / count
        evidence = np.zeros(count)
        for eye in range(2):
            line = self._line(T, angles, eye)
            half = 0.5 * self.needle.wire * self.eyes.focal / line.depths
            on, beside = (
                self._sample(
                    views[eye],
                    line.pixels + np.array(shares)[:, None, None] * line.normals
                    * (half + extra)[:, None],
                )
                for shares, extra in (((-0.5, 0.0, 0.5), 0.0), ((-1.0, 1.0), 2.5))
            )  # fmt: skip
            covered = (beside.max(axis=0) > 0.6) & (beside.min(axis=0) > 0.45)
            known = ~covered & (self._inside(line.pixels, 3.0) > 0.0)
            evidence += np.where(known, np.clip(on.mean(axis=0), -0.3, 1.3) - 0.5, 0.0)
        width = round(self.needle.arc / (2.0 * np.pi) * count)
        sums = np.concatenate([[0.0], np.cumsum(np.tile(evidence, 3))])
        most = min(int(limit / (2.0 * np.pi) * count) + 1, count // 2)
        start = count + np.arange(-most, most + 1)
        best = int((sums[start + width] - sums[start]).argmax())
        turn = matrix_from_rotation_vector([0.0, 0.0, (best - most) * 2.0 * np.pi / count])
        found = T.copy()
        found[:3, :3] = T[:3, :3] @ turn
        return found

    def blunter(self, views: Sequence[_View], T: Array) -> float:
        """Return by how much the swage's end is thicker than the tip's; below 0: wrong way round.

        An end counts where the wire is seen up to it and the ground beyond.
        """
        needle, found = self.needle, 0.0
        s = np.linspace(0.1, 0.8, 12) * needle.taper / needle.radius
        beyond = -np.linspace(0.1, 0.3, 6) * needle.taper / needle.radius
        for start, sign in ((0.0, 1.0), (needle.arc, -1.0)):
            for eye in range(2):
                line = self._line(T, start + sign * s, eye)
                half = 0.36 * needle.wire * self.eyes.focal / line.depths
                at = line.pixels + np.array([-1.0, 0.0, 1.0])[:, None, None] * (
                    half[:, None] * line.normals
                )
                there = np.clip(self._sample(views[eye], at), -0.3, 1.3).mean(axis=1)
                ground = self._sample(views[eye], self._line(T, start + sign * beyond, eye).pixels)
                if there[1] > 0.4 and ground.mean() < 0.4:
                    found += sign * (0.5 * (there[0] + there[2]) / there[1] - 0.6)
        return found

    def quality(self, rows: Rows) -> Quality:
        """Return how well the pose of profiles explains the images."""
        good = (rows.weight > 0.3) & (np.abs(rows.offset) < 2.0)
        n = len(good) // 2
        rms = float(np.sqrt(np.mean(rows.offset[good] ** 2))) if good.any() else np.inf
        return Quality(float(good.mean()), float(min(good[:n].mean(), good[n:].mean())), rms)

    def refine(
        self,
        images: Sequence[Picture],
        T: Array,
        lengths: Sequence[float] = (16.0, 12.0, 8.0, 6.0, 5.0, 4.0),
        colours: Colours | None = None,
        rods: Sequence[Rod] = (),
    ) -> tuple[Array, Quality, Colours]:
        """Return the pose that fits best, near a given one, how well it does, and its colours."""
        for k, length in enumerate(lengths):
            if colours is None:
                colours = self.metallic(images, T)
            elif k:
                fresh = self.colours(images, T)
                if fresh.separation > 0.7 * colours.separation:
                    colours = fresh
            views = self.views(images, T, colours, length + 16.0)
            rows = self.rows(views, T, length, rods)
            pull = np.minimum(1.0, max(1.0, length / 6.0) / np.maximum(np.abs(rows.offset), 1e-6))
            weight = rows.weight * pull
            A = (rows.jacobian * weight[:, None]).T @ rows.jacobian + np.diag(
                [1.0] * 3 + [1e-4] * 3
            )
            b = (rows.jacobian * weight[:, None]).T @ rows.offset
            if k:
                ends = self.ends(views, T, rods)
                row = np.concatenate([np.zeros(3), T[:3, 2]])
                pull = np.minimum(1.0, 2.0 * END_RAD / np.maximum(np.abs(ends.angle), 1e-9))
                strength = ends.weight * pull * (SIGMA_PX / END_RAD) ** 2 / WORTH
                A += strength.sum() * np.outer(row, row)
                b += (strength @ ends.angle) * row
            x = np.asarray(np.linalg.solve(A, b), np.float64)
            x[:3] = np.clip(x[:3], -0.004, 0.004)
            x[3:] *= min(1.0, 0.35 / max(float(np.linalg.norm(x[3:])), 1e-9))
            T = moved(T, x)
        assert colours is not None  # noqa: S101  there is at least one length
        views = self.views(images, T, colours, lengths[-1] + 16.0)
        return T, self.quality(self.rows(views, T, lengths[-1], rods)), colours

    # ------------------------------------------------------------------ inside

    def _on(self, T: Array, angles: Array) -> Array:
        return self.needle.points(angles) @ T[:3, :3].T + T[:3, 3]

    def _line(self, T: Array, angles: Array, eye: int) -> _Line:
        points = self._on(T, angles)
        pixels, depths, jacobian = self.eyes.project_with_jacobian(points, eye)
        along = (jacobian @ (self.needle.tangents(angles) @ T[:3, :3].T)[..., None])[..., 0]
        stretch = np.linalg.norm(along, axis=1)
        along = along / np.maximum(stretch, 1e-9)[:, None]
        normals = np.stack([-along[:, 1], along[:, 0]], axis=1)
        return _Line(points, pixels, depths, jacobian, normals, stretch)

    def _sample(self, view: _View, pixels: Array) -> Floats:
        return between(view.evidence, pixels - view.corner)

    def _inside(self, pixels: Array, margin: float) -> Array:
        limit = np.array(self.eyes.size) - 1.0 - margin
        return np.asarray(((pixels > margin) & (pixels < limit)).all(axis=1), np.float64)

    def _uncovered(self, pixels: Array, eye: int, rods: Sequence[Rod]) -> Array:
        free: Array = np.ones(len(pixels))
        for start, end, radius in rods:
            both = np.stack([start, end])
            (a, b), depths, _ = self.eyes.project_with_jacobian(both, eye)
            way = b - a
            share = np.clip((pixels - a) @ way / (way @ way + 1e-9), 0.0, 1.0)
            off = np.linalg.norm(pixels - a - share[:, None] * way, axis=1)
            free = free * (off > radius * self.eyes.focal / depths.min())
        return free


def _box(low: float, high: float) -> Array:
    """Return a kernel that averages samples from low to high [px] about the middle one."""
    count = int(np.ceil(max(-low, high) / STEP)) + 1
    edges = (np.arange(-count, count + 2) - 0.5) * STEP
    share = np.clip(edges, low, high)
    kernel = np.diff(share)
    return np.asarray(kernel / kernel.sum(), np.float64)
