"""An arm whose linkage is not the drawing's, but closes as exactly."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.records import ArmDescription
from trocar.errors import InputError
from trocar.geometry.rotations import rotation_z
from trocar.geometry.se3 import inverse, transform
from trocar.kinematics.forward import poses
from trocar.kinematics.mechanism import Closure, Frame, Mechanism

Array = NDArray[np.float64]

#: How far a robot is off its drawing. Source: the spread of the paper's Table 6, doubled.
LENGTH_M, ANGLE_RAD = 0.003, math.radians(1.0)


def perturbed(
    arm: ArmDescription,
    rng: np.random.Generator,
    length_m: float = LENGTH_M,
    angle_rad: float = ANGLE_RAD,
) -> ArmDescription:
    """Return a PSM or an ECM with other link lengths and angles, its parallelograms still closed.

    Opposite sides stay equal: 3-4 and 6-c1, 3-6 and 4-c1, 6-8 and 7-c2, 6-7 and 8-c2. Each
    length is off by up to `length_m`, the angles of 3-4, 3-6 (beta1) and 3-7 (beta2) by up to
    `angle_rad`. 6-8 stays parallel to the yaw axis, so that there is a remote centre, and the shaft
    still passes it, as on the drawing.

    Args:
        arm: a PSM or an ECM
        rng: where the numbers come from
        length_m: [m]
        angle_rad: [rad]

    Raises:
        InputError: another arm
    """
    if arm.type not in ("PSM", "ECM") or len(arm.mechanism.closures) != 2:
        raise InputError(f"{arm.name}: got a {arm.type}; allowed: a PSM or an ECM with two loops")
    off = _Offsets(arm, rng.uniform(-length_m, length_m, 4), rng.uniform(-angle_rad, angle_rad, 3))
    return replace(arm, mechanism=off.mechanism(), title=f"{arm.title}, not as drawn")


class _Offsets:
    """The linkage at q = 0, seen along its axes: vectors in the plane that are made anew.

    u goes from axis 3 to 4, v from 3 to 6, w from 3 to 7, l from 6 to 8; of each the length, and
    of u, v and w the angle, are off. Poses are in the frame of the body that carries axes 3 and 4.
    """

    def __init__(self, arm: ArmDescription, lengths: Array, angles: Array) -> None:
        self.arm = arm
        old = arm.mechanism
        c1, c2 = old.closures
        self.four, self.six, self.seven, self.eight = c1.frame_a, c1.frame_b, c2.frame_a, c2.frame_b
        self.three = next(
            name
            for name in (old.frames[i].name for i in reversed(old.chain(self.six)[:-1]))
            if old.frame(name).motion != "fixed"
        )
        q = np.zeros(len(old.joints))
        self.home = poses(old, q, self.three)
        place = {n: self.home[n][:3, 3] for n in (self.four, self.six, self.seven, self.eight)}
        along = place[self.eight] - place[self.six]
        self.turns = dict(zip("uvw", angles, strict=True))
        self.u = _turned(place[self.four], lengths[0], angles[0])
        self.v = _turned(place[self.six], lengths[1], angles[1])
        self.w = _turned(place[self.seven], lengths[2], angles[2])
        self.l = _turned(along, lengths[3], 0.0)

    def mechanism(self) -> Mechanism:
        """Return the mechanism with every pose, closing point and the remote centre anew."""
        at = self._new_home()
        old = self.arm.mechanism
        frames = tuple(self._frame(frame, at) for frame in old.frames)
        c1, c2 = old.closures
        closures = (
            _closure(c1, at, at[self.six][:3, 3] + self.u),
            _closure(c2, at, at[self.eight][:3, 3] + self.w - self.v),
        )
        return replace(old, frames=frames, closures=closures)

    def _new_home(self) -> dict[str, Array]:
        """Return the new poses at q = 0 in the old frame of axis 3, of all that change."""
        at = dict(self.home)
        at[self.three] = _placed(self.home[self.three], np.zeros(3), self.turns["v"])
        at[self.four] = _placed(self.home[self.four], self.u, self.turns["v"])
        at[self.six] = _placed(self.home[self.six], self.v, 0.0)
        at[self.seven] = _placed(self.home[self.seven], self.w, 0.0)
        at[self.eight] = _placed(self.home[self.eight], self.v + self.l, 0.0)
        centre = self.l  # the end link turns about it, whatever the other sides are
        moved = centre - self._old_centre()
        at["rcm"] = _shifted(self.home["rcm"], moved)
        at["insertion"] = _shifted(self.home["insertion"], moved)
        return at

    def _old_centre(self) -> Array:
        return self.home[self.eight][:3, 3] - self.home[self.six][:3, 3]

    def _frame(self, frame: Frame, at: dict[str, Array]) -> Frame:
        """Return a frame on its parent, both as they stand now."""
        changed = {self.three, self.four, self.six, self.seven, self.eight, "rcm", "insertion"}
        if frame.name not in changed or frame.parent is None:
            return frame
        parent = self._carrier(frame.parent, at)
        return replace(frame, before=inverse(parent) @ at[frame.name] @ inverse(frame.after))

    def _carrier(self, name: str, at: dict[str, Array]) -> Array:
        """Return the new pose of a frame, by what it is fixed to where it is none of the axes'."""
        frame = self.arm.mechanism.frame(name)
        fixed = frame.motion == "fixed" and frame.parent is not None and name not in ("rcm",)
        if fixed and frame.parent == self.three:
            return at[self.three] @ frame.before @ frame.after
        return at[name]


def _turned(vector: Array, longer: float, angle: float) -> Array:
    """Return a vector in the plane across z, longer and turned; what it has along z stays."""
    flat = np.array([vector[0], vector[1], 0.0])
    size = float(np.linalg.norm(flat))
    return rotation_z(angle) @ flat * (1.0 + longer / size) + np.array([0.0, 0.0, vector[2]])


def _placed(pose: Array, origin: Array, angle: float) -> Array:
    """Return a pose with another origin, turned about z of the frame that it is told in."""
    return transform(rotation_z(angle) @ pose[:3, :3], origin)


def _shifted(pose: Array, by: Array) -> Array:
    return transform(pose[:3, :3], pose[:3, 3] + by)


def _closure(closure: Closure, at: dict[str, Array], point: Array) -> Closure:
    """Return a closing hinge whose point on both sides is this one at q = 0."""

    def seen(frame: str, old: Array) -> Array:
        told = inverse(at[frame]) @ np.append(point, 1.0)
        return np.array([told[0], told[1], old[2]])

    return replace(
        closure,
        point_a=seen(closure.frame_a, closure.point_a),
        point_b=seen(closure.frame_b, closure.point_b),
    )
