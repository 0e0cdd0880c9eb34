"""Where a calibrated linkage stands on its arm.

The sweep of the loops alone says how the axes stand to one another, not how the whole stands on the
arm. Where the description has a remote centre (a slide on a link of the loops whose line passes the
arm's reference point at every joint position), the calibrated linkage is placed so that its own
remote centre is there, in the direction from its first axis that the description has, and the slide
passes it as before. Elsewhere the first axis of the ground stays, and its direction to the next.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions import ArmDescription
from trocar.descriptions.overlay import ClosurePatch, FramePatch, closure_patch, frame_patch
from trocar.kinematics.forward import poses
from trocar.kinematics.loops import closed_coordinates
from trocar.kinematics.mechanism import Frame, Mechanism
from trocar.robot.calibration.axes import BaseAxis, slopes
from trocar.robot.calibration.linkage import (
    LoopedPart,
    Slot,
    bodies_of,
    displacements,
    home_points,
    in_frame,
    rebuilt,
    shift_rows,
    slots,
)
from trocar.robot.calibration.refine import Refined
from trocar.robot.calibration.robot import Robot, body_poses, displaced, mechanism_of, swept
from trocar.robot.calibration.zero_pose import planar_turn

Array = NDArray[np.float64]

# Source: our own choice; a description whose slide passes its reference point is exact to rounding.
PASSES_M = 1e-6


@dataclass(frozen=True, eq=False)
class Centre:
    """The remote centre of a description.

    Attributes:
        body: the body of the loops that turns about it
        slide: the frame that slides through it
        base: the body on which it rests
        point: in the plane of the linkage at home, (2,) [m]
        start: the ground's first hinge, in the same plane (2,) [m]
        turns: the frame that is the first of the ground's body, and turns it
        axis: about which it turns, where tracks show it and the linkage is to stand on it
    """

    body: str
    slide: str
    base: str
    point: Array
    start: Array
    turns: str
    axis: BaseAxis | None = None


def remote_centre_of(arm: ArmDescription, linkage: LoopedPart) -> Centre | None:
    """Return the remote centre that a description is built for, None where there is none."""
    mechanism, body_of = arm.mechanism, bodies_of(arm)
    q = swept(linkage, mechanism)
    every = poses(mechanism, q, mechanism.reference)
    ground = poses(mechanism, linkage.rest, linkage.bodies[linkage.ground])
    base = body_of[mechanism.reference]
    if base in linkage.bodies and base != linkage.ground:
        return None
    for frame in mechanism.frames:
        body = body_of.get(str(frame.parent), "")
        if frame.motion != "prismatic" or body not in linkage.bodies:
            continue
        axis = every[str(frame.parent)] @ frame.before
        along, at = axis[..., :3, 2], axis[..., :3, 3]
        if np.linalg.norm(np.cross(at, along), axis=-1).max() < PASSES_M:
            point = linkage.plane[:, :2].T @ ground[mechanism.reference][:3, 3]
            start = linkage.points[linkage.hinges[0].name]
            return Centre(body, frame.name, base, point, start, linkage.bodies[linkage.ground])
    return None


def still_point(robot: Robot, body: str) -> tuple[Array, float]:
    """Find the point of a body that moves least in the ground, over a sweep of the joints.

    Returns:
        it at home, in the plane (2,) [m]; and the root of its mean squared distance from there [m]
    """
    linkage, mechanism = robot.linkage, mechanism_of(robot)
    q = swept(linkage, mechanism)
    at = body_poses(linkage, mechanism, closed_coordinates(mechanism, q))
    pose = linkage.plane.T @ at[body][..., :3, :]
    # In the plane: turn @ tip + place = post, for the body's tip and the ground's post.
    turn = pose[:, :2, :3] @ linkage.frames[linkage.bodies[body]][:3, :3].T @ linkage.plane[:, :2]
    place = pose[:, :2, 3]
    left = np.concatenate([turn, -np.tile(np.eye(2), (len(q), 1, 1))], axis=2).reshape(-1, 4)
    found = np.asarray(np.linalg.lstsq(left, -place.ravel(), rcond=None)[0], dtype=np.float64)
    away = turn @ found[:2] + place - found[2:]
    return found[2:], float(np.sqrt(np.mean(np.sum(away**2, axis=1))))


def placed(robot: Robot, centre: Centre | None) -> Robot:
    """Return the robot with its linkage placed on its arm; its markers do not follow."""
    if centre is None:
        return robot
    linkage = robot.linkage
    points = home_points(linkage, robot.moved)
    own, _ = still_point(robot, centre.body)
    turn, goal, lean = _stand(robot, centre, points, own)
    moved = displacements(
        linkage, {slot: turn @ (points[slot] - own) + goal for slot in slots(linkage)}
    )
    tilts = {name: turn @ tilt for name, tilt in robot.tilts.items()}
    if lean.any():
        for hinge in linkage.hinges:
            if not hinge.closure and hinge.body_a == linkage.ground:
                tilts[hinge.name] = tilts.get(hinge.name, np.zeros(2)) + lean
    return replace(robot, moved=moved, tilts=tilts)


def _stand(
    robot: Robot, centre: Centre, points: Mapping[Slot, Array], own: Array
) -> tuple[Array, Array, Array]:
    """Return how the linkage is turned, where its remote centre goes, and how far it leans.

    Without a measured axis the centre goes to the description's, and its direction from the first
    hinge too. With one, the linkage stands on the arm's axis as it does on the measured one; how
    far along and which way about it are the description's.
    """
    linkage = robot.linkage
    first = linkage.hinges[0]
    if centre.axis is None:
        have = own - points[Slot(first.name, first.body_a)]
        return _onto(have, centre.point - centre.start), centre.point, np.zeros(2)
    frame = linkage.mechanism.frame(centre.turns)
    drawn = linkage.plane.T @ np.linalg.inv(frame.after)[:3, 2:]  # the axis, a point of it
    markers = robot.markers[linkage.ground]
    along = linkage.plane.T @ (markers[:3, :3] @ centre.axis.direction)
    at = linkage.plane.T @ (markers[:3, :3] @ centre.axis.point + markers[:3, 3])
    turn = _onto(along[:2], drawn[:2, 0])
    up = drawn[:2, 0] / np.linalg.norm(drawn[:2, 0])
    across = np.array([-up[1], up[0]])
    # Across the axis the centre is as far off as measured, along it where the description has it.
    off = across @ (turn @ (own - at[:2])) + across @ drawn[:2, 1]
    goal = up * (up @ centre.point) + across * off
    return turn, goal, along[2] * across


def _onto(have: Array, want: Array) -> Array:
    """Return the rotation that brings one direction of the plane to another, (2, 2)."""
    return planar_turn(float(np.arctan2(have[0] * want[1] - have[1] * want[0], have @ want)))


def calibrated(arm: ArmDescription, robot: Robot, centre: Centre | None) -> Mechanism:
    """Return the whole arm's mechanism with the calibrated linkage in it."""
    linkage, there = robot.linkage, placed(robot, centre)
    mechanism = rebuilt(linkage, arm.mechanism, there.moved, there.tilts)
    if centre is None:
        return mechanism
    own, _ = still_point(there, centre.body)
    shift = shift_rows(linkage)[centre.body] @ there.moved - (own - centre.point)

    def follow(frame: Frame) -> Frame:
        if frame.name != centre.slide:
            return frame
        before = frame.before.copy()
        before[:3, 3] -= in_frame(linkage, str(frame.parent), shift)
        return replace(frame, before=before)

    return replace(mechanism, frames=tuple(follow(frame) for frame in mechanism.frames))


