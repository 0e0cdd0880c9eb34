"""Rules of tasks for many worlds at once: what their classes have beside those of `Task`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import cast

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.scenes import Scene
from trocar.geometry.rotations import matrix_from_quaternion
from trocar.simulation.batch import Batch
from trocar.tasks import Task
from trocar.tasks.registry import task_class
from trocar.tasks.scenes.dynamic import Pendulum
from trocar.tasks.scenes.reach import ActiveTrack, Track
from trocar.tasks.scenes.transfer import WallTransfer

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]
Index = NDArray[np.intp]

#: Methods of `Task` that a batch has in its own way: a class that replaces one needs a row in
#: `RULES`.
REPLACED = (
    *("reset", "begin", "step", "command", "look"),
    *("measure", "met", "accomplished", "reward"),
)


@dataclass(frozen=True, eq=False)
class SeenWorlds:
    """Worlds of a scene, as of the last look; a `SceneBatch` fills the arrays.

    Attributes:
        task: one world of the scene
        physics: of all worlds
        time: of each episode, (n,) [s]
        tips: of the driven arms in the world, {arm: (n, 4, 4)}
        objects: positions and quaternions of all objects, in the world's order, (n, O, 7)
        drawn: places of goals that resets drew, in the world or in the object that they stand on,
            (n, G, 3) [m]
        places: of goals in the world, (n, G, 3) [m]
    """

    task: Task
    physics: Batch
    time: Array
    tips: Mapping[str, Array]
    objects: Array
    drawn: Array
    places: Array

    def row(self, name: str) -> int:
        """Return the row of an object."""
        return list(self.task.world.objects).index(name)


class BatchRules:
    """The rules of `Task`, which do nothing of their own.

    Args:
        seen: the worlds that they judge
    """

    def __init__(self, seen: SeenWorlds) -> None:
        self._seen = seen

    def begin(self, which: Index) -> None:
        """Begin to count in some worlds, as `Task.begin`."""

    def measure(self, which: Index, holds: Mapping[str, Index]) -> None:
        """Measure in every period before goals are judged, as `Task.measure`.

        Args:
            which: worlds, (k,)
            holds: rows of the objects that arms hold in them, {arm: (k,)}
        """

    def met(self, which: Index, met: Bools) -> Bools:  # noqa: ARG002
        """Judge goals in some worlds, (k, G), given those met by the scene's file."""
        return met

    def accomplished(self, which: Index, settled: Bools, late: Bools) -> Bools:  # noqa: ARG002
        """Judge whether episodes end with success now, as `Task.accomplished`, (k,)."""
        return settled


class TrackRules(BatchRules):
    """The rules of `Track`: optical axes pass near places that lie ahead."""

    def met(self, which: Index, met: Bools) -> Bools:
        """Judge whether axes pass near."""
        seen, found = self._seen, met.copy()
        for k, goal in enumerate(seen.task.scene.goals):
            T = seen.tips[goal.arm][which]
            off = seen.places[which, k] - T[:, :3, 3]
            x, y, z = np.moveaxis((off[:, None] @ T[:, :3, :3])[:, 0], 1, 0)
            found[:, k] = (z > 0.0) & (np.hypot(x, y) <= goal.radius)
        return found


class ActiveTrackRules(TrackRules):
    """The rules of `ActiveTrack`: a target circles and stays in the middle most of the time."""

    def __init__(self, seen: SeenWorlds) -> None:
        super().__init__(seen)
        self._middle = np.zeros((len(seen.time), 3))
        self._looks, self._good = np.zeros((2, len(seen.time)), np.intp)

    def begin(self, which: Index) -> None:
        """Begin to count, with the target where the goal is."""
        self._middle[which] = self._seen.drawn[which, 0]
        self._looks[which] = self._good[which] = 0

    def measure(self, which: Index, holds: Mapping[str, Index]) -> None:  # noqa: ARG002
        """Move the target."""
        angle = 2.0 * np.pi * self._seen.time[which] / ActiveTrack.TURN_S
        way = np.stack([np.cos(angle), np.sin(angle), np.zeros(len(which))], axis=1)
        self._seen.drawn[which, 0] = self._middle[which] + ActiveTrack.CIRCLE_M * way

    def met(self, which: Index, met: Bools) -> Bools:
        """Judge axes, and count the looks at which they pass near."""
        found = super().met(which, met)
        counts = self._seen.time[which] > ActiveTrack.FIND_S
        self._looks[which] += counts
        self._good[which] += counts & found[:, 0]
        return found

    def accomplished(self, which: Index, settled: Bools, late: Bools) -> Bools:  # noqa: ARG002
        """Judge whether the time is over and the target was in the middle for most of it."""
        return late & (self._good[which] >= ActiveTrack.SHARE * self._looks[which])


