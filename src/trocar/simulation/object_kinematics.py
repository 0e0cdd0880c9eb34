"""Poses and velocities of objects from the coordinates of their joints."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.records import PropJoint, RigDescription
from trocar.geometry.rotations import (
    matrix_from_quaternion,
    matrix_from_rotation_vector,
    quaternion_from_matrix,
)
from trocar.geometry.se3 import inverse, transform
from trocar.modeling import naming

Array = NDArray[np.float64]
Index = NDArray[np.intp]

#: Coordinates and rates of a joint; a free one has a position too.
WIDTHS = {"free": (7, 6), "ball": (4, 3), "slide": (1, 1), "hinge": (1, 1)}


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
        places, free = qpos[self._places], qvel[self._rates]
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
        found = np.full((len(self.joints), 2), np.nan)
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
