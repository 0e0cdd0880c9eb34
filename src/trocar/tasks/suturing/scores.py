"""Scores of stitches: errors of the path, forces, slip, closure; and published scores."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.descriptions.needles import Needle
from trocar.geometry.se3 import inverse
from trocar.simulation import World
from trocar.simulation.tissue.tissues import SoftTissue, TissueReading

Array = NDArray[np.float64]


@dataclass
class StitchScore:
    """One stitch.

    Attributes:
        entry_mm, exit_mm: from the planned points to where the needle passed, in the surface
        depth_mm: largest error of the depth at the points beside the wound
        bites_mm: difference of both bites, from the wound's edges to entry and exit
        angle_deg: between needle and surface where it went in
        displacement_mm, force_n: largest, of tissue at a channel point
        tension_n: largest, of the thread
        excess_mm: largest length by which the thread was too long: a measure of numerical health
        press_n: largest force with which fingers pressed the surface
        slip_um, turn_deg: largest change of the needle's pose in a jaw that held it
        friction: largest share of a grip's friction that was used
        gap_before_mm, gap_mm, gap_deep_mm: between the walls: before; in the end at the surface,
            and at depth
        time_s: from the stitch before it
        tries: of grasps, one each for pick or hand-back, and regrasp
    """

    entry_mm: float = float("nan")
    exit_mm: float = float("nan")
    depth_mm: float = float("nan")
    bites_mm: float = float("nan")
    angle_deg: float = float("nan")
    displacement_mm: float = 0.0
    force_n: float = 0.0
    tension_n: float = 0.0
    excess_mm: float = 0.0
    press_n: float = 0.0
    slip_um: float = 0.0
    turn_deg: float = 0.0
    friction: float = 0.0
    gap_before_mm: float = float("nan")
    gap_mm: float = float("nan")
    gap_deep_mm: float = float("nan")
    time_s: float = float("nan")
    tries: int = 0


@dataclass
class Watch:
    """Scores stitches as they are made; look at it every period.

    Attributes:
        world, tissue, needle: that are watched
        scores: of each stitch so far
    """

    world: World
    tissue: SoftTissue
    needle: Needle
    scores: list[StitchScore] = field(default_factory=list[StitchScore])

    def __post_init__(self) -> None:
        """Begin with intact tissue."""
        self.scores = [StitchScore() for _ in self.tissue.plan]
        self._since, self._number = self.world.time, 0
        self._held: dict[str, Array] = {}

    def look(self, current: int) -> TissueReading:
        """Note what counts for the stitch that is being made."""
        world, read = self.world, self.tissue.read()
        number = min(current, len(self.scores) - 1)
        score = self.scores[number]
        if number != self._number:
            self._since, self._number = world.time, number
        if np.isnan(score.gap_before_mm):
            score.gap_before_mm = 1e3 * float(read.gaps[number, 0])
        score.time_s = world.time - self._since
        if np.isnan(score.angle_deg) and read.passed[number, 0]:
            T = world.objects[self.tissue.tissue.needle].measured_cp().matrix
            into = T[:3, :3] @ self.needle.tip[:3, 1] @ self.tissue.pose[:3, 2]
            score.angle_deg = float(np.degrees(np.arcsin(min(1.0, abs(into)))))
        moved = np.linalg.norm(read.displacements[:, :4], axis=2).max()
        forces = np.linalg.norm(read.forces[:, :4], axis=2).max()
        score.displacement_mm = max(score.displacement_mm, 1e3 * float(moved))
        score.force_n = max(score.force_n, float(forces))
        score.tension_n = max(score.tension_n, read.tension)
        score.excess_mm = max(score.excess_mm, 1e3 * read.excess)
        score.press_n = max(score.press_n, read.pressed)
        self._look_at_grips(score)
        return read

    def close(self, number: int, read: TissueReading) -> None:
        """Note how a stitch ended that is tight and locked."""
        score, plan, off = self.scores[number], self.tissue.plan[number], read.offsets[number]
        score.entry_mm, score.exit_mm = (1e3 * float(np.linalg.norm(off[k, :2])) for k in (0, 3))
        score.depth_mm = 1e3 * float(np.abs(off[1:3, 2]).max())
        at = plan + off
        score.bites_mm = 1e3 * abs(abs(float(at[0, 1])) - abs(float(at[3, 1])))
        self.measure_gaps(read)

    def measure_gaps(self, read: TissueReading) -> None:
        """Note the gaps of all stitches made so far."""
        for score, (surface, deep) in zip(self.scores, read.gaps, strict=True):
            if not np.isnan(score.entry_mm):
                score.gap_mm, score.gap_deep_mm = 1e3 * float(surface), 1e3 * float(deep)

    def _look_at_grips(self, score: StitchScore) -> None:
        """Note how far the needle moved in the jaws that hold it, and friction that they need."""
        for arm, grasp in self.world.grasps().items():
            if grasp.load == 0.0 or self.world.arms[arm].joints.setpoints()[-1] > 0.0:
                self._held.pop(arm, None)  # it presses, but does not hold yet, or lets go
                continue
            needle = self.world.objects[grasp.object].measured_cp().matrix
            held = inverse(self.world.arms[arm].measured_cp("world").matrix) @ needle
            if arm not in self._held:
                self._held[arm] = held
                score.tries += 1
                continue
            change = inverse(self._held[arm]) @ held
            at = inverse(held)[:3, 3]  # the arm's tip in the needle: a point that both share
            slip = np.linalg.norm((change[:3, :3] - np.eye(3)) @ at + change[:3, 3])
            turn = np.arccos(np.clip(0.5 * (np.trace(change[:3, :3]) - 1.0), -1.0, 1.0))
            score.slip_um = max(score.slip_um, 1e6 * float(slip))
            score.turn_deg = max(score.turn_deg, float(np.degrees(turn)))
            score.friction = max(score.friction, grasp.load)


def pose_score(needle: Needle, reported: Array, true: Array) -> float:
    """Return the score of a reported needle pose as task 1 of the AccelNet challenge has it [m].

    The sum of the distances of the needle's base, middle and tip; the least wins.
    Source: as of `score_pass`, `Task_1_Evaluation`.

    Args:
        needle: its dimensions
        reported, true: poses of its frame, (4, 4)
    """
    ends = needle.points([0.0, 0.5 * needle.arc, needle.arc])
    there = [ends @ T[:3, :3].T + T[:3, 3] for T in (np.asarray(reported), np.asarray(true))]
    return float(np.linalg.norm(there[0] - there[1], axis=1).sum())


@dataclass(frozen=True)
class Pass:
    """A pass of a needle's tip through two holes, as tasks 2 and 3 of the challenge score it.

    Attributes:
        entry_m, exit_m: lateral distance of the tip from a hole at the first sample beyond its
            plane, of the last crossing; NaN: it did not cross
        axial_m: distance of the tip from the exit's plane in the end
        complete: whether it crossed the entry before the exit, and is nearer to the exit then
    """

    entry_m: float
    exit_m: float
    axial_m: float
    complete: bool


#: Half the edges of the box about a hole in which the tip is looked at, and the distance from the
#: exit that the challenge recommends for the end. Source: `hole_bounds` of the challenge's
#: evaluation.py. [m]
HOLE_M = 5e-3


def score_pass(tips: ArrayLike, entry: Array, out: Array) -> Pass:
    """Score a tip's path through two holes as tasks 2 and 3 of the challenge do.

    The tip is looked at within 5 mm of a hole along each axis. It crosses an entry from +z to -z
    of its frame, an exit from -z to +z; the last crossing counts, by the tip's distance from the
    hole's axis at the first sample beyond the plane.
    Source: surgical-robotics-ai/surgical_robotics_challenge at c17b95a, evaluation/evaluation.py
    (of 2021-22; tasks 1 and 2 of 2023-24 are 2 and 3 there). It samples every 10 ms.

    Args:
        tips: the tip's way in the world, (n, 3) [m]
        entry, out: frames of the holes in the world, z out of the surface, (4, 4)
    """
    path = np.asarray(tips, dtype=np.float64)
    (went, at_entry), (came, at_exit) = _crossing(path, entry, -1.0), _crossing(path, out, 1.0)
    end = (path[-1] - out[:3, 3]) @ out[:3, :3]
    nearer = np.linalg.norm(end) < np.linalg.norm(path[-1] - entry[:3, 3])
    return Pass(at_entry, at_exit, abs(float(end[2])), bool(0 <= went < came and nearer))


def _crossing(path: Array, hole: Array, direction: float) -> tuple[int, float]:
    """Return the number of the point after the last crossing of a hole's plane, and its error."""
    local = (path - hole[:3, 3]) @ hole[:3, :3]
    near = np.flatnonzero((np.abs(local) <= HOLE_M).all(axis=1))
    z = direction * local[near, 2]
    crossed = np.flatnonzero((z[:-1] < 0.0) & (z[1:] > 0.0))
    if not len(crossed):
        return -1, float("nan")
    after = int(near[crossed[-1] + 1])
    return after, float(np.hypot(*local[after, :2]))
