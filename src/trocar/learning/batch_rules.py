"""Rules of tasks for many worlds at once: what their classes have beside those of `Task`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.scenes import Scene
from trocar.geometry.rotations import matrix_from_quaternion
from trocar.tasks import Task
from trocar.tasks.registry import task_class
from trocar.tasks.scenes.dynamic import Pendulum
from trocar.tasks.scenes.reach import ActiveTrack, Track
from trocar.tasks.scenes.transfer import WallTransfer

if TYPE_CHECKING:
    from trocar.learning.scene_batch import SceneBatch

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]
Index = NDArray[np.intp]

#: Methods of `Task` that a batch has in its own way: a class that replaces one needs a row in
#: `RULES`.
REPLACED = (
    *("reset", "begin", "step", "command", "look"),
    *("measure", "met", "accomplished", "reward"),
)


class BatchRules:
    """The rules of `Task`, which do nothing of their own.

    Args:
        batch: whose worlds they judge
    """

    def __init__(self, batch: SceneBatch) -> None:
        self._batch = batch

    def begin(self, which: Index) -> None:
        """Begin to count in some worlds, as `Task.begin`."""

    def measure(self, which: Index, holds: Mapping[str, Index]) -> None:
        """Measure in every period before goals are judged, as `Task.measure`.

        Args:
            which: worlds, (k,)
            holds: rows of the objects that arms hold in them, {arm: (k,)}
        """

    def met(self, which: Index, met: Bools) -> Bools:  # noqa: ARG002
        """Return which goals are met in some worlds, (k, G), from those met by the scene's file."""
        return met

    def accomplished(self, which: Index, settled: Bools, late: Bools) -> Bools:  # noqa: ARG002
        """Return in which worlds the episode ends with success now, as `Task.accomplished`, (k,)."""
        return settled


class TrackRules(BatchRules):
    """The rules of `Track`: optical axes pass near places that lie ahead."""

    def met(self, which: Index, met: Bools) -> Bools:
        """Return which axes pass near."""
        batch, found = self._batch, met.copy()
        for k, goal in enumerate(batch.scene.goals):
            T = batch.tips[goal.arm][which]
            off = batch.places[which, k] - T[:, :3, 3]
            x, y, z = np.moveaxis((off[:, None] @ T[:, :3, :3])[:, 0], 1, 0)
            found[:, k] = (z > 0.0) & (np.hypot(x, y) <= goal.radius)
        return found


class ActiveTrackRules(TrackRules):
    """The rules of `ActiveTrack`: a target circles and stays in the middle most of the time."""

    def __init__(self, batch: SceneBatch) -> None:
        super().__init__(batch)
        self._middle = np.zeros((batch.n, 3))
        self._looks, self._good = np.zeros(batch.n, np.intp), np.zeros(batch.n, np.intp)

    def begin(self, which: Index) -> None:
        """Begin to count, with the target where the goal is."""
        self._middle[which] = self._batch.drawn[which, 0]
        self._looks[which] = self._good[which] = 0

    def measure(self, which: Index, holds: Mapping[str, Index]) -> None:  # noqa: ARG002
        """Move the target."""
        angle = 2.0 * np.pi * self._batch.time[which] / ActiveTrack.TURN_S
        way = np.stack([np.cos(angle), np.sin(angle), np.zeros(len(which))], axis=1)
        self._batch.drawn[which, 0] = self._middle[which] + ActiveTrack.CIRCLE_M * way

    def met(self, which: Index, met: Bools) -> Bools:
        """Return which axes pass near, and count the looks at which they do."""
        found = super().met(which, met)
        counts = self._batch.time[which] > ActiveTrack.FIND_S
        self._looks[which] += counts
        self._good[which] += counts & found[:, 0]
        return found

    def accomplished(self, which: Index, settled: Bools, late: Bools) -> Bools:  # noqa: ARG002
        """Return where the time is over and the target was in the middle for most of it."""
        return late & (self._good[which] >= ActiveTrack.SHARE * self._looks[which])


class PendulumRules(BatchRules):
    """The rules of `Pendulum`: it hangs at rest, away from the jaw."""

    def met(self, which: Index, met: Bools) -> Bools:
        """Return which pendulums hang at rest."""
        batch, found = self._batch, met.copy()
        assert isinstance(batch.task, Pendulum)
        for k, goal in enumerate(batch.scene.goals):
            at = batch.objects[which, batch.names.index(goal.object)]
            bob = at[:, :3] + matrix_from_quaternion(at[:, 3:]) @ batch.task.bob
            apart = (batch.tips[batch.arms[0]][which, :3, 3] - bob)[:, :2]
            alone = np.linalg.norm(apart, axis=1) > Pendulum.SIDE_M + 0.002
            rate = batch.physics.object_rates(goal.object, which)[:, 0]
            swings = np.abs(rate) * np.linalg.norm(batch.task.bob) > Pendulum.REST_M_S
            off = bob - batch.places[which, k]
            found[:, k] = alone & ~swings & (np.hypot(off[:, 0], off[:, 1]) <= goal.radius)
        return found


class WallTransferRules(BatchRules):
    """The rules of `WallTransfer`: a goal counts once its ring has been in both hands."""

    def __init__(self, batch: SceneBatch) -> None:
        super().__init__(batch)
        #: Whether each object has been in each hand.
        self._hands = np.zeros((batch.n, len(batch.names), len(batch.arms)), np.bool_)

    def begin(self, which: Index) -> None:
        """Forget the hands that rings have been in."""
        self._hands[which] = False

    def measure(self, which: Index, holds: Mapping[str, Index]) -> None:
        """Note the hands that each ring has been in."""
        for column, name in enumerate(self._batch.arms):
            some = np.flatnonzero(holds[name] >= 0)
            self._hands[which[some], holds[name][some], column] = True

    def met(self, which: Index, met: Bools) -> Bools:
        """Return which rings are at their goals after both arms have held them."""
        rows = [self._batch.names.index(goal.object) for goal in self._batch.scene.goals]
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
    """Return why a scene cannot run in a batch; "" where it can.

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
