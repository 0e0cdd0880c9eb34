"""Bilateral teleoperation against walls: transparency, and energy that no delay may generate.

A modelled hand leads a simulated master to and fro; the instrument that follows meets an elastic
wall, whose force comes back to the hand. Everything between hand and wall is the simulation's.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from itertools import product
from multiprocessing import get_context
from pathlib import Path
from typing import cast

import numpy as np
from numpy.typing import NDArray

from trocar.live import Loop
from trocar.robot.verification.figures import Figure
from trocar.simulation import World
from trocar.simulation.parts import Attached, Part
from trocar.teleoperation import Teleoperation
from trocar.teleoperation.force_feedback import (
    ARCHITECTURES,
    Architecture,
    FeedbackSettings,
    ForceFeedback,
)
from trocar.teleoperation.masters import ArmMaster
from trocar.teleoperation.psm import PsmTeleoperation
from trocar.teleoperation.slave import view_in_world

Array = NDArray[np.float64]

RIG = Path(__file__).parents[1] / "examples" / "assistance" / "rig.toml"
WALLS = (100.0, 1_000.0, 10_000.0)
DELAYS = (0.0, 0.010, 0.050)
TICK_S = 0.001
#: Stiffness and damping of the hand at the handle. Source: Tsuji et al., Biological Cybernetics 72,
#: 1995: 100 to 400 N/m and 5 to 20 N s/m of the hand of an arm at rest. [N/m, N s/m]
HAND_N_M, HAND_NS_M = 300.0, 10.0
#: Way of the hand to both sides, and its rate. Source: our own choice. [m, Hz]
WAY_M, RATE_HZ = 0.03, 0.5
#: Beginning that is left out of the means. Source: our own choice: two periods of the hand. [s]
SETTLE_S = 4.0
#: Least force on the instrument that counts as contact. Source: our own choice. [N]
CONTACT_N = 0.05
#: Energy that may be generated. Source: none; what the observer cannot see, the turns of the handle
#: within a period of 1 ms, stays below it.
GENERATED_J = 1e-5


class Wall(Part):
    """An elastic half space that pushes an instrument's tip out along its normal, without friction.

    Args:
        arm: the instrument's
        stiffness: [N/m]
        point, normal: of its surface, in the world, (3,) [m], (3,)
    """

    before_every = 1

    def __init__(self, arm: str, stiffness: float, point: Array, normal: Array) -> None:
        self._arm, self._stiffness = arm, stiffness
        self._point, self._normal = point, normal
        self.force = np.zeros(3)

    def attach(self, physics: Attached) -> None:
        """Find the tip in the physics."""
        arm = physics.rig.arm(self._arm)
        index = physics.joints.arms[self._arm]
        self._body, at = index.carrier(arm, arm.arm.mechanism.tip)
        self._at, self._data, self._frames = at[:3, 3].copy(), physics.data, physics.true_frames

    def before_step(self) -> None:
        """Push the tip out of the wall."""
        now = self._frames.bodies()
        tip = now.xpos[self._body] + now.xmat[self._body].reshape(3, 3) @ self._at
        depth = max(0.0, float((self._point - tip) @ self._normal))
        self.force = self._stiffness * depth * self._normal
        middle = now.xpos[self._body] + now.xmat[self._body].reshape(3, 3) @ self._middle()
        applied = self._data.xfrc_applied[self._body]
        applied[:3], applied[3:] = self.force, np.cross(tip - middle, self.force)

    def _middle(self) -> Array:
        return cast(Array, self._data.model.body_ipos[self._body])


class HeldMaster(ArmMaster):
    """A master that the modelled hand holds: hand and feedback act together, from the same tick."""

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self.hand = np.zeros(3)

    def exert(self, world: World, wrench: Array) -> None:
        """Exert a wrench on the hand, and the hand's force on the handle."""
        R = self.read(world).T[:3, :3]
        super().exert(world, np.concatenate([R.T @ self.hand, np.zeros(3)]) + wrench)


@dataclass(frozen=True)
class Run:
    """A run of one hand against one wall.

    Attributes:
        lowest: least energy that the hand had given in total [J]
        ratio: force at the hand over the scaled force of the wall, median of the contact
        error: from the instrument to where the hand leads it without delay, RMS of the contact [m]
        dissipated: by the passivity controller, for each second [W]
        contact: share of the time in contact
    """

    lowest: float
    ratio: float
    error: float
    dissipated: float
    contact: float


