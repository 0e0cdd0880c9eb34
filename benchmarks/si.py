"""Errors at rest of an Si arm whose weight is not what its controller computes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions import load_rig
from trocar.descriptions.records import ArmDescription, Body, RigDescription
from trocar.geometry.rotations import matrix_from_rpy, rotation_x
from trocar.geometry.se3 import inverse, transform
from trocar.kinematics.forward import poses
from trocar.robot.verification.figures import Figure
from trocar.simulation import World

Array = NDArray[np.float64]
Six = tuple[float, float, float, float, float, float]
Three = tuple[float, float, float]


class CadLink(NamedTuple):
    """A link of dvrk_model's Si PSM, placed in the link before.

    Attributes:
        frame: of trocar's psm_si that moves like it
        xyz, rpy: of its joint [m, rad]
        axis: that the pitch turns it about, with its sign; none for 0
        mass, com: [kg, m]
        inertia: xx, yy, zz, xy, xz, yz [kg m^2]
    """

    frame: str
    xyz: Three
    rpy: Three
    axis: float
    mass: float
    com: Three
    inertia: Six


#: Source: jhu-dvrk/dvrk_model@70998aa urdf/Si/PSM_base.urdf.xacro, CAD.
CAD = (
    CadLink(
        "yaw", (0.158, 0.0, 0.0), (0.0, 0.0, 0.0), 0.0, 1.7571, (0.1461, 0.090363, -0.024957),
        (0.0049404, 0.019686, 0.020795, -0.0035267, 0.0045945, 0.00070407),
    ),
    CadLink(
        "pitch_1", (0.2987, 0.0, -0.071222), (0.0, -1.1345, -3.1416), -1.0, 4.017,
        (0.083895, -0.00073113, -0.028998),
        (0.012797, 0.026307, 0.025616, -0.0002464, 0.0011164, 8.5164e-05),
    ),
    CadLink(
        "pitch_2", (0.2032, 0.0, 0.0), (0.0, -0.90761, -3.1416), -1.0, 2.1982,
        (0.11824, 0.0, 0.12932), (0.0076428, 0.032839, 0.026585, 0.0, -0.0074855, 0.0),
    ),
    CadLink(
        "pitch_3", (0.35966, 0.0, 0.16013), (0.0, -0.063963, 0.0), 1.0, 0.75206,
        (0.041219, 0.0, 0.13651), (0.018546, 0.018573, 0.00039277, 0.0, 0.00048607, 0.0),
    ),
)  # fmt: skip
#: Its base in its remote centre's frame. [m, rad]
CAD_BASE = (0.0, -0.84316314, 0.0), (0.0, 0.0, np.pi / 2.0)
#: Its pitch where the dVRK's is 0: an erratum of its zero. [rad]
CAD_ZERO = np.radians(-9.335)
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


def cad_bodies(arm: ArmDescription) -> tuple[Body, ...]:
    """Return the bodies of a psm_si with masses and inertias of the CAD model's upper links."""
    own = poses(arm.mechanism, np.zeros(len(arm.joints)))
    base, turn = CAD_BASE
    T = transform(matrix_from_rpy(*turn), np.array(base))
    found: dict[str, Body] = {}
    bodies = {body.frame: body for body in arm.bodies if body.part == arm.name}
    for link in CAD:
        T = T @ transform(matrix_from_rpy(*link.rpy), np.array(link.xyz))
        T = T @ transform(matrix_from_rpy(0.0, link.axis * CAD_ZERO, 0.0), np.zeros(3))
        here = inverse(own[link.frame]) @ T
        xx, yy, zz, xy, xz, yz = link.inertia
        inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        R = here[:3, :3]
        found[link.frame] = replace(
            bodies[link.frame],
            mass=link.mass,
            com=(here @ [*link.com, 1.0])[:3],
            inertia=R @ inertia @ R.T,
        )
    return tuple(
        found[b.frame] if b.part == arm.name and b.frame in found else b for b in arm.bodies
    )


def plant(mount: float, observed: bool) -> RigDescription:
    """Return a PSM Si with the CAD model's masses and the dVRK's controller.

    Args:
        mount: its mounting pitch [deg]
        observed: whether it has its disturbance observers
    """
    rig = load_rig("psm_si")
    (place,) = rig.arms
    pose = place.pose.copy()
    pose[:3, :3] = rotation_x(np.radians(mount))
    control = place.arm.control["dvrk"]
    if not observed:
        control = replace(control, observer={})
    arm = replace(place.arm, bodies=cad_bodies(place.arm), control={"dvrk": control})
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
