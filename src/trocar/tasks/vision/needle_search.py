"""Finding a needle without a pose to start from: on its own, or in the jaws of a tool."""

from __future__ import annotations

from collections.abc import Sequence
from typing import cast

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.needles import Needle
from trocar.geometry import transform
from trocar.tasks.vision.eyes import Eyes, Picture
from trocar.tasks.vision.images import Floats, Lines, bright_lines, distances, metal

Array = NDArray[np.float64]

#: Depths at which needles are looked for [m]. Source: our own choice, about the working distance.
NEAREST_M, FARTHEST_M = 0.04, 0.16
#: Largest ratio of the pixels that are lines. Source: our own choice, 1.5 times that of a needle at
#: 60 mm and its jaws.
LINES = 0.03
#: Triples of points that are tried, and circles that are scored. Source: our own choice.
TRIPLES, CIRCLES = 2400, 400
#: Largest distance of a seen point from a line, by the focal length, 3.7 px at 1280x720; the second
#: for jaws, whose pose has an error. Source: our own choice.
NEAR, NEAR_HELD = 1.0 / 300.0, 1.0 / 110.0
#: Largest error of the radius of a circle through three points [m]. Source: stereo noise at 100 mm.
RADIUS_M = 0.0022
#: Points along an arc, turns about the wire, places along it, of needles in jaws. Source: our own
#: choice: 5 degrees, 0.6 mm.
POINTS, TURNS, PLACES = 36, 72, 20
#: Range of jaws' grips on needles, as ratios of the arc from the swage. Source: guides of suturing
#: (1/3 to 1/2), with room.
FROM, TO = 0.12, 0.62