def run(
    architecture: Architecture,
    stiffness: float,
    delay: float,
    seconds: float,
    *,
    scale: float = 0.5,
    passive: bool = True,
    settle: float = SETTLE_S,
) -> Run:
    """Lead the hand against a wall, and measure.

    Args:
        architecture: of the feedback
        stiffness: of the wall [N/m]
        delay: each way [s]
        seconds: how long
        scale: of forces
        passive: whether the passivity controller acts
        settle: beginning that is left out of the means [s]
    """
    world = World(RIG)
    loop, master = Loop(world, tick_s=TICK_S, speed="max"), HeldMaster("MTMR")
    engine = Teleoperation(loop, None, {"MTMR": master})
    engine.set_feedback(FeedbackSettings(architecture, scale, delay, passive=passive))
    engine.start()
    component = cast(PsmTeleoperation, engine.components["MTMR_PSM1"])
    feedback = cast(ForceFeedback, component.feedback)
    R_world_view = view_in_world(world)[:3, :3]
    down = np.array([0.0, 0.0, -1.0])
    surface = (world.reference_pose("PSM1") @ world.arm("PSM1").local.measured_cp().matrix)[:3, 3]
    wall = Wall("PSM1", stiffness, surface, -down)
    world.add("wall", wall)
    feedback.contact = lambda: wall.force
    component.set_align(False)
    component.lock_rotation(True)
    component.command("enable")
    start = master.read(world).T[:3, 3]
    along, before = R_world_view.T @ down, start
    energy = lowest = 0.0
    given, x_given = np.zeros(3), start
    rows: list[tuple[float, float, float]] = []
    for k in range(round(seconds / TICK_S)):
        time, x = k * TICK_S, master.read(world).T[:3, 3]
        # Measured here, and not taken from the observer that is judged.
        energy -= float(given @ (x - x_given))
        lowest, x_given = min(lowest, energy), x
        goal = start + WAY_M * np.sin(2.0 * np.pi * RATE_HZ * time) * along
        rate = WAY_M * 2.0 * np.pi * RATE_HZ * np.cos(2.0 * np.pi * RATE_HZ * time) * along
        master.hand = HAND_N_M * (goal - x) + HAND_NS_M * (rate - (x - before) / TICK_S)
        before = x
        loop.tick()
        given = feedback.force if component.following else np.zeros(3)
        if component.following and time > settle:
            tip = (world.reference_pose("PSM1") @ world.frames.measured("PSM1"))[:3, 3]
            led = surface + component.scale * R_world_view @ (x - start)
            felt = -float(given @ along)
            rows.append((float(np.linalg.norm(wall.force)), felt, float((tip - led) @ down)))
    table = np.array(rows)
    touching = table[:, 0] > CONTACT_N
    pushed, felt, gap = table[touching].T
    return Run(
        lowest,
        float(np.median(felt / (scale * pushed))),
        float(np.sqrt(np.mean(gap**2))),
        feedback.passivity.dissipated / seconds,
        float(touching.mean()),
    )


def bilateral(watch: Callable[[str], None], duration_s: float = 60.0) -> list[Figure]:
    """Measure both architectures against every wall with every delay.

    Args:
        watch: called with what is measured
        duration_s: of each run
    """
    cases = list(product(ARCHITECTURES, WALLS, DELAYS))
    found: list[Figure] = []
    with ProcessPoolExecutor(mp_context=get_context("spawn")) as pool:
        running = [
            pool.submit(run, cast(Architecture, kind), wall, delay, duration_s)
            for kind, wall, delay in cases
        ]
        for (kind, wall, delay), each in zip(cases, running, strict=True):
            label = f"{kind}, {wall:g} N/m, {1e3 * delay:g} ms"
            watch(f"bilateral: {label}")
            found += figures(label, each.result())
    return found


def figures(label: str, one: Run) -> list[Figure]:
    """Return the figures of a run; the energy may not fall below zero."""
    source = f"energy of the hand by its own positions; at least -{1e3 * GENERATED_J:g} mJ"
    return [
        Figure(
            f"{label}: lowest energy",
            one.lowest,
            "J",
            lower=-GENERATED_J,
            shown="mJ",
            source=source,
        ),
        Figure(f"{label}: force ratio", one.ratio, "", source="median over the contact"),
        Figure(
            f"{label}: position error", one.error, "m", shown="mm", source="RMS over the contact"
        ),
        Figure(f"{label}: dissipated", one.dissipated, "W", shown="mW", source="by the controller"),
    ]
