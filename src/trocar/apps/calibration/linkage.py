"""The loops of a mechanism as bodies and hinges: what motion capture sees of it.

Frames that are fixed to one another are one body. A hinge joins two bodies: the hinge of a frame
joins its parent's body with its own, a closure the bodies of its two frames. Nothing here knows a
robot by name.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions import ArmDescription
from trocar.descriptions.calibration_plan import default_plan
from trocar.errors import InputError
from trocar.kinematics.loops import closed_coordinates
from trocar.kinematics.mechanism import Mechanism
from trocar.kinematics.tree import frame_poses

Array = NDArray[np.float64]

# Source: our own choice. The hinges of a loop count as parallel within this angle; real ones are
# ten times straighter. [rad]
PARALLEL_RAD = 0.05


@dataclass(frozen=True)
class Hinge:
    """An axis about which two bodies turn.

    Attributes:
        name: the frame that moves about it, or the closure
        label: what reports call it
        body_a, body_b: the parent's body and the child's; of a closure, of frame_a and frame_b
        closure: whether it closes a loop
    """

    name: str
    label: str
    body_a: str
    body_b: str
    closure: bool


@dataclass(frozen=True, eq=False)
class Linkage:
    """The part of a mechanism that its loops move.

    Attributes:
        arm: name of the arm
        mechanism: the frames of the loops and what leads to them, with all joints
        bodies: {body: its first frame}, the ground of the loops first
        hinges: every hinge of the loops, those of the tree before the closures
        joints: positions in `mechanism.joints` of the joints that move the loops
        rest: joint positions of home, (n_joints,) [rad or m]; the limit where 0 lies beyond it
        frames: T_ground_frame at home of every frame in `mechanism`, {frame: (4, 4)}
        plane: two unit vectors across the axes and one along them, as columns, in the ground
            body's first frame (3, 3)
        points: {hinge: where its axis passes the plane at home, (2,) [m]}
        first: the hinge whose origin the plane passes in which distances are told (see `datum`)
        level: how far along the axes that is [m]
        turns: {body: d angle / d joint in the plane as the description has it, (n_joints,)}
        body_of: {frame: its body} of the frames in `mechanism`
        known: every body of the arm
    """

    arm: str
    mechanism: Mechanism
    bodies: Mapping[str, str]
    hinges: tuple[Hinge, ...]
    joints: tuple[int, ...]
    rest: Array
    frames: Mapping[str, Array]
    plane: Array
    points: Mapping[str, Array]
    first: str
    level: float
    turns: Mapping[str, Array]
    body_of: Mapping[str, str]
    known: frozenset[str]

    @property
    def ground(self) -> str:
        """The body that every loop hangs on."""
        return next(iter(self.bodies))

    def hinge(self, name: str) -> Hinge:
        """Return the hinge of this name."""
        return next(hinge for hinge in self.hinges if hinge.name == name)

    def carried(self, body: str) -> tuple[str, ...]:
        """Return the names of the hinges that a body carries."""
        return tuple(h.name for h in self.hinges if body in (h.body_a, h.body_b))


def linkage(arm: ArmDescription) -> Linkage:
    """Return the loops of an arm as bodies and hinges.

    Raises:
        InputError: the arm has no loops, one that slides, or axes that are not parallel
    """
    mechanism, body_of = arm.mechanism, bodies_of(arm)
    loops = [_loop(mechanism, c.frame_a, c.frame_b) for c in mechanism.closures]
    if not loops:
        raise InputError(f"{arm.name}: has no closed loop, so there are no axes to calibrate")
    moving = sorted({index for loop in loops for index in loop})
    names = [mechanism.frames[index].name for index in moving]
    for index in moving:
        if mechanism.frames[index].motion == "prismatic":
            raise InputError(
                f"{arm.name}: {mechanism.frames[index].name} slides inside a loop; allowed: hinges"
            )
    core = _core(mechanism)
    labels = _labels(arm)
    hinges = tuple(
        [
            Hinge(
                name,
                labels.get(name, name),
                body_of[str(mechanism.frame(name).parent)],
                body_of[name],
                False,
            )
            for name in names
        ]
        + [
            Hinge(c.name, labels.get(c.name, c.name), body_of[c.frame_a], body_of[c.frame_b], True)
            for c in mechanism.closures
        ]
    )
    present = {h.body_a for h in hinges} | {h.body_b for h in hinges}
    first = {
        body: next(f.name for f in mechanism.frames if body_of[f.name] == body)
        for body in dict.fromkeys(body_of[f.name] for f in mechanism.frames)
        if body in present
    }
    plan = arm.calibration or default_plan(mechanism)
    return _placed(next(iter(plan.axes.values())), core, first, hinges, names, body_of)


def bodies_of(arm: ArmDescription) -> dict[str, str]:
    """Return {frame: the body that it is fixed on}; a body is named after its first frame."""
    found: dict[str, str] = {}
    for frame in arm.mechanism.frames:
        fixed = frame.motion == "fixed" and frame.parent is not None
        found[frame.name] = found[str(frame.parent)] if fixed else f"{arm.name}_{frame.name}"
    return found


def _labels(arm: ArmDescription) -> dict[str, str]:
    plan = arm.calibration
    return {} if plan is None else {frame: label for label, frame in plan.axes.items()}


def _loop(mechanism: Mechanism, frame_a: str, frame_b: str) -> list[int]:
    """Return the moving frames of a loop: what leads to one of its ends, but not to both."""
    one, two = set(mechanism.chain(frame_a)), set(mechanism.chain(frame_b))
    return [i for i in sorted(one ^ two) if mechanism.frames[i].motion != "fixed"]


def _core(mechanism: Mechanism) -> Mechanism:
    """Return the mechanism without the frames that hang on the loops."""
    needed: set[int] = set()
    for closure in mechanism.closures:
        needed |= {*mechanism.chain(closure.frame_a), *mechanism.chain(closure.frame_b)}
    frames = tuple(mechanism.frames[index] for index in sorted(needed))
    root = frames[0].name
    return Mechanism(mechanism.name, mechanism.joints, frames, mechanism.closures, root, root)


def _placed(
    first: str,
    core: Mechanism,
    bodies: Mapping[str, str],
    hinges: tuple[Hinge, ...],
    names: list[str],
    body_of: Mapping[str, str],
) -> Linkage:
    """Find where everything stands at home, in the ground body's first frame."""
    rest = np.clip(np.zeros(len(core.joints)), core.lower, core.upper)
    for column, joint in enumerate(core.joints):
        if joint.lower <= 0.0 <= joint.upper:
            rest[column] = 0.0
    at = frame_poses(core, closed_coordinates(core, rest))
    ground = np.linalg.inv(at[core.frame_index[next(iter(bodies.values()))]])
    frames = {frame.name: ground @ at[i] for i, frame in enumerate(core.frames)}
    axes = {name: _axis(core, frames, name) for name in names}
    for closure in core.closures:
        pose = frames[closure.frame_a]
        axes[closure.name] = (
            pose[:3, :3] @ closure.point_a + pose[:3, 3],
            # A closing hinge is parallel to the hinge that its first passive frame turns about.
            axes[closure.passive[0]][1],
        )
    along = axes[names[0]][1]
    for name, (_, direction) in axes.items():
        if np.linalg.norm(np.cross(direction, along)) > PARALLEL_RAD:
            raise InputError(
                f"{core.name}: axis {name} is not parallel to {names[0]}; allowed: loops whose axes"
                f" are parallel within {PARALLEL_RAD} rad"
            )
    plane = _plane(along)
    joints = sorted({c for n in names for c in np.flatnonzero(core.ratios[core.frame_index[n]])})
    return Linkage(
        arm=core.name,
        mechanism=core,
        bodies=bodies,
        hinges=hinges,
        joints=tuple(int(column) for column in joints),
        rest=rest,
        frames=frames,
        plane=plane,
        points={name: plane[:, :2].T @ point for name, (point, _) in axes.items()},
        first=first,
        level=float(plane[:, 2] @ axes[first][0]),
        turns=_turns(core, hinges, {n: float(np.sign(axes[n][1] @ along)) for n in names}),
        body_of={frame.name: body_of[frame.name] for frame in core.frames},
        known=frozenset(body_of.values()),
    )


def _axis(core: Mechanism, frames: Mapping[str, Array], name: str) -> tuple[Array, Array]:
    frame = core.frame(name)
    pose = frames[str(frame.parent)] @ frame.before
    return pose[:3, 3], pose[:3, 2]


def _plane(along: Array) -> Array:
    """Return a right-handed basis whose last column is `along`, (3, 3)."""
    start = np.eye(3)[int(np.argmin(np.abs(along)))]
    one = np.cross(along, np.cross(start, along))
    one = np.asarray(one / np.linalg.norm(one), dtype=np.float64)
    return np.stack([one, np.cross(along, one), along], axis=1)


def _turns(
    core: Mechanism, hinges: tuple[Hinge, ...], signs: Mapping[str, float]
) -> dict[str, Array]:
    """Return how each body turns in the plane by the couplings alone, from the ground up."""
    tree = [hinge for hinge in hinges if not hinge.closure]
    found = {tree[0].body_a: np.zeros(len(core.joints))}
    for hinge in tree:
        ratio = signs[hinge.name] * core.ratios[core.frame_index[hinge.name]]
        found[hinge.body_b] = found.setdefault(hinge.body_a, np.zeros(len(core.joints))) + ratio
    return found
