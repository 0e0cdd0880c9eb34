"""Table 6: how far the hinges of a link are apart, in the description and in motion."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from trocar.apps.verification.figure import Figure, Part
from trocar.apps.verification.motion import MARKERS, Sweep, exact
from trocar.apps.verification.paper import TABLE6, TABLE6_SPREAD_M
from trocar.apps.verification.subject import Subject
from trocar.descriptions.axis_lines import Line, home_lines, line_distance
from trocar.descriptions.calibration_plan import axis_links, default_plan
from trocar.fitting import HingeFit, fit_hinge
from trocar.geometry.se3 import inverse
from trocar.kinematics import forward
from trocar.kinematics.mechanism import Mechanism

Array = NDArray[np.float64]

#: How far a distance in motion may be from that of the kinematics: play of the loops.
#: Source: a hundred times the gap that is allowed to a loop. [m]
SEEN_M = 1e-5


def axes(subject: Subject, motion: Sweep | None) -> Part:
    """Compare the distances of axes with Table 6.

    Args:
        subject: the arm
        motion: a sweep of its linkage; None: of the description alone
    """
    arm = subject.arm
    title, command = "Axis distances: Table 6 of the paper", subject.command("axes")
    plan = arm.calibration or default_plan(arm.mechanism)
    if not plan.distances:
        note = (f"{arm.name}: no link carries two axes of a loop",)
        return Part("axes", subject.name, title, (), command, note)
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
    return Part("axes", subject.name, title, tuple(figures), command, _notes(subject, paper))


def _of_the_description(label: str, told: float, paper: float | None) -> Figure:
    limits = {}
    source = "ours: distance of the two hinges in the description"
    if paper is not None:
        limits = {"lower": paper - TABLE6_SPREAD_M, "upper": paper + TABLE6_SPREAD_M}
        source += "; closed-loop paper, Table 6; limit: the spread between its own tables"
    return Figure(f"{label}: description", told, "m", "mm", paper, source=source, **limits)


def _measured(subject: Subject, label: str) -> list[Figure]:
    """State what the tracks of a calibrated arm said of a distance."""
    overlay = subject.arm.overlay
    found = {} if overlay is None else overlay.measured.get("axis_distances_m", {})
    value = found.get(label, {}).get("value")
    if overlay is None or not isinstance(value, float):
        return []
    sigma = found[label].get("sigma")
    known = f", sigma {1e3 * sigma:.2g} mm" if isinstance(sigma, float) else ""
    source = f"measured: {overlay.source.get('file', overlay.file)}{known}"
    return [Figure(f"{label}: measured", value, "m", "mm", source=source)]


def _in_motion(label: str, seen: float, wanted: float, paper: float | None) -> Figure:
    source = (
        "ours: both hinges found from the poses of the simulated links in motion, as from motion"
        " capture; limit: the same from the kinematics, to a hundred times a loop's gap"
    )
    return Figure(f"{label}: in motion", seen, "m", "mm", paper, lower=wanted - SEEN_M,
                  upper=wanted + SEEN_M, source=source)  # fmt: skip


def _hinges(mechanism: Mechanism, labels: Mapping[str, str], motion: Sweep) -> dict[str, HingeFit]:
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
