"""Readings of worlds of a scene after a period: what observations and rewards are made of."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trocar.tasks import Task

Array = NDArray[np.float64]
#: Held by nothing, in `SceneReadings.held`.
NOTHING = -1


@dataclass(frozen=True, eq=False)
class SceneReadings:
    """Readings of n worlds of one scene, as of the last look; PSMs have a tip and a jaw.

    Attributes:
        time: of the episode, (n,) [s]
        tips: measured pose of each PSM's tip in the world, {arm: (n, 4, 4)}
        targets: pose of its set-point in the world, {arm: (n, 4, 4)}
        q, v: measured joint positions and velocities of each driven arm, the jaw last,
            {arm: (n, j)} [rad or m, per s]
        setpoints: of these joints, {arm: (n, j)} [rad or m]
        objects: position and quaternion wxyz in the world, {object: (n, 7)}; without hidden ones
        held: row of `names` that both fingers of each PSM press, or `NOTHING`, {arm: (n,)}
        names: of all objects of the scene, hidden ones included
        stalled: whether each PSM stayed where it was though the last action moves it, {arm: (n,)}
        goals: places of the goals in the world, (n, G, 3) [m]; without those on hidden objects
        achieved: places of what shall be there, the object or the tip, (n, G, 3) [m]
        met: whether each goal is met, (n, G)
    """

    time: Array
    tips: Mapping[str, Array]
    targets: Mapping[str, Array]
    q: Mapping[str, Array]
    v: Mapping[str, Array]
    setpoints: Mapping[str, Array]
    objects: Mapping[str, Array]
    held: Mapping[str, NDArray[np.intp]]
    names: tuple[str, ...]
    stalled: Mapping[str, NDArray[np.bool_]]
    goals: Array
    achieved: Array
    met: NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.time)


def read_task(task: Task) -> SceneReadings:
    """Return the readings of a task, as those of one world.

    Tips and objects are as robots and cameras report them, whether goals are met is the truth.
    """
    world, referee, controller = task.world, task.referee, task.controller
    states, hidden = task.observed, task.scene.hidden
    rows = {name: row for row, name in enumerate(states.names)}
    psms = [name for name in task.arms if world.arms[name].description.type == "PSM"]
    joints = {name: world.arms[name].joints for name in task.arms}
    controller.readings.renew()
    poses = controller.readings.tips
    tips = {name: controller.registered(name, poses[name].copy()) for name in psms}
    measured = {name: of.readings()[:2] for name, of in joints.items()}
    goals: list[Array] = []
    achieved: list[Array] = []
    met: list[bool] = []
    for goal, at in task.goals:
        if goal.on in hidden:
            continue
        place = task.place_seen(goal, at)
        if goal.arm and not goal.held:
            if goal.object:
                place = place + states.positions[rows[goal.object]]
            found = tips[goal.arm][:3, 3] if goal.arm in tips else _tip(task, goal.arm)
        else:
            found = states.positions[rows[goal.object]]
        goals.append(place)
        achieved.append(found)
        met.append(task.met(goal, at))
    placed = np.concatenate([states.positions, states.quaternions], axis=1)
    return SceneReadings(
        time=np.array([referee.time]),
        tips={name: T[None] for name, T in tips.items()},
        targets={name: controller.target(name)[None] for name in psms},
        q={name: q[None] for name, (q, _) in measured.items()},
        v={name: v[None] for name, (_, v) in measured.items()},
        setpoints={name: of.setpoints()[None] for name, of in joints.items()},
        objects={name: placed[None, row] for name, row in rows.items() if name not in hidden},
        held={n: np.array([rows.get(referee.held.get(n, ""), NOTHING)]) for n in psms},
        names=states.names,
        stalled={name: np.array([controller.stays(name)]) for name in psms},
        goals=np.array(goals).reshape(1, -1, 3),
        achieved=np.array(achieved).reshape(1, -1, 3),
        met=np.array(met, np.bool_).reshape(1, -1),
    )


def _tip(task: Task, arm: str) -> Array:
    return task.world.arms[arm].measured_cp("world").matrix[:3, 3]
