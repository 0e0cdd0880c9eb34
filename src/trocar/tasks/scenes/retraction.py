"""Retraction: a flap of tissue is lifted out of the endoscope's view of what lies below it."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.scenes import Goal
from trocar.geometry.se3 import inverse, transform_points
from trocar.tasks.motions import TRIES, UP, Hand, Motion, together
from trocar.tasks.referee import SETTLED_S
from trocar.tasks.scenes.transfer import across
from trocar.tasks.task import Task

Array = NDArray[np.float64]


class TissueRetraction(Task):
    """A flap is held up by its edge, so that both eyes see all of the vessel below it.

    Sight is a line from each eye to points of the vessel that passes no part of the flap;
    instruments are left out, for they move out of the way.
    """

    task = "tissue-retraction"

    #: The prop to be seen, and the number of its points. Source: the scene; our own choice.
    TARGET, POINTS = "vessel", 5
    #: The hinge of the base, in its frame. Source: the scene. [m]
    BASE_M = np.array([0.0, 0.012, 0.0])
    #: Height of the grip above the edge's middle, so that the fingers' ends stay above the flap;
    #: height of the way; opening; speed. Source: the scene; our own choice. [m, m, rad, m/s]
    GRASP_M, WAY_M, OPENING, SPEED_M_S = 0.0022, 0.012, 0.6, 0.04

    def met(self, goal: Goal, at: Array) -> bool:
        """Return whether an arm holds the edge at its place, and the vessel is in full view."""
        return super().met(goal, at) and self.exposed() == 1.0

    def exposed(self) -> float:
        """Return the ratio of the vessel's points, over both eyes, that the flap does not hide."""
        world = self.world
        vessel = next(p for p in self.scene.rig.props if p.name == self.TARGET)
        (shape,) = vessel.shapes
        along = float(shape.size[1]) * np.linspace(-1.0, 1.0, self.POINTS)
        line = np.column_stack([np.zeros((self.POINTS, 2)), along])
        points = transform_points(vessel.pose @ shape.pose, line)
        camera = next(c for c in world.cameras().values() if c.kind == "endoscope")
        hidden = np.zeros((2, self.POINTS), bool)
        for prop in self.scene.rig.objects:
            T = self.object_pose(prop.name)
            for part in prop.shapes:
                into = inverse(T @ part.pose)
                ends = transform_points(into, points)
                for eye, T_world_eye in enumerate(camera.T_world_eyes):
                    start = transform_points(into, T_world_eye[:3, 3])
                    hidden[eye] |= passes(start, ends, part.size)
        return 1.0 - float(hidden.mean())

    def figures(self) -> dict[str, float]:
        """Return the ratio of the vessel that both eyes see in the end."""
        return {"exposed": self.exposed()}

    def policy(self) -> Iterator[Array]:
        """Yield the actions of the scripted policy."""
        return together(self, **{self.arms[0]: self._run(Hand(self, self.arms[0]))})

    def _run(self, hand: Hand) -> Motion:
        ((goal, at),) = self.goals

        def grip() -> tuple[Array, float]:
            T = self.object_pose(goal.object)
            return T[:3, 3] + self.GRASP_M * UP, across(T)

        for _ in range(TRIES):
            if self.referee.held.get(hand.arm) != goal.object:
                yield from hand.grasp(*grip(), self.WAY_M, self.OPENING)
            yield from self._turn_up(hand, goal, at)
            yield from hand.wait(2.0 * SETTLED_S)

    def _turn_up(self, hand: Hand, goal: Goal, at: Array) -> Motion:
        """Bring the edge to its place about the base, never farther from it than now."""
        axis = self.object_pose(goal.on)
        base = transform_points(axis, self.BASE_M)
        for part in (0.5, 1.0):
            here = self.object_pose(goal.object)[:3, 3] - base
            there = self.referee.place(goal, at) - base
            reach = (1.0 - part) * np.linalg.norm(here) + part * np.linalg.norm(there)
            way = here / np.linalg.norm(here) * (1.0 - part) + there / np.linalg.norm(there) * part
            yield from hand.shift(reach * way / np.linalg.norm(way) - here, self.SPEED_M_S)


def passes(start: Array, ends: Array, half: Array) -> NDArray[np.bool_]:
    """Test for lines from a point (3,) to others (n, 3) whether they pass a box, (n,).

    Args:
        start, ends: in the box's axes, from its middle [m]
        half: half its edges, (3,) [m]
    """
    way = ends - start
    way = np.where(np.abs(way) < 1e-12, 1e-12, way)
    one, two = (-half - start) / way, (half - start) / way
    first = np.minimum(one, two).max(axis=1)
    last = np.maximum(one, two).min(axis=1)
    return (first <= last) & (last >= 0.0) & (first <= 1.0)
