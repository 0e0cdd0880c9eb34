"""The count of an episode: goals, drops, forces, paths, its end and its points."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.scenes import Goal, Scene
from trocar.simulation.grasps import Grasps
from trocar.simulation.probes import Sensors
from trocar.tasks.controller import TipController
from trocar.tasks.scoring import fls_score

Array = NDArray[np.float64]

#: Time for which all goals must be met. Source: our own choice. [s]
SETTLED_S = 0.2
#: Depth below the lowest goal at which an object is out of play. Source: our own choice. [m]
LOST_M = 0.05
#: Rounding errors of times are smaller. [s]
ROUNDING_S = 1e-9


class Ending(StrEnum):
    """Outcome of an episode: success or failure by its rules, or truncation by the time limit.

    `SUCCESS` and `FAILURE` are `terminated` in Gymnasium's terms, `TRUNCATION` is `truncated`.
    """

    RUNNING = "running"
    SUCCESS = "success"
    FAILURE = "failure"
    TRUNCATION = "truncation"


class Referee:
    """Counts the events of a scene, independently of the source of the arms' commands.

    Args:
        scene: with goals and limits
        controller: drives the arms; its stalls are reported when the time is over

    Attributes:
        goals: of this episode, with their places (3,) in the world, or in the object that they
            stand on [m]
        stage: of the goals that count now
        met_count: goals that are met, those of earlier stages included
        gained: change of the ratio of goals met, in the last period
        drops: objects dropped so far
        ending, reason: how the episode ended, and why: "done", "time" with what held an arm back
            then, or what went wrong; "" before
        failed: why the policy gave up, which ends the episode; "" before
        remarks: of the policy, about what it could not do; they stand in the reason
        time: of the last reading [s]
        states: of all objects, then
        tips: true poses of the driven arms' tips in the world, then, {arm: (4, 4)}
        held: objects that both fingers press, then, {arm: object}
        reported: the same from elsewhere, which replaces them from the next reading on; "" for
            nothing, {arm: object}
        distance: length of each tip's path, {arm: length} [m]
        force: largest net force of contacts on each arm, {arm: force} [N]
        grip: largest force of the weaker finger on an object, {arm: force} [N]
    """

    def __init__(self, scene: Scene, controller: TipController) -> None:
        self._scene, self._controller, self._world = scene, controller, controller.world
        self._arms = {name: self._world.arms[name] for name in controller.arms}
        self._readings, self._grasps = controller.readings, self._world.part(Grasps)
        self._sensors = self._world.part(Sensors)
        self._rows = {name: row for row, name in enumerate(self._world.objects)}
        self.goals: tuple[tuple[Goal, Array], ...] = ()
        self._floor = -np.inf
        self.reported: Mapping[str, str] = {}
        self._readings.read()
        self.states = self._readings.objects
        self.begin()

    def place_goals(self, rng: np.random.Generator) -> None:
        """Draw the goals' places of an episode, with the objects where it begins."""
        self.goals = tuple(
            (goal, goal.at + goal.spread * rng.uniform(-1.0, 1.0, 3)) for goal in self._scene.goals
        )
        self._floor = min(self.place(goal, at)[2] for goal, at in self.goals) - LOST_M

    def begin(self) -> None:
        """Count from now on, from where everything is."""
        self.drops, self.ending, self.reason = 0, Ending.RUNNING, ""
        self.stage, self.met_count, self.gained = 0, 0, 0.0
        self.failed = ""
        self.remarks: list[str] = []
        self._settling: float | None = None
        self._fell_from: dict[str, float] = {}
        self.distance = dict.fromkeys(self._arms, 0.0)
        self.force = dict.fromkeys(self._arms, 0.0)
        self.grip = dict.fromkeys(self._arms, 0.0)
        self.time = 0.0
        self.held: dict[str, str] = {}
        self.tips = self._true_tips()
        #: Position of each tip at the last reading [m].
        self._were: dict[str, list[float]] = {n: T[:3, 3].tolist() for n, T in self.tips.items()}

    def read(self) -> None:
        """Read objects, grasps, forces and tips, and count drops; once in every period."""
        readings, grasps, before = self._readings, self._grasps, self.held
        readings.read()
        self.states = readings.objects
        self.time, self.held = self.states.time, {}
        for arm, grasp in zip(grasps.arms, grasps.latest, strict=True):
            if grasp.object and arm in self.grip:
                self.held[arm] = grasp.object
                self.grip[arm] = max(self.grip[arm], grasp.force)
        for arm, name in self.reported.items():
            self.held.pop(arm, None)
            if name:
                self.held[arm] = name
        if readings.touching():
            world = self._world  # plain numbers where no tissue acts
            forces = world.contact_forces() if world.tissues else self._sensors.probes.net_forces()
            for arm, force in forces.items():
                if arm in self.force:
                    self.force[arm] = max(self.force[arm], math.hypot(*force))
        if self._fell_from or before != self.held:
            self._count_drops(set(before.values()), set(self.held.values()))
        tips = readings.tips if self._world.errors is None else self._true_tips()
        for name, T in tips.items():
            at = T[:3, 3].tolist()
            self.distance[name] += math.dist(at, self._were[name])
            self._were[name] = at
        self.tips = tips

    def judge(
        self, met: Callable[[Goal, Array], bool], accomplished: Callable[[bool, bool], bool]
    ) -> None:
        """Count the goals that are met, as of the last reading, and end the episode.

        Args:
            met: rule of a goal, as `met`
            accomplished: whether the episode ends with success, by whether all goals are met and
                settled, and whether the time is over
        """
        earlier = now = count = 0
        for goal, at in self.goals:
            if goal.stage < self.stage:
                earlier += 1
            elif goal.stage == self.stage:
                now += 1
                count += met(goal, at)
        count += earlier
        self.gained, self.met_count = (count - self.met_count) / len(self.goals), count
        if count < earlier + now:
            self._settling = None
        elif self._settling is None:
            self._settling = self.time
        settled = self._settling is not None and self.time - self._settling >= SETTLED_S
        if settled:
            later = [goal.stage for goal, _ in self.goals if goal.stage > self.stage]
            if later:
                self.stage, self._settling, settled = min(later), None, False
        late = self.time >= self._scene.time_limit - ROUNDING_S
        if accomplished(settled, late):
            self.ending, self.reason = Ending.SUCCESS, "done"
            return
        faults: list[str] = []
        heights: list[float] = self.states.positions[:, 2].tolist()
        for name, arm in self._arms.items():
            if arm.runtime.control.states.phase == "FAULT":
                faults.append(name)
        if faults:
            self.ending, self.reason = Ending.FAILURE, f"{', '.join(faults)}: FAULT"
        elif min(heights, default=np.inf) < self._floor:
            lost = [n for n, z in zip(self._rows, heights, strict=True) if z < self._floor]
            self.drops += len(lost)
            self.ending, self.reason = Ending.FAILURE, f"{', '.join(lost)}: out of play"
        elif late:
            stalls = self._controller.stalls().items()
            stalled = [f"{name} stands still, {why}" for name, why in stalls if why]
            self.ending = Ending.TRUNCATION
            self.reason = "; ".join(["time", *self.remarks, *stalled])
        elif self.failed:
            self.ending, self.reason = Ending.FAILURE, self.failed

    # ------------------------------------------------------------------ looking

    def met(self, goal: Goal, at: Array) -> bool:
        """Return whether a goal is met, as of the last reading.

        Args:
            goal, at: a row of `goals`
        """
        if goal.on:
            at = self.place(goal, at)
        if goal.arm and not goal.held:
            tip = self.tips.get(goal.arm)
            if tip is None:
                tip = self._true_tip(goal.arm)
            off = tip[:3, 3] - at
            if goal.object:
                off -= self.states.positions[self._rows[goal.object]]
        else:
            if goal.arm:
                held = self.held.get(goal.arm) == goal.object
            else:
                held = goal.object in self.held.values()
            if goal.held != held:
                return False
            off = self.states.positions[self._rows[goal.object]] - at
        x, y, z = off.tolist()
        return math.hypot(x, y) <= goal.radius and abs(z) <= goal.height

    def place(self, goal: Goal, at: Array) -> Array:
        """Return the place of a goal in the world now, (3,) [m].

        Args:
            goal, at: a row of `goals`
        """
        if not goal.on:
            return at
        T = self._world.object(goal.on).measured_cp().matrix
        return T[:3, :3] @ at + T[:3, 3]

    def position(self, name: str) -> Array:
        """Return an object's position, as of the last reading, (3,) [m]."""
        return self.states.positions[self._rows[name]]

    def score(self) -> float:
        """Return the points of the episode as `fls_score` computes them."""
        wrong, limit = len(self.goals) - self.met_count, self._scene.time_limit
        return fls_score(min(self.time, limit), len(self.goals), self.drops, wrong, limit)

    # ------------------------------------------------------------------ inside

    def _true_tips(self) -> dict[str, Array]:
        """Return the true tips of the driven arms in the world now, {arm: (4, 4)}."""
        return {name: self._true_tip(name) for name in self._arms}

    def _true_tip(self, arm: str) -> Array:
        """Return the true pose of a tip in the world, whatever its encoders report, (4, 4)."""
        if self._world.errors is None:
            return self._world.arms[arm].measured_cp("world").matrix
        return self._world.true_state(arm).world

    def _count_drops(self, before: set[str], now: set[str]) -> None:
        """Count objects that fell since a jaw released them."""
        for name in before - now:
            self._fell_from[name] = float(self.position(name)[2])
        for name in now:
            self._fell_from.pop(name, None)
        for name, height in list(self._fell_from.items()):
            if height - float(self.position(name)[2]) > self._scene.drop_height:
                self.drops += 1
                del self._fell_from[name]
