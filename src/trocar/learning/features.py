"""Features that a cloned policy reads, and the set-points that it plans, relative to the tips."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.geometry.rotations import (
    matrix_from_quaternion,
    matrix_from_rotation_vector,
    rotation_vector_from_matrix,
)
from trocar.learning.readings import NOTHING, SceneReadings, read_task
from trocar.tasks import Task
from trocar.tasks.controller import PERIOD_S

Array = NDArray[np.float64]
Floats = NDArray[np.float32]

#: Factor of positions and ways among the features: 50 mm are 1. Source: our own choice. [1/m]
SCALE = 20.0
#: Factor of ways within tanh, which resolves the last 10 mm. Source: our own choice. [1/m]
NEAR = 100.0
#: Factors of a planned set-point of a PSM: way of the tip, rotation vector, opening of the jaw; and
#: of a joint of an ECM. Source: our own choice; a chunk's spread is then about 1.
#: [1/m, 1/rad, 1/rad, 1/rad or 1/m]
PSM_SCALE = np.array([50.0, 50.0, 50.0, 1.0, 1.0, 1.0, 1.0])
ECM_SCALE = 50.0


class SceneFeatures:
    """Computes the features of a scene's worlds: places and axes, seen from tips and objects.

    Args:
        task: of the scene; only its arms, objects and goals count

    Attributes:
        names: of the columns
    """

    def __init__(self, task: Task) -> None:
        readings = read_task(task)
        self._psms = tuple(readings.tips)
        self._ecms = tuple(name for name in task.arms if name not in readings.tips)
        self._objects = tuple(readings.objects)
        joints = {name: task.world.arms[name].joints for name in self._ecms}
        self._middles = {name: (of.upper + of.lower) / 2.0 for name, of in joints.items()}
        self._halves = {name: (of.upper - of.lower) / 2.0 for name, of in joints.items()}
        self.names = self._names(readings.goals.shape[1])

    @property
    def size(self) -> int:
        """Number of columns."""
        return len(self.names)

    def encode(self, readings: SceneReadings) -> Floats:
        """Compute the features of n worlds.

        Returns:
            (n, size), in the order of `names`
        """
        places = {name: readings.objects[name][:, :3] for name in self._objects}
        turns = {
            name: matrix_from_quaternion(readings.objects[name][:, 3:]) for name in self._objects
        }
        found: list[Array] = []
        for name in self._psms:
            T = readings.tips[name]
            at, R = T[:, :3, 3], T[:, :3, :3]
            holds = (readings.held[name] != NOTHING)[:, None]
            found += [at * SCALE, R[:, :, 0], R[:, :, 2], readings.q[name][:, -1:], holds]
            for other in self._objects:
                way, seen = places[other] - at, np.swapaxes(R, 1, 2) @ turns[other]
                found += [way * SCALE, np.tanh(way * NEAR), seen[:, :, 0], seen[:, :, 1]]
        for turn in turns.values():
            found += [turn[:, :, 0], turn[:, :, 1]]
        for name in self._ecms:
            found.append((readings.q[name] - self._middles[name]) / self._halves[name])
        for at in (readings.achieved, *(places[name][:, None] for name in self._objects)):
            found.append(((readings.goals - at) * SCALE).reshape(len(readings), -1))
        found.append(readings.met.astype(np.float64))
        return np.concatenate(found, axis=1, dtype=np.float32)

    def _names(self, goals: int) -> tuple[str, ...]:
        def vector(*names: str) -> list[str]:
            return [f"{name} {axis}" for name in names for axis in "xyz"]

        found: list[str] = []
        for name in self._psms:
            found += vector(f"{name}", f"{name} x axis", f"{name} z axis")
            found += [f"{name} jaw", f"{name} holds"]
            for other in self._objects:
                way, seen = f"{name} to {other}", f"{other} in {name}"
                found += vector(way, f"{way} near", f"{seen} x axis", f"{seen} y axis")
        for name in self._objects:
            found += vector(f"{name} x axis", f"{name} y axis")
        for name in self._ecms:
            found += [f"{name} joint {k}" for k in range(len(self._middles[name]))]
        for name in ("achieved", *self._objects):
            found += vector(*(f"{name} to goal {k}" for k in range(goals)))
        return (*found, *(f"goal {k} met" for k in range(goals)))


class SetpointPlans:
    """Converts between actions of `TipController` and plans: set-points of the next periods.

    A row of a plan has, in the order of the arms, for a PSM the way of the tip's set-point from the
    measured tip as it was when planned, in axes of the world, the rotation vector between the two,
    and the commanded opening of the jaw; for an ECM its joints' set-points from the measured ones.
    All are scaled by `PSM_SCALE` and `ECM_SCALE`. Set-points relative to the tip do not drift as
    cloned velocities do.

    Args:
        task: of the scene; only its arms count

    Attributes:
        width: numbers in a row
        scale: of these, (width,)
    """

    def __init__(self, task: Task) -> None:
        parts: list[Array] = []
        self._parts: dict[str, slice] = {}
        self._psms: set[str] = set()
        width = 0
        for name in task.arms:
            arm = task.world.arms[name].description
            if arm.type == "PSM":
                self._psms.add(name)
                parts.append(PSM_SCALE)
            else:
                parts.append(np.full(len(arm.joints), ECM_SCALE))
            self._parts[name] = slice(width, width + len(parts[-1]))
            width += len(parts[-1])
        self.width, self.scale = width, np.concatenate(parts)

    def labels(self, readings: SceneReadings, actions: ArrayLike, length: int) -> Floats:
        """Compute the plans that an episode would have followed, one for each of its periods.

        Args:
            readings: of n successive periods of one world, each before its action
            actions: that the policy chose then, without noise, (n, width); see `TipController`
            length: rows of a plan; the last set-point is repeated beyond the end

        Returns:
            (n, length * width)
        """
        values, count = np.asarray(actions, np.float64), len(readings)
        found = np.empty((count, length, self.width))
        later = np.minimum(np.arange(count)[:, None] + np.arange(length), count - 1)
        for name, part in self._parts.items():
            rates = values[:, part]
            if name not in self._psms:
                after = readings.setpoints[name] + rates * PERIOD_S
                found[:, :, part] = after[later] - readings.q[name][:, None]
                continue
            targets, tips = readings.targets[name], readings.tips[name]
            places = targets[:, :3, 3] + rates[:, :3] * PERIOD_S
            turns = matrix_from_rotation_vector(rates[:, 3:6] * PERIOD_S) @ targets[:, :3, :3]
            back = np.swapaxes(tips[:, None, :3, :3], 2, 3)
            plan = found[:, :, part]
            plan[..., :3] = places[later] - tips[:, None, :3, 3]
            plan[..., 3:6] = rotation_vector_from_matrix(turns[later] @ back)
            plan[..., 6] = rates[later, 6]
        return (found * self.scale).reshape(count, -1).astype(np.float32)

    def setpoints(self, plans: Array, readings: SceneReadings) -> Array:
        """Return the set-points of plans, independent of the tips.

        Args:
            plans: (n, length, width)
            readings: when they were planned

        Returns:
            (n, length, k): for a PSM, position of the tip (3), its rotation matrix by rows (9),
            opening of the jaw; for an ECM, positions of its joints
        """
        found: list[Array] = []
        for name, part in self._parts.items():
            plan = plans[:, :, part] / self.scale[part]
            if name not in self._psms:
                found.append(plan + readings.q[name][:, None])
                continue
            tips = readings.tips[name][:, None]
            turns = matrix_from_rotation_vector(plan[..., 3:6]) @ tips[..., :3, :3]
            found += [plan[..., :3] + tips[..., :3, 3], turns.reshape(*plan.shape[:2], 9)]
            found.append(plan[..., 6:])
        return np.concatenate(found, axis=2)

    def actions(self, setpoints: Array, readings: SceneReadings) -> Array:
        """Compute the actions that reach set-points within a period; undoes `labels`.

        Args:
            setpoints: m of each world, (n, m, k)
            readings: now

        Returns:
            (n, m, width)
        """
        found: list[Array] = []
        at = 0
        for name in self._parts:
            if name not in self._psms:
                before = readings.setpoints[name][:, None]
                found.append((setpoints[:, :, at : at + before.shape[2]] - before) / PERIOD_S)
                at += before.shape[2]
                continue
            places, turns = setpoints[:, :, at : at + 3], setpoints[:, :, at + 3 : at + 12]
            targets = readings.targets[name][:, None]
            back = np.swapaxes(targets[..., :3, :3], 2, 3)
            turn = rotation_vector_from_matrix(turns.reshape(*turns.shape[:2], 3, 3) @ back)
            found += [(places - targets[..., :3, 3]) / PERIOD_S, turn / PERIOD_S]
            found.append(setpoints[:, :, at + 12 : at + 13])
            at += 13
        return np.concatenate(found, axis=2)

    def capped(self, actions: Array, speed_m_s: float, spin_rad_s: float) -> Array:
        """Return actions with the velocities of tips no longer than given.

        Args:
            actions: (n, width)
            speed_m_s, spin_rad_s: greatest speed of a tip and of its rotation [m/s, rad/s]
        """
        found = actions.copy()
        for name in self._psms:
            for of, most in ((slice(3), speed_m_s), (slice(3, 6), spin_rad_s)):
                twist = found[:, self._parts[name]][:, of]
                length = np.linalg.norm(twist, axis=1, keepdims=True)
                twist *= np.minimum(1.0, most / np.maximum(length, 1e-9))
        return found
