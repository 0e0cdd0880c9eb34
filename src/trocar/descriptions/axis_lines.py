"""The axes of a mechanism as lines at home, their distances and angles.

The distance of two lines that are not parallel depends on where along them it is taken. Everywhere
in trocar it is taken in one plane: across the mean direction of the lines, through one point, the
datum. The datum of a description is the origin of the frame of its plan's first axis.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trocar.geometry.se3 import inverse, transform
from trocar.kinematics.forward import poses
from trocar.kinematics.mechanism import Mechanism

Array = NDArray[np.float64]

#: Direction from the pitch axis to the centre in the paper's frame. Source: closed-loop paper,
#: Table 7. The paper does not give the sense of the axis across both; it is our own choice.
TOWARDS: dict[str, tuple[float, float, float]] = {"PSM": (0.0, -1.0, 0.0), "ECM": (1.0, 0.0, 0.0)}


@dataclass(frozen=True, eq=False)
class Line:
    """An axis in some frame.

    Attributes:
        point: on it, (3,) [m]
        direction: along it, a unit vector, (3,)
    """

    point: Array
    direction: Array

    def moved(self, T_ab: Array) -> Line:
        """Return the line, given in b, in a."""
        return Line(T_ab[:3, :3] @ self.point + T_ab[:3, 3], T_ab[:3, :3] @ self.direction)


def home_lines(mechanism: Mechanism, axes: Mapping[str, str]) -> dict[str, Line]:
    """Return axes at joint positions 0, or at the limit where 0 lies beyond it, in the root.

    Args:
        mechanism: whose
        axes: {label: frame or closure}. A frame's axis passes the origin that it has before its
            motion; a closure's passes its point, parallel to what frame_a turns about

    Returns:
        {label: line}
    """
    q = np.clip(np.zeros(len(mechanism.joints)), mechanism.lower, mechanism.upper)
    at = poses(mechanism, q, mechanism.frames[0].name)
    return {label: _line(mechanism, at, name) for label, name in axes.items()}


def _line(mechanism: Mechanism, at: Mapping[str, Array], name: str) -> Line:
    closure = next((c for c in mechanism.closures if c.name == name), None)
    frame = mechanism.frame(name if closure is None else closure.frame_a)
    hinge = at[frame.name] @ inverse(frame.after)  # a standard DH row puts its frame off its axis
    return Line((hinge if closure is None else at[name])[:3, 3], hinge[:3, 2])


def mean_direction(lines: Sequence[Line]) -> Array:
    """Return the mean direction of lines, (3,); each may point either way."""
    first = lines[0].direction
    total = np.sum([np.copysign(1.0, n.direction @ first) * n.direction for n in lines], axis=0)
    return np.asarray(total / np.linalg.norm(total), dtype=np.float64)


def along_to_plane(line: Line, through: Array, normal: Array) -> float:
    """Return the distance along a line from its point to its intersection with a plane [m]."""
    return float((through - line.point) @ normal) / float(line.direction @ normal)


def line_distance(one: Line, two: Line, through: Array) -> float:
    """Return the distance of two lines in the plane across both, through a point (3,) [m]."""
    first, second = _pierced((one, two), through)
    return float(np.linalg.norm(second - first))


def line_angle(to: tuple[Line, Line], start: tuple[Line, Line], through: Array) -> float:
    """Return the angle from where one pair of lines leads to where another does [rad].

    A pair leads from its first line to its second, in the plane across all four through a point.
    The angle is positive about the direction of the first line of `start`.
    """
    lines = (*start, *to)
    a, b, c, d = _pierced(lines, through)
    about = np.cross(b - a, d - c) @ lines[0].direction
    return float(np.arctan2(about, (b - a) @ (d - c)))


def _pierced(lines: Sequence[Line], through: Array) -> list[Array]:
    """Return the intersections of lines with the plane across their mean direction at a point."""
    normal = mean_direction(lines)
    return [n.point + along_to_plane(n, through, normal) * n.direction for n in lines]


def axes_frame(x: Array, sense: float, towards: Array) -> Array:
    """Return the frame of the first two joint axes, (4, 4).

    Args:
        x: the centre, then point and direction of the pitch axis, then of the yaw axis, (15,)
        sense: +1 or -1, the factor that points the pitch axis along the description's
        towards: where in the paper's frame the centre lies, (3,)
    """
    centre, g, h, y, k = x.reshape(5, 3)
    z = sense * h
    # The point of the pitch axis nearest to the yaw axis.
    across = np.cross(k, np.cross(h, k))
    origin = g + h * float((y - g) @ across / (h @ across))
    up = k - (k @ z) * z
    up *= np.sign(up @ (centre - origin)) / np.linalg.norm(up)
    side = np.cross(z, up)
    across_axes = np.column_stack([up, side, z])
    drawn = np.column_stack([towards, np.cross([0.0, 0.0, 1.0], towards), [0.0, 0.0, 1.0]])
    return transform(across_axes @ drawn.T, origin)
