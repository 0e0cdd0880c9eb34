"""Errors at rest of an Si arm whose weight is not what its controller computes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions import load_rig
from trocar.descriptions.records import RigDescription
from trocar.geometry.rotations import rotation_x
from trocar.robot.verification.figures import Figure
from trocar.simulation import World

Array = NDArray[np.float64]
#: Source: arXiv 2603.12099, abstract; its gains, instrument and observer are not known.
PAPER = "paper (arXiv 2603.12099): steady-state errors -68 to -84 %, drift of the tip -83 %"
HOW = "root mean square at rest after moves to 12 poses at two mounting pitches, CAD masses"
#: Mounting pitches of a bench and of an Si cart. [deg]
MOUNTS = (0.0, -45.0)
#: Our own choice: poses in the middle of the workspace, where the PID's cap is enough without
#: compensation, the ratio of the limits that moves keep to, and the time at each pose.
#: [rad, rad, m], [s]
LOWER, UPPER, POSES = (-0.8, -0.3, 0.06), (0.8, 0.3, 0.2), 12
SPEED, SETTLE_S = 0.3, 2.0


def plant(mount: float, observed: bool) -> RigDescription:
    """Return a PSM Si with the CAD model's masses and the dVRK's controller.

    Args:
        mount: its mounting pitch [deg]
        observed: whether it has its disturbance observers
    """
    rig = load_rig("psm_si")
    (place,) = rig.arms
    (other,) = load_rig("psm_si", {"PSM1": "psm_si_cad"}).arms
    pose = place.pose.copy()
    pose[:3, :3] = rotation_x(np.radians(mount))
    control = place.arm.control["dvrk"]
    if not observed:
        control = replace(control, observer={}, disc_observer=())
    arm = replace(place.arm, bodies=other.arm.bodies, control={"dvrk": control})
    return replace(rig, arms=(replace(place, pose=pose, arm=arm),))


class Held(NamedTuple):
    """Root mean squares at rest, of yaw and pitch [rad], of insertion [m] and of the tip [m]."""

    yaw: float
    pitch: float
    insertion: float
    tip: float


def held(world: World, compensated: bool) -> Array:
    """Return squares of the errors at rest of poses that an arm moves to, (POSES, 4)."""
    world.reset()
    arm = world.arm("PSM1")
    world.set_state("PSM1", np.array([0.0, 0.0, 0.12, 0.0, 0.0, 0.0, 0.0]))
    arm.joints.set_trajectory_ratio(SPEED)
    arm.joints.use_gravity_compensation(compensated)
    rng = np.random.default_rng(0)
    found: list[Array] = []
    for _ in range(POSES):
        goal = np.concatenate([rng.uniform(LOWER, UPPER), np.zeros(3)])
        if not arm.move_jp(goal).wait(10.0):
            raise RuntimeError(f"{arm!r} did not arrive: {arm.runtime.control.rejections.last}")
        world.step(round(SETTLE_S / world.timestep))
        error = arm.joints.positions()[:3] - goal[:3]
        drift = arm.setpoint_cp().matrix[:3, 3] - arm.measured_cp().matrix[:3, 3]
        found.append(np.square([*error, float(np.linalg.norm(drift))]))
    return np.array(found)


def controller(watch: Callable[[str], None]) -> list[Figure]:
    """Measure errors at rest with compensation and observers on and off.

    Raises:
        RuntimeError: an arm does not arrive
    """
    found: dict[tuple[bool, bool], Held] = {}
    for observed in (False, True):
        for compensated in (False, True):
            watch(f"compensation {compensated}, observer {observed}")
            each = [held(World(plant(mount, observed)), compensated) for mount in MOUNTS]
            found[observed, compensated] = Held(*np.sqrt(np.concatenate(each).mean(axis=0)))
    figures: list[Figure] = []
    shown = ("mrad", "mrad", "mm", "mm")
    papers = (None, None, None, -83.0)
    for observed in (False, True):
        label = f"observer {'on' if observed else 'off'}"
        off, on = found[observed, False], found[observed, True]
        for name, unit, paper, before, after in zip(
            Held._fields, shown, papers, off, on, strict=True
        ):
            for said, value in (("off", before), ("on", after)):
                figures.append(
                    Figure(f"{name}, {label}, compensation {said}", 1e3 * value, unit, source=HOW)
                )
            change = 100.0 * (after / before - 1.0)
            figures.append(
                Figure(f"{name}, {label}, change", change, "%", paper=paper, source=PAPER)
            )
    return figures
