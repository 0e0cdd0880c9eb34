"""Joints, frames and closing hinges from TOML.

The pin of a closing hinge may shift along its own axis, so that loops with skew axes close. Four
hinges whose axes are not parallel cannot turn unless something gives. In a real linkage it is the
play along the pins; here it is a passive frame, the pin, that slides from point_b along the axis
that frame_a turns about, and carries the point that both sides share.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import cast

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.records import Body, JointDescription, Spring
from trocar.descriptions.table import Table
from trocar.errors import TrocarError
from trocar.geometry.dh import modified_dh, standard_dh
from trocar.geometry.rotations import check_rotation, matrix_from_rotation_vector, matrix_from_rpy
from trocar.geometry.se3 import inverse, transform
from trocar.kinematics.mechanism import Closure, Frame, Motion

Array = NDArray[np.float64]


def read_joint(row: Table) -> JointDescription:
    """Return a public joint with its limits and what drives it."""
    name = row.text("name")
    kind = row.text("kind", allowed=("revolute", "prismatic"))
    turns = kind == "revolute"
    measure, way = ("angle", "angular") if turns else ("length", "linear")
    effort = "torque" if turns else "force"
    lower, upper = row.quantity("lower", measure), row.quantity("upper", measure)
    if not lower < upper:
        raise row.fail("lower", f"got {lower:g}; allowed: less than the upper limit {upper:g}")
    drive = row.table("drive")
    if len(drive.entries()) != 1:
        raise row.fail("drive", f"got {drive.entries()}; allowed: one frame = weight")
    joint = JointDescription(
        name=name,
        kind="revolute" if turns else "prismatic",
        lower=lower,
        upper=upper,
        effort_max=row.positive("effort_max", effort, default=np.inf),
        velocity_max=row.positive("velocity_max", f"{way} velocity", default=np.inf),
        acceleration_max=row.positive("acceleration_max", f"{way} acceleration", default=np.inf),
        tracking_tolerance=row.positive("tracking_tolerance", measure, default=np.inf),
        drive=tuple((frame, drive.number(frame)) for frame in drive.entries()),
        stop_lower=row.quantity("stop_lower", measure, default=lower),
        stop_upper=row.quantity("stop_upper", measure, default=upper),
        no_load=row.positive("no_load", f"{way} velocity", default=np.inf),
        stall=row.positive("stall", effort, default=np.inf),
        spring=_read_spring(row) if turns else None,
        source=row.text("source", ""),
    )
    if not lower <= joint.stop_lower < joint.stop_upper <= upper:
        raise row.fail("stop_lower", "mechanical stops must lie inside the limits")
    if np.isfinite(joint.no_load) != np.isfinite(joint.stall) or joint.stall < joint.effort_max:
        got = f"got {joint.stall:g} with a no-load speed of {joint.no_load:g}"
        raise row.fail("stall", f"{got}; allowed: both or none, and effort_max or more")
    return joint


def _read_spring(row: Table) -> Spring | None:
    """Return the spring of a joint without a motor, None of one with a motor."""
    if "spring" not in row:
        return None
    table = row.table("spring")
    stiffness = table.positive("stiffness", "angular stiffness", default=0.0)
    spring = Spring(stiffness, table.quantity("rest", "angle"))
    table.done()
    return spring


def read_frame(row: Table) -> Frame:
    """Return a frame: where it stands on its parent, and what moves it."""
    name = row.text("name")
    parent = row.text("parent", "") or None
    motion = cast(Motion, row.text("motion", "fixed", allowed=("fixed", "revolute", "prismatic")))
    before, after = _read_placement(row)
    if motion == "fixed":
        before, after = before @ after, np.eye(4)
    coupling = row.optional_table("q")
    couplings = tuple((joint, coupling.number(joint)) for joint in coupling.entries())
    if (motion == "fixed") != (not couplings):
        raise row.fail("q", "a moving frame needs q = { joint = ratio }, a fixed one has none")
    measure = "length" if motion == "prismatic" else "angle"
    lower = row.quantity("lower", measure, default=-np.inf)
    upper = row.quantity("upper", measure, default=np.inf)
    if not lower < upper:
        raise row.fail("lower", f"got {lower:g}; allowed: less than the upper limit {upper:g}")
    return Frame(name, parent, motion, before, after, couplings, lower, upper)


def _read_placement(row: Table) -> tuple[Array, Array]:
    """Return (before, after) of a frame: what comes ahead of its motion and what follows."""
    if "dh" in row:
        convention = row.text("dh", allowed=("modified", "standard"))
        a = row.quantity("a", "length", default=0.0)
        alpha = row.quantity("alpha", "angle", default=0.0)
        d = row.quantity("d", "length", default=0.0)
        theta = row.quantity("theta", "angle", default=0.0)
        if convention == "modified":
            return exact(modified_dh(a, alpha, d, theta)), np.eye(4)
        return exact(standard_dh(0.0, 0.0, d, theta)), exact(standard_dh(a, alpha, 0.0, 0.0))
    turned = "rotation" not in row and row.has("rpy", "angle")
    at = read_pose(row)
    return exact(at) if turned else at, np.eye(4)


def read_pose(row: Table) -> Array:
    """Return a pose given as xyz and rpy or rotation, identity when absent, (4, 4)."""
    turn = np.eye(3)
    if "rotation" in row:
        try:
            turn = check_rotation(row.matrix("rotation", 3, 3))
        except TrocarError as problem:
            raise row.fail("rotation", str(problem)) from problem
    elif row.has("rpy", "angle"):
        turn = matrix_from_rpy(*row.vector("rpy", 3, "angle"))
    return transform(turn, row.vector("xyz", 3, "length", default=np.zeros(3)))


def exact(matrix: Array) -> Array:
    """Return a matrix whose entries at right angles are exactly 0 and 1 (cos 90 deg is 6e-17)."""
    return np.where(np.abs(matrix) < 1e-15, 0.0, matrix)


def read_closure(row: Table) -> tuple[Closure, bool]:
    """Return a hinge that closes a loop, and whether its pin may slide along its axis."""
    name = row.text("name")
    passive, guard = row.texts("passive"), row.texts("guard")
    if len(passive) != 2:
        raise row.fail("passive", f"got {list(passive)}; allowed: the two frames it determines")
    if len(guard) not in (0, 2):
        raise row.fail("guard", f"got {list(guard)}; allowed: two frames, or none")
    closure = Closure(
        name,
        row.text("frame_a"),
        row.vector("point_a", 3, "length"),
        row.text("frame_b"),
        row.vector("point_b", 3, "length"),
        (passive[0], passive[1]),
        guard,
        row.flag("open", False),
    )
    return closure, row.flag("slides", False)


#: A pin's own mass, and what resists its slide besides, as a rotor does [kg]. Source: measured on a
#: PSM and an ECM with skew axes under 10 N: with 0.2 kg loop errors are half as large again, with
#: 5 kg as small; a pin slides by parts of a millimetre, so neither matters.
PIN_MASS_KG = 0.001
PIN_ROTOR_KG = 1.0
#: Inertia of a ball of 1 g and 10 mm. [kg m^2]
PIN_INERTIA = 4e-8


def pin_name(closure: str) -> str:
    """Return the name of a closure's pin."""
    return f"{closure}_pin"


