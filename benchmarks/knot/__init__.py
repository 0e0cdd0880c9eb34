"""How far two arms get with the first throw of an instrument tie, and what ends it.

Two threads leave a wound, as the ends of a suture do. PSM1 holds the long one and winds it once
about PSM2's instrument, which then takes the short one and draws back, so that the turn would slip
off over it. The linking number of the long thread with the instrument and the short thread is about
1 while the turn lies about either, and falls only where thread passes through something. Then the
long end is pulled aside, which tightens the throw.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions import load_arm
from trocar.descriptions.catalogue import load_scene
from trocar.descriptions.scenes import Scene
from trocar.geometry.rotations import quaternion_numbers
from trocar.geometry.se3 import transform
from trocar.robot.verification.figures import Figure
from trocar.tasks.controller import EVERY, PERIOD_S
from trocar.tasks.motions import UP, Hand, Motion, together
from trocar.tasks.task import Task

Array = NDArray[np.float64]

FOLDER = Path(__file__).parent
#: Directions of projections: the axes of an icosahedron through its corners, (6, 3).
GOLDEN = 0.5 * (1.0 + math.sqrt(5.0))
WAYS = np.array(
    [[0, 1, GOLDEN], [0, -1, GOLDEN], [1, GOLDEN, 0], [-1, GOLDEN, 0], [GOLDEN, 0, 1],
     [GOLDEN, 0, -1]]
) / math.hypot(1.0, GOLDEN)  # fmt: skip
#: Tension of both ends at which a throw is tight, step and number of the pulls until then. Source:
#: our own choice. [N, m]
TIGHT_N, PULL_M, PULLS = 0.2, 0.002, 45
#: Length of the long thread between the wound and the jaws, and what is spared of it. Source: our
#: own choice. [m]
FREE_M, SPARE_M, FOLLOW_M = 0.108, 0.008, 0.002
#: Distance of thread from the axis of the instrument within which it lies on it. Source: our own
#: choice, the shaft's radius of 4.2 mm and more. [m]
NEAR_M = 0.006
#: Distance from the shaft's end to the tip. Source: LARGE_NEEDLE_DRIVER_400006.toml. [m]
WRIST_M = 0.0091
#: Height of the instrument about which the thread is wound, and its tip then. Source: our own
#: choice. [m]
AXIS_M, TIP_M = 0.070, np.array([0.036, 0.0, 0.070])
#: Where its shaft enters. Source: rig.toml. [m]
PORT_M = np.array([-0.130, 0.0, 0.072])
#: Tension with which it is wound. Source: our own choice. [N]
TENSION_N = 0.04
#: The winding jaws' angle about the instrument, from in front of it over its top, and their place
#: along it, which is beyond its tip as they come back below it. Source: our own choice. [deg, m]
ANGLES = (0, 90, 150, 200, 225, 245, 300, 330, 360, 400)
PLACES = (-0.018, -0.018, -0.018, -0.014, 0.02, 0.060, 0.060, 0.03, -0.01, -0.03)
#: Place along the short thread's direction at which it is taken. Source: our own choice. [m]
TAKEN_M = 0.034


def knot(watch: Callable[[str], None]) -> list[Figure]:
    """Measure the attempt with the instrument as it is, and with a wrist that thread touches."""
    found: list[Figure] = []
    for label, tool in (("", ""), (", wrist of 3.2 mm radius", str(FOLDER / "instrument.toml"))):
        watch(f"knot{label}")
        found += Attempt(_scene(tool)).figures(label)
    return found


def _scene(tool: str) -> Scene:
    """Return the scene with another instrument of PSM2, or "" for its own."""
    scene = load_scene(FOLDER / "scene.toml")
    if not tool:
        return scene
    arms = tuple(
        replace(arm, arm=load_arm("psm", tool)) if arm.name == "PSM2" else arm
        for arm in scene.rig.arms
    )
    return replace(scene, rig=replace(scene.rig, arms=arms))


def linking(one: Array, other: Array) -> float:
    """Return the linking number of two open polylines, (n, 3) and (m, 3).

    Half of their signed crossings, mean of the projections along six axes of an icosahedron.
    """
    total = 0.0
    for way in WAYS:
        across = np.cross(way, np.roll(way, 1))
        across /= np.linalg.norm(across)
        turn = np.column_stack([across, np.cross(way, across), way])
        first, second = one @ turn, other @ turn
        u, v = np.diff(first, axis=0)[:, None], np.diff(second, axis=0)[None]
        apart = second[None, :-1] - first[:-1, None]
        area = u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0]
        with np.errstate(divide="ignore", invalid="ignore"):
            s = (apart[..., 0] * v[..., 1] - apart[..., 1] * v[..., 0]) / area
            t = (apart[..., 0] * u[..., 1] - apart[..., 1] * u[..., 0]) / area
            above = s * u[..., 2] - apart[..., 2] - t * v[..., 2]
        met = (s > 0.0) & (s < 1.0) & (t > 0.0) & (t < 1.0)
        total += float((np.sign(area) * np.sign(above))[met].sum())
    return 0.5 * total / len(WAYS)


@dataclass
class Attempt:
    """One attempt of the scene.

    Attributes:
        scene: of the benchmark
        links: (time [s], linking number) while the instrument draws back
        lost: where the linking number fell below a half: distance ahead of the tip [m], fastest
            link of the thread [m/s]; None while it has not
    """

    scene: Scene
    links: list[tuple[float, float]] = field(default_factory=list[tuple[float, float]])
    lost: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        self.task = Task(self.scene)
        self.world = self.task.world
        self.winder, self.post = Hand(self.task, "PSM1"), Hand(self.task, "PSM2")
        self.level = self.task.controller.target("PSM2")[:3, :3]
        self.down = self.winder.pointing_down(0.0, np.array([-0.014, -0.09, 0.08]))
        self.long, self.short = self.world.threads["long"], self.world.threads["short"]
        self.base = self.long.points()[0]
        self.port = PORT_M
        self.tension = 0.0

    def figures(self, label: str) -> list[Figure]:
        """Wind, take, draw back, and return what was reached."""
        self.grip()
        self.wind()
        turns = self.turns()
        self.take()
        taken = self.taken()
        self.draw_back()
        kept = [abs(number) for _, number in self.links]
        tension = self.tighten() if self.lost is None else 0.0
        throw = abs(linking(self.long.points(), self.short.points()))
        found = [
            Figure(f"knot: turns about the instrument{label}", turns, ""),
            Figure(f"knot: short end in the jaws{label}", float(taken), ""),
            Figure(f"knot: linking number, short end taken{label}", kept[0], ""),
            Figure(f"knot: linking number, instrument drawn back{label}", kept[-1], ""),
            Figure(f"knot: linking number of both ends, pulled{label}", throw, "", lower=0.9),
            Figure(f"knot: tension of both ends then{label}", tension, "N", lower=TIGHT_N),
        ]
        if self.lost is not None:
            ahead, speed = self.lost
            found += [
                Figure(f"knot: thread passes, ahead of the tip{label}", 1e3 * ahead, "mm"),
                Figure(f"knot: fastest link then{label}", speed, "m/s"),
            ]
        return found

    # ------------------------------------------------------------------ motions

    def grip(self) -> None:
        """Lay the long thread straight into PSM1's jaws, and close them."""
        way = np.array([-0.1, -0.9, 0.25])
        self.winder.jaw, self.post.jaw = 0.04, 0.0
        start = self.base + FREE_M * way / np.linalg.norm(way)
        self.run(
            self.winding_jaws_to(start, 0.2), self.post_to(TIP_M - np.array([0.03, 0.0, 0.0]), 0.2)
        )
        self.run(self.winder.wait(0.5), self.post.wait(0.5))
        tip = self.world.true_state("PSM1").world
        along = tip[:3, 3] + self.winder.reach * tip[:3, 2] - self.base
        along /= np.linalg.norm(along)
        side = np.cross(along, UP)
        side /= np.linalg.norm(side)
        laid = np.column_stack([along, np.cross(side, along), side])
        placed = self.world.objects["long"]
        prop = next(p for p in self.scene.rig.objects if p.name == "long")
        turn = quaternion_numbers(prop.pose[:3, :3].T @ laid)
        closed_at, model, data = self.world.time + 0.2, self.world.mj_model, self.world.mj_data
        names = [model.joint(k).name for k in range(model.njnt)]
        bends = [k for k, name in enumerate(names) if name.startswith("long/") and name[-1] in "yz"]
        for action in together(self.task, PSM1=self.winder.close(), PSM2=self.post.wait(0.3)):
            for row in self.task.controller.setpoints(action):
                self.task.controller.drive(row)
                for _ in range(EVERY):
                    if self.world.time < closed_at:
                        placed.set_jp(turn)
                        data.qpos[model.jnt_qposadr[bends]] = 0.0
                        data.qvel[model.jnt_dofadr[bends]] = 0.0
                    self.world.step(1)
        self.run(self.winder.wait(0.02), self.post_to(TIP_M, 0.1))

    def wind(self) -> None:
        """Wind the long thread once about the instrument, taut, and bring it to its side."""
        for first, last in pairwise(ANGLES):
            slow = 200 <= first < 245
            self.run(self._winding(first, last, 30.0 if slow else 60.0), self.post.wait(0.02))
        self.run(self._follow([-0.6, -0.75, 0.1], 1.5), self.post.wait(0.02))

    def take(self) -> None:
        """Take the short thread, from above at 45 degrees, and lift it."""
        c = math.sqrt(0.5)
        steep = np.column_stack([[c, 0.0, c], [0.0, -1.0, 0.0], [c, 0.0, -c]])
        back, reach = [-0.8, -0.6, 0.0], self.post.reach
        self.post.jaw = 0.5
        for deeper, above, time in ((0.0, 0.012, 1.4), (0.001, 0.0, 0.8)):
            points = self.short.points()
            point = points[np.argmin(np.abs(points[:, 0] - TAKEN_M))]
            at = point - (reach + deeper) * steep[:, 2] + above * UP
            self.run(self._follow(back, time), self.post.go(transform(steep, at), 0.04))
        self.run(self._follow(back, 0.5), self.post.close())
        self.run(self.winder.wait(0.02), self.post.shift(0.006 * UP, 0.03))

    def draw_back(self) -> None:
        """Draw the instrument back through the turn, and measure the linking number."""
        back = [-0.8, -0.6, 0.0]
        here = self.task.controller.target("PSM2")[:3, 3]
        self.run(
            self._follow(back, 1.2), self.post_to(here + np.array([-0.03, 0.0, 0.01]), 0.04), True
        )
        self.run(
            self._follow(back, 1.4), self.post.shift(np.array([-0.02, 0.0, 0.004]), 0.03), True
        )
        self.run(
            self.winding_jaws_to(np.array([-0.03, -0.045, 0.08]), 0.04), self.post.wait(0.02), True
        )
        self.run(
            self.winding_jaws_to(np.array([-0.01, -0.035, 0.08]), 0.04), self.post.wait(0.02), True
        )
        self.run(self.winder.wait(0.02), self.post.shift(np.array([-0.032, 0.0, 0.0]), 0.02), True)

    def tighten(self) -> float:
        """Pull the long thread aside until both ends are taut; return the lower tension [N]."""
        way = PULL_M * np.array([0.962, 0.192, -0.192])
        pull = 0.0
        for _ in range(PULLS):
            self.run(self.winder.shift(way, 0.03), self.post.wait(0.02))
            self.run(self.winder.wait(0.1), self.post.wait(0.1))
            ends = self.long.tension()[18:25], self.short.tension()[6:10]
            pull = min(float(np.median(end)) for end in ends)
            if pull >= TIGHT_N:
                break
        return pull

    def winding_jaws_to(self, point: Array, speed: float) -> Motion:
        """Bring PSM1's pads to a point."""
        at = point - self.winder.reach * self.down[:, 2]
        yield from self.winder.go(transform(self.down, at), speed)

    def post_to(self, point: Array, speed: float) -> Motion:
        """Bring PSM2's tip to a point, level."""
        yield from self.post.go(transform(self.level, point), speed)

    def _winding(self, first: float, last: float, rate: float) -> Iterator[Array]:
        """Turn PSM1's pads about the instrument, at the radius that keeps the thread taut."""
        here, angle = self._pads(), first
        radius = math.hypot(here[1], here[2] - AXIS_M)
        while angle < last:
            angle = min(angle + rate * PERIOD_S, last)
            pull = self.long.tension()
            pull = max(float(np.median(pull[:6])), float(np.median(pull[18:25])))
            self.tension += 0.2 * (pull - self.tension)
            change = np.clip(1.5 * (TENSION_N - self.tension), -0.15, 0.05) * PERIOD_S
            radius = float(np.clip(radius + change, 0.014, 0.1))
            along, turn = float(np.interp(angle, ANGLES, PLACES)), math.radians(angle)
            edge = np.array([0.6 * self.base[0] + 0.4 * min(along, 0.03), 0.0, AXIS_M])
            while True:  # within the thread's length
                goal = np.array([along, -radius * math.cos(turn), AXIS_M + radius * math.sin(turn)])
                over = float(np.linalg.norm(goal - self.base))
                if turn > 1.75:
                    over = float(np.linalg.norm(edge - self.base) + np.linalg.norm(goal - edge))
                    over += 0.0045 * (turn - 1.0)
                if over < FREE_M - SPARE_M or radius < 0.014:
                    break
                radius *= 0.98
            yield self._towards(goal, 0.15)

    def _follow(self, direction: list[float], time: float) -> Iterator[Array]:
        """Keep the thread between the instrument and PSM1's pads nearly taut, to one side."""
        way = np.array(direction) / np.linalg.norm(direction)
        held = FREE_M / self.long.thread.link
        for _ in range(int(time / PERIOD_S)):
            points, near = self.long.points(), self._on_instrument()
            last = near[-1] if near else 20
            left = (held - last) * self.long.thread.link - FOLLOW_M
            yield self._towards(points[last] + left * way, 0.05)

    def _towards(self, goal: Array, fastest: float) -> Array:
        """Return PSM1's part of an action that moves its pads towards a point."""
        rate = (goal - self._pads()) / PERIOD_S
        rate *= min(1.0, fastest / max(float(np.linalg.norm(rate)), 1e-9))
        return np.concatenate([rate, np.zeros(3), [self.winder.jaw]])

    def run(self, winder: Motion, post: Motion, linked: bool = False) -> None:
        """Run motions of both arms side by side, without the scene's referee."""
        before = self.long.points()
        for action in together(self.task, PSM1=winder, PSM2=post):
            for row in self.task.controller.setpoints(action):
                self.task.controller.drive(row)
                self.world.step(EVERY)
                if linked:
                    points, path = self.long.points(), self._path()
                    number = linking(points, path)
                    self.links.append((self.world.time, number))
                    if self.lost is None and abs(number) < 0.5:
                        speed = np.linalg.norm(points - before, axis=1).max()
                        self.lost = self._nearest(before), float(speed / (EVERY * 1e-3))
                    before = points

    # ------------------------------------------------------------------ measures

    def turns(self) -> float:
        """Return the turns of the long thread about the shaft, up to PSM1's pads."""
        local = self._local(self.long.points()[: round(FREE_M / self.long.thread.link)])
        angles = np.unwrap(np.arctan2(local[:, 1], local[:, 0]))
        return float(abs(angles[-1] - angles[0]) / (2.0 * math.pi))

    def taken(self) -> bool:
        """Return whether the short thread is between PSM2's pads."""
        tip = self.world.true_state("PSM2").world
        pads = tip[:3, 3] + self.post.reach * tip[:3, 2]
        return bool(np.linalg.norm(self.short.points() - pads, axis=1).min() < 3e-3)

    def _pads(self) -> Array:
        target = self.task.controller.target("PSM1")
        return target[:3, 3] + self.winder.reach * target[:3, 2]

    def _wrist(self) -> tuple[Array, Array]:
        """Return PSM2's tip, (4, 4), and the end of its shaft, (3,), in the world."""
        tip = self.world.true_state("PSM2").world
        return tip, tip[:3, 3] - WRIST_M * tip[:3, 2]

    def _local(self, points: Array) -> Array:
        """Return points in a frame at the shaft's end, z along the shaft."""
        _, end = self._wrist()
        z = (end - self.port) / np.linalg.norm(end - self.port)
        x = np.cross([0.0, 1.0, 0.0], z)
        x /= np.linalg.norm(x)
        return (points - end) @ np.column_stack([x, np.cross(z, x), z])

    def _on_instrument(self) -> list[int]:
        """Return the points of the long thread that lie on the instrument."""
        local = self._local(self.long.points()[:25])
        return np.flatnonzero(np.hypot(local[:, 0], local[:, 1]) < NEAR_M).tolist()

    def _path(self) -> Array:
        """Return the way from the port along the instrument and the short thread to the wound."""
        tip, end = self._wrist()
        points = self.short.points()
        pads = tip[:3, 3] + self.post.reach * tip[:3, 2]
        last = int(np.argmin(np.linalg.norm(points - pads, axis=1)))
        corners = (self.port, end, tip[:3, 3], pads)
        parts = [
            one + (two - one) * np.linspace(0.0, 1.0, count)[:, None]
            for one, two, count in zip(corners, corners[1:], (60, 20, 20), strict=False)
        ]
        return np.concatenate([*parts, points[last::-1]])

    def _nearest(self, points: Array) -> float:
        """Return how far ahead of the tip a thread is next to the instrument's middle [m]."""
        tip, _ = self._wrist()
        fine = np.concatenate(
            [a + (b - a) * np.linspace(0.0, 1.0, 12)[:, None] for a, b in pairwise(points)]
        )
        local = (fine - tip[:3, 3]) @ tip[:3, :3]
        return float(local[np.argmin(np.hypot(local[:, 0], local[:, 1])), 2])
