"""Links and joints: a rig, as files are written from it, and a model that was read from a file.

In a `LinkModel` every joint turns about or slides along z through the origin of its child link,
whose pose in the parent is the joint's `pose` where the coordinate is 0. A frame that the
description puts beyond its hinge (standard DH) becomes a fixed link without mass behind a link
`..._hinge` with the mass, so that every frame of the description is a link of its own name.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.inertial import merged
from trocar.descriptions.materials import MATERIALS
from trocar.descriptions.meshes import Mesh
from trocar.descriptions.records import (
    ArmDescription,
    Body,
    JointDescription,
    RigArm,
    RigDescription,
    Shape,
    ShapeKind,
)
from trocar.errors import InputError
from trocar.geometry.rotations import matrix_from_rotation_vector, rotation_z
from trocar.geometry.se3 import pose_difference, transform, translation
from trocar.kinematics.forward import coordinates
from trocar.kinematics.loops import loops_are_parallelograms
from trocar.kinematics.mechanism import Frame, Mechanism, Motion
from trocar.kinematics.tree import frame_poses
from trocar.modeling.hinges import Hinge, hinge_of

Array = NDArray[np.float64]

#: The root of every model: a link without mass.
WORLD = "world"
#: Margin of a passive coordinate's limits beyond the range that the joints give it [rad or m].
#: Source: our own choice, so that rounding stops no loop.
SLACK = 1e-3
#: Ratio of a helper link's mass and inertia to those of the link behind it: engines reject a moving
#: link without any. Source: our own choice.
SHARE = 1e-6
#: Number of joint vectors in the fit of straight lines to a loop that is no parallelogram.
SAMPLES = 256
#: Smallest motion over a joint's range of a coordinate that follows the joint [rad or m].
#: Source: our own choice, far above the numerical error of a closed loop.
UNMOVED = 1e-9


@dataclass(frozen=True, eq=False)
class Link:
    """A rigid body, or a frame without mass.

    Attributes:
        name: "PSM1_pitch_back"
        arm, frame: the rig's arm and the frame of its description that moves with the link; "" of
            the world and of a link that was read
        mass: [kg], 0 of a mere frame
        com: centre of mass in the link, (3,) [m]
        inertia: about the centre of mass in the link's axes, (3, 3) [kg m^2]
        shapes: visible and colliding shapes in the link's frame
    """

    name: str
    arm: str = ""
    frame: str = ""
    mass: float = 0.0
    com: Array = field(default_factory=lambda: np.zeros(3))
    inertia: Array = field(default_factory=lambda: np.zeros((3, 3)))
    shapes: tuple[Shape, ...] = ()


@dataclass(frozen=True, eq=False)
class LinkJoint:
    """The joint between a link of a rig and its parent.

    Attributes:
        name: "PSM1_pitch" where a public joint's motor sits on it, else the child's name
        kind: fixed, revolute (about z) or prismatic (along z)
        parent, child: names of links
        pose: T_parent_child where the coordinate is 0, (4, 4)
        arm, frame: arm and frame that the joint moves, "" of a fixed joint
        hinge: its passive properties, None of a fixed joint
        lower, upper: limits [rad or m]
        effort, velocity: limits of its motor, of a passive joint those of its leaders [N m, N,
            rad/s or m/s]
        offset, follows: coordinate = offset + sum(ratio * coordinate of joint) over ((joint,
            ratio), ...); empty of an independent joint
        in_loop: whether a loop determines it, not a coupling
    """

    name: str
    kind: Motion
    parent: str
    child: str
    pose: Array
    arm: str = ""
    frame: str = ""
    hinge: Hinge | None = None
    lower: float = 0.0
    upper: float = 0.0
    effort: float = 0.0
    velocity: float = 0.0
    offset: float = 0.0
    follows: tuple[tuple[str, float], ...] = ()
    in_loop: bool = False


@dataclass(frozen=True, eq=False)
class LinkLoop:
    """A point that two links share: a loop's closure; of a rig a hinge about link_a's z.

    Attributes:
        name: "PSM1_c1"
        link_a, point_a: a link and the point in it, (3,) [m]
        link_b, point_b: the other link and the point in it
    """

    name: str
    link_a: str
    point_a: Array
    link_b: str
    point_b: Array


@dataclass(frozen=True)
class LineError:
    """Largest errors of frames against the closed loops, over the joints' ranges.

    Attributes:
        frame, worst: the frame with the largest error, and that error [m]
        tip, tip_angle: errors of the arm's tip [m, rad]
    """

    frame: str
    worst: float
    tip: float
    tip_angle: float


@dataclass(frozen=True, eq=False)
class LinkModel:
    """A rig as links and joints.

    Attributes:
        name, title: those of the rig
        links: parents before children; the first is the world
        joints: one for every other link, in their order
        loops: closures of the loops
        start: coordinates of the rig's pose "start", {joint: rad or m}, passive ones included
        zero: coordinates with every independent joint at 0 and the loops closed: 0 except for
            passive joints of a loop that is no parallelogram
        line_errors: {arm: errors of its frames if the loops' coordinates follow straight lines},
            of arms whose loops are no parallelograms
    """

    name: str
    title: str
    links: tuple[Link, ...]
    joints: tuple[LinkJoint, ...]
    loops: tuple[LinkLoop, ...]
    start: Mapping[str, float]
    zero: Mapping[str, float]
    line_errors: Mapping[str, LineError]

    def joint(self, name: str) -> LinkJoint:
        """Return the joint called `name`."""
        return next(joint for joint in self.joints if joint.name == name)


def link_name(arm: str, frame: str) -> str:
    """Return the name of a frame's link: "PSM1_pitch_back"."""
    return f"{arm}_{frame}"


def joint_name(place: RigArm, frame: str) -> str:
    """Return the name of the joint that moves a frame: "PSM1_yaw", else its link's."""
    motors = {joint.drive[0][0]: joint for joint in reversed(place.arm.joints)}
    joint = motors.get(frame)
    own = joint is not None and joint.drive == ((frame, 1.0),)
    return link_name(place.name, joint.name if own and joint else frame)


def own_joints(place: RigArm) -> dict[str, str]:
    """Return the independent joints of an arm, {name: the frame that it moves}."""
    motors = {joint.drive[0][0] for joint in place.arm.joints}
    moving = [f.name for f in place.arm.mechanism.frames if f.motion != "fixed"]
    return {joint_name(place, name): name for name in moving if name in motors}


def rig_links(rig: RigDescription, friction: str = "identified") -> LinkModel:
    """Return a rig as links and joints, without its movable props.

    Args:
        rig: its description
        friction: "identified" or "paper"

    Raises:
        InputError: a moving frame of an arm has no mass
    """
    links = [Link(WORLD)]
    joints: list[LinkJoint] = []
    for prop in (prop for prop in rig.props if prop.movable is None):
        links.append(Link(prop.name, shapes=prop.shapes))
        joints.append(_fixed(prop.name, WORLD, prop.name, prop.pose))
    loops: list[LinkLoop] = []
    start: dict[str, float] = {}
    zero: dict[str, float] = {}
    errors: dict[str, LineError] = {}
    for place in rig.arms:
        found = _Reading.of(place, friction)
        for frame in place.arm.mechanism.frames:
            found.read(frame, links, joints)
        loops += found.loops()
        at = coordinates(place.arm.mechanism, rig.poses["start"][place.name])
        start |= {found.joint_name(f): float(at[k]) for k, f in found.moving()}
        at = coordinates(place.arm.mechanism, np.zeros(len(place.arm.joints)))
        zero |= {found.joint_name(f): float(at[k]) for k, f in found.moving()}
        if found.line_error is not None:
            errors[place.name] = found.line_error
    return LinkModel(
        rig.name, rig.title, tuple(links), tuple(joints), tuple(loops), start, zero, errors
    )


def helper_link(link: Link, name: str) -> Link:
    """Return a link of almost no mass, between two joints in front of `link`."""
    mass, inertia = SHARE * link.mass, SHARE * link.inertia
    return replace(link, name=name, frame="", mass=mass, inertia=inertia, shapes=())


def joint_values(model: LinkModel, own: Mapping[str, Any]) -> dict[str, Any]:
    """Return every joint's coordinate.

    Args:
        own: coordinates of the independent joints, (...) each [rad or m]
    """
    found = dict(own)
    for joint in model.joints:
        if joint.follows:
            found[joint.name] = joint.offset + sum(r * found[n] for n, r in joint.follows)
    return found


def link_poses(model: LinkModel, values: Mapping[str, Any]) -> dict[str, Array]:
    """Return the poses of links in the world, {link: T_world_link (..., 4, 4)}.

    Args:
        values: coordinates of all joints that move, (...) each [rad or m]
    """
    found = {model.links[0].name: np.eye(4)}
    for joint in model.joints:
        motion = joint_motion(joint.kind, values.get(joint.name, 0.0))
        found[joint.child] = found[joint.parent] @ joint.pose @ motion
    return found


def joint_motion(kind: Motion, at: Array | float) -> Array:
    """Return the motion of a joint's child at coordinates (...) [rad or m], (..., 4, 4)."""
    turn = rotation_z(at if kind == "revolute" else 0.0)
    slide = np.zeros((*np.shape(at), 3))
    slide[..., 2] = at if kind == "prismatic" else 0.0
    return transform(turn, slide)


def _fixed(name: str, parent: str, child: str, pose: Array) -> LinkJoint:
    return LinkJoint(name, "fixed", parent, child, pose)


@dataclass(frozen=True, eq=False)
class _Reading:
    """One arm of a rig: the bodies of its frames, and the lines that its coordinates follow."""

    place: RigArm
    friction: str
    bodies: Mapping[str, list[Body]]
    offsets: Array
    ratios: Array
    line_error: LineError | None

    @staticmethod
    def of(place: RigArm, friction: str) -> _Reading:
        arm = place.arm
        bodies: dict[str, list[Body]] = {}
        for body in arm.bodies:
            bodies.setdefault(body.frame, []).append(body)
        bare = [f.name for f in arm.mechanism.frames if f.motion != "fixed"]
        bare = [name for name in bare if name not in bodies]
        if bare:
            why = "".join(f"; {m.what}: {m.why}" for m in arm.missing)
            raise InputError(f"{arm.name}: has no mass for {', '.join(bare)}{why}")
        return _Reading(place, friction, bodies, *_lines(arm))

    def moving(self) -> list[tuple[int, Frame]]:
        frames = self.place.arm.mechanism.frames
        return [(k, f) for k, f in enumerate(frames) if f.motion != "fixed"]

    def joint_name(self, frame: Frame) -> str:
        return joint_name(self.place, frame.name)

    def read(self, frame: Frame, links: list[Link], joints: list[LinkJoint]) -> None:
        """Add a frame's links and joints."""
        name = link_name(self.place.name, frame.name)
        parent = self._parent(frame)
        pose = frame.before if frame.parent else self.place.pose @ frame.before
        own = self._massed(frame)
        links.append(self._link(own, frame))
        if frame.motion == "fixed":
            joints.append(_fixed(name, parent, own, pose))
        else:
            joints.append(self._moving(frame, parent, own, pose))
        if own != name:
            links.append(Link(name, self.place.name, frame.name))
            joints.append(_fixed(f"{name}_frame", own, name, frame.after))

    def _massed(self, frame: Frame) -> str:
        """Return the link that a frame's bodies are in."""
        name = link_name(self.place.name, frame.name)
        return name if np.array_equal(frame.after, np.eye(4)) else f"{name}_hinge"

    def _parent(self, frame: Frame) -> str:
        if frame.parent is not None:
            return link_name(self.place.name, frame.parent)
        return link_name(self.place.on, self.place.frame) if self.place.on else WORLD

    def _link(self, name: str, frame: Frame) -> Link:
        bodies = self.bodies.get(frame.name, [])
        mass, com, inertia = merged(bodies)
        turn, shift = frame.after[:3, :3], frame.after[:3, 3]
        shapes = tuple(
            replace(s, pose=frame.after @ s.pose) for body in bodies for s in body.shapes
        )
        com = turn @ com + shift if bodies else com
        return Link(name, self.place.name, frame.name, mass, com, turn @ inertia @ turn.T, shapes)

    def _moving(self, frame: Frame, parent: str, child: str, pose: Array) -> LinkJoint:
        arm = self.place.arm
        mechanism = arm.mechanism
        index = mechanism.frame_index[frame.name]
        hinge = hinge_of(arm, frame.name, self.friction)
        row, offset = self.ratios[index], float(self.offsets[index])
        ends = np.sort(np.stack([row * mechanism.lower, row * mechanism.upper]), axis=0)
        lower, upper = offset + ends.sum(axis=1)
        if hinge.joint is not None:
            effort, follows = hinge.joint.effort_max * abs(hinge.weight), ()
        else:
            lower, upper = lower - SLACK, upper + SLACK
            leads = [(arm.joints[k], float(row[k])) for k in np.flatnonzero(row)]
            effort = max((j.effort_max / abs(ratio) for j, ratio in leads), default=0.0)
            follows = tuple(self._lead(joint, ratio) for joint, ratio in leads)
        return LinkJoint(
            name=self.joint_name(frame),
            kind=frame.motion,
            parent=parent,
            child=child,
            pose=pose,
            arm=self.place.name,
            frame=frame.name,
            hinge=hinge,
            lower=float(lower),
            upper=float(upper),
            effort=float(effort),
            velocity=sum(abs(row[k]) * arm.joints[k].velocity_max for k in np.flatnonzero(row)),
            offset=offset if hinge.joint is None else 0.0,
            follows=follows,
            in_loop=any(frame.name in c.passive for c in mechanism.closures),
        )

    def _lead(self, joint: JointDescription, ratio: float) -> tuple[str, float]:
        """Return the joint that a public joint's motor sits on, and the ratio to it."""
        frame, weight = joint.drive[0]
        mechanism = self.place.arm.mechanism
        leader = mechanism.frames[mechanism.frame_index[frame]]
        return self.joint_name(leader), ratio * weight

    def loops(self) -> list[LinkLoop]:
        """Return the closures of the arm, points in the links that carry the mass."""
        name = self.place.name
        return [
            LinkLoop(
                link_name(name, c.name),
                *self._side(c.frame_a, c.point_a),
                *self._side(c.frame_b, c.point_b),
            )
            for c in self.place.arm.mechanism.closures
            if not c.open
        ]

    def _side(self, name: str, point: Array) -> tuple[str, Array]:
        mechanism = self.place.arm.mechanism
        frame = mechanism.frames[mechanism.frame_index[name]]
        return self._massed(frame), frame.after[:3, :3] @ point + frame.after[:3, 3]


def range_samples(mechanism: Mechanism, seed: int) -> Array:
    """Return joint positions over the whole range, denser towards its ends, (SAMPLES, n).

    Least squares over them come near the least largest error, as at Chebyshev's nodes.
    """
    rng = np.random.default_rng(seed)
    turn = rng.uniform(0.0, np.pi, (SAMPLES, len(mechanism.joints)))
    return mechanism.lower + 0.5 * (1.0 - np.cos(turn)) * (mechanism.upper - mechanism.lower)


def _lines(arm: ArmDescription) -> tuple[Array, Array, LineError | None]:
    """Return the straight lines that coordinates follow, offsets and ratios, and their error.

    Where loops are no parallelograms, coordinates of the loops' frames follow the lines that fit
    them best over the whole range.
    """
    mechanism = arm.mechanism
    if loops_are_parallelograms(mechanism):
        return np.zeros(len(mechanism.frames)), mechanism.ratios, None
    q = range_samples(mechanism, 0)
    closed = coordinates(mechanism, q)
    table = np.hstack([np.ones((SAMPLES, 1)), q])
    moves = _moves(mechanism)
    found = np.zeros((len(mechanism.joints) + 1, len(mechanism.frames)))
    for k, frame in enumerate(mechanism.frames):
        if any(frame.name in c.passive for c in mechanism.closures):
            own = np.concatenate([[True], moves[:, k]])
            found[own, k] = np.linalg.lstsq(table[:, own], closed[:, k])[0]
        else:
            found[1:, k] = mechanism.ratios[k]
    true, straight = frame_poses(mechanism, closed), frame_poses(mechanism, table @ found)
    pairs = {f.name: (true[k], straight[k]) for k, f in enumerate(mechanism.frames)}
    error = line_error(pairs, mechanism.tip)
    return found[0], found[1:].T, error


def line_error(frames: Mapping[str, tuple[Array, Array]], tip: str) -> LineError:
    """Return the largest errors of frames.

    Args:
        frames: {frame: (true, other) poses (k, 4, 4)}
        tip: one of them
    """
    off = {name: pose_difference(*pair) for name, pair in frames.items()}
    frame = max(off, key=lambda name: float(off[name][0].max()))
    worst, (tip_off, tip_turn) = float(off[frame][0].max()), off[tip]
    return LineError(frame, worst, float(tip_off.max()), float(tip_turn.max()))


def _moves(mechanism: Mechanism) -> NDArray[np.bool_]:
    """Return whether each joint moves each frame's coordinate, (joints, frames)."""
    count = len(mechanism.joints)
    middle = np.tile(0.5 * (mechanism.lower + mechanism.upper), (count + 1, 1))
    ends = middle + np.vstack([np.diag(0.5 * (mechanism.upper - mechanism.lower)), np.zeros(count)])
    at = coordinates(mechanism, ends)
    return np.abs(at[:-1] - at[-1]) > UNMOVED


#: {type of a joint in URDF and SDF: kind}
KINDS: Mapping[str, Motion] = {
    "fixed": "fixed",
    "revolute": "revolute",
    "continuous": "revolute",
    "prismatic": "prismatic",
}


class ImportFileError(InputError):
    """A file that cannot be imported.

    Attributes:
        file: its path
        line: line of the problem, from 1; None: the whole file
    """

    def __init__(self, file: str, problem: str, line: int | None = None) -> None:
        self.file = file
        self.line = line
        super().__init__(f"{file}: {problem}" if line is None else f"{file}:{line}: {problem}")


@dataclass(frozen=True, eq=False)
class SourceJoint:
    """A joint that was read: T_parent_child = pose @ motion(coordinate).

    Attributes:
        name: as in the file
        kind: fixed, revolute or prismatic
        parent, child: names of links
        pose: T_parent_child where the coordinate is 0, (4, 4)
        axis: unit direction in the child, (3,)
        point: a point of the axis in the child, (3,) [m]
        lower, upper: limits, infinite where the file gives none [rad or m]
        effort, velocity: limits, infinite where the file gives none [N m, N, rad/s or m/s]
        damping, friction: viscous and dry [N m s, N s/m; N m, N]
        follows: (joint, ratio, offset) of a coupled joint
        driven: whether it may have a motor
    """

    name: str
    kind: Motion
    parent: str
    child: str
    pose: Array
    axis: Array = field(default_factory=lambda: np.array([0.0, 0.0, 1.0]))
    point: Array = field(default_factory=lambda: np.zeros(3))
    lower: float = -np.inf
    upper: float = np.inf
    effort: float = np.inf
    velocity: float = np.inf
    damping: float = 0.0
    friction: float = 0.0
    follows: tuple[str, float, float] | None = None
    driven: bool = True

    def motion(self, value: float) -> Array:
        """Return the motion of the child at a coordinate [rad or m], (4, 4)."""
        if self.kind == "prismatic":
            return transform(np.eye(3), value * self.axis)
        turn = matrix_from_rotation_vector(value * self.axis)
        return transform(turn, self.point - turn @ self.point)


@dataclass(frozen=True, eq=False)
class SourceModel:
    """A model that was read: a tree of links, and closures.

    Attributes:
        name: as in the file
        file: its path
        links: parents before children, the root first
        joints: one for every other link, in their order
        loops: closures of the loops
        warnings: parts of the file that are ignored or changed
    """

    name: str
    file: str
    links: tuple[Link, ...]
    joints: tuple[SourceJoint, ...]
    loops: tuple[LinkLoop, ...]
    warnings: tuple[str, ...]

    @property
    def moves(self) -> bool:
        """Whether any joint moves."""
        return any(joint.kind != "fixed" for joint in self.joints)

    def poses(self) -> dict[str, Array]:
        """Return the poses of links where all coordinates are 0, {link: T_root_link (4, 4)}."""
        at = {self.links[0].name: np.eye(4)}
        for joint in self.joints:
            at[joint.child] = at[joint.parent] @ joint.pose
        return at


def as_tree(
    file: str, links: Sequence[Link], joints: Sequence[SourceJoint]
) -> tuple[tuple[Link, ...], tuple[SourceJoint, ...]]:
    """Return links and joints with parents first.

    Raises:
        ImportFileError: duplicate names, a joint of an unknown link, a loop, or several roots
    """
    by_name = {link.name: link for link in links}
    for what, names in (("link", [k.name for k in links]), ("joint", [j.name for j in joints])):
        for again in sorted({n for n in names if names.count(n) > 1}):
            raise ImportFileError(file, f"{what} {again!r} is defined twice")
    above: dict[str, SourceJoint] = {}
    for joint in joints:
        for side in (joint.parent, joint.child):
            if side not in by_name:
                raise ImportFileError(
                    file,
                    f"joint {joint.name!r} names link {side!r}; known: {', '.join(by_name)}",
                )
        if joint.child in above:
            raise ImportFileError(
                file,
                f"link {joint.child!r} has two parent joints, {above[joint.child].name!r} and"
                f" {joint.name!r}: this format has no closed loops; allowed: one parent"
                " (SDF and MJCF support closed loops)",
            )
        above[joint.child] = joint
    roots = [name for name in by_name if name not in above]
    if len(roots) != 1:
        found = ", ".join(roots) or "none, the links go round in a ring"
        raise ImportFileError(file, f"got {len(roots)} root links ({found}); allowed: one")
    order, waiting = [roots[0]], [roots[0]]
    while waiting:
        parent = waiting.pop(0)
        children = [j.child for j in joints if j.parent == parent]
        order += children
        waiting += children
    if len(order) != len(by_name):
        lost = ", ".join(sorted(set(by_name) - set(order)))
        raise ImportFileError(file, f"links {lost} form a cycle; allowed: a tree")
    return tuple(by_name[n] for n in order), tuple(above[n] for n in order[1:])


AnyJoint = TypeVar("AnyJoint", LinkJoint, SourceJoint)


def joints_above(joints: Iterable[AnyJoint], link: str) -> list[AnyJoint]:
    """Return the joints from a link up to the root."""
    above = {joint.child: joint for joint in joints}
    found: list[AnyJoint] = []
    while link in above:
        found.append(above[link])
        link = found[-1].parent
    return found


def without_capsule(shape: Shape) -> tuple[Shape, ...]:
    """Return a shape, or the cylinder and two spheres of a capsule, for formats without it."""
    if shape.kind != "capsule":
        return (shape,)
    radius, half, _ = shape.size
    ball = replace(shape, kind="sphere", size=np.array([radius, 0.0, 0.0]))
    ends = (shape.pose @ translation(np.array([0.0, 0.0, z])) for z in (-half, half))
    return replace(shape, kind="cylinder"), *(replace(ball, pose=end) for end in ends)


def material_of(rgb: Array) -> str:
    """Return the name in `descriptions.materials` of a colour (3,) in 0 to 1, to 8 bits."""
    eight = np.rint(255.0 * np.clip(rgb[:3], 0.0, 1.0)).astype(int)
    for name, material in MATERIALS.items():
        if np.array_equal(eight, np.rint(255.0 * np.array(material.rgba[:3])).astype(int)):
            return name
    return "color_" + "".join(f"{value:02x}" for value in eight)


def solid(kind: ShapeKind, pose: Array, sizes: Sequence[float], material: str) -> Shape:
    """Return a primitive along z.

    Args:
        kind: box, sphere, cylinder or capsule
        pose: T_link_shape, of its centre, (4, 4)
        sizes: edges of a box; radius of a sphere; radius and length of a cylinder or of a capsule's
            straight part [m]
        material: a row of `descriptions.materials`
    """
    if kind == "box":
        return Shape("box", pose, 0.5 * np.asarray(sizes, dtype=np.float64), material)
    radius, length = (*sizes, 0.0)[:2]
    return Shape(kind, pose, np.array([radius, 0.5 * length, 0.0]), material)


def mesh_shape(pose: Array, surface: Mesh, material: str) -> Shape:
    """Return a mesh as a shape at T_link_shape, (4, 4)."""
    reach = np.abs(surface.vertices).max(axis=0)
    return Shape("mesh", pose, reach, material, collide=False, weigh=False, mesh=surface)
