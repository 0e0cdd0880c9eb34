"""Distances and angles of the description, and the rejection of tracks that are far from them.

A robot differs from its description by millimetres. Centimetres mean that a body has another one's
name, that the description is of another arm, or that the arm did not start at joint positions 0.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from itertools import product

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions import ArmDescription
from trocar.descriptions.axis_lines import home_lines, line_angle
from trocar.descriptions.calibration_plan import Pair
from trocar.errors import FarFromNominalError
from trocar.robot.calibration.linkage import LoopedPart
from trocar.robot.calibration.rcm import RcmReport, centre_links, own_centre

Array = NDArray[np.float64]

#: An axis distance or a remote centre this far from the description is refused. Source: real arms
#: are off by up to 1.3 mm (axis distances) and 3.9 mm (remote centre), the closed-loop paper's
#: Tables 6 and 7; `trocar mocap --perturb` makes 3 mm, and the least sweep that is accepted, with
#: 0.1 mm and 0.05 deg of noise, a standard deviation of 1.3 mm. Of the wrong orders of the loops'
#: bodies (719 of a PSM or an ECM, 119 of an MTM) all that pass as hinges at all put some distance
#: off by 31 mm at least (measured; pitch_bottom and pitch_top: 3-6 is 34 mm less than 3-7). [m]
FAR_M = 0.010
#: Or this part of the longest distance, where that is less: crank and rocker of
#: examples/mechanisms/four_bar_gripper.toml, exchanged, are 6 mm off, the longest link has 46 mm.
FAR_PART = 0.1
#: An angle at the still start this far off is refused. Source: our own choice; 10 mm at the end of
#: a link of 100 mm, six times what `trocar mocap --perturb` makes. [rad]
FAR_RAD = 0.1
#: Smallest number of distances that show a scale. Source: our own choice.
LEAST_SCALED = 3
#: A common scale of all distances that is off by more is worth a warning. Source: the spread of
#: the paper's Table 6 over the distances of a PSM, 0.16 %, six times. [1]
SCALE = 0.01
#: Yaw and pitch at which the description's remote centre is found. Source: our own choice. [rad]
TURNS = (-0.5, 0.0, 0.5)


def nominal_betas(
    arm: ArmDescription, first: str, lines: Mapping[str, tuple[Pair, Pair]]
) -> dict[str, float]:
    """Return the angles at joint positions 0 that the description has, {name: [rad]}.

    Args:
        arm: whose
        first: the axis whose origin the plane passes in which angles are taken
        lines: {name: (pair, pair)}, as `axes.betas` has them
    """
    hinges = [first, *(hinge for pairs in lines.values() for pair in pairs for hinge in pair)]
    at = home_lines(arm.mechanism, {hinge: hinge for hinge in hinges})
    through = at[first].point
    return {
        name: line_angle((at[a], at[b]), (at[c], at[d]), through) - 0.5 * np.pi
        for name, ((a, b), (c, d)) in lines.items()
    }


def distance_bound(nominal: Iterable[float]) -> float:
    """Return the largest allowed difference of an axis distance from the description [m].

    Args:
        nominal: distances of the description [m]
    """
    return min(FAR_M, FAR_PART * max(nominal, default=0.0))


def check_axes(
    file: str,
    distances: Mapping[str, tuple[float, float]],
    angles: Mapping[str, tuple[float, float]],
    names: str,
) -> None:
    """Reject axes that are not where any robot of this kind has them.

    Args:
        file: the tracks
        distances: {label: measured, nominal [m]}
        angles: {name: measured, nominal [rad]}
        names: which bodies were taken for the links (`likely_labels`)

    Raises:
        FarFromNominalError: with every distance and angle that is too far off
    """
    bound = distance_bound(nominal for _, nominal in distances.values())
    far = _far(distances, bound)
    turned = _far(
        {k: (n + float(np.angle(np.exp(1j * (v - n)))), n) for k, (v, n) in angles.items()}, FAR_RAD
    )
    if not far and not turned:
        return
    parts: list[str] = []
    if far:
        listed = ", ".join(
            f"{k} {1e3 * v:.1f} mm (nominal {1e3 * n:.1f})" for k, (v, n) in far.items()
        )
        parts.append(f"axis distances {listed}; allowed: within {1e3 * bound:.3g} mm of nominal")
    if turned:
        listed = ", ".join(f"{k} {v:.3f} rad (nominal {n:.3f})" for k, (v, n) in turned.items())
        parts.append(f"angles at rest {listed}; allowed: within {FAR_RAD:g} rad of the nominal")
    cause = _scaled(distances, bound) or names
    if not far:
        cause = "The arm may not have stood at joint positions 0 at the start"
    raise FarFromNominalError(
        file, f"too far from the description: {'; '.join(parts)}", {**far, **turned}, cause
    )


def scale_of(distances: Mapping[str, tuple[float, float]]) -> float:
    """Return the factor that brings nominal distances nearest to the measured ones.

    Args:
        distances: {label: measured, nominal [m]}
    """
    measured, nominal = np.array(list(distances.values())).reshape(-1, 2).T
    return float(measured @ nominal / max(float(nominal @ nominal), 1e-300))


def _scaled(distances: Mapping[str, tuple[float, float]], bound: float) -> str:
    """Return the cause where one scale explains all distances, else ""."""
    scale = scale_of(distances)
    if len(distances) < LEAST_SCALED or scale <= 0.0:
        return ""
    if _far({k: (v / scale, n) for k, (v, n) in distances.items()}, bound):
        return ""
    return (
        f"All distances are {scale:.4g} times the nominal: check the unit of the positions and the"
        " scale of the tracking volume"
    )


def check_centre(
    file: str, seen: RcmReport, arm: ArmDescription, linkage: LoopedPart, names: str
) -> None:
    """Reject a remote centre that is not where any robot of this kind has it.

    Args:
        file: the tracks of its sweep
        seen: the remote centre
        arm: the description
        linkage: its loops
        names: which bodies were taken for the links (`likely_labels`)

    Raises:
        FarFromNominalError: with its distance from the first axis and its place
    """
    links = centre_links(arm)
    nominal = own_centre(arm.mechanism, links, np.array(list(product(TURNS, TURNS)))).position
    parts: list[str] = []
    off: dict[str, tuple[float, float]] = {}
    if seen.distance is not None:
        name = f"remote centre from axis {linkage.hinges[0].label}"
        off = _far({name: (seen.distance.value, float(np.linalg.norm(nominal[:2])))}, FAR_M)
        parts += [f"{k} {1e3 * v:.1f} mm (nominal {1e3 * n:.1f})" for k, (v, n) in off.items()]
    found, hinges = seen.table7, seen.hinges
    if found is not None and hinges.yaw is not None and hinges.pitch is not None:
        away = float(np.linalg.norm(found.position - nominal))
        if away > FAR_M:
            off["remote centre"] = (away, 0.0)
            at, drawn_at = (
                ", ".join(f"{x:.1f}" for x in np.round(1e3 * place, 1) + 0.0)
                for place in (found.position, nominal)
            )
            parts.append(
                f"remote centre at ({at}) mm in the frame of the first two joint axes (nominal"
                f" ({drawn_at}))"
            )
        # Where the two axes are nearly parallel that frame, and the place in it, are undetermined.
        angle = _angle(hinges.yaw.direction_b, hinges.pitch.direction_a)
        axes = {body: links.frame(body) for body in (links.yaw, links.pitch)}
        drawn = _angle(*(line.direction for line in home_lines(arm.mechanism, axes).values()))
        if abs(angle - drawn) > FAR_RAD:
            off["angle"] = (angle, drawn)
            parts.append(f"first two joint axes at {angle:.3f} rad (nominal {drawn:.3f})")
    if parts:
        raise FarFromNominalError(
            file,
            f"too far from the description: {', '.join(parts)}; allowed: within"
            f" {1e3 * FAR_M:.3g} mm and {FAR_RAD:g} rad of the nominal",
            off,
            names,
        )


def _far(found: Mapping[str, tuple[float, float]], bound: float) -> dict[str, tuple[float, float]]:
    """Return the values farther from their nominals than a bound."""
    return {k: (value, nominal) for k, (value, nominal) in found.items()
            if abs(value - nominal) > bound}  # fmt: skip


def _angle(one: Array, two: Array) -> float:
    """Return the angle of two lines along unit vectors, whichever way they point [rad]."""
    return float(np.arccos(min(abs(float(one @ two)), 1.0)))
