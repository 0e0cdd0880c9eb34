"""Readings of a scene as flat, scaled vectors for networks, and as the goals of a goal dict."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trocar.geometry.rotations import matrix_from_quaternion
from trocar.learning.readings import NOTHING, SceneReadings
from trocar.tasks import Task

Array = NDArray[np.float64]
Vectors = NDArray[np.float32]

#: Factor on positions: 50 mm become 1. Source: our own choice; networks take numbers near 1, and
#: the scenes are about 100 mm wide. [1/m]
SCALE = 20.0
#: Largest magnitude in an observation. Source: our own choice, 500 mm.
BOUND = 10.0


@dataclass(frozen=True, eq=False)
class _EncodedArm:
    """An arm of the scene, as its columns have it.

    Attributes:
        name: of the arm
        psm: whether it has a tip and a jaw in readings
        middle, half: of the ranges of its joints, (n,) [rad or m]
        fastest: velocities of its joints, (n,) [rad/s or m/s]
    """

    name: str
    psm: bool
    middle: Array
    half: Array
    fastest: Array


class StateEncoder:
    """Encodes readings of a scene's worlds as rows of numbers, each from -10 to 10.

    Columns, in this order, named in `names`; positions are in the world, about `centre`, times
    `SCALE`:

    - of each driven arm: position of the tip (3), its x and z axes (3 each); position of each
      joint, -1 and 1 at its limits (j); its velocity over the largest one (j); whether both fingers
      press an object, and whether the arm stalls (1 each). An ECM has its joints' columns alone.
    - of each object that the scene does not hide: position (3), x and y axes (3 each), and for each
      PSM the way from its tip (3) and whether it holds the object (1)
    - the ratio of the time that is left (1)
    - of each goal: its place (3), the way to it from the tip or object that shall be there (3), and
      whether it is met (1)

    Args:
        task: of the scene

    Attributes:
        names: of the columns, (d,)
        size: d
        goals: number of goals
        centre: middle of the places of objects and goals, nominal, (3,) [m]
    """

    def __init__(self, task: Task) -> None:
        scene, world = task.scene, task.world
        self.centre = scene_centre(task)
        self.goals = sum(goal.on not in scene.hidden for goal, _ in task.goals)
        self._limit = scene.time_limit
        self._arms: list[_EncodedArm] = []
        self._objects = [name for name in world.objects if name not in scene.hidden]
        self._rows = {name: row for row, name in enumerate(world.objects)}
        names: list[str] = []
        for name in task.arms:
            arm = world.arms[name]
            low, high = np.array(arm.joints.lower), np.array(arm.joints.upper)
            joints = arm.description.joints
            psm = arm.description.type == "PSM"
            fastest = np.array([joint.velocity_max for joint in joints])
            self._arms.append(
                _EncodedArm(name, psm, (low + high) / 2.0, (high - low) / 2.0, fastest)
            )
            if psm:
                names += _axes(name, "tip", "x_axis", "z_axis")
            names += [f"{name}.{joint.name}" for joint in joints]
            names += [f"{name}.{joint.name}.velocity" for joint in joints]
            names += [f"{name}.holds", f"{name}.stalled"] if psm else []
        self._psms = [arm.name for arm in self._arms if arm.psm]
        for name in self._objects:
            names += _axes(name, "position", "x_axis", "y_axis")
            for psm in self._psms:
                names += [*_axes(name, f"from_{psm}"), f"{name}.in_{psm}"]
        names.append("time_left")
        self._own = len(names)
        for k in range(self.goals):
            names += [*_axes(f"goal{k + 1}", "position", "way"), f"goal{k + 1}.met"]
        self.names = tuple(names)
        self.size = len(names)

    def encode(self, readings: SceneReadings) -> Vectors:
        """Return the rows of readings, (n, d)."""
        ways = SCALE * (readings.goals - readings.achieved)
        places = SCALE * (readings.goals - self.centre)
        met = readings.met[..., None].astype(np.float64)
        goals = np.concatenate([places, ways, met], axis=2).reshape(len(readings), -1)
        return _bounded([*self._parts(readings), goals])

    def encode_goal(self, readings: SceneReadings) -> tuple[Vectors, Vectors, Vectors]:
        """Return the goal dict of readings.

        Returns:
            observation: the columns of `encode` without those of goals, (n, d - 7 G)
            achieved, desired: places of what shall be at the goals, and of the goals, about
            `centre` and times `SCALE`, (n, 3 G)
        """
        return _bounded(self._parts(readings)), *self.places(readings)

    def places(self, readings: SceneReadings) -> tuple[Vectors, Vectors]:
        """Return achieved and desired as `encode_goal`, (n, 3 G) each."""
        flat = len(readings), 3 * self.goals
        achieved = SCALE * (readings.achieved - self.centre).reshape(flat)
        desired = SCALE * (readings.goals - self.centre).reshape(flat)
        return _bounded([achieved]), _bounded([desired])

    def _parts(self, readings: SceneReadings) -> list[Array]:
        """Return the columns before those of goals."""
        parts: list[Array] = []
        for arm in self._arms:
            if arm.psm:
                T = readings.tips[arm.name]
                parts += [SCALE * (T[:, :3, 3] - self.centre), T[:, :3, 0], T[:, :3, 2]]
            parts.append((readings.q[arm.name] - arm.middle) / arm.half)
            parts.append(readings.v[arm.name] / arm.fastest)
            if arm.psm:
                holds = readings.held[arm.name] != NOTHING
                parts.append(np.stack([holds, readings.stalled[arm.name]], axis=1, dtype=float))
        for name in self._objects:
            placed = readings.objects[name]
            R = matrix_from_quaternion(placed[:, 3:])
            parts += [SCALE * (placed[:, :3] - self.centre), R[:, :, 0], R[:, :, 1]]
            for psm in self._psms:
                parts.append(SCALE * (placed[:, :3] - readings.tips[psm][:, :3, 3]))
                parts.append(1.0 * (readings.held[psm] == self._rows[name])[:, None])
        parts.append(1.0 - readings.time[:, None] / self._limit)
        return parts


def scene_centre(task: Task) -> Array:
    """Return the middle of the box around the nominal places of objects and goals, (3,) [m].

    It follows from the scene alone, not from the episode.
    """
    scene = task.scene
    poses = {prop.name: prop.pose for prop in scene.rig.objects}
    places = [poses[name][:3, 3] for name in poses if name not in scene.hidden]
    for goal in scene.goals:
        if goal.on:
            places.append(poses[goal.on][:3, :3] @ goal.at + poses[goal.on][:3, 3])
        elif goal.arm and goal.object and not goal.held:
            places.append(poses[goal.object][:3, 3] + goal.at)
        else:
            places.append(goal.at)
    return (np.min(places, axis=0) + np.max(places, axis=0)) / 2.0


def _axes(of: str, *names: str) -> list[str]:
    return [f"{of}.{name}.{axis}" for name in names for axis in "xyz"]


def _bounded(parts: list[Array]) -> Vectors:
    """Return columns side by side, clipped."""
    return np.clip(np.concatenate(parts, axis=1, dtype=np.float32), -BOUND, BOUND)
