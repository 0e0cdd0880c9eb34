"""What a rig has that can be moved: where it is, how fast, and putting it elsewhere."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.descriptions.records import Prop, RigDescription
from trocar.errors import InputError
from trocar.geometry.rotations import matrix_from_quaternion, quaternion_from_matrix
from trocar.geometry.se3 import check_transform
from trocar.modeling import naming
from trocar.simulation.journal import Journal, command
from trocar.simulation.records import Pose, Twist

Array = NDArray[np.float64]
Index = NDArray[np.intp]

#: The frame of objects' poses: that of the rig, which its arms stand in.
FRAME = "world"
#: No object or tip is put farther from the origin. Source: our own choice; MuJoCo calls a position
#: of 1e10 diverged. [m]
FARTHEST_M = 1e3


@dataclass(frozen=True, eq=False)
class ObjectStates:
    """Where all objects are at a time, and how fast; rows follow `names`.

    Attributes:
        names: of the objects
        time: [s]
        positions: of their frames in the world, (n, 3) [m]
        quaternions: wxyz, (n, 4)
        linear: velocity of the frame's origin in the world, (n, 3) [m/s]
        spin: angular velocity in the object's own axes, (n, 3) [rad/s]
    """

    names: tuple[str, ...]
    time: float
    positions: Array
    quaternions: Array
    linear: Array
    spin: Array

    @property
    def angular(self) -> Array:
        """Angular velocity in axes of the world, (n, 3) [rad/s]."""
        return (matrix_from_quaternion(self.quaternions) @ self.spin[..., None])[..., 0]


class SceneObject:
    """A movable prop. Its commands are entries under its own name.

    Args:
        prop: its description
        journal: receives its commands

    Attributes:
        name: what it is called
        description: the prop
    """

    def __init__(self, prop: Prop, journal: Journal) -> None:
        self.name, self.description = prop.name, prop
        self._journal, self._source, self._prefix = journal, prop.name, ""

    def attach(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        """Take the physics that the object is in."""
        joint = model.joint(naming.free_joint(self.name))
        first, rate = int(joint.qposadr[0]), int(joint.dofadr[0])
        self._data = data
        self._qpos, self._qvel = data.qpos[first : first + 7], data.qvel[rate : rate + 6]
        self._rates = slice(rate, rate + 6)
        #: Where its first coordinate is in qpos.
        self.place = first

    @property
    def mass(self) -> float:
        """What it weighs [kg]."""
        movable = self.description.movable
        return 0.0 if movable is None else movable.mass

    def measured_cp(self) -> Pose:
        """Return where its frame is in the world."""
        at = np.eye(4)
        at[:3, :3] = matrix_from_quaternion(self._qpos[3:])
        at[:3, 3] = self._qpos[:3]
        return Pose(at, FRAME, float(self._data.time))

    def measured_cv(self) -> Twist:
        """Return the velocity of its frame's origin and its rotation, in axes of the world."""
        turn = matrix_from_quaternion(self._qpos[3:])
        linear, angular = self._qvel[:3].copy(), turn @ self._qvel[3:]
        return Twist(linear, angular, FRAME, float(self._data.time))

    @command
    def set_cp(self, T: ArrayLike) -> None:
        """Put it somewhere, at rest.

        Args:
            T: pose of its frame in the world, (4, 4)

        Raises:
            InputError: no pose, or one too far away; nothing changes
        """
        at = checked_pose(self.name, T)
        self._qpos[:3] = at[:3, 3]
        self._qpos[3:] = quaternion_from_matrix(at[:3, :3])
        self._qvel[:] = 0.0
        self._data.qacc_warmstart[self._rates] = 0.0
        self._data.qacc[self._rates] = np.nan  # belongs to where it was; sensors look for this mark


class Objects:
    """All objects of a rig.

    Args:
        rig: its description
        journal: receives commands
    """

    def __init__(self, rig: RigDescription, journal: Journal) -> None:
        self.by_name = {prop.name: SceneObject(prop, journal) for prop in rig.objects}
        self._names = tuple(self.by_name)

    def attach(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        """Take the physics that the objects are in."""
        self._data = data
        joints = [model.joint(naming.free_joint(name)) for name in self._names]
        first = np.array([int(j.qposadr[0]) for j in joints], np.intp)
        rate = np.array([int(j.dofadr[0]) for j in joints], np.intp)
        self._places, self._rates = first[:, None] + np.arange(7), rate[:, None] + np.arange(6)
        for one in self.by_name.values():
            one.attach(model, data)

    def states(self) -> ObjectStates:
        """Return where all of them are."""
        at, v = self._data.qpos[self._places], self._data.qvel[self._rates]
        return ObjectStates(
            self._names, float(self._data.time), at[:, :3], at[:, 3:], v[:, :3], v[:, 3:]
        )


def checked_pose(name: str, T: ArrayLike) -> Array:
    """Return a pose that is given to an object or an arm, (4, 4).

    Raises:
        InputError: no pose, or one too far away
    """
    try:
        at = check_transform(T, f"{name}: pose")
    except (TypeError, ValueError, OverflowError) as problem:
        raise InputError(f"{name}: got the pose {T!r}; allowed: (4, 4) finite numbers") from problem
    if at.shape != (4, 4):
        raise InputError(f"{name}: got a pose of shape {at.shape}; allowed: (4, 4)")
    if np.abs(at[:3, 3]).max() > FARTHEST_M:
        raise InputError(
            f"{name}: got a pose at {at[:3, 3].tolist()} m; allowed: up to {FARTHEST_M:g} m away"
        )
    return at
