"""The pull of a thread: a straight way of the jaw, on which the needle turns in line with it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.needles import Needle
from trocar.geometry.rotations import matrix_from_rotation_vector
from trocar.geometry.se3 import inverse, transform

Array = NDArray[np.float64]
UP = np.array([0.0, 0.0, 1.0])

#: Distance of a held needle beyond the tip, the fingers' pivot. Source: 2 mm before the end of a
#: large needle driver's pads. [m]
REACH_M = 0.0085
#: Directions of the pull: back across the wound, up, and towards the arm's own side along it.
#: Source: our own choice; the first closes a wound with the least force.
PULLS = ((0.9, 0.45, 0.0), (0.4, 0.7, 0.6), (0.0, 0.8, 0.6))
#: Those where something is in the way of each of these: straight up. Source: measured: with four
#: stitches a forearm of an Si meets the endoscope's in all others.
LAST_PULLS = ((0.0, 1.0, 0.0),)
#: Least distance of an instrument from the endoscope's shaft. Source: our own choice: both are 9 mm
#: thick. [m]
APART_M = 0.03
#: Length of the pull beyond the thread's free length at which it ends though it is not tight: edges
#: of the wound come along. Source: our own choice. [m]
GIVES_M = 0.02
#: Part of the pull within which the needle turns in line with it; ratios of this turn that are
#: tried, and steps in which reach is checked then. Source: our own choice. [m, m]
TURN_M, SHARES, STEP_M = 0.02, (1.0, 0.75, 0.5, 0.25, 0.0), 0.004


@dataclass(frozen=True, eq=False)
class Pull:
    """A straight pull.

    Attributes:
        start: pose of the tip where it begins, in the world (4, 4)
        way: its direction, (3,)
        turn: of the needle within `TURN_M`, a rotation vector in the world (3,) [rad]
        length: after which it ends though the thread is not tight [m]
    """

    start: Array
    way: Array
    turn: Array
    length: float

    def pose(self, pulled: float) -> Array:
        """Return the pose of the tip in the world after a part of the pull, (4, 4) [m]."""
        part = min(1.0, pulled / TURN_M)
        facing = matrix_from_rotation_vector(part * self.turn) @ self.start[:3, :3]
        return transform(facing, self.start[:3, 3] + pulled * self.way)

    def continuing(self, first: Pull) -> Pull:
        """Return the pull that ends as far from the start of the first one as that would.

        Args:
            first: pull whose way something blocked, and which this one goes on with
        """
        before = self.start[:3, 3] - first.start[:3, 3]
        along = float(before @ self.way)
        root = max(0.0, along**2 + first.length**2 - float(before @ before))
        return replace(self, length=max(0.0, float(np.sqrt(root)) - along))

    def poses(self) -> list[Array]:
        """Return the poses at which reach is checked, (4, 4) each."""
        return [self.pose(depth) for depth in np.arange(0.0, self.length, STEP_M)]


def clear_ways(
    start: Array,
    axes: Array,
    free: float,
    scopes: Sequence[tuple[Array, Array]],
    directions: Sequence[tuple[float, float, float]] = PULLS,
) -> list[Array]:
    """Return the directions of a pull that stay clear of endoscopes, the best first, (3,) each.

    Where none does, the last one.

    Args:
        start: position of the tip in the world, (3,) [m]
        axes: across the wound, up, and towards the arm's own side along it, rows (3, 3)
        free: length of thread that is pulled through [m]
        scopes: both ends of the shafts of endoscopes, in the world
        directions: in these axes
    """
    ways = [way @ axes / np.linalg.norm(way) for way in np.array(directions)]
    lines = [np.linspace(*ends, 20) for ends in scopes]
    found: list[Array] = []
    for way in ways:
        reach = start + np.linspace(0.0, free, 20)[:, None, None] * way
        gaps = [np.linalg.norm(reach - line, axis=2).min() for line in lines]
        if min(gaps, default=np.inf) > APART_M:
            found.append(way)
    return found or ways[-1:]


def pulls(
    start: Array, held: Array, needle: Needle, ways: Sequence[Array], free: float
) -> Iterator[Pull]:
    """Yield pulls that can be made, the best first: along each way with the needle in line or less.

    Args:
        start: pose of the tip in the world, (4, 4)
        held: the same in the needle's frame, (4, 4)
        needle: whose swage the thread leaves
        ways: directions, (3,) each
        free: length of thread that is pulled through [m]
    """
    grip = held[:3, 3] + REACH_M * held[:3, 2]
    chord = (start @ inverse(held))[:3, :3] @ (grip - needle.swage[:3, 3])
    for way in ways:
        axis = np.cross(chord, way)
        sine = float(np.linalg.norm(axis))
        turn = np.arctan2(sine, chord @ way) / max(sine, 1e-12) * axis
        for share in SHARES:
            yield Pull(start, way, share * turn, free + GIVES_M)