class NeedleSearch:
    """Lines of a pair of images, and poses that explain them.

    Args:
        eyes: the cameras
        needle: its dimensions
        images: left and right
    """

    def __init__(self, eyes: Eyes, needle: Needle, images: Sequence[Picture]) -> None:
        self.eyes, self.needle = eyes, needle
        thick = needle.wire * eyes.focal / 0.08
        sigma = max(1.2, 0.5 * thick / np.sqrt(3.0))
        least = int(0.2 * needle.length * eyes.focal / FARTHEST_M)
        self._lines: list[Lines] = []
        self._distance: list[Floats] = []
        for image in images:
            values = metal(image)
            lines = bright_lines(values, sigma, LINES, least)
            self._lines.append(lines)
            self._distance.append(distances(lines, values.shape))

    def held(self, T_left_tip: Array, reach: float, count: int = 24) -> list[Array]:
        """Return poses of a needle in the jaws of a tool, best first.

        The wire runs along the tip's x axis, the hinge of the jaws: a place along the wire and a
        turn about it are left, and two signs.

        Args:
            T_left_tip: the tool's tip, z along the fingers, (4, 4)
            reach: from there to where the jaws hold [m]
            count: of poses
        """
        needle = self.needle
        turns = np.linspace(-np.pi, np.pi, TURNS, endpoint=False)
        found: list[Array] = []
        for sign in (-1.0, 1.0):
            radial = np.stack([0.0 * turns, np.sin(turns), np.cos(turns)], axis=1)
            tangent = np.tile([sign, 0.0, 0.0], (TURNS, 1))
            grips = np.stack([radial, tangent, np.cross(radial, tangent)], axis=2)
            for share in np.linspace(FROM, TO, PLACES):
                at = needle.pose(share * needle.arc)
                T = np.tile(np.eye(4), (TURNS, 1, 1))
                T[:, :3, :3] = grips @ at[:3, :3].T
                T[:, :3, 3] = [0.0, 0.0, reach] - T[:, :3, :3] @ at[:3, 3]
                found.append(T_left_tip @ T)
        poses = np.concatenate(found)
        line = needle.points(np.linspace(0.0, needle.arc, POINTS))
        points = np.einsum("hij,nj->hni", poses[:, :3, :3], line) + poses[:, None, :3, 3]
        scores = self._near(points, NEAR_HELD).mean(axis=1)
        return self._best(poses, scores, count)

    def free(self, rng: np.random.Generator, count: int = 24) -> list[Array]:
        """Return poses of a needle anywhere, best first, by circles through points of both eyes."""
        X = self._matched(rng)
        if len(X) < 10:
            return []
        centres, normals, starts = self._circles(X, rng)
        if not len(centres):
            return []
        samples = 120
        angles = np.arange(samples) * 2.0 * np.pi / samples
        y = np.cross(normals, starts)
        ring = (
            np.cos(angles)[:, None] * starts[:, None] + np.sin(angles)[:, None] * y[:, None]
        ) * self.needle.radius + centres[:, None]
        seen = self._near(ring, NEAR)
        width = min(round(self.needle.arc / (2.0 * np.pi) * samples), samples)
        sums = np.concatenate([np.zeros((len(seen), 1)), np.cumsum(np.tile(seen, 2), axis=1)], 1)
        windows = sums[:, width : width + samples] - sums[:, :samples]
        inside, first = windows.max(axis=1), windows.argmax(axis=1)
        outside = (seen.sum(axis=1) - inside) / max(samples - width, 1)
        scores = inside / width - 0.35 * outside
        poses = np.tile(np.eye(4), (len(seen), 1, 1))
        a = angles[first][:, None]
        poses[:, :3, 0] = np.cos(a) * starts + np.sin(a) * y
        poses[:, :3, 1] = np.cos(a) * y - np.sin(a) * starts
        poses[:, :3, 2], poses[:, :3, 3] = normals, centres
        return self._best(poses, scores, count)

    # ------------------------------------------------------------------ inside

    def _near(self, points: Array, share: float) -> Array:
        """Return the nearness of points (h, n, 3) to lines of both eyes, 0 to 1, (h, n)."""
        width, height = self.eyes.size
        found = np.zeros(points.shape[:2])
        for eye, distance in enumerate(self._distance):
            u, v = np.round(self.eyes.project(points, eye)).astype(int).transpose(2, 0, 1)
            inside = (u >= 0) & (u < width) & (v >= 0) & (v < height) & (points[..., 2] > 0.02)
            off = np.full(u.shape, np.inf)
            off[inside] = distance[v[inside], u[inside]]
            found += 0.5 * np.clip(1.0 - off / (share * self.eyes.focal), 0.0, 1.0)
        return found

    def _best(self, poses: Array, scores: Array, count: int) -> list[Array]:
        """Return the best poses that differ."""
        picked: list[Array] = []
        for row in np.argsort(-scores)[:400]:
            T = poses[row]
            if all(
                np.linalg.norm(T[:3, 3] - other[:3, 3]) > 0.002
                or T[:3, 2] @ other[:3, 2] < 0.95
                or T[:3, 0] @ other[:3, 0] < 0.8
                for other in picked
            ):
                picked.append(T)
            if len(picked) == count:
                break
        return picked

    def _matched(self, rng: np.random.Generator) -> Array:
        """Return points where lines of both eyes cross an epipolar line, (n, 3).

        Eyes that squint are turned to be parallel first.
        """
        left, right = self._lines
        steep = np.flatnonzero(np.abs(np.sin(left.angles)) > 0.3)
        if len(steep) < 20 or len(right.points) < 20:
            return np.zeros((0, 3))
        if len(steep) > 2500:
            steep = rng.choice(steep, 2500, replace=False)
        T = self.eyes.T_eye_left[1]
        base = -T[:3, :3].T @ T[:3, 3]  # the right eye in the left one's frame
        x = base / np.linalg.norm(base)
        z = np.cross(x, [0.0, 1.0, 0.0])
        turn = np.stack([x, np.cross(z, x), z]) / np.linalg.norm(z)
        turn[0] = x
        one = self._turned(left.points[steep], 0, turn)
        other = self._turned(right.points, 1, turn @ T[:3, :3].T)
        order = np.argsort(other[:, 1])
        rows = other[order, 1]
        slack = 0.7 / self.eyes.focal
        low, high = (np.searchsorted(rows, one[:, 1] + s) for s in (-slack, slack))
        i = np.repeat(np.arange(len(one)), high - low)
        first = np.repeat(low - np.concatenate([[0], np.cumsum(high - low)[:-1]]), high - low)
        j = order[np.arange(len(i)) + first]
        disparity = one[i, 0] - other[j, 0]
        length = float(np.linalg.norm(base))
        turned = left.angles[steep[i]] - right.angles[j]
        turned = np.abs((turned + 0.5 * np.pi) % np.pi - 0.5 * np.pi)
        good = (
            (disparity > length / FARTHEST_M) & (disparity < length / NEAREST_M) & (turned < 0.35)
        )
        i, disparity = i[good], disparity[good]
        depth = length / disparity
        return np.stack([one[i, 0] * depth, one[i, 1] * depth, depth], axis=1) @ turn

    def _turned(self, pixels: Array, eye: int, turn: Array) -> Array:
        flat = self.eyes.flat(pixels, eye)
        p = np.concatenate([flat, np.ones((len(flat), 1))], axis=1) @ turn.T
        return p[:, :2] / p[:, 2:]

    def _circles(self, X: Array, rng: np.random.Generator) -> tuple[Array, Array, Array]:
        """Return centres, normals and directions of the first point, (m, 3) each, of circles.

        The first point of a triple is random, the others lie within a needle's chord of it.
        """
        R = self.needle.radius
        first = rng.integers(len(X), size=TRIPLES)
        chord = 2.0 * R if self.needle.arc >= np.pi else 2.0 * R * np.sin(0.5 * self.needle.arc)
        pool = X[rng.permutation(len(X))[:1500]]
        gap = np.linalg.norm(X[first][:, None] - pool[None], axis=2)
        allowed = (gap > 0.0022) & (gap < chord + 0.001)
        some = allowed.sum(axis=1) >= 2
        first, allowed = first[some], allowed[some]
        dice = cast(Array, rng.random(allowed.shape) * allowed)
        pair = np.argpartition(-dice, 2, axis=1)[:, :2]
        A, B, C = X[first], pool[pair[:, 0]], pool[pair[:, 1]]
        ab, ac = B - A, C - A
        normal = np.cross(ab, ac)
        area = np.maximum((normal**2).sum(axis=1), 1e-24)
        bb, cc = (ab**2).sum(axis=1)[:, None], (ac**2).sum(axis=1)[:, None]
        to_centre = (np.cross(normal, ab) * cc + np.cross(ac, normal) * bb) / (2.0 * area[:, None])
        radius = np.linalg.norm(to_centre, axis=1)
        sides = np.stack(
            [np.linalg.norm(B - C, axis=1), *(np.linalg.norm(v, axis=1) for v in (ab, ac))]
        )
        good = (
            (sides.min(axis=0) > 0.0022)
            & (sides.max(axis=0) > 0.7 * R)
            & (np.abs(radius - R) < RADIUS_M)
        )
        a, b, c, normal, to_centre, radius = (
            v[good][:CIRCLES] for v in (A, B, C, normal, to_centre, radius)
        )
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        centre = a + to_centre
        # The needle's own radius about the middle of the three points.
        out = centre - (a + b + c) / 3.0
        out /= np.maximum(np.linalg.norm(out, axis=1, keepdims=True), 1e-9)
        centre = centre + out * (R - radius)[:, None]
        start = a - centre
        start -= normal * (start * normal).sum(axis=1, keepdims=True)
        start /= np.maximum(np.linalg.norm(start, axis=1, keepdims=True), 1e-9)
        return centre, normal, start


def flipped(needle: Needle, T: Array) -> Array:
    """Return the same arc run from its other end: tip and swage exchanged."""
    c, s = np.cos(needle.arc), np.sin(needle.arc)
    return T @ transform(np.array([[c, s, 0.0], [s, -c, 0.0], [0.0, 0.0, -1.0]]), np.zeros(3))


def mirrored(T: Array) -> Array:
    """Return a pose tilted the other way about the line of sight, which nearly looks the same."""
    sight = T[:3, 3] / np.linalg.norm(T[:3, 3])
    found = T.copy()
    found[:3, :3] = (np.eye(3) - 2.0 * np.outer(sight, sight)) @ T[:3, :3]
    found[:3, 2] *= -1.0
    return found
