"""Suturing as a task: a wound anywhere on the table, a needle beside it, stitches to make."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import asdict, replace
from functools import lru_cache
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from trocar.descriptions.scenes import Goal, Scene
from trocar.errors import InputError
from trocar.geometry.rotations import rotation_z
from trocar.geometry.se3 import inverse, transform
from trocar.simulation.records import DrawnCurve
from trocar.simulation.tissue.tissues import SoftTissue
from trocar.tasks.controller import PERIOD_S
from trocar.tasks.referee import SETTLED_S
from trocar.tasks.suturing.planning import Plan, make_plan, wound_frame
from trocar.tasks.suturing.policy import PerceptionNoise, Sewing, StitchError
from trocar.tasks.suturing.scene import settings_of_stitches
from trocar.tasks.suturing.scores import Watch, score_pass
from trocar.tasks.task import Task

Array = NDArray[np.float64]

#: Half the range of the wound's place and rotation, and the largest factor on its stiffness, each
#: way. Source: our own choice. [m, rad]
PLACE_M, TURN_RAD, STIFFER = 0.015, np.radians(20.0), 2.0
#: Points that are seen of a wound, and the ratio of its length along which they lie. Source: our
#: own choice.
SEEN, SEEN_SHARE = 15, 0.9
#: Periods between two measurements of stitches. Source: our own choice, 10 Hz: forces change
#: slowly.
LOOK_PERIODS = 5
#: Units at the end of the scores' names.
UNITS = ("mm", "um", "deg", "n", "s")
#: Rings in pictures about planned points: radius, thickness, height above the surface, colour.
#: Source: our own choice; a blue that tissue never has. [m]
RING_M, RING, RING_RGBA = (1.2e-3, 1.2e-4, 2e-4), 16, (0.35, 0.75, 1.0, 1.0)
#: Height of a banner by that of the picture. Source: our own choice.
BANNER = 0.055
#: Largest gap between the edges at a closed stitch. Source: our own choice. [m]
CLOSED_M = 3e-4


class Suturing(Task):
    """Every stitch of the tissue is made, tight, and the wound closed there.

    Attributes:
        tissue: that is stitched
        noise, noise_rng: errors of the policy's perception, and their generator
        banner: step that the policy executes
        find_wound: returns points of the wound's middle from noisy ones, both in the world (n, 3)
            [m]; None: these are taken as they are
    """

    task = "suturing"

    noise = PerceptionNoise()
    find_wound: Callable[[Array], Array] | None = None
    spread = (PLACE_M, TURN_RAD, STIFFER)

    def __init__(self, scene: Scene) -> None:
        self._seed, self.banner = 0, ""
        super().__init__(scene)

    @classmethod
    def derived_settings(cls, scene: Scene, nominal: Scene) -> dict[str, Any]:
        """Return settings of thread and time for other numbers of stitches."""
        return settings_of_stitches(scene, nominal)

    def reset(self, seed: int) -> dict[str, Array]:
        """Begin an episode: the wound, its stiffness and the needle are drawn."""
        self._seed = seed
        return super().reset(seed)

    def begin(self) -> None:
        """Draw the wound and its stiffness, and begin to count the stitches."""
        tissues = self.world.tissues
        if len(tissues) != 1:
            raise InputError(f"{self.scene.name}: got {len(tissues)} tissues; allowed: one")
        self.tissue: SoftTissue = next(iter(tissues.values()))
        rng = np.random.default_rng([self._seed, 1])
        self.noise_rng = np.random.default_rng([self._seed, 2])
        place, turn, stiffer = self.spread
        start = next(p.pose for p in self.scene.rig.props if p.name == self.tissue.name)
        at = start[:3, 3] + [*rng.uniform(-place, place, 2), 0.0]
        pose = transform(rotation_z(cast(float, rng.uniform(-turn, turn))) @ start[:3, :3], at)
        self.tissue.set_cp(pose, float(stiffer ** rng.uniform(-1.0, 1.0)))
        self.referee.goals = self._stitch_goals()
        self._plan: Plan | None = None
        self.watch = Watch(self.world, self.tissue, self.tissue.tissue.wire)
        self._tight = np.zeros(len(self.goals), bool)
        super().begin()

    def _stitch_goals(self) -> tuple[tuple[Goal, Array], ...]:
        """Return one goal for each stitch."""
        goal, _ = self.goals[0]
        pose, plan = self.tissue.pose, self.tissue.plan
        middles = plan.mean(axis=1) @ pose[:3, :3].T + pose[:3, 3]
        return tuple((replace(goal), middle) for middle in middles)

    def met(self, goal: Goal, at: Array) -> bool:  # noqa: ARG002  the tissue says where
        """Return whether a stitch is made and the wound closed there."""
        number = next(k for k, (one, _) in enumerate(self.goals) if one is goal)
        tissue = self.tissue
        if not tissue.left[number].all() or tissue.torn[number].any():
            return False
        return tissue.locked(number) and bool(tissue.read().gaps[number, 0] < CLOSED_M)

    def measure(self) -> None:
        """Measure the stitches."""
        if round(self.world.time / PERIOD_S) % LOOK_PERIODS:
            return
        read = self.watch.look(int(self._tight.sum()))
        for number in np.flatnonzero(~self._tight):
            if self.tissue.locked(int(number)) and read.left[number].all():
                self.watch.close(int(number), read)
                self._tight[number] = True
        self.watch.measure_gaps(read)

    def figures(self) -> dict[str, Any]:
        """Return the scores of the stitches, of each the largest; see `StitchScore`."""
        scores = [asdict(score) for score in self.watch.scores]
        worst = {key: float(np.nanmax([*(one[key] for one in scores), -1.0])) for key in scores[0]}
        names = {key: key.rpartition("_") for key in worst}
        return {
            "stiffness": round(self.tissue.stiffness, 3),
            **{
                f"{name} [{unit}]" if name and unit in UNITS else key: worst[key]
                for key, (name, _, unit) in names.items()
            },
        }

    def announce(self, text: str) -> None:
        """Publish the step that the policy executes."""
        self.banner = text
        self.world.journal.event(self.tissue.name, "status", text=text)

    def picture(self, capture: Callable[[], NDArray[np.uint8]]) -> NDArray[np.uint8]:
        """Return the endoscope's image with planned points that are ahead, and with the banner."""
        stops = [self.world.draw(ring.name, lambda ring=ring: ring) for ring in self._rings()]
        try:
            image = np.array(capture())
        finally:
            for stop in stops:
                stop()
        strip = _banner(self.banner, image.shape[1], round(BANNER * image.shape[0]))
        image[: len(strip)] = np.maximum(image[: len(strip)] // 3, strip)
        return image

    def _rings(self) -> Iterator[DrawnCurve]:
        """Yield rings about planned punctures that are ahead."""
        if self._plan is None:
            return
        tissue, (radius, thick, height) = self.tissue, RING_M
        angles = np.linspace(0.0, 2.0 * np.pi, RING + 1)
        circle = radius * np.column_stack([np.cos(angles), np.sin(angles), np.zeros(RING + 1)])
        for number, points in enumerate(tissue.plan):
            for place, k in (("in", 0), ("out", 3)):
                if not tissue.passed[number, k]:
                    at = circle + points[k] + [0.0, 0.0, height]
                    at = at @ tissue.pose[:3, :3].T + tissue.pose[:3, 3]
                    yield DrawnCurve(f"plan_{number + 1}_{place}", at, thick, RING_RGBA, 0.3)

    @property
    def plan(self) -> Plan:
        """Its stitches; made where the policy has not."""
        return self._plan or self.make_plan()

    def make_plan(self) -> Plan:
        """Plan the stitches from points that are seen of the wound and set the tissue's plan."""
        tissue, rng = self.tissue, self.noise_rng
        line = np.zeros((SEEN, 3))
        line[:, 0] = np.linspace(-0.5, 0.5, SEEN) * SEEN_SHARE * tissue.tissue.length
        line = line @ tissue.pose[:3, :3].T + tissue.pose[:3, 3]
        seen = line + self.noise.wound * rng.normal(size=line.shape)
        wound, _ = wound_frame(seen if self.find_wound is None else self.find_wound(seen))
        places = [float(row[0, 0]) for row in tissue.plan]
        needle = self.object_pose(tissue.tissue.needle)
        plan = make_plan(self.world, tissue.tissue, wound, places, needle)
        to_tissue = inverse(tissue.pose) @ wound
        points = [s.points @ to_tissue[:3, :3].T + to_tissue[:3, 3] for s in plan.stitches]
        tissue.set_plan(np.array(points))
        self._plan = plan
        return plan

    def policy(self) -> Iterator[Array]:
        """Yield the actions of the scripted policy."""
        try:
            self.make_plan()
            sewing = Sewing(self, self)
            yield from sewing.run()
            yield from sewing.rest(SETTLED_S + 0.1)
            self.referee.failed = "the wound is still open"
        except StitchError as problem:
            self.referee.failed = str(problem)


@lru_cache(maxsize=16)
def _banner(text: str, width: int, height: int) -> NDArray[np.uint8]:
    """Return a strip of an image with white words, (height, width, 3)."""
    strip = Image.new("RGB", (width, height))
    font = ImageFont.load_default(size=0.6 * height)
    ImageDraw.Draw(strip).text((0.5 * height, 0.15 * height), text, fill="white", font=font)
    return np.array(strip)


class NeedleThroughPhantom(Suturing):
    """Four passes through a phantom that stands still, as in task 3 of the AccelNet challenge.

    The wound, the needle and the grips are seen with the noise of `Suturing`; each pass is scored
    as the challenge defines it, beside the scores of stitches.
    """

    task = "needle-through-phantom"

    spread = (0.0, 0.0, 1.0)

    def begin(self) -> None:
        """Begin to count, with no pass made."""
        self._ways: dict[int, list[Array]] = {}
        super().begin()

    def measure(self) -> None:
        """Measure the stitches, and the way of the tip until thread follows it."""
        super().measure()
        number = int(self._tight.sum())
        if number < len(self.goals) and not self.tissue.left[number].any():
            tip = self.object_pose(self.tissue.tissue.needle) @ self.tissue.tissue.wire.tip
            self._ways.setdefault(number, []).append(tip[:3, 3])

    def figures(self) -> dict[str, Any]:
        """Return the scores of the stitches, and those of the passes."""
        found, pose = super().figures(), self.tissue.pose
        for number, tips in self._ways.items():
            points = self.tissue.plan[number]
            entry, out = (pose @ transform(np.eye(3), points[k]) for k in (0, 3))
            made = score_pass(tips, entry, out)
            if made.complete:
                name = f"pass {number + 1}"
                found |= {
                    f"{name} entry [mm]": 1e3 * made.entry_m,
                    f"{name} exit [mm]": 1e3 * made.exit_m,
                    f"{name} out [mm]": 1e3 * made.axial_m,
                }
        return found
