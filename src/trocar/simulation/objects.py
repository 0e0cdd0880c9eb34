"""Movable objects of a rig: poses, velocities, and commands that place them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.descriptions.records import Prop, PropJoint, RigDescription
from trocar.errors import InputError
from trocar.geometry.rotations import (
    matrix_from_quaternion,
    matrix_from_rotation_vector,
    quaternion_from_matrix,
)
from trocar.geometry.se3 import inverse, transform
from trocar.inputs import check_numbers
from trocar.modeling import naming
from trocar.simulation.grasps import Grasps
from trocar.simulation.journal import Journal, command
from trocar.simulation.parts import Attached, Part
from trocar.simulation.records import FARTHEST_M, JointState, Pose, Twist, checked_pose
from trocar.simulation.threads import laid

Array = NDArray[np.float64]
Index = NDArray[np.intp]

#: The frame of objects' poses: that of the rig, which its arms stand in.
FRAME = "world"
#: Largest force and torque on an object. Source: our own choice, ten times a strong hand's pull.
#: [N, N m]
MOST_N, MOST_NM = 100.0, 10.0
#: Most that they accelerate it by. Source: our own choice, a hundred times gravity; with 0.25 N m
#: a ring of grams turns at 1e6 rad/s after 0.1 s, and the simulation diverges. [m/s^2, rad/s^2]
MOST_M_S2, MOST_RAD_S2 = 1e3, 1e4
#: A thread is not laid deeper than this into anything. Source: measured: contacts push its light
#: links out by 0.45 m/s for each millimetre, and from 15 mm so fast that the simulation diverges.
#: [m]
OVERLAP_M = 0.002
#: Norms of quaternions differ from 1 by less than this. Source: our own choice.
UNIT = 1e-6
#: Coordinates and rates of a joint; a free one has a position too.
WIDTHS = {"free": (7, 6), "ball": (4, 3), "slide": (1, 1), "hinge": (1, 1)}


class ObjectStates(NamedTuple):
    """Poses and velocities of all objects at a time; rows follow `names`.

    Attributes:
        names: of the objects
        time: [s]
        positions: of their frames in the world, (n, 3) [m]
        quaternions: wxyz, (n, 4)
        linear: velocity of the frame's origin in the world, (n, 3) [m/s]
        spin: angular velocity in the object's own axes, (n, 3) [rad/s]
        joint: coordinate and rate of a hinge or slide, NaN of others, (n, 2) [rad or m, per s]
    """

    names: tuple[str, ...]
    time: float
    positions: Array
    quaternions: Array
    linear: Array
    spin: Array
    joint: Array

    @property
    def angular(self) -> Array:
        """Angular velocity in axes of the world, (n, 3) [rad/s]."""
        return (matrix_from_quaternion(self.quaternions) @ self.spin[..., None])[..., 0]


@dataclass(frozen=True, eq=False)
class JointRows:
    """An object's joint: its rows of `qpos` and `qvel`, and the body that it moves.

    Attributes:
        kind: "free", "hinge", "slide" or "ball"
        qpos, qvel: its rows
        joint: its description, None of a free one
        on: number of the object that carries it, -1 for what stands still
        pose: its pose in that object, or in the world, where its coordinate is 0 (4, 4)
    """

    kind: str
    qpos: slice
    qvel: slice
    joint: PropJoint | None
    on: int
    pose: Array


class ObjectKinematics:
    """The objects of a rig in a model.

    Args:
        rig: its description
        model: the compiled rig

    Attributes:
        names: of the objects
        joints: of each object
    """

    def __init__(self, rig: RigDescription, model: mujoco.MjModel) -> None:
        self.names = tuple(prop.name for prop in rig.objects)
        poses = {prop.name: prop.pose for prop in rig.props}
        joints: list[JointRows] = []
        for prop in rig.objects:
            joint = prop.joint
            kind = "free" if joint is None else joint.kind
            name = naming.free_joint(prop.name)
            if joint is not None:
                name = naming.prop_joint(prop.name, joint.kind)
            row = model.joint(name)
            places, rates = WIDTHS[kind]
            first, rate = int(row.qposadr[0]), int(row.dofadr[0])
            on, pose = -1, prop.pose
            if joint is not None and joint.on in self.names:
                on = self.names.index(joint.on)
                pose = inverse(poses[joint.on]) @ prop.pose
            at = slice(first, first + places), slice(rate, rate + rates)
            joints.append(JointRows(kind, *at, joint, on, pose))
        self.joints = tuple(joints)
        self._scalars = [
            (k, row.qpos.start, row.qvel.start)
            for k, row in enumerate(joints)
            if row.kind in ("hinge", "slide")
        ]
        self._free = [k for k, row in enumerate(joints) if row.kind == "free"]
        rows = [(row.qpos.start, row.qvel.start) for row in joints if row.kind == "free"]
        #: Coordinates of joints that have none of one number.
        self._nan = np.full((len(joints), 2), np.nan)
        self._nan.setflags(write=False)
        first, rate = np.array(rows, np.intp).reshape(-1, 2).T
        self._places, self._rates = first[:, None] + np.arange(7), rate[:, None] + np.arange(6)

    def poses(self, qpos: Array) -> Array:
        """Return position and quaternion wxyz of each object in the world, (..., n, 7) [m].

        Args:
            qpos: MuJoCo's coordinates, (..., nq)
        """
        free = qpos[..., self._places]
        if len(self._free) == len(self.joints):
            return free
        return self._poses(free, self._matrices(qpos))

    def free_rows(self, names: Sequence[str]) -> tuple[Index, Index]:
        """Return the rows of free objects in `qpos` and `qvel`, (k, 7) and (k, 6)."""
        rows = [self._free.index(self.names.index(name)) for name in names]
        return self._places[rows], self._rates[rows]

    def motion(self, qpos: Array, qvel: Array) -> tuple[Array, Array]:
        """Return the same poses, and velocity of each origin and spin in its own axes, (n, 6).

        Args:
            qpos: MuJoCo's coordinates, (nq,)
            qvel: their rates, (nv,)
        """
        places, free = qpos.take(self._places), qvel.take(self._rates)
        if len(self._free) == len(self.joints):
            return places, free
        found = np.empty((len(self.joints), 6))
        found[self._free] = free
        at = self._matrices(qpos)
        twists: list[Array] = []  # of each origin in axes of the world
        for row, here in zip(self.joints, at, strict=True):
            rates, twist, turn = qvel[row.qvel], np.zeros(6), here[:3, :3]
            if row.on >= 0:
                twist = twists[row.on].copy()
                twist[:3] += np.cross(twist[3:], here[:3, 3] - at[row.on][:3, 3])
            if row.joint is None:
                twist[:3], twist[3:] = rates[:3], turn @ rates[3:]
            elif row.kind == "slide":
                twist[:3] += turn @ row.joint.axis * rates[0]
            else:
                spin = turn @ (rates if row.kind == "ball" else row.joint.axis * rates[0])
                twist[:3] -= np.cross(spin, turn @ row.joint.point)
                twist[3:] += spin
            twists.append(twist)
        for k, (here, twist) in enumerate(zip(at, twists, strict=True)):
            if self.joints[k].kind != "free":
                found[k, :3], found[k, 3:] = twist[:3], here[:3, :3].T @ twist[3:]
        return self._poses(places, at), found

    def coordinates(self, qpos: Array, qvel: Array) -> Array:
        """Return coordinate and rate of each hinge or slide, NaN of other joints, (n, 2)."""
        if not self._scalars:
            return self._nan
        found = self._nan.copy()
        for k, at, rate in self._scalars:
            found[k] = qpos[at], qvel[rate]
        return found

    def _poses(self, free: Array, matrices: list[Array]) -> Array:
        """Return the poses of all objects from those of free ones and all matrices."""
        found = np.empty((*free.shape[:-2], len(self.joints), 7))
        found[..., self._free, :] = free
        for k, at in enumerate(matrices):
            if self.joints[k].kind != "free":
                found[..., k, :3] = at[..., :3, 3]
                found[..., k, 3:] = quaternion_from_matrix(at[..., :3, :3])
        return found

    def _matrices(self, qpos: Array) -> list[Array]:
        """Return the pose of each object in the world, (..., 4, 4) each."""
        found: list[Array] = []
        for row in self.joints:
            q, joint = qpos[..., row.qpos], row.joint
            if joint is None:
                found.append(transform(matrix_from_quaternion(q[..., 3:]), q[..., :3]))
                continue
            if row.kind == "slide":
                motion = transform(np.eye(3), q * joint.axis)
            else:
                ball = row.kind == "ball"
                turn = (
                    matrix_from_quaternion(q)
                    if ball
                    else matrix_from_rotation_vector(q * joint.axis)
                )
                motion = transform(turn, joint.point - turn @ joint.point)
            placed = row.pose @ motion
            found.append(found[row.on] @ placed if row.on >= 0 else placed)
        return found


class SceneObject:
    """A movable prop. Its commands are entries under its own name.

    Args:
        prop: its description
        journal: receives its commands
        grasps: let go of it when it is put elsewhere

    Attributes:
        name: what it is called
        description: the prop
    """

    def __init__(self, prop: Prop, journal: Journal, grasps: Grasps) -> None:
        self.name, self.description, self._grasps = prop.name, prop, grasps
        self._journal, self._source, self._prefix = journal, prop.name, ""

    def attach(
        self, model: mujoco.MjModel, data: mujoco.MjData, kinematics: ObjectKinematics
    ) -> None:
        """Take the physics that the object is in."""
        self._model, self._data, self._kinematics = model, data, kinematics
        self._index = kinematics.names.index(self.name)
        self._row = kinematics.joints[self._index]
        self._qpos, self._qvel = data.qpos[self._row.qpos], data.qvel[self._row.qvel]
        body = model.body(self.name).id
        self._applied = data.xfrc_applied[body]
        self._tree = int(model.body_treeid[body])
        #: The bends of a thread, in `qpos` and `qvel`.
        self._bends = slice(0, 0), slice(0, 0)
        if self.description.thread is not None:
            first, bends = model.joint(f"{self.name}/1/y"), 2 * self.description.thread.links - 2
            at, rate = int(first.qposadr[0]), int(first.dofadr[0])
            self._bends = slice(at, at + bends), slice(rate, rate + bends)
        self._most_n = min(MOST_N, MOST_M_S2 * float(model.body_mass[body]))
        self._most_nm = min(MOST_NM, MOST_RAD_S2 * float(model.body_inertia[body].min()))

    @property
    def mass(self) -> float:
        """Mass [kg]."""
        movable = self.description.movable
        return 0.0 if movable is None else movable.mass

    def measured_cp(self) -> Pose:
        """Return the pose of its frame in the world."""
        free = self._row.kind == "free"
        found = self._qpos if free else self._kinematics.poses(self._data.qpos)[self._index]
        at = transform(matrix_from_quaternion(found[3:]), found[:3])
        return Pose(at, FRAME, float(self._data.time))

    def measured_cv(self) -> Twist:
        """Return the velocity of its frame's origin and its rotation, in axes of the world."""
        _, twists = self._kinematics.motion(self._data.qpos, self._data.qvel)
        twist = twists[self._index]
        turn = self.measured_cp().matrix[:3, :3]
        return Twist(twist[:3].copy(), turn @ twist[3:], FRAME, float(self._data.time))

    def measured_js(self) -> JointState:
        """Return the coordinate of its hinge or slide and its rate; the effort is not measured.

        Raises:
            InputError: it is free, or on a ball joint
        """
        self._check_kind("measured_js", "hinge", "slide")
        nothing = np.zeros(0)
        parts = self._qpos.copy(), self._qvel.copy(), nothing
        return JointState((self.name,), *parts, float(self._data.time))

    @command
    def set_cp(self, T: ArrayLike) -> None:
        """Put it somewhere, at rest; a thread lies straight there.

        Args:
            T: pose of its frame in the world, (4, 4)

        Raises:
            InputError: no pose, one too far away, the object is on a joint, or a thread would lie
                deeper than 2 mm in something; nothing changes
        """
        self._check_kind("set_cp", "free")
        self._lay(checked_pose(self.name, T), 0.0)

    @command
    def set_curve(self, points: ArrayLike) -> None:
        """Lay a free thread along a curve, at rest.

        Args:
            points: on a polyline in the world from the thread's beginning on, (n, 3) [m]

        Raises:
            InputError: the object is no free thread, other points, a curve that is too short or
                too sharp, or one that lies deeper than 2 mm in something; nothing changes
        """
        self._check_kind("set_curve", "free")
        if self.description.thread is None:
            raise InputError(f"{self.name}: set_curve: the object is no thread; allowed: set_cp")
        self._lay(*laid(self.name, self.description.thread, _checked_points(self.name, points)))

    @command
    def set_jp(self, q: ArrayLike) -> None:
        """Put its joint somewhere, at rest.

        Args:
            q: coordinate of a hinge or slide, (1,) [rad or m]; quaternion wxyz of a ball joint,
                relative to where the prop is placed, (4,)

        Raises:
            InputError: the object is free, other numbers, or beyond a limit; nothing changes
        """
        self._check_kind("set_jp", "hinge", "slide", "ball")
        size, joint = len(self._qpos), self._row.joint
        values = [q] if isinstance(q, (int, float)) else q
        values = check_numbers(values, (size,), f"{self.name}: set_jp")
        if size == 4 and not abs(float(np.linalg.norm(values)) - 1.0) < UNIT:
            raise InputError(
                f"{self.name}: set_jp: got {values.tolist()}; allowed: a unit quaternion"
            )
        if joint is not None and size == 1 and not joint.lower <= values[0] <= joint.upper:
            raise InputError(
                f"{self.name}: set_jp: got {values[0]:g}; allowed: {joint.lower:g} to"
                f" {joint.upper:g}"
            )
        self._put(values)

    @command
    def servo_cf(self, wrench: ArrayLike) -> None:
        """Let a force and a torque act on it from now on, until others are set or a reset.

        Args:
            wrench: force at its centre of mass and torque, in axes of the world, (6,) [N, N m]

        Raises:
            InputError: no six finite numbers, more than 100 N or 10 N m, or more than accelerates
                it by 1e3 m/s^2 or 1e4 rad/s^2; nothing changes
        """
        values = check_numbers(wrench, (6,), f"{self.name}: servo_cf")
        if np.abs(values[:3]).max() > self._most_n or np.abs(values[3:]).max() > self._most_nm:
            raise InputError(
                f"{self.name}: servo_cf: got {values.tolist()}; allowed: up to {self._most_n:.3g} N"
                f" and {self._most_nm:.3g} N m along each axis"
            )
        self._applied[:] = values

    def _check_kind(self, verb: str, *kinds: str) -> None:
        """Reject a verb that its kind of joint does not have."""
        kind = self._row.kind
        if kind not in kinds:
            is_on = "is free" if kind == "free" else f"is on a {kind}"
            other = "set_cp" if kind == "free" else "set_jp"
            hint = f"; allowed: {other}" if verb.startswith("set") else ""
            raise InputError(f"{self.name}: {verb}: the object {is_on}{hint}")

    def _lay(self, at: Array, bends: Array | float) -> None:
        """Put a free object somewhere, with the bends of a thread.

        Raises:
            InputError: a thread would lie deeper than 2 mm in something; nothing changes
        """
        coordinates = np.concatenate([at[:3, 3], quaternion_from_matrix(at[:3, :3])])
        if self.description.thread is not None:
            self._check_apart(coordinates, bends)
        self._put(coordinates)
        self._data.qpos[self._bends[0]] = bends

    def _check_apart(self, coordinates: Array, bends: Array | float) -> None:
        """Reject a place of a thread that is deep in other bodies."""
        model, there = self._model, mujoco.MjData(self._model)
        there.qpos[:] = self._data.qpos
        there.qpos[self._row.qpos], there.qpos[self._bends[0]] = coordinates, bends
        mujoco.mj_fwdPosition(model, there)
        deep = (there.contact.dist < -OVERLAP_M) & (there.contact.geom.min(axis=1) >= 0)
        met = model.geom_bodyid[there.contact.geom[deep]]
        its = model.body_treeid[met] == self._tree
        others = np.unique(met[its.any(axis=1, keepdims=True) & ~its])
        if len(others):
            depth = -float(there.contact.dist[deep][its.any(axis=1)].min())
            raise InputError(
                f"{self.name}: would lie {1e3 * depth:.1f} mm deep in"
                f" {', '.join(model.body(k).name for k in others)}; allowed: up to"
                f" {1e3 * OVERLAP_M:g} mm"
            )

    def _put(self, coordinates: Array) -> None:
        self._grasps.let_go(prop=self.name)
        rates = self._row.qvel
        self._qpos[:] = coordinates
        self._qvel[:] = self._data.qvel[self._bends[1]] = 0.0
        if self._data.tree_asleep[self._tree] < 0:  # it was still, held by what it touched: no more
            self._data.tree_asleep[self._tree] = -(1 + mujoco.mjMINAWAKE)
        self._data.qacc_warmstart[rates] = 0.0
        self._data.qacc[rates] = np.nan  # belongs to where it was; sensors look for this mark