class PendulumRules(BatchRules):
    """The rules of `Pendulum`: it hangs at rest, away from the jaw."""

    def met(self, which: Index, met: Bools) -> Bools:
        """Judge whether pendulums hang at rest."""
        seen, found = self._seen, met.copy()
        middle = cast(Pendulum, seen.task).bob
        for k, goal in enumerate(seen.task.scene.goals):
            at = seen.objects[which, seen.row(goal.object)]
            bob = at[:, :3] + matrix_from_quaternion(at[:, 3:]) @ middle
            apart = (seen.tips[seen.task.arms[0]][which, :3, 3] - bob)[:, :2]
            alone = np.linalg.norm(apart, axis=1) > Pendulum.SIDE_M + 0.002
            rate = seen.physics.object_rates(goal.object, which)[:, 0]
            swings = np.abs(rate) * np.linalg.norm(middle) > Pendulum.REST_M_S
            off = bob - seen.places[which, k]
            found[:, k] = alone & ~swings & (np.hypot(off[:, 0], off[:, 1]) <= goal.radius)
        return found


class WallTransferRules(BatchRules):
    """The rules of `WallTransfer`: a goal counts once its ring has been in both hands."""

    def __init__(self, seen: SeenWorlds) -> None:
        super().__init__(seen)
        #: Whether each object has been in each hand.
        shape = len(seen.time), len(seen.task.world.objects), len(seen.task.arms)
        self._hands = np.zeros(shape, np.bool_)

    def begin(self, which: Index) -> None:
        """Forget the hands that rings have been in."""
        self._hands[which] = False

    def measure(self, which: Index, holds: Mapping[str, Index]) -> None:
        """Note the hands that each ring has been in."""
        for column, name in enumerate(self._seen.task.arms):
            some = np.flatnonzero(holds[name] >= 0)
            self._hands[which[some], holds[name][some], column] = True

    def met(self, which: Index, met: Bools) -> Bools:
        """Judge whether rings are at their goals after both arms have held them."""
        rows = [self._seen.row(goal.object) for goal in self._seen.task.scene.goals]
        return met & self._hands[which][:, rows].all(axis=2)


#: Classes of tasks that replace some of `REPLACED`.
RULES: dict[type[Task], type[BatchRules]] = {
    Track: TrackRules,
    ActiveTrack: ActiveTrackRules,
    Pendulum: PendulumRules,
    WallTransfer: WallTransferRules,
}


def batch_rules(kind: type[Task]) -> type[BatchRules] | None:
    """Return the rules of a class of tasks, None where it has some that no batch has."""
    for known, rules in RULES.items():
        if kind is known:
            return rules
    own = [name for name in REPLACED if getattr(kind, name) is not getattr(Task, name)]
    return None if own else BatchRules


def obstacle(scene: Scene) -> str:
    """Return the reason that keeps a scene out of batches; "" if none does.

    Raises:
        UnknownNameError, InputError: as `task_class`
    """
    rig, kind = scene.rig, task_class(scene)
    if tissues := [prop.name for prop in rig.props if prop.tissue is not None]:
        return f"has soft tissue ({', '.join(tissues)}); allowed in a batch: rigid bodies"
    if threads := [prop.name for prop in rig.objects if prop.thread]:
        return f"has threads ({', '.join(threads)}); allowed in a batch: rigid bodies"
    if scripts := [prop.name for prop in rig.objects if prop.script]:
        return f"has scripts of objects ({', '.join(scripts)}); allowed in a batch: none"
    if rig.errors is not None:
        return f"has errors of robots ({rig.errors.name}); allowed in a batch: perfect sensors"
    if kind.sees:
        return "looks at images; allowed in a batch: tasks that read the physics"
    if batch_rules(kind) is None:
        own = [name for name in REPLACED if getattr(kind, name) is not getattr(Task, name)]
        return (
            f"its class {kind.__name__} has its own {', '.join(own)}; allowed in a batch: those of"
            f" Task, {', '.join(known.__name__ for known in RULES)}"
        )
    strange = {goal.arm for goal in scene.goals if goal.arm} - {*scene.arms}
    if strange:
        return (
            f"has goals of {', '.join(sorted(strange))}; allowed in a batch: of the arms that it"
            f" drives ({', '.join(scene.arms)})"
        )
    return ""
