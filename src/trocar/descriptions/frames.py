"""Joints, frames and closing hinges from TOML.

The pin of a closing hinge may shift along its own axis, so that loops with skew axes close. Four
hinges whose axes are not parallel cannot turn unless something gives. In a real linkage it is the
play along the pins; here it is a passive frame, the pin, that slides from point_b along the axis
that frame_a turns about, and carries the point that both sides share.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.keys import key
from trocar.descriptions.records import Body, JointDescription, Spring
from trocar.descriptions.table import Table
from trocar.errors import TrocarError
from trocar.geometry.dh import modified_dh, standard_dh
from trocar.geometry.rotations import check_rotation, matrix_from_rotation_vector, matrix_from_rpy
from trocar.geometry.se3 import inverse, transform
from trocar.kinematics.mechanism import Closure, Frame, JointKind, Motion

Array = NDArray[np.float64]


def _origin() -> Array:
    return np.zeros(3)


def read_joint(row: Table) -> JointDescription:
    """Return a public joint with its limits and what drives it."""
    kind = row.text("kind", allowed=get_args(JointKind))
    turns = kind == "revolute"
    drive = row.table("drive")
    if len(drive.entries()) != 1:
        raise row.fail("drive", f"got {drive.entries()}; allowed: one frame = weight")
    joint = row.record(
        JointDescription,
        turns=turns,
        drive=tuple((frame, drive.number(frame)) for frame in drive.entries()),
        spring=_read_spring(row) if turns else None,
    )
    lower, upper = joint.lower, joint.upper
    if not lower < upper:
        raise row.fail("lower", f"got {lower:g}; allowed: less than the upper limit {upper:g}")
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
    spring = table.record(Spring)
    table.done()
    return spring


@dataclass(frozen=True, eq=False)
class FrameKeys:
    """Keys of a frame beside its placement.

    Attributes:
        name, parent: of the frame
        motion: along or about z
        q: `{ pitch = -1.0 }`: coordinate = sum of ratio times joint; several only inside a loop
        lower, upper: range of its coordinate, where several joints move it; default: none
            [rad or m]
    """

    name: str = field(metadata=key())
    parent: str = field(default="", metadata=key())
    motion: Motion = field(default="fixed", metadata=key())
    q: Mapping[str, float] = field(default_factory=dict[str, float], metadata=key())
    lower: float = field(default=-np.inf, metadata=key("angle", "length"))
    upper: float = field(default=np.inf, metadata=key("angle", "length"))


@dataclass(frozen=True)
class DhKeys:
    """Keys of a frame's placement by Denavit and Hartenberg.

    Attributes:
        dh: convention of the row of the next four keys
        a, alpha, d, theta: the motion adds to theta or d [m, rad, m, rad]
    """

    dh: Literal["modified", "standard"] = field(metadata=key())
    a: float = field(metadata=key("length", default=0.0))
    alpha: float = field(metadata=key("angle", default=0.0))
    d: float = field(metadata=key("length", default=0.0))
    theta: float = field(metadata=key("angle", default=0.0))


@dataclass(frozen=True, eq=False)
class PoseKeys:
    """Keys of a pose.

    Attributes:
        xyz: position, (3,) [m]
        rpy: angles about the fixed axes x, y, z, (3,) [rad]
        rotation: instead of `rpy`: rows of a rotation matrix
    """

    xyz: Array = field(default_factory=_origin, metadata=key("length", size=3))
    rpy: Array | None = field(default=None, metadata=key("angle", size=3, of=("rpy",)))
    rotation: object = field(default=None, metadata=key(form="any", of=("rotation",)))


@dataclass(frozen=True, eq=False)
class ClosureKeys:
    """Keys of a hinge that closes a loop; it is a frame, too.

    Attributes:
        name: of the hinge
        frame_a, point_a: point on a frame, (3,) [m]
        frame_b, point_b: point on another frame, in the same place, (3,) [m]
        passive: the two frames that the loop determines
        guard: two frames of equal angles in a parallelogram; default: no guard
        open: whether the hinge is broken
        slides: whether the pin, a passive frame `c1_pin`, shifts along the axis of `frame_a`: for
            axes that are not parallel
    """

    name: str = field(metadata=key())
    frame_a: str = field(metadata=key())
    point_a: Array = field(metadata=key("length", size=3))
    frame_b: str = field(metadata=key())
    point_b: Array = field(metadata=key("length", size=3))
    passive: tuple[str, ...] = field(metadata=key(default=()))
    guard: tuple[str, ...] = field(
        metadata=key(default=(), see="mechanism.md#singular-loops-and-the-wrong-branch")
    )
    open: bool = field(metadata=key(default=False, see="tutorial/03_open_a_loop.md"))
    slides: bool = field(metadata=key(default=False))


def read_frame(row: Table) -> Frame:
    """Read a frame: its placement on its parent, and its motion."""
    motion = row.text("motion", "fixed", allowed=get_args(Motion))
    keys = row.record(FrameKeys, turns=motion != "prismatic")
    before, after = _read_placement(row)
    if motion == "fixed":
        before, after = before @ after, np.eye(4)
    if (motion == "fixed") != (not keys.q):
        raise row.fail("q", "a moving frame needs q = { joint = ratio }, a fixed one has none")
    lower, upper = keys.lower, keys.upper
    if not lower < upper:
        raise row.fail("lower", f"got {lower:g}; allowed: less than the upper limit {upper:g}")
    couplings = tuple(keys.q.items())
    return Frame(
        keys.name, keys.parent or None, keys.motion, before, after, couplings, lower, upper
    )


def _read_placement(row: Table) -> tuple[Array, Array]:
    """Return the parts of a frame's placement before and after its motion."""
    if "dh" in row:
        dh = row.record(DhKeys)
        if dh.dh == "modified":
            return exact(modified_dh(dh.a, dh.alpha, dh.d, dh.theta)), np.eye(4)
        before, after = standard_dh(0.0, 0.0, dh.d, dh.theta), standard_dh(dh.a, dh.alpha, 0.0, 0.0)
        return exact(before), exact(after)
    turned = "rotation" not in row and row.has("rpy", "angle")
    at = read_pose(row)
    return exact(at) if turned else at, np.eye(4)


