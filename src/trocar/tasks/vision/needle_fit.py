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

from trocar.descriptions.needles import Needle
from trocar.geometry import matrix_from_rotation_vector, rotation_vector_from_matrix
from trocar.tasks.vision.eyes import Eyes, Picture
from trocar.tasks.vision.images import between, filtered_rows, smoothed_columns, weighed

Array = NDArray[np.float64]
Floats = NDArray[np.float32]
#: A straight part of the tool in the left eye's frame: start, end (3,) and radius [m].
Rod = tuple[Array, Array, float]

#: Profiles of each eye along the arc. Source: our own choice; 4 px apart at 80 mm and 1280x720.
PROFILES = 56
#: Number of neighbouring profiles that are averaged, and of those worth one measurement. Source:
#: our own choice; the ratio makes a profile's standard deviation hold: prototypes, and `python -m
#: benchmarks vision`.
SMOOTH, WORTH = 5, 0.4
#: Spacing of a profile's samples, and width of the rims beside the wire [px]. Source: our own
#: choice.
STEP, RIM = 0.5, 3.0
#: Standard deviation of a profile's offset [px]. Source: measured on rendered tissue, 0.05 to 0.3.
#: With 0.5 the filter left the depth to the disparity, which calibration spoils: 90 % of errors
#: were 1.07 mm at 640x480; with 0.25 0.82 mm, no less consistent with their covariance.
SIGMA_PX = 0.25
#: Range of the search for ends, and spacing of samples along the arc [m]. Source: our own choice.
REACH_M, ALONG_M = 0.0024, 0.00006
#: Standard deviation of an end's place, as an angle [rad]; and how thick the point is where it can
#: no more be seen [px]. Source: measured on rendered needles.
END_RAD, POINT_PX = np.deg2rad(1.5), 1.2
#: Profiles of the point, where the wire is thinner than what it is matched with, slide towards a
#: shadow beside it: in the filter they weigh nothing from this share of the wire's width on. A
#: search needs them: they separate poses. Source: 20 rendered needles, one of which was 3 degrees
#: off by two profiles.
THIN = 0.5
#: Bounds of the evidence, beyond which glints and shadows are cut off. Source: our own choice.
DARK, BRIGHT = -0.6, 1.6


class Colours(NamedTuple):
    """A direction in colour (3,), its values on the needle and beside it, and their separation."""

    direction: Array
    inside: float
    outside: float
    separation: float


class ProfileRows(NamedTuple):
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


class FitQuality(NamedTuple):
    """Agreement of a pose with the images.

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


class Covers(NamedTuple):
    """Bands of both eyes' images that rods cover: starts, ways (m, 2, 1, 2), half widths [px]."""

    starts: Array
    ways: Array
    halves: Array


