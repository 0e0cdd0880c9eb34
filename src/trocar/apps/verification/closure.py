"""Whether the loops stay closed, on their branch, all over the joint range."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trocar.apps.trials import TICK_S, loop_health, paper_sine, periods_per_tick, whole_pitch
from trocar.apps.verification.figure import Figure, Part
from trocar.apps.verification.subject import Subject
from trocar.kinematics import forward
from trocar.kinematics.loops import (
    NEAR_FLAT_RAD,
    branch_determinants,
    flattenings,
    loops_are_parallelograms,
)
from trocar.simulation.health import arm_health

Array = NDArray[np.float64]

#: The kinematics closes loops to this. Source: `kinematics.loops.PARALLELOGRAM_TOLERANCE_M`. [m]
KINEMATIC_GAP_M = 1e-9
#: Largest gap in motion. Source: the project's own goal; some 0.04 um are measured. [m]
SIMULATED_GAP_M = 1e-7
#: Source: our own choice, what an instrument presses with. [N]
LOAD_N = 10.0
#: Types of arms whose tips may be loaded. Source: `simulation.tip_load`.
LOADED = ("PSM", "ECM")
STEPS = 201
#: How far past the joint's limits the loops are drawn. Source: our own choice. [rad]
BEYOND_RAD = 0.7


@dataclass(frozen=True, eq=False)
class Fold:
    """How a joint folds the loops.

    Attributes:
        joint: name of the joint
        lower, upper: its range [rad]
        positions: also beyond the range, where the loops can be followed there, (k,) [rad]
        loops: names of the closures
        determinants: of each loop, zero where it is flat, (k, n)
    """

    joint: str
    lower: float
    upper: float
    positions: Array
    loops: tuple[str, ...]
    determinants: Array


def closure(subject: Subject) -> Part:
    """Look at gaps and branches, in the kinematics and in motion over the whole pitch."""
    arm = subject.arm
    title = "Closure: the loops of the linkage"
    if not arm.mechanism.closures:
        note = (f"{arm.name}: has no closed loop",)
        return Part("closure", subject.name, title, (), subject.command("closure"), note)
    figures = [*_kinematic(subject)]
    notes = ["Each joint is moved through its whole range, or the pitch while all others swing."]
    if subject.simulated:
        figures += _simulated(subject, 0.0)
        figures += _simulated(subject, LOAD_N) if arm.type in LOADED else []
    else:
        notes.append(f"{arm.name}: no masses or gains are known, so nothing was simulated")
    command = subject.command("closure")
    return Part(
        "closure", subject.name, title, tuple(figures), command, tuple(notes), fold(subject)
    )


def fold(subject: Subject) -> Fold | None:
    """Follow the branch determinants along the joint that folds the loops; None: none does."""
    mechanism = subject.arm.mechanism
    found = flattenings(mechanism)
    if not found:
        return None
    index = mechanism.joint_index[found[0].joint]
    joint = mechanism.joints[index]
    beyond = BEYOND_RAD if loops_are_parallelograms(mechanism) else 0.0
    positions = np.linspace(joint.lower - beyond, joint.upper + beyond, STEPS, dtype=np.float64)
    q = np.tile(subject.rest(), (STEPS, 1))
    q[:, index] = positions
    return Fold(
        joint.name,
        joint.lower,
        joint.upper,
        positions,
        tuple(c.name for c in mechanism.closures),
        branch_determinants(mechanism, forward.coordinates(mechanism, q)),
    )


def _kinematic(subject: Subject) -> list[Figure]:
    """Move each joint alone through its range, in the kinematics."""
    mechanism = subject.arm.mechanism
    share = np.linspace(0.0, 1.0, STEPS)
    q = np.tile(subject.rest(), (len(mechanism.joints), STEPS, 1))
    for joint, table in enumerate(q):
        lower, upper = mechanism.lower[joint], mechanism.upper[joint]
        table[:, joint] = lower + share * (upper - lower)
    found = arm_health(subject.arm, forward.coordinates(mechanism, q.reshape(-1, q.shape[-1])))
    return [
        Figure(
            "kinematics: largest loop gap",
            found.loop_gap_m,
            "m",
            "nm",
            upper=KINEMATIC_GAP_M,
            source="limit: loops count as closed below it (docs/mechanism.md)",
        ),
        Figure(
            "joint range to the nearest flat loop",
            found.flattening_margin_rad,
            "rad",
            lower=NEAR_FLAT_RAD,
            source="limit: our own choice; nearer, a loop could change its branch",
        ),
        _flips("kinematics: branch flips", found.branch_ok),
    ]


def _simulated(subject: Subject, load: float) -> list[Figure]:
    """Drive the arm along the test sine, the pitch over its whole range, at 1 kHz."""
    world = subject.world(tip_load_n=load)
    sine = paper_sine(world.rig, 10.0, TICK_S)
    if "pitch" in subject.arm.mechanism.joint_index:
        sine = whole_pitch(sine, world)
    gap, _, branch = loop_health(world, sine, periods_per_tick(world))
    label = f"simulation, {load:g} N at the tip" if load else "simulation"
    return [
        Figure(
            f"{label}: largest loop gap",
            gap,
            "m",
            "um",
            upper=SIMULATED_GAP_M,
            source="limit: the project's own goal; every step of 10 s at 1 kHz is looked at",
        ),
        _flips(f"{label}: branch flips", branch),
    ]


def _flips(name: str, kept: bool) -> Figure:
    source = "sign of each loop's determinant (docs/mechanism.md, the wrong branch)"
    return Figure(name, float(not kept), "", upper=0.0, source=source)