def read_pose(row: Table) -> Array:
    """Read a pose, identity when absent, (4, 4)."""
    turn = np.eye(3)
    keys = row.record(PoseKeys, "rotation" if "rotation" in row else "rpy")
    if "rotation" in row:
        try:
            turn = check_rotation(row.matrix("rotation", 3, 3))
        except TrocarError as problem:
            raise row.fail("rotation", str(problem)) from problem
    elif keys.rpy is not None:
        turn = matrix_from_rpy(*keys.rpy)
    return transform(turn, keys.xyz)


def exact(matrix: Array) -> Array:
    """Return a matrix whose entries at right angles are exactly 0 and 1 (cos 90 deg is 6e-17)."""
    return np.where(np.abs(matrix) < 1e-15, 0.0, matrix)


def read_closure(row: Table) -> tuple[Closure, bool]:
    """Return a hinge that closes a loop, and whether its pin may slide along its axis."""
    keys = row.record(ClosureKeys)
    passive, guard = keys.passive, keys.guard
    if len(passive) != 2:
        raise row.fail("passive", f"got {list(passive)}; allowed: the two frames it determines")
    if len(guard) not in (0, 2):
        raise row.fail("guard", f"got {list(guard)}; allowed: two frames, or none")
    closure = Closure(
        keys.name,
        keys.frame_a,
        keys.point_a,
        keys.frame_b,
        keys.point_b,
        (passive[0], passive[1]),
        guard,
        keys.open,
    )
    return closure, keys.slides


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
    """Return the mass properties of a pin."""
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
