"""The joints of an arm's chain one after another: distance and angle of each axis to the next.

Of two axes that are parallel the distance counts, of others the distance along their
common normal, whose sense the two directions give, and the angle between them. A slide has a
direction only.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.axis_lines import Line, home_lines, line_distance
from trocar.descriptions.records import ArmDescription

Array = NDArray[np.float64]

#: Axes count as parallel within this. Source: our own choice; real ones lean by a degree. [rad]
PARALLEL_RAD = 0.1


@dataclass(frozen=True, eq=False)
class SerialJoint:
    """A joint of the chain.

    Attributes:
        frame: the frame that it moves; the axis goes by its name
        parent: the frame that moves the link before it, the root for what rests
        slides: whether it slides
        column: its place among the mechanism's joints, -1 where several move it
        sense: 1 where its coordinate grows with the joint's position, else -1
        line: its axis at joint positions 0, in the root
    """

    frame: str
    parent: str
    slides: bool
    column: int
    sense: float
    line: Line


def serial_joints(arm: ArmDescription) -> tuple[SerialJoint, ...]:
    """Return the joints from an arm's root to its tip, without those of its tool."""
    mechanism = arm.mechanism
    chain = [mechanism.frames[i] for i in sorted(mechanism.chain(mechanism.tip))]
    names = [frame.name for frame in chain]
    if arm.tool_frame in names:
        chain = chain[: names.index(arm.tool_frame) + 1]
    moving = [frame for frame in chain if frame.motion != "fixed"]
    lines = home_lines(mechanism, {frame.name: frame.name for frame in moving})
    before = [arm.root, *(frame.name for frame in moving)]
    return tuple(
        SerialJoint(
            frame.name,
            parent,
            frame.motion == "prismatic",
            mechanism.joint_names.index(frame.couplings[0][0]) if len(frame.couplings) == 1 else -1,
            -1.0 if frame.couplings and frame.couplings[0][1] < 0.0 else 1.0,
            lines[frame.name],
        )
        for frame, parent in zip(moving, before, strict=False)
    )


def parallel(one: Line, two: Line) -> bool:
    """Return whether two axes count as parallel."""
    return bool(np.linalg.norm(np.cross(one.direction, two.direction)) < PARALLEL_RAD)


def spacing(one: Line, two: Line, through: Array | None) -> float:
    """Return the distance between two axes [m].

    Args:
        one, two: in one frame
        through: of axes that count as parallel, a point of the plane across them in which they are
            compared, (3,) [m]; None: along the common normal, positive along the cross product of
            the directions
    """
    if through is not None:
        return line_distance(one, two, through)
    normal = np.cross(one.direction, two.direction)
    return float((two.point - one.point) @ normal / np.linalg.norm(normal))


def tilt(one: Line, two: Line) -> float:
    """Return the angle between the directions of two axes [rad]."""
    across = np.linalg.norm(np.cross(one.direction, two.direction))
    return float(np.arctan2(across, one.direction @ two.direction))


def serial_figures(
    joints: tuple[SerialJoint, ...], markers: Mapping[str, Array] | None = None
) -> Mapping[str, Mapping[str, float]]:
    """Return distance and angle of each axis to the next one.

    Args:
        joints: in turn
        markers: {link: place of its markers in the root at joint positions 0 (3,) [m]}, where
            parallel axes that lean are compared; when omitted at a point of the first axis

    Returns:
        {"distances_m": {"a-b": [m]}, "angles_rad": {"a-b": [rad]}}; angles of those that are not
        parallel
    """
    distances: dict[str, float] = {}
    angles: dict[str, float] = {}
    for one, two in pairwise(joints):
        level, label = parallel(one.line, two.line), f"{one.frame}-{two.frame}"
        if not (one.slides or two.slides):
            at = one.line.point if markers is None else markers[one.frame]
            distances[label] = spacing(one.line, two.line, at if level else None)
        if not level:
            angles[label] = tilt(one.line, two.line)
    return {"distances_m": distances, "angles_rad": angles}
