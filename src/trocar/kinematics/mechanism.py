"""A mechanism: a tree of frames, what moves them, and the points that close loops."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from trocar.errors import LoopError, UnknownNameError

Array = NDArray[np.float64]
JointKind = Literal["revolute", "prismatic"]
Motion = Literal["fixed", "revolute", "prismatic"]


@dataclass(frozen=True)
class Joint:
    """A public coordinate of an arm.

    Attributes:
        name: the dVRK's name ("yaw", "insertion", "jaw", ...)
        kind: revolute [rad] or prismatic [m]
        lower: smallest position [rad or m]
        upper: largest position [rad or m]
        drive: the frames whose motion the motor makes, with weights:
            q = sum(weight * coordinate of frame)
    """

    name: str
    kind: JointKind
    lower: float
    upper: float
    drive: tuple[tuple[str, float], ...]


@dataclass(frozen=True, eq=False)
class Frame:
    """One link frame: T_parent_frame = before @ motion_z(coordinate) @ after.

    Attributes:
        name: name of the frame
        parent: name of the parent frame, None for the root
        motion: turns about or slides along z of `before`, or is fixed
        before: pose of the moving axis in the parent, (4, 4)
        after: pose of the frame on the moving side, (4, 4)
        couplings: ((joint, ratio), ...): coordinate = sum(ratio * q[joint])
        lower, upper: range of the coordinate of an actuator that several joints move; motions are
            planned in it, no stop holds the simulation there [rad or m]
    """

    name: str
    parent: str | None
    motion: Motion
    before: Array
    after: Array
    couplings: tuple[tuple[str, float], ...] = ()
    lower: float = -np.inf
    upper: float = np.inf


@dataclass(frozen=True, eq=False)
class Closure:
    """A hinge that closes a loop: point_a on frame_a is point_b on frame_b.

    Attributes:
        name: name of the point ("c1")
        frame_a, point_a: frame and point in it, (3,) [m]
        frame_b, point_b: the same on the other side
        passive: the two frames whose coordinates this hinge determines; where its pin may slide
            along its axis, the frame of the pin comes third
        guard: two frames that turn alike when the loop is a parallelogram, or ()
        open: whether the hinge has come apart, for simulations; kinematics always take the linkage
            as closed
    """

    name: str
    frame_a: str
    point_a: Array
    frame_b: str
    point_b: Array
    passive: tuple[str, ...]
    guard: tuple[str, ...] = ()
    open: bool = False


@dataclass(frozen=True, eq=False)
class Mechanism:
    """Frames in an order where parents come first, and what moves them.

    Attributes:
        name: name of the arm
        joints: public coordinates, in their public order
        frames: every frame, parents first; the first is the root
        closures: the hinges that close loops
        reference: frame that public poses are given in
        tip: frame whose pose is the tip's
    """

    name: str
    joints: tuple[Joint, ...]
    frames: tuple[Frame, ...]
    closures: tuple[Closure, ...] = ()
    reference: str = ""
    tip: str = ""

    @cached_property
    def frame_index(self) -> dict[str, int]:
        """Position of each frame in `frames`."""
        return {frame.name: index for index, frame in enumerate(self.frames)}

    @cached_property
    def joint_index(self) -> dict[str, int]:
        """Position of each joint in `joints`."""
        return {joint.name: index for index, joint in enumerate(self.joints)}

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the public coordinates."""
        return tuple(joint.name for joint in self.joints)

    @property
    def frame_names(self) -> tuple[str, ...]:
        """Names of every frame, the closing points included."""
        return tuple(f.name for f in self.frames) + tuple(c.name for c in self.closures)

    @cached_property
    def lower(self) -> Array:
        """Lower limits, (n,) [rad or m]."""
        return _read_only([joint.lower for joint in self.joints])

    @cached_property
    def upper(self) -> Array:
        """Upper limits, (n,) [rad or m]."""
        return _read_only([joint.upper for joint in self.joints])

    def within(self, q: Array) -> NDArray[np.bool_]:
        """Return whether positions are in the ranges of joints and actuators, (..., n) -> (...)."""
        inside = np.all((self.lower <= q) & (q <= self.upper), axis=-1)
        for frame, ratio in zip(self.frames, self.ratios, strict=True):
            if np.isfinite([frame.lower, frame.upper]).any():
                inside = inside & (frame.lower <= q @ ratio) & (q @ ratio <= frame.upper)
        return np.asarray(inside)

    @cached_property
    def ratios(self) -> Array:
        """D coordinate / d q for loops that are parallelograms, (n_frames, n_joints)."""
        table = np.zeros((len(self.frames), len(self.joints)))
        for row, frame in enumerate(self.frames):
            for joint, ratio in frame.couplings:
                table[row, self.joint_index[joint]] += ratio
        return _read_only(table)

    def frame(self, name: str) -> Frame:
        """Return the frame called `name`.

        Raises:
            UnknownNameError: no frame has this name; the known ones are listed
        """
        try:
            return self.frames[self.frame_index[name]]
        except KeyError:
            raise UnknownNameError("frame", name, self.frame_names, self.name) from None

    def chain(self, name: str) -> tuple[int, ...]:
        """Return the indices of the frames from the root to `name`, both included."""
        found: list[int] = []
        at: str | None = self.frame(name).name
        while at is not None:
            found.append(self.frame_index[at])
            at = self.frames[found[-1]].parent
        return tuple(reversed(found))


def check_mechanism(mechanism: Mechanism) -> Mechanism:
    """Return the mechanism when it hangs together.

    Raises:
        LoopError: a frame before its parent, an unknown name, or a passive frame that no
            closure can move
    """
    seen: set[str] = set()
    for frame in mechanism.frames:
        if frame.name in seen:
            raise LoopError(f"{mechanism.name}: frame {frame.name!r} is defined twice")
        if frame.parent is None and seen:
            raise LoopError(f"{mechanism.name}: frame {frame.name!r} has no parent")
        if frame.parent is not None and frame.parent not in seen:
            raise LoopError(
                f"{mechanism.name}: frame {frame.name!r} comes before its parent {frame.parent!r}"
            )
        seen.add(frame.name)
        for joint, _ in frame.couplings:
            if joint not in mechanism.joint_index:
                raise UnknownNameError("joint", joint, mechanism.joint_names, frame.name)
    for joint in mechanism.joints:
        for name, _ in joint.drive:
            mechanism.frame(name)
    for closure in mechanism.closures:
        for name in (closure.frame_a, closure.frame_b, *closure.passive, *closure.guard):
            mechanism.frame(name)
        moved = {*mechanism.chain(closure.frame_a), *mechanism.chain(closure.frame_b)}
        for name in closure.passive:
            if mechanism.frame_index[name] not in moved:
                raise LoopError(
                    f"{mechanism.name}: closure {closure.name!r} is not moved by {name!r}"
                )
    mechanism.frame(mechanism.reference)
    mechanism.frame(mechanism.tip)
    return mechanism


def _read_only(values: object) -> Array:
    array = np.array(values, dtype=np.float64)
    array.setflags(write=False)
    return array