class Objects(Part):
    """All objects of a rig.

    Args:
        rig: its description
        journal: receives commands
        grasps: what the jaws of the rig hold

    Attributes:
        by_name: the objects
        kinematics: of the objects in the model that they are attached to
    """

    def __init__(self, rig: RigDescription, journal: Journal, grasps: Grasps) -> None:
        self._rig = rig
        self.by_name = {prop.name: SceneObject(prop, journal, grasps) for prop in rig.objects}
        self._names = tuple(self.by_name)

    def attach(self, physics: Attached) -> None:
        """Take the physics that the objects are in."""
        self._data, self.kinematics = physics.data, ObjectKinematics(self._rig, physics.model)
        for one in self.by_name.values():
            one.attach(physics.model, physics.data, self.kinematics)

    def states(self) -> ObjectStates:
        """Return poses and velocities of all of them."""
        qpos, qvel = self._data.qpos, self._data.qvel
        at, v = self.kinematics.motion(qpos, qvel)
        parts = at[:, :3], at[:, 3:], v[:, :3], v[:, 3:], self.kinematics.coordinates(qpos, qvel)
        return ObjectStates(self._names, float(self._data.time), *parts)


def _checked_points(name: str, points: ArrayLike) -> Array:
    """Return two or more points that are given to an object, (n, 3) [m].

    Raises:
        InputError: no points, one point, or some too far away
    """
    try:
        curve: Array = np.asarray(points, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        curve = np.zeros(0)
    if curve.ndim != 2 or curve.shape[1] != 3 or len(curve) < 2:
        raise InputError(f"{name}: got points of shape {curve.shape}; allowed: (n, 3), n > 1")
    if not (np.abs(curve) <= FARTHEST_M).all():  # NaN is not either
        raise InputError(f"{name}: got {points!r}; allowed: points up to {FARTHEST_M:g} m away")
    return curve
