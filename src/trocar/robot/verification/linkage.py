"""The linkage: loops that stay closed on their branch, and distances of hinges (Table 6)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.axis_lines import Line, home_lines, line_distance
from trocar.descriptions.calibration_plan import axis_links, default_plan
from trocar.descriptions.paper import TABLE6, TABLE6_SPREAD_M
from trocar.fitting import HingeFit, fit_hinge
from trocar.geometry.se3 import inverse
from trocar.kinematics import forward
from trocar.kinematics.loops import (
    NEAR_FLAT_RAD,
    branch_determinants,
    flattenings,
    loops_are_parallelograms,
)
from trocar.kinematics.mechanism import Mechanism
from trocar.robot.verification.figures import Figure, ReportPart
from trocar.robot.verification.subject import MARKERS, Subject, SweepResult, exact
from trocar.simulation.health import arm_health
from trocar.simulation.trials import TICK_S, loop_health, paper_sine, periods_per_tick, whole_pitch

Array = NDArray[np.float64]

#: Tolerance of closed loops in the kinematics [m]. Source:
#: `kinematics.loops.PARALLELOGRAM_TOLERANCE_M`.
KINEMATIC_GAP_M = 1e-9
#: Largest gap in motion. Source: the project's own goal; some 0.04 um are measured. [m]
SIMULATED_GAP_M = 1e-7
#: Load of the tip [N]. Source: our own choice, a force that an instrument exerts.
LOAD_N = 10.0
#: Types of arms whose tips may be loaded. Source: `simulation.tip_load`.
LOADED = ("PSM", "ECM")
STEPS = 201
#: Margin past the joint's limits in the drawing of loops [rad]. Source: our own choice.
BEYOND_RAD = 0.7


@dataclass(frozen=True, eq=False)
class Fold:
    """Branch determinants of the loops along the joint that folds them.

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


def closure(subject: Subject) -> ReportPart:
    """Look at gaps and branches, in the kinematics and in motion over the whole pitch."""
    arm = subject.arm
    title = "Closure: the loops of the linkage"
    if not arm.mechanism.closures:
        note = (f"{arm.name}: has no closed loop",)
        return ReportPart("closure", subject.name, title, (), subject.command("closure"), note)
    figures = [*_kinematic(subject)]
    notes = ["Each joint is moved through its whole range, or the pitch while all others swing."]
    if subject.simulated:
        figures += _simulated(subject, 0.0)
        figures += _simulated(subject, LOAD_N) if arm.type in LOADED else []
    else:
        notes.append(f"{arm.name}: unknown masses or gains, nothing simulated")
    command = subject.command("closure")
    return ReportPart(
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
            shown="nm",
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
            shown="um",
            upper=SIMULATED_GAP_M,
            source="limit: the project's own goal; every step of 10 s at 1 kHz is looked at",
        ),
        _flips(f"{label}: branch flips", branch),
    ]


def _flips(name: str, kept: bool) -> Figure:
    source = "sign of each loop's determinant (docs/mechanism.md, the wrong branch)"
    return Figure(name, float(not kept), "", upper=0.0, source=source)


Array = NDArray[np.float64]

#: Largest difference of a distance in motion from that of the kinematics, play of the loops [m].
#: Source: a hundred times the largest loop gap.
SEEN_M = 1e-5


def axes(subject: Subject, motion: SweepResult | None) -> ReportPart:
    """Compare the distances of axes with Table 6.

    Args:
        subject: the arm
        motion: a sweep of its linkage; None: of the description alone
    """
    arm = subject.arm
    title, command = "Axis distances: Table 6 of the paper", subject.command("axes")
    plan = arm.calibration or default_plan(arm.mechanism)
    if not plan.distances:
        note = (f"{arm.name}: no link has two axes of a loop",)
        return ReportPart("axes", subject.name, title, (), command, note)
    paper = {} if subject.calibrated else TABLE6.get(arm.type, {})
    moved = () if motion is None else (motion, exact(subject, motion))
    hinges = [_hinges(arm.mechanism, plan.axes, each) for each in moved]
    lines = home_lines(arm.mechanism, plan.axes)
    datum = next(iter(lines.values())).point
    figures: list[Figure] = []
    for pair in plan.distances:
        label, names = "-".join(pair), (plan.axes[pair[0]], plan.axes[pair[1]])
        told = line_distance(lines[pair[0]], lines[pair[1]], datum)
        figures += _measured(subject, label)
        figures.append(_of_the_description(label, told, paper.get(label)))
        if hinges:
            seen, wanted = (_seen(arm.mechanism, names, found, datum) for found in hinges)
            figures.append(_in_motion(label, seen, wanted, paper.get(label)))
    return ReportPart("axes", subject.name, title, tuple(figures), command, _notes(subject, paper))


