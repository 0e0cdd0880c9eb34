"""Figures of arms at rest: masters that float hands-off, servos that hold their set-points."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal

import numpy as np

from trocar.apps.benchmarks.figure import Figure
from trocar.apps.trials import TICK_S, loop_health, paper_sine
from trocar.simulation import World
from trocar.simulation.arm import Arm

FrictionModel = Literal["identified", "paper"]
FRICTIONS: tuple[FrictionModel, ...] = ("identified", "paper")
SEED = 9
POSES = 20
FLOAT_S = 10.0
#: Until friction has stopped a servo. Source: measured, an MTM rests after 0.5 s. [s]
SETTLE_S = 1.0
#: No move of an arm lasts longer; a whole turn of a slow joint takes 8 s. [s]
MOVE_S = 30.0


def hands_off() -> Iterator[Figure]:
    """Let both masters go (mode effort, no effort) from random poses: how far do their tips drift?

    Without collisions, for at random poses the two would reach through each other.
    """
    for friction in FRICTIONS:
        said = ", no dry friction" if friction == "paper" else ""
        drift = max(drifts("mtm", friction))
        yield Figure(f"mtm: hands-off drift of a tip in 10 s{said}", 1e3 * drift, "mm", 5.0)


def drifts(
    rig: str, friction: FrictionModel, poses: int = POSES, seconds: float = FLOAT_S
) -> list[float]:
    """Return how far the tip of each arm drifts hands-off from random poses [m]."""
    world = World(rig, friction=friction, collisions=False)
    rng = np.random.default_rng(SEED)
    found: list[float] = []
    for _ in range(poses):
        world.reset()
        for name, arm in world.arms.items():
            world.set_state(name, rng.uniform(arm.lower, arm.upper))
            arm.set_mode("effort")
            arm.servo_jf(np.zeros(len(arm.measured_js().position)))
        before = {name: arm.local_measured_cp().T[:3, 3] for name, arm in world.arms.items()}
        world.step(round(seconds / world.timestep))
        for name, arm in world.arms.items():
            found.append(float(np.linalg.norm(arm.local_measured_cp().T[:3, 3] - before[name])))
    return found


def at_set_points() -> Iterator[Figure]:
    """Move every kind of arm to random goals with the dVRK's gains: how near does it come to rest?

    The goals are inside the limits by a tenth of the range, so that no mechanical stop helps.
    """
    for rig in ("psm", "ecm", "mtm"):
        worst = rest_errors(rig)
        for kind, unit, limit in (("revolute", "mrad", 2.0), ("prismatic", "mm", 0.1)):
            found = [error for (_, moves), error in worst.items() if moves == kind]
            if found:
                label = f"{rig}: set-point against measured at rest, {unit}"
                yield Figure(label, 1e3 * max(found), unit, limit)


def rest_errors(rig: str, goals: int = POSES) -> dict[tuple[str, str], float]:
    """Return the largest error at rest of each joint, {(arm/joint, kind): rad or m}."""
    world = World(rig, collisions=False)
    rng = np.random.default_rng(SEED)
    found: dict[tuple[str, str], float] = {}
    for _ in range(goals):
        moves = [arm.move_jp(_goal(arm, rng)) for arm in world.arms.values()]
        for move in moves:
            move.wait(MOVE_S)
        world.step(round(SETTLE_S / world.timestep))
        for name, arm in world.arms.items():
            measured, told = arm.measured_js(), arm.setpoint_js()
            for k, joint in enumerate(measured.name):
                key = (f"{name}/{joint}", arm.description.joints[k].kind)
                off = abs(float(measured.position[k] - told.position[k]))
                found[key] = max(found.get(key, 0.0), off)
    return found


def _goal(arm: Arm, rng: np.random.Generator) -> np.ndarray:
    count = len(arm.measured_js().position)
    lower, upper = arm.lower[:count], arm.upper[:count]
    return rng.uniform(lower + 0.1 * (upper - lower), upper - 0.1 * (upper - lower))


def masters_loops() -> Iterator[Figure]:
    """Drive both masters along the whole test sine: how far do their parallelograms gape?"""
    world = World("mtm")
    sine = paper_sine(world.rig, 10.0, TICK_S)
    gap, _, branch = loop_health(world, sine, round(TICK_S / world.timestep))
    yield Figure("mtm: loop gap along the test sine", 1e6 * gap, "um", 0.1)
    yield Figure("mtm: branch flips", float(not branch), "", 0.0)