def pinned(closure: Closure) -> Closure:
    """Return a closure whose side b is its pin."""
    pin = pin_name(closure.name)
    passive = (*closure.passive[:2], pin)
    return replace(closure, frame_b=pin, point_b=np.zeros(3), passive=passive)


def pin_frame(closure: Closure, frames: Mapping[str, Frame]) -> Frame:
    """Return the frame of a closure's pin: slides from point_b on frame_b along frame_a's axis.

    Args:
        closure: not pinned, on frames that `rest_poses` has
        frames: of the mechanism by name; they stand as at coordinate 0 of each
    """
    at, frame_a = rest_poses(frames), frames[closure.frame_a]
    axis = at[frame_a.name] @ inverse(frame_a.after)
    turned = at[closure.frame_b][:3, :3].T @ axis[:3, 2]
    before = transform(_rotation_to(turned), closure.point_b)
    return Frame(pin_name(closure.name), closure.frame_b, "prismatic", before, np.eye(4))


def rest_poses(frames: Mapping[str, Frame]) -> dict[str, Array]:
    """Return the pose in the root of each frame that has one, at coordinate 0 of each, (4, 4)."""
    at: dict[str, Array] = {}
    for frame in frames.values():
        if frame.parent is None or frame.parent in at:
            parent = np.eye(4) if frame.parent is None else at[frame.parent]
            at[frame.name] = parent @ frame.before @ frame.after
    return at


def _rotation_to(axis: Array) -> Array:
    """Return the smallest rotation that takes the z axis to this one, or to its opposite."""
    z = axis if axis[2] >= 0.0 else -axis
    across = np.array([-z[1], z[0], 0.0])  # z axis x axis
    sine = float(np.linalg.norm(across))
    if sine == 0.0:
        return np.eye(3)
    return matrix_from_rotation_vector(across * (np.arctan2(sine, z[2]) / sine))


def pin_body(closure: str, part: str) -> Body:
    """Return what a pin weighs."""
    return Body(
        frame=pin_name(closure),
        mass=PIN_MASS_KG,
        com=np.zeros(3),
        inertia=PIN_INERTIA * np.eye(3),
        shapes=(),
        inertia_from="shape",
        source="our own choice: a pin too light to be felt",
        part=part,
    )