def _of_the_description(label: str, told: float, paper: float | None) -> Figure:
    limits: dict[str, float] = {}
    source = "ours: distance of the two hinges in the description"
    if paper is not None:
        limits = {"lower": paper - TABLE6_SPREAD_M, "upper": paper + TABLE6_SPREAD_M}
        source += "; closed-loop paper, Table 6; limit: the spread between its own tables"
    return Figure(
        f"{label}: description", told, "m", shown="mm", paper=paper, source=source, **limits
    )


def _measured(subject: Subject, label: str) -> list[Figure]:
    """State the distance that the tracks of a calibrated arm measured."""
    overlay = subject.arm.overlay
    found: dict[str, Any] = {}
    if overlay is not None:
        found = overlay.measured.get("axis_distances_m", {})
    value = found.get(label, {}).get("value")
    if overlay is None or not isinstance(value, float):
        return []
    sigma = found[label].get("sigma")
    known = f", sigma {1e3 * sigma:.2g} mm" if isinstance(sigma, float) else ""
    source = f"measured: {overlay.source.get('file', overlay.file)}{known}"
    return [Figure(f"{label}: measured", value, "m", shown="mm", source=source)]


def _in_motion(label: str, seen: float, wanted: float, paper: float | None) -> Figure:
    source = (
        "ours: both hinges found from the poses of the simulated links in motion, as from motion"
        " capture; limit: the same from the kinematics, to a hundred times a loop's gap"
    )
    return Figure(f"{label}: in motion", seen, "m", shown="mm", paper=paper, lower=wanted - SEEN_M,
                  upper=wanted + SEEN_M, source=source)  # fmt: skip


def _hinges(
    mechanism: Mechanism, labels: Mapping[str, str], motion: SweepResult
) -> dict[str, HingeFit]:
    """Find every axis from the motion of the two links that it joins."""
    at = motion.link_poses(mechanism)
    found: dict[str, HingeFit] = {}
    for name in labels.values():
        a, b = axis_links(mechanism, name)
        found[name] = fit_hinge(inverse(at[a] @ MARKERS) @ at[b] @ MARKERS)
    return found


def _seen(
    mechanism: Mechanism, pair: tuple[str, str], hinges: dict[str, HingeFit], datum: Array
) -> float:
    """Return the distance of two axes inside the link that carries both [m].

    It is taken in the plane across both through the datum, a point in the root at home (3,) [m].
    """
    links = [axis_links(mechanism, name) for name in pair]
    (link,) = set(links[0]) & set(links[1])
    on = [
        hinges[name].in_a if link == ends[0] else hinges[name].in_b
        for name, ends in zip(pair, links, strict=True)
    ]
    rest = np.clip(np.zeros(len(mechanism.joints)), mechanism.lower, mechanism.upper)
    marker = forward.pose(mechanism, rest, link, mechanism.frames[0].name) @ MARKERS
    through = (inverse(marker) @ np.append(datum, 1.0))[:3]
    one, two = (Line(axis.point, axis.direction) for axis in on)
    return line_distance(one, two, through)


def _notes(subject: Subject, paper: dict[str, float]) -> tuple[str, ...]:
    overlay = subject.arm.overlay
    if overlay is not None:
        note = "A calibrated arm: Table 6 is of another robot and not compared."
        skew = (
            "Axes that are not parallel are nearer at one end than at the other: all distances are"
            " taken in the plane across them through the origin of the first axis' frame."
        )
        return (note, skew) if overlay.closure == "general" else (note,)
    if not paper:
        return (f"Table 6 has no {subject.arm.type}; simulation and description are compared.",)
    return ("The paper's values are of its hardware, measured by motion capture.",)
