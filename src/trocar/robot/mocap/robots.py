"""Simulated robots that are not as drawn: other lengths, broken loops, worn bearings."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.calibration_plan import default_plan
from trocar.descriptions.overlay import apply_overlay
from trocar.descriptions.overlay_records import ClosurePatch, FramePatch, Overlay
from trocar.descriptions.records import ArmDescription
from trocar.descriptions.serial_axes import serial_joints
from trocar.errors import InputError
from trocar.geometry.rotations import matrix_from_rotation_vector, rotation_z, rpy_from_matrix
from trocar.geometry.se3 import inverse, transform
from trocar.kinematics.forward import poses
from trocar.kinematics.mechanism import Closure, Frame

Array = NDArray[np.float64]

#: Errors of a robot against its drawing. Source: the spread of the paper's Table 6, doubled.
LENGTH_M, ANGLE_RAD = 0.003, math.radians(1.0)
#: Displacement of each axis across itself, and its tilt. Source: our own choice; it makes the
#: remote centre wander by tenths of a millimetre, as the paper's real PSM does (Table 7).
DISPLACED_M, TILTED_RAD = 0.0003, 0.001


def perturbed(
    arm: ArmDescription,
    rng: np.random.Generator,
    length_m: float = LENGTH_M,
    angle_rad: float = ANGLE_RAD,
) -> ArmDescription:
    """Return an arm with other link lengths and angles, its parallelograms still closed.

    Of an arm without a remote centre that loops make: see `displaced_joints`. Of a PSM or an ECM
    opposite sides stay equal: 3-4 and 6-c1, 3-6 and 4-c1, 6-8 and 7-c2, 6-7 and 8-c2. Each
    length is off by up to `length_m`, the angles of 3-4, 3-6 (beta1) and 3-7 (beta2) by up to
    `angle_rad`. 6-8 stays parallel to the yaw axis, so that there is a remote centre, and the shaft
    still passes it, as on the drawing.

    Args:
        arm: a PSM or an ECM, or an arm whose chain is calibrated
        rng: where the numbers come from
        length_m: [m]
        angle_rad: [rad]

    Raises:
        InputError: an arm without joints to displace
    """
    if arm.type not in ("PSM", "ECM") or len(arm.mechanism.closures) != 2:
        return displaced_joints(arm, rng, length_m, angle_rad)
    old = arm.mechanism
    c1, c2 = old.closures
    four, six, seven, eight = c1.frame_a, c1.frame_b, c2.frame_a, c2.frame_b
    above = [old.frames[i] for i in reversed(old.chain(six)[:-1])]
    three = next(frame.name for frame in above if frame.motion != "fixed")
    lengths, angles = rng.uniform(-length_m, length_m, 4), rng.uniform(-angle_rad, angle_rad, 3)
    # At q = 0, in the frame of axis 3: vectors from axis 3 to 4, 6 and 7, and from 6 to 8.
    home = poses(old, np.zeros(len(old.joints)), three)
    end = home[eight][:3, 3] - home[six][:3, 3]
    to_4 = _stretched(home[four][:3, 3], lengths[0], angles[0])
    to_6 = _stretched(home[six][:3, 3], lengths[1], angles[1])
    to_7 = _stretched(home[seven][:3, 3], lengths[2], angles[2])
    new_end = _stretched(end, lengths[3], 0.0)
    turn = rotation_z(angles[1])
    moved = {
        three: transform(turn @ home[three][:3, :3], np.zeros(3)),
        four: transform(turn @ home[four][:3, :3], to_4),
        six: transform(home[six][:3, :3], to_6),
        seven: transform(home[seven][:3, :3], to_7),
        eight: transform(home[eight][:3, :3], to_6 + new_end),
    }
    for name in ("rcm", "insertion"):  # the end link turns about the centre
        moved[name] = transform(home[name][:3, :3], home[name][:3, 3] + (new_end - end))
    at = home | moved
    for frame in old.frames:
        if frame.motion == "fixed" and frame.parent == three and frame.name not in moved:
            at[frame.name] = at[three] @ frame.before @ frame.after

    def placed(frame: Frame) -> Frame:
        if frame.name not in moved or frame.parent is None:
            return frame
        before = inverse(at[frame.parent]) @ at[frame.name] @ inverse(frame.after)
        return replace(frame, before=before)

    def closed(closure: Closure, point: Array) -> Closure:
        a, b = (inverse(at[f]) @ np.append(point, 1.0) for f in (closure.frame_a, closure.frame_b))
        return replace(
            closure,
            point_a=np.array([a[0], a[1], closure.point_a[2]]),
            point_b=np.array([b[0], b[1], closure.point_b[2]]),
        )

    mechanism = replace(
        old,
        frames=tuple(placed(frame) for frame in old.frames),
        closures=(
            closed(c1, at[six][:3, 3] + to_4),
            closed(c2, at[eight][:3, 3] + to_7 - to_6),
        ),
    )
    return replace(arm, mechanism=mechanism, title=f"{arm.title}, not as drawn")


def displaced_joints(
    arm: ArmDescription,
    rng: np.random.Generator,
    length_m: float = LENGTH_M,
    angle_rad: float = ANGLE_RAD,
) -> ArmDescription:
    """Return an arm whose chain has its axes displaced and tilted; its loops stay as drawn.

    Args:
        arm: an arm without a remote centre that loops make
        rng: where the numbers come from
        length_m: each axis is off by up to this across itself [m]
        angle_rad: and turned by up to this about all three axes of its frame [rad]

    Raises:
        InputError: an arm all of whose axes belong to loops
    """
    mechanism = arm.mechanism
    looped = {f for c in mechanism.closures for end in (c.frame_a, c.frame_b)
              for f in (mechanism.frames[i].name for i in mechanism.chain(end))}  # fmt: skip
    frames: dict[str, FramePatch] = {}
    for name in (joint.frame for joint in serial_joints(arm)):
        across = np.append(rng.uniform(-length_m, length_m, 2), 0.0)
        turn = rng.uniform(-angle_rad, angle_rad, 3)
        if name not in looped:
            before = mechanism.frame(name).before
            at = before[:3, 3] + before[:3, :3] @ across
            R = before[:3, :3] @ matrix_from_rotation_vector(turn)
            frames[name] = FramePatch(at, rpy_from_matrix(R))
    if not frames:
        raise InputError(f"{arm.name}: its loops carry all axes; allowed: psm, ecm, or an arm with"
                         " others")  # fmt: skip
    found = apply_overlay(arm, Overlay(arm.name, "parallelogram", frames))
    return replace(found, overlay=None, title=f"{arm.title}, not as drawn")


def _stretched(vector: Array, longer: float, angle: float) -> Array:
    """Return a vector in the plane across z, longer and turned; what it has along z stays."""
    flat = np.array([vector[0], vector[1], 0.0])
    size = float(np.linalg.norm(flat))
    return rotation_z(angle) @ flat * (1.0 + longer / size) + np.array([0.0, 0.0, vector[2]])


def broken(arm: ArmDescription, rng: np.random.Generator, loops_m: float) -> ArmDescription:
    """Return an arm whose loops are no parallelograms: each closing hinge is displaced.

    The hinges stay parallel. A displacement of 1 mm is that of the paper's Table 6.

    Args:
        arm: with closed loops whose frames have z along their axes, as a PSM and an ECM
        rng: draws the directions, across the axes
        loops_m: length of each displacement [m]

    Raises:
        InputError: the arm carries a calibration already
        DescriptionError: its loops do not close any more
    """
    closures: dict[str, ClosurePatch] = {}
    for closure in arm.mechanism.closures:
        way = rng.uniform(-math.pi, math.pi)
        by = loops_m * np.array([math.cos(way), math.sin(way), 0.0])
        closures[closure.name] = ClosurePatch(closure.point_a + by, closure.point_b)
    return apply_overlay(arm, Overlay(arm.name, "general", {}, closures))


def worn(
    arm: ArmDescription,
    rng: np.random.Generator,
    displaced_m: float = DISPLACED_M,
    tilted_rad: float = TILTED_RAD,
) -> ArmDescription:
    """Return an arm each axis of whose loops is a little off, as bearings wear.

    Opposite sides are no longer equal and axes no longer parallel; pins shift in their hinges, so
    the loops still close and move.

    Args:
        arm: with closed loops whose frames have z along their axes, as a PSM and an ECM
        rng: where the numbers come from
        displaced_m: each axis is off by up to this along x and y of its frame [m]
        tilted_rad: and tilted by up to this about them [rad]

    Raises:
        InputError: the arm carries a calibration already
        DescriptionError: its loops do not close any more
    """
    mechanism = arm.mechanism

    def across(most: float) -> Array:
        return np.append(rng.uniform(-most, most, 2), 0.0)

    def moved(before: Array) -> FramePatch:
        at = before[:3, 3] + before[:3, :3] @ across(displaced_m)
        turned = before[:3, :3] @ matrix_from_rotation_vector(across(tilted_rad))
        return FramePatch(at, rpy_from_matrix(turned))

    axes = default_plan(mechanism).axes.values()
    frames = {n: moved(mechanism.frame(n).before) for n in axes if n in mechanism.frame_index}
    closures = {
        c.name: ClosurePatch(
            c.point_a + across(displaced_m), c.point_b + across(displaced_m), slides=True
        )
        for c in mechanism.closures
    }
    return apply_overlay(arm, Overlay(arm.name, "general", frames, closures))