def patches(
    arm: ArmDescription, refined: Refined, centre: Centre | None
) -> tuple[dict[str, FramePatch], dict[str, ClosurePatch]]:
    """Return what the calibrated linkage replaces in its description, with standard deviations.

    Returns:
        {frame: patch} and {closure: patch}
    """
    robot, linkage = refined.robot, refined.robot.linkage
    axis = None if centre is None else centre.axis
    frames = [hinge.name for hinge in linkage.tree]
    frames += [centre.slide] if centre is not None else []
    tilted = list(refined.tilted)
    if axis is not None:  # the whole linkage may lean
        ground = [hinge.name for hinge in linkage.tree if hinge.body_a == linkage.ground]
        tilted += [name for name in ground if name not in tilted]

    def places(robot: Robot, centre: Centre | None) -> Array:
        """Return points of frames and of closures, and tilts, (3 n,) [m, rad]."""
        mechanism = calibrated(arm, robot, centre)
        parts = [mechanism.frame(name).before[:3, 3] for name in frames]
        for closure in mechanism.closures:
            parts += [closure.point_a, closure.point_b]
        # A small turn of a frame about its own x and y shows in its z axis as the parent has it.
        for name in tilted:
            start = linkage.mechanism.frame(name).before[:3, :3]
            z = start.T @ mechanism.frame(name).before[:3, 2]
            parts.append(np.array([-z[1], z[0], 0.0]))
        return np.concatenate(parts)

    def of_geometry(step: Array) -> Array:
        return places(displaced(robot, refined.basis, refined.tilted, step), centre)

    slope = slopes(of_geometry, np.zeros(len(refined.covariance)))
    variance = np.einsum("ij,jk,ik->i", slope, refined.covariance, slope)
    if centre is not None and axis is not None:

        def of_axis(step: Array) -> Array:
            moved = replace(axis, point=axis.point + step[:3], direction=axis.direction + step[3:])
            return places(robot, replace(centre, axis=moved))

        slope = slopes(of_axis, np.zeros(6))
        variance += np.einsum("ij,jk,ik->i", slope, axis.covariance, slope)
    sigma = list(np.sqrt(np.maximum(variance, 0.0)).reshape(-1, 3))
    mechanism = calibrated(arm, robot, centre)
    of_tilts = dict(zip(tilted, sigma[len(frames) + 2 * len(mechanism.closures) :], strict=True))
    patched = {
        name: replace(
            frame_patch(mechanism.frame(name)), xyz_sigma=sigma[i], rpy_sigma=of_tilts.get(name)
        )
        for i, name in enumerate(frames)
    }
    closures = {
        closure.name: replace(
            closure_patch(closure, slides=bool(refined.tilted)),
            point_a_sigma=sigma[len(frames) + 2 * i],
            point_b_sigma=sigma[len(frames) + 2 * i + 1],
        )
        for i, closure in enumerate(mechanism.closures)
    }
    return patched, closures
