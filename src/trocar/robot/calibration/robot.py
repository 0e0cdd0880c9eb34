"""One robot: its linkage, where markers sit on it, where they go, and where it stands on its arm.

The sweep of the loops alone says how the axes stand to one another, not how the whole stands on the
arm. Where the description has a remote centre (a slide on a link of the loops whose line passes the
arm's reference point at every joint position), the calibrated linkage is placed so that its own
remote centre is there, in the direction from its first axis that the description has, and the slide
passes it as before. Elsewhere the first axis of the ground stays, and its direction to the next.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import cast

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline  # pyright: ignore[reportMissingTypeStubs] - no types

from trocar.descriptions import ArmDescription
from trocar.descriptions.axis_lines import home_lines, line_distance
from trocar.descriptions.calibration_plan import Pair
from trocar.descriptions.frames import pin_frame, pinned
from trocar.geometry import inverse, skew, transform, unskew
from trocar.kinematics.forward import poses
from trocar.kinematics.loops import closed_coordinates, loops_are_parallelograms
from trocar.kinematics.mechanism import Frame, Mechanism
from trocar.kinematics.tree import frame_poses
from trocar.robot.calibration.axes import (
    BaseAxis,
    FlatAxes,
    planar_fit,
    planar_turn,
    shared_body,
)
from trocar.robot.calibration.linkage import (
    LoopedPart,
    Slot,
    bodies_of,
    displacements,
    freedoms,
    home_points,
    in_frame,
    place_rows,
    rebuilt,
    shift_rows,
    slots,
)

Array = NDArray[np.float64]

#: Gauss-Newton steps of the first guess, whose planar turn is the only non-linear unknown.
GUESS_STEPS = 5
#: The linkage's own remote centre is that over this many positions of a joint, and over this range
#: about home. Source: our own choice; the sweep that is asked for. [rad]
POSITIONS, SWEEP_RAD = 17, 0.6
# Source: our own choice; central differences of smooth functions of order 1 leave 1e-10. [rad]
STEP = 1e-5
#: Loops that are no parallelograms are closed at so many positions of a joint and interpolated.
#: Source: our own choice; over 2 rad splines of smooth functions of order 1 leave 1e-10.
NODES = 401


@dataclass(frozen=True, eq=False)
class Robot:
    """One robot's linkage, and where the markers sit on it.

    Attributes:
        linkage: the description's
        moved: displacements of its axes, (n_slots, 2) [m] (see `linkage`)
        tilts: {frame: small turn of its hinge about the plane's two axes (2,) [rad]}
        markers: {body: T_frame_markers (4, 4)}, of the body's first frame
    """

    linkage: LoopedPart
    moved: Array
    tilts: Mapping[str, Array]
    markers: Mapping[str, Array]


def displaced(robot: Robot, basis: Array, tilted: Sequence[str], step: Array) -> Robot:
    """Return a robot at a step of its geometry's unknowns; its markers stay.

    Args:
        robot: to start from
        basis: the free displacements, (2 n_slots, n_free)
        tilted: frames whose hinges tilt
        step: of the free displacements, then two of each tilt; more is ignored [m, rad]
    """
    free = basis.shape[1]
    tilts = {
        name: robot.tilts.get(name, np.zeros(2)) + step[free + 2 * i : free + 2 * i + 2]
        for i, name in enumerate(tilted)
    }
    return replace(robot, moved=robot.moved + (basis @ step[:free]).reshape(-1, 2), tilts=tilts)


def first_guess(
    linkage: LoopedPart,
    axes: FlatAxes,
    home: Mapping[str, Array],
    datum: Array,
    parallelogram: bool,
) -> Robot:
    """Fit a closed linkage to the axes at home.

    What the tracks do not show stays as the description has it. Along the axes, the linkage stands
    so that the datum is level with the origin of the first axis' frame.

    Args:
        linkage: the description's
        axes: at home
        home: {body: T_first_body (4, 4)} of each body's markers
        datum: in the frame of `home`, (3,) [m]
        parallelogram: whether the loops close by the couplings alone
    """
    flat, first_plane = axes.points, axes.plane.copy()
    up = first_plane[:3, 2]
    first_plane[:3, 3] += (up @ (datum - first_plane[:3, 3])) * up
    keys = list(flat)
    places = place_rows(linkage)
    # Of a frame's hinge both bodies have the same place.
    hinges = [linkage.hinge[name] for name, _ in keys]
    at = [
        Slot(h.name, b if h.closure else h.body_a) for h, (_, b) in zip(hinges, keys, strict=True)
    ]
    rows = np.vstack([np.kron(places[slot], np.eye(2)) for slot in at])
    got = np.stack([flat[key] for key in keys])
    nominal = np.stack([linkage.points[name] for name, _ in keys])
    basis = freedoms(linkage, parallelogram)
    angle, shift = planar_fit(got, nominal)
    free = np.zeros(basis.shape[1])
    for _ in range(GUESS_STEPS):
        placed = got @ planar_turn(angle).T + shift
        turned = np.stack([-placed[:, 1], placed[:, 0]], axis=1)
        left = np.hstack([
            rows @ basis,
            -turned.reshape(-1, 1),
            -np.tile(np.eye(2), (len(keys), 1)),
        ])  # fmt: skip
        right = (placed - nominal).ravel() - rows @ basis @ free
        step = np.linalg.lstsq(left, right, rcond=1e-10)[0]
        free = free + step[: len(free)]
        more = float(step[len(free)])
        shift = planar_turn(more) @ shift + step[len(free) + 1 :]
        angle += more
    moved = (basis @ free).reshape(-1, 2)
    # T_ground_plane: the measured plane's coordinates, turned and shifted onto the description's.
    spin = np.eye(3)
    spin[:2, :2] = planar_turn(angle)
    onto = transform(linkage.plane @ spin, linkage.plane @ np.append(shift, linkage.level))
    ground_first = onto @ inverse(first_plane)
    shifts = shift_rows(linkage)
    markers: dict[str, Array] = {}
    for body, pose in home.items():
        frame = linkage.frames[linkage.bodies[body]].copy()
        frame[:3, 3] += linkage.plane[:, :2] @ (shifts[body] @ moved)
        markers[body] = inverse(frame) @ ground_first @ pose
    return Robot(linkage, moved, {}, markers)


def mechanism_of(robot: Robot) -> Mechanism:
    """Return the linkage of a robot as a mechanism; with tilted axes its closing pins slide."""
    found = rebuilt(robot.linkage, robot.linkage.mechanism, robot.moved, robot.tilts)
    return with_pins(found) if robot.tilts else found


def with_pins(mechanism: Mechanism) -> Mechanism:
    """Return a mechanism whose closing pins slide, as axes that lean need."""
    known = {frame.name: frame for frame in mechanism.frames}
    return replace(
        mechanism,
        frames=(*mechanism.frames, *(pin_frame(closure, known) for closure in mechanism.closures)),
        closures=tuple(pinned(closure) for closure in mechanism.closures),
    )


def swept(linkage: LoopedPart, mechanism: Mechanism) -> Array:
    """Return joint positions over the range of the joints that move the loops, (n, n_joints)."""
    q = np.tile(linkage.rest, (POSITIONS, 1))
    for joint in linkage.joints:
        q[:, joint] = np.linspace(
            max(mechanism.lower[joint], -SWEEP_RAD),
            min(mechanism.upper[joint], SWEEP_RAD),
            POSITIONS,
        )
    return q


def marker_poses(robot: Robot, mechanism: Mechanism, q: Array) -> Array:
    """Return the pose of each tracked body's markers in the ground's first frame.

    Args:
        robot: whose markers
        mechanism: `mechanism_of(robot)`
        q: positions of the joints that move the loops, (n, n_moving) [rad]

    Returns:
        (n, n_bodies, 4, 4), in the order of `robot.markers`
    """
    coordinates = _coordinates(robot, mechanism, q)
    at = body_poses(robot.linkage, mechanism, coordinates)
    return np.stack([at[body] @ X for body, X in robot.markers.items()], axis=1)


def body_poses(linkage: LoopedPart, mechanism: Mechanism, coordinates: Array) -> dict[str, Array]:
    """Return {body: pose of its first frame in the ground's (n, 4, 4)}.

    Args:
        linkage: whose bodies
        mechanism: of the linkage, displaced or not
        coordinates: of every frame, the loops closed, (n, n_frames)
    """
    at, index = frame_poses(mechanism, coordinates), mechanism.frame_index
    ground = np.linalg.inv(at[index[linkage.bodies[linkage.ground]]])
    return {body: ground @ at[index[frame]] for body, frame in linkage.bodies.items()}


def _coordinates(robot: Robot, mechanism: Mechanism, q: Array) -> Array:
    """Return every frame's coordinate with the loops closed, (n, n_frames)."""

    def closed(some: Array) -> Array:
        every = np.tile(robot.linkage.rest, (len(some), 1))
        every[:, list(robot.linkage.joints)] += some
        return closed_coordinates(mechanism, every)

    if q.shape[1] != 1 or len(q) < 2 * NODES or loops_are_parallelograms(mechanism):
        return closed(q)
    nodes = cast(Array, np.linspace(q.min() - STEP, q.max() + STEP, NODES))
    return CubicSpline(nodes, closed(nodes[:, None]))(q[:, 0])


def marker_rates(robot: Robot, mechanism: Mechanism, q: Array, at: Array) -> Array:
    """Return the markers' velocities by the joints, (n, n_bodies, 6, n_moving).

    The rows are the velocity of the markers' origin and the angular velocity, in the ground's axes.
    """
    rates = np.zeros((*at.shape[:2], 6, q.shape[1]))
    for column in range(q.shape[1]):
        away = STEP * np.eye(q.shape[1])[column]
        plus, minus = (marker_poses(robot, mechanism, q + s * away) for s in (1.0, -1.0))
        rates[..., :3, column] = (plus - minus)[..., :3, 3] / (2.0 * STEP)
        spin = (plus - minus)[..., :3, :3] @ np.swapaxes(at[..., :3, :3], -1, -2) / (2.0 * STEP)
        rates[..., 3:, column] = unskew(spin)
    return rates


def closed_distances(robot: Robot, pairs: Mapping[str, Pair]) -> dict[str, float]:
    """Return the distances of axes in the closed geometry, {label: [m]}."""
    found = _flat_distances(robot, pairs)
    if not robot.tilts:
        return found
    lines = home_lines(mechanism_of(robot), {h.name: h.name for h in robot.linkage.hinges})
    through = lines[robot.linkage.first].point
    at = {label: [lines[name] for name in pairs[label]] for label in found}
    return {label: line_distance(one, two, through) for label, (one, two) in at.items()}


def _flat_distances(robot: Robot, pairs: Mapping[str, Pair]) -> dict[str, float]:
    """Return the same where all axes are parallel."""
    points = home_points(robot.linkage, robot.moved)
    found: dict[str, float] = {}
    for label, (one, two) in pairs.items():
        body = shared_body(robot.linkage, one, two)
        if body is not None:
            between = points[Slot(one, body)] - points[Slot(two, body)]
            found[label] = float(np.linalg.norm(between))
    return found


def nominal_distances(linkage: LoopedPart, pairs: Mapping[str, Pair]) -> dict[str, float]:
    """Return the axis distances in the description, {label: [m]}."""
    drawn = Robot(linkage, np.zeros((len(slots(linkage)), 2)), {}, {})
    return _flat_distances(drawn, pairs)


@dataclass(frozen=True, eq=False)
class Level:
    """The datum as the markers of one body have it.

    Attributes:
        body: the ground, or the first that is tracked
        point: in its markers, at home (3,) [m]
    """

    body: str
    point: Array


def level_of(robot: Robot, points: Mapping[str, Array]) -> Level:
    """Return the datum in the markers of the ground where it is tracked, else of another body.

    Args:
        robot: whose bodies
        points: {body: the datum in its markers (3,) [m]}
    """
    ground = robot.linkage.ground
    body = ground if ground in points else next(name for name in robot.markers if name in points)
    return Level(body, points[body])


def height(robot: Robot, level: Level) -> float:
    """Return the datum's height over the linkage's plane, along the axes [m]."""
    linkage, marker = robot.linkage, robot.markers[level.body]
    frame = linkage.frames[linkage.bodies[level.body]]
    at = frame[:3, :3] @ (marker[:3, :3] @ level.point + marker[:3, 3]) + frame[:3, 3]
    return float(linkage.plane[:, 2] @ at) - linkage.level


def height_slope(robot: Robot, level: Level) -> Array:
    """Return the derivative of the height by a shift and a turn of the body's markers, (6,)."""
    linkage, turn = robot.linkage, robot.markers[level.body][:3, :3]
    up = linkage.plane[:, 2] @ linkage.frames[linkage.bodies[level.body]][:3, :3] @ turn
    return np.concatenate([up, -up @ skew(level.point)])


def levelled(robot: Robot, level: Level) -> Robot:
    """Return the same robot, described by where its axes pierce the plane through the datum.

    Args:
        robot: with tilted axes
        level: the datum
    """
    linkage, up = robot.linkage, robot.linkage.plane[:, 2]
    off = height(robot, level)
    drift = _drifts(robot)
    moved = robot.moved + off * np.stack([drift[slot] for slot in slots(linkage)])
    markers = {name: pose.copy() for name, pose in robot.markers.items()}
    for name, pose in markers.items():
        pose[:3, 3] -= off * (linkage.frames[linkage.bodies[name]][:3, :3].T @ up)
    return replace(robot, moved=moved, markers=markers)


def _drifts(robot: Robot) -> dict[Slot, Array]:
    """Return each axis' shift across itself per metre along it, in the body that has it, (2,)."""
    linkage = robot.linkage
    found: dict[Slot, Array] = {}
    for slot in slots(linkage):
        tilt = robot.tilts.get(slot.hinge, np.zeros(2))
        found[slot] = np.array([tilt[1], -tilt[0]])
    turns = _swept_turns(robot)
    for hinge in linkage.hinges:
        if hinge.closure:
            line = _pin_line(turns[hinge.body_a], turns[hinge.body_b])
            found[Slot(hinge.name, hinge.body_a)] = line[:2]
            found[Slot(hinge.name, hinge.body_b)] = line[2:]
    return found


def _swept_turns(robot: Robot) -> dict[str, Array]:
    """Return bodies' turns over a sweep, from their drawn home, in the plane's axes (n, 3, 3)."""
    linkage, mechanism = robot.linkage, mechanism_of(robot)
    at = body_poses(linkage, mechanism, closed_coordinates(mechanism, swept(linkage, mechanism)))
    found: dict[str, Array] = {}
    for body, frame in linkage.bodies.items():
        home = linkage.frames[frame][:3, :3].T
        found[body] = linkage.plane.T @ at[body][..., :3, :3] @ home @ linkage.plane
    return found


def _pin_line(a: Array, b: Array) -> Array:
    """Return the line on which a pin may sit with the same motion: across a, across b, (4,).

    A pin goes up by 1 along the axis of its side b, and slides along that of its side a. Its places
    on both move across, by v_a and v_b, so that both see it at one place again at every turn. Of
    parallelograms that are tilted a little, there are such; of others, those that come nearest.
    """
    left = np.concatenate([a[:, :2, :2], -b[:, :2, :2]], axis=2).reshape(-1, 4)
    right = (b[:, :2, 2] - a[:, :2, 2]).ravel()
    return np.asarray(np.linalg.lstsq(left, right, rcond=1e-6)[0], dtype=np.float64)


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
    """Return the remote centre that a description is built for, or None without one."""
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
    squared: Array = np.sum(away**2, axis=1)
    return found[2:], float(np.sqrt(np.mean(squared)))


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
    """Return the linkage's turn, the place of its remote centre, and its lean.

    Without a measured axis the centre goes to the description's, and its direction from the first
    hinge too. With one, the linkage stands on the arm's axis as it does on the measured one; its
    place along that axis and its turn about it are the description's.
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


def lengths_only(robot: Robot, arm: ArmDescription, on: BaseAxis | None) -> Mechanism:
    """Return a calibrated arm none of whose axes leans out of the plane of its linkage.

    Args:
        robot: as calibrated
        arm: the description that was calibrated
        on: the axis that the calibrated linkage stands on, where it was measured
    """
    robot, linkage = replace(robot, tilts={}), robot.linkage
    centre = remote_centre_of(arm, linkage)
    if centre is not None and on is not None:
        markers = robot.markers[linkage.ground][:3, :3]
        up = markers.T @ linkage.plane[:, 2]
        flat = on.direction - (on.direction @ up) * up
        centre = replace(centre, axis=replace(on, direction=flat / np.linalg.norm(flat)))
    return calibrated(arm, robot, centre)
