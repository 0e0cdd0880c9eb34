"""Motions that scripted policies are made of, as generators of one arm's part of an action."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.pads import pads
from trocar.descriptions.records import Shape
from trocar.errors import InputError
from trocar.geometry.rotations import matrix_from_rotation_vector, rotation_vector_from_matrix
from trocar.geometry.se3 import transform
from trocar.tasks.controller import PERIOD_S
from trocar.tasks.task import Task

Array = NDArray[np.float64]
Motion = Iterator[Array]

#: Distance of the pads' ends beyond the held object. Source: our own choice, the radius of a peg
#: and of a ring's rubber, and more. [m]
BEYOND_M = 0.002
#: Tries of a grasp, and the largest tilt of its object. Source: our own choice; a needle that is
#: tilted by more than 12 deg turns on in the jaw. [rad]
TRIES, TILTED_RAD = 3, math.radians(12.0)
#: Peak speeds of scripted motion. Source: our own choice. [m/s, rad/s]
SPEED_M_S, SPIN_RAD_S = 0.12, 2.5
#: Peak speed of a minimum-jerk motion over its mean speed. Source: its polynomial.
PEAK = 15.0 / 8.0
#: Openings of the jaw. Source: our own choice. [rad]
OPEN, GRIP = 0.9, -0.3
#: Upwards in the world.
UP = np.array([0.0, 0.0, 1.0])
#: Time in which the jaw closes on an object and the grip builds up. Source: our own choice. [s]
CLOSE_S = 0.3


class Hand:
    """An instrument of a task under a scripted policy.

    Args:
        task: the episode
        arm: name of a PSM that the task drives

    Attributes:
        task, arm: as given
        jaw: opening that motions keep [rad]
        turned: of the grip about the world's z against what was planned, after a miss [rad]
        reach: distance of held objects beyond the tip, the fingers' pivot [m]
    """

    def __init__(self, task: Task, arm: str) -> None:
        self.task, self.arm, self.turned = task, arm, 0.0
        self.jaw = float(task.controller.idle()[arm][-1])
        described = task.world.arms[arm].description
        faces = pads(described)
        self.reach = float(faces.T_tip[2, 3]) + 0.5 * faces.length - BEYOND_M
        widest = described.joints[-1].upper
        self._gap = 2.0 * self.reach * math.sin(0.5 * min(widest, math.pi))

    def go(self, goal: Array, speed: float = SPEED_M_S) -> Motion:
        """Bring the tip to a pose in the world, (4, 4), with minimum jerk."""
        start = self.task.controller.target(self.arm)
        turn = rotation_vector_from_matrix(goal[:3, :3] @ start[:3, :3].T)
        way = goal[:3, 3] - start[:3, 3]
        time = PEAK * max(np.linalg.norm(way) / speed, np.linalg.norm(turn) / SPIN_RAD_S)
        count = max(1, math.ceil(time / PERIOD_S))
        for k in range(1, count + 1):
            s = k / count
            s = s**3 * (10.0 - 15.0 * s + 6.0 * s * s)
            now = self.task.controller.target(self.arm)
            part = np.zeros(7)
            part[:3] = (start[:3, 3] + s * way - now[:3, 3]) / PERIOD_S
            if turn.any():
                facing = matrix_from_rotation_vector(s * turn) @ start[:3, :3]
                part[3:6] = rotation_vector_from_matrix(facing @ now[:3, :3].T) / PERIOD_S
            part[6] = self.jaw
            yield part

    def shift(self, way: Array, speed: float = SPEED_M_S) -> Motion:
        """Move the tip along a straight line, (3,) [m], without turning."""
        goal = self.task.controller.target(self.arm)
        goal[:3, 3] += way
        yield from self.go(goal, speed)

    def wait(self, time: float) -> Motion:
        """Hold still for a time [s]."""
        for _ in range(max(1, round(time / PERIOD_S))):
            yield np.concatenate([np.zeros(6), [self.jaw]])

    def close(self, opening: float = GRIP) -> Motion:
        """Close the jaw, with grip below 0 [rad]."""
        self.jaw = opening
        yield from self.wait(CLOSE_S)

    def open(self, opening: float = OPEN) -> Motion:
        """Open the jaw [rad]."""
        self.jaw = opening
        yield from self.wait(CLOSE_S)

    def over(self, point: Array, height: float, angle: float | None = None) -> Motion:
        """Go above a point in the world, (3,), fingers closing along an angle about z [m, rad]."""
        now, at = self.task.controller.target(self.arm), point + (height + self.reach) * UP
        turn = now[:3, :3] if angle is None else self.pointing_down(angle, at)
        yield from self.go(transform(turn, at))

    def pointing_down(self, angle: float, at: Array) -> Array:
        """Return the rotation of the tip that points down at a place, (3, 3).

        Fingers close along an angle about the world's z; of both such rotations the one whose joint
        positions are nearer, so that the roll turns back before its limit.
        """
        c, s = math.cos(angle), math.sin(angle)
        one = np.array([[-s, c, 0.0], [c, s, 0.0], [0.0, 0.0, -1.0]])
        both = (one, one * [-1.0, -1.0, 1.0])
        return min(both, key=lambda R: self.task.controller.farthest(self.arm, transform(R, at)))

    def grasp(self, point: Array, angle: float, height: float, opening: float = OPEN) -> Motion:
        """Grasp an object at a point from above.

        Args:
            point: between the fingers, in the world, (3,) [m]
            angle: of the direction along which the fingers close, about the world's z [rad]
            height: above the point, on the way there [m]
            opening: of the jaw on the way down [rad]
        """
        self.jaw = opening
        yield from self.over(point, height, angle)
        yield from self.over(point, 0.0)
        yield from self.close()

    def pick(self, point: Array, angle: float, height: float, opening: float = OPEN) -> Motion:
        """Grasp an object at a point as `grasp` does, then lift it by the height."""
        yield from self.grasp(point, angle, height, opening)
        yield from self.shift(height * UP)

    def take(
        self,
        name: str,
        grip: Callable[[], tuple[Array, float]],
        height: float,
        opening: float = OPEN,
        level: bool = False,
    ) -> Motion:
        """Pick an object up, again where the jaw does not hold it then.

        Args:
            name: of the object
            grip: point and angle as `pick` takes them, of where the object is then
            height: above the point, on the way there and back [m]
            opening: of the jaw on the way down [rad]
            level: also again where its z axis is more than 12 deg from the vertical then

        Raises:
            InputError: no part of it fits between the pads
        """
        self._check_fits(name)
        before = self.task.object_pose(name)[:3, 3]
        for tried in range(TRIES):
            yield from self.pick(*grip(), height, opening)
            T = self.task.object_pose(name)
            if self.task.referee.held.get(self.arm) == name:
                if not level or tried + 1 == TRIES or abs(T[2, 2]) > math.cos(TILTED_RAD):
                    return
                yield from self.shift(-height * UP)
                yield from self.open(opening)
        moved = float(np.linalg.norm(self.task.object_pose(name)[:3, 3] - before))
        self.task.referee.remarks.append(
            f"{self.arm} missed {name} {TRIES} times, which rolled or slid by {1e3 * moved:.1f} mm"
        )

    def _check_fits(self, name: str) -> None:
        """Reject an object that is too large for the jaw."""
        prop = next(prop for prop in self.task.scene.rig.objects if prop.name == name)
        widths = [2.0 * thinnest(shape) for shape in prop.shapes if shape.collide]
        if widths and min(widths) > self._gap:
            raise InputError(
                f"{self.task.scene.name}: {name} is {1e3 * min(widths):.1f} mm wide where it is"
                f" thinnest; allowed: up to {1e3 * self._gap:.1f} mm between the pads of {self.arm}"
            )

    def place(self, name: str, at: Array, height: float, opening: float = OPEN) -> Motion:
        """Carry a held object over a place, lower it, release it and withdraw.

        Args:
            name: of the object
            at: where its frame shall be, in the world, (3,) [m]
            height: above the place, on the way there and back [m]
            opening: of the jaw that releases it [rad]
        """
        up = height * UP
        yield from self.shift(at + up - self.task.object_pose(name)[:3, 3])
        yield from self.shift(at - self.task.object_pose(name)[:3, 3])
        yield from self.wait(0.1)
        yield from self.open(opening)
        yield from self.shift(up)


def thinnest(shape: Shape) -> float:
    """Return the half width of a shape where it is thinnest [m]."""
    sizes = {"box": 3, "sphere": 1, "mesh": 3}.get(shape.kind, 2)
    return float(shape.size[0] if shape.kind == "capsule" else shape.size[:sizes].min())


def together(task: Task, **hands: Motion) -> Iterator[Array]:
    """Yield whole actions that run motions of arms side by side, until the last one ends."""
    running = dict(hands)
    while running:
        parts = task.controller.idle()
        for arm in list(running):
            part = next(running[arm], None)
            if part is None:
                del running[arm]
            else:
                parts[arm] = part
        if running:
            yield np.concatenate([parts[arm] for arm in task.arms])