class _Line(NamedTuple):
    """Points (n, 3) of the arc in both eyes, (2, n, ...).

    Pixels, depths, d pixel / d point, normals, px per metre along the arc.
    """

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

    Attributes:
        thick: weight of each profile, both eyes', by how thick the wire is there
    """

    def __init__(self, eyes: Eyes, needle: Needle) -> None:
        self.eyes, self.needle = eyes, needle
        self.angles = np.linspace(0.0, needle.arc, PROFILES + 2)[1:-1]
        self._halves = needle.half_width(self.angles)
        self._half = float(np.median(self._halves))
        thick = np.clip((self._halves / self._half - THIN) / (1.0 - THIN), 0.0, 1.0)
        self.thick = np.tile(thick, 2)
        self._around = np.linspace(0.0, 2.0 * np.pi, 48, endpoint=False)
        self._rim = _box(-0.5 * RIM, 0.5 * RIM)
        self._limit = np.array(eyes.size) - 1.0

    # ------------------------------------------------------------------ images

    def colours(self, images: Sequence[Picture], T: Array) -> Colours:
        """Return the colour direction that separates the needle from what is beside it."""
        line = self._line(T, self.angles[::2])
        half = self._halves[::2] * self.eyes.focal / line.depths
        off = [share * half for share in (-0.4, 0.0, 0.4)]
        off += [np.sign(beyond) * half + beyond for beyond in (-6.0, -4.0, -2.5, 2.5, 4.0, 6.0)]
        at = line.pixels + np.stack(off)[..., None] * line.normals
        values = np.stack([between(images[eye], at[:, eye]) for eye in range(2)], axis=1)
        one, other = (part.reshape(-1, 3).astype(np.float64) for part in (values[:3], values[3:]))
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
        line = self._line(T, self._around)
        for eye, pixels in enumerate(line.pixels):
            low = np.clip(np.floor(pixels.min(axis=0)) - 10, 0, (width - 2, height - 2))
            high = np.clip(np.ceil(pixels.max(axis=0)) + 10, low + 1, (width, height))
            (left, top), (right, bottom) = low.astype(int), high.astype(int)
            part = images[eye][top:bottom:2, left:right:2].reshape(-1, 3)
            values.append(part.astype(np.float64) @ direction)
            length = line.stretch[eye].mean() * self.needle.length
            covered += 0.25 * length * self.needle.wire * self.eyes.focal / line.depths[eye].mean()
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

    def covers(self, rods: Sequence[Rod]) -> Covers | None:
        """Return the bands of both eyes' images that rods cover, None without rods."""
        if not rods:
            return None
        ends = np.concatenate([(start, end) for start, end, _ in rods])
        pixels, depths, _ = self.eyes.project_with_jacobian(ends)
        pairs = pixels.reshape(2, -1, 1, 2, 2).transpose(1, 0, 2, 3, 4)
        nearest = depths.reshape(2, -1, 2).min(axis=2).T[..., None]
        radii = np.array([radius for _, _, radius in rods])[:, None, None]
        start = pairs[..., 0, :]
        return Covers(start, pairs[..., 1, :] - start, radii * self.eyes.focal / nearest)

    def rows(
        self, views: Sequence[_View], T: Array, length: float, covers: Covers | None = None
    ) -> ProfileRows:
        """Return offsets along profiles that reach so far to both sides [px]."""
        line = self._line(T, self.angles)
        half = max(self._half * self.eyes.focal / float(line.depths.mean()), 0.5)
        middle, most = int((length + half + RIM + 2.0) / STEP) + 1, int(length / STEP + 0.5)
        places = STEP * np.arange(-middle, middle + 1)
        at = line.pixels[:, :, None] + places[:, None] * line.normals[:, :, None]
        # Profiles of both eyes beside each other: the rims at their ends are not used.
        profile = smoothed_columns(np.concatenate([*self._sample(views, at)], axis=1), SMOOTH)
        shape = len(profile), 2, -1
        inside = filtered_rows(profile, _box(-half, half)).reshape(shape)
        side = filtered_rows(profile, self._rim).reshape(shape)
        shift = round((half + 0.5 * RIM) / STEP)
        before, there, after = (
            part[..., middle - most + by : middle + most + 1 + by].swapaxes(0, 1)
            for part, by in ((side, -shift), (inside, 0), (side, shift))
        )
        score = there - 0.5 * (before + after)
        best = score.argmax(axis=2)
        k = np.clip(best, 1, 2 * most - 1)[..., None]
        a, b, c = (np.take_along_axis(score, k + by, 2)[..., 0] for by in (-1, 0, 1))
        beside = np.take_along_axis(np.maximum(before, after), k, 2)[..., 0]
        bend = np.minimum(a - 2.0 * b + c, -1e-6)
        offset = STEP * (k[..., 0] - most + np.clip(0.5 * (a - c) / bend, -1.0, 1.0))
        weight = (
            np.clip((b - 0.3) / 0.3, 0.0, 1.0)
            * np.clip((0.75 - beside) / 0.25, 0.0, 1.0)
            * ((best > 0) & (best < 2 * most))
            * self._known(line.pixels, length + 2.0, covers)
        )
        by_point = (line.normals[:, :, None] @ line.jacobian)[:, :, 0]
        by_turn = np.cross(line.points - T[:3, 3], by_point)
        return ProfileRows(
            offset.ravel().astype(np.float64),
            np.concatenate([by_point, by_turn], axis=2).reshape(-1, 6),
            line.normals.reshape(-1, 2),
            weight.ravel(),
        )

    def ends(self, views: Sequence[_View], T: Array, covers: Covers | None = None) -> Ends:
        """Measure the ends of the arc in the images: swage and tip, of the left eye first."""
        needle = self.needle
        s = np.arange(-REACH_M, REACH_M, ALONG_M)
        count = len(s)
        line = self._line(T, np.concatenate([-s / needle.radius, needle.arc + s / needle.radius]))
        wire = needle.wire * self.eyes.focal / line.depths
        across = np.maximum(0.5 * wire, 1.0) * np.repeat([0.45, 0.0], count)
        at = line.pixels + np.array([-1.0, 0.0, 1.0])[:, None, None, None] * (
            across[..., None] * line.normals
        )
        there = self._sample(views, at.swapaxes(0, 1)).mean(axis=1).reshape(4, count)
        sums = np.zeros((4, count + 1))
        np.cumsum(np.clip(there, -0.3, 1.3) - 0.5, axis=1, out=sums[:, 1:])
        end, row = np.arange(4), sums[:, 1:].argmax(axis=1) + 1
        first, last = np.maximum(row - 12, 0), np.minimum(row + 12, count)
        contrast = (sums[end, row] - sums[end, first]) / (row - first)
        contrast -= (sums[end, last] - sums[end, row]) / np.maximum(last - row, 1)
        pixels, wires, depths, stretch = (
            part.reshape(4, count, *part.shape[2:])[end, row - 1]
            for part in (line.pixels, wire, line.depths, line.stretch)
        )
        good = (row > 7) & (row < count - 6) & (contrast >= 0.55)
        good &= self._known(pixels.reshape(2, 2, 2), 3.0, covers).ravel() > 0.0
        sign = np.array([-1.0, 1.0, -1.0, 1.0])
        seen = s[row - 1] + 0.5 * ALONG_M + (sign > 0.0) * needle.taper * POINT_PX / wires
        # Ends of an arc that is seen from its edge are less certain.
        weight = contrast * stretch * depths / self.eyes.focal
        return Ends(np.where(good, sign * seen / needle.radius, 0.0), np.where(good, weight, 0.0))

    def roll(self, views: Sequence[_View], T: Array, limit: float = np.pi) -> Array:
        """Return a pose turned about its own axis so that the arc covers the most evidence."""
        count = 360
        line = self._line(T, np.arange(count) * 2.0 * np.pi / count)
        half = 0.5 * self.needle.wire * self.eyes.focal / line.depths
        off = [-0.5 * half, 0.0 * half, 0.5 * half, -half - 2.5, half + 2.5]
        at = line.pixels[:, None] + np.stack(off, 1)[..., None] * line.normals[:, None]
        values = self._sample(views, at)
        on, beside = values[:, :3].mean(axis=1), values[:, 3:]
        covered = (beside.max(axis=1) > 0.6) & (beside.min(axis=1) > 0.45)
        known = ~covered & (self._known(line.pixels, 3.0) > 0.0)
        evidence = np.where(known, np.clip(on, -0.3, 1.3) - 0.5, 0.0).sum(axis=0)
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
            line = self._line(T, start + sign * s)
            half = 0.36 * needle.wire * self.eyes.focal / line.depths
            at = line.pixels + np.array([-1.0, 0.0, 1.0])[:, None, None, None] * (
                half[..., None] * line.normals
            )
            wires = np.clip(self._sample(views, at.swapaxes(0, 1)), -0.3, 1.3).mean(axis=2)
            at = self._line(T, start + sign * beyond).pixels[:, None]
            for there, ground in zip(wires, self._sample(views, at), strict=True):
                if there[1] > 0.4 and ground.mean() < 0.4:
                    found += sign * float(0.5 * (there[0] + there[2]) / there[1] - 0.6)
        return found

    def quality(self, rows: ProfileRows) -> FitQuality:
        """Return the agreement of the profiles' pose with the images."""
        good = (rows.weight > 0.3) & (np.abs(rows.offset) < 2.0)
        n = len(good) // 2
        rms = float(np.sqrt(np.mean(rows.offset[good] ** 2))) if good.any() else np.inf
        return FitQuality(float(good.mean()), float(min(good[:n].mean(), good[n:].mean())), rms)

    def refine(
        self,
        images: Sequence[Picture],
        pose: Array,
        lengths: Sequence[float] = (16.0, 12.0, 8.0, 6.0, 5.0, 4.0),
        colours: Colours | None = None,
        rods: Sequence[Rod] = (),
    ) -> tuple[Array, FitQuality, Colours]:
        """Return the pose that fits best, near a given one, with its quality and its colours."""
        covers = self.covers(rods)
        for k, length in enumerate(lengths):
            if colours is None:
                colours = self.metallic(images, pose)
            elif k:
                fresh = self.colours(images, pose)
                if fresh.separation > 0.7 * colours.separation:
                    colours = fresh
            views = self.views(images, pose, colours, length + 16.0)
            rows = self.rows(views, pose, length, covers)
            pull = np.minimum(1.0, max(1.0, length / 6.0) / np.maximum(np.abs(rows.offset), 1e-6))
            weight = rows.weight * pull
            matrix = (rows.jacobian * weight[:, None]).T @ rows.jacobian + np.diag(
                [1.0] * 3 + [1e-4] * 3
            )
            b = (rows.jacobian * weight[:, None]).T @ rows.offset
            if k:
                ends = self.ends(views, pose, covers)
                row = np.concatenate([np.zeros(3), pose[:3, 2]])
                pull = np.minimum(1.0, 2.0 * END_RAD / np.maximum(np.abs(ends.angle), 1e-9))
                strength = ends.weight * pull * (SIGMA_PX / END_RAD) ** 2 / WORTH
                matrix += strength.sum() * np.outer(row, row)
                b += (strength @ ends.angle) * row
            x = np.asarray(np.linalg.solve(matrix, b), np.float64)
            x[:3] = np.clip(x[:3], -0.004, 0.004)
            x[3:] *= min(1.0, 0.35 / max(float(np.linalg.norm(x[3:])), 1e-9))
            pose = moved(pose, x)
        assert colours is not None  # noqa: S101  there is at least one length
        views = self.views(images, pose, colours, lengths[-1] + 16.0)
        return pose, self.quality(self.rows(views, pose, lengths[-1], covers)), colours

    # ------------------------------------------------------------------ inside

    def _on(self, T: Array, angles: Array) -> Array:
        return self.needle.points(angles) @ T[:3, :3].T + T[:3, 3]

    def _line(self, T: Array, angles: Array) -> _Line:
        points = self._on(T, angles)
        pixels, depths, jacobian = self.eyes.project_with_jacobian(points)
        along = (jacobian @ (self.needle.tangents(angles) @ T[:3, :3].T)[..., None])[..., 0]
        stretch = np.hypot(along[..., 0], along[..., 1])
        along /= np.maximum(stretch, 1e-9)[..., None]
        normals = np.stack([-along[..., 1], along[..., 0]], axis=-1)
        return _Line(points, pixels, depths, jacobian, normals, stretch)

    def _sample(self, views: Sequence[_View], pixels: Array) -> Floats:
        """Return evidence of both eyes at pixels (2, n, k, 2), (2, n, k)."""
        pairs = zip(views, pixels, strict=True)
        return np.stack([between(view.evidence, at - view.corner) for view, at in pairs])

    def _known(self, pixels: Array, margin: float, covers: Covers | None = None) -> Array:
        """Return 1 where pixels (2, n, 2) are in the image and not covered, else 0, (2, n)."""
        free = ((pixels > margin) & (pixels < self._limit - margin)).all(axis=-1)
        if covers is not None:
            off = pixels - covers.starts
            along = (off * covers.ways).sum(-1) / ((covers.ways**2).sum(-1) + 1e-9)
            off -= np.clip(along, 0.0, 1.0)[..., None] * covers.ways
            free = free & ((off**2).sum(-1) > covers.halves**2).all(axis=0)
        return np.asarray(free, np.float64)


def _box(low: float, high: float) -> Array:
    """Return a kernel that averages samples from low to high [px] about the middle one."""
    count = int(np.ceil(max(-low, high) / STEP)) + 1
    edges = (np.arange(-count, count + 2) - 0.5) * STEP
    share = np.clip(edges, low, high)
    kernel = np.diff(share)
    return np.asarray(kernel / kernel.sum(), np.float64)
