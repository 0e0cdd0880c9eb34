"""A robot from published figures of its hardware: the closed-loop paper's Tables 6 and 7.

The paper prints eight axis distances of each robot, where its remote centre is and how far that
spreads, but no tracks. Of all geometries that have these figures, the one nearest the description
is taken: unequal sides, axes that lean, and a linkage that stands off the yaw axis.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares  # pyright: ignore[reportMissingTypeStubs, reportUnknownVariableType]

from trocar import __version__
from trocar.descriptions import ArmDescription
from trocar.descriptions.axis_lines import home_lines, line_distance
from trocar.descriptions.calibration_plan import default_plan
from trocar.descriptions.overlay import Overlay, overlay_between
from trocar.descriptions.paper import TABLE6, TABLE6_SPREAD_M, TABLE7, PaperRcm
from trocar.errors import InputError
from trocar.fitting.adjust import slopes
from trocar.kinematics.mechanism import Mechanism
from trocar.robot.calibration.axes import BaseAxis
from trocar.robot.calibration.linkage import freedoms, linkage, slots
from trocar.robot.calibration.rcm import OwnCentre, centre_links, own_centre
from trocar.robot.calibration.refine import may_tilt
from trocar.robot.calibration.robot import Robot, calibrated, displaced, remote_centre_of, with_pins

Array = NDArray[np.float64]

#: Yaw and pitch at which the remote centre is found: so many positions of each, to these angles on
#: either side. Source: our own choice, as the paper does not print its sweep. Of four that were
#: tried on the ECM (yaw and pitch 0.6 and 0.6, 0.4 and 0.4, 0.3 and 0.6, 0.3 and 0.8 rad) the two
#: with 0.3 rad of yaw miss the spread by 0.3 to 0.4 mm, the others by 2 mm or more. [rad]
POSITIONS, SWEEP_RAD = 5, {"yaw": 0.3, "pitch": 0.6}
#: Table 6 prints tenths of a millimetre. Source: half of the last digit. [m]
DISTANCE_M = 5e-5
#: Tolerance on place and spread of the remote centre. Source: our own choice; a tenth of
#: the figure that the twin has to keep. [m]
CENTRE_M = 1e-4
#: The fit ends when a step lowers the sum of squares by less, or after so many. Source: our own
#: choice, for a fit of half a minute. It is not at its minimum then: of a PSM swept by 0.6 rad, 50
#: steps more lowered the sum by a third.
CHANGE, MOST_STEPS = 0.03, 12
#: Errors of axes against the description where the figures leave them open: displaced as far as
#: the paper's own tables differ, and tilted so that a hinge of 0.1 m runs out by as much.
#: [m], [rad]
DISPLACED_M, TILTED_RAD = TABLE6_SPREAD_M, TABLE6_SPREAD_M / 0.1


@dataclass(frozen=True, eq=False)
class PaperTwin:
    """The robot that the paper measured, rebuilt.

    Attributes:
        hardware: remote centre, place and spread, as the paper prints them
        nominal, twin: the same of the description and of the twin, over the same sweep
        distances: {axes: (hardware, nominal, twin)} [m]
        overlay: what makes the twin of the description
    """

    hardware: PaperRcm
    nominal: OwnCentre
    twin: OwnCentre
    distances: dict[str, tuple[float, float, float]]
    overlay: Overlay

    def missed(self, found: OwnCentre) -> tuple[float, float]:
        """Return by how much a mechanism misses the hardware's place and spread [m]."""
        place = np.linalg.norm(found.position - self.hardware.position)
        spread = np.linalg.norm(found.rms_axes - self.hardware.rms)
        return float(place), float(spread)

    def as_dict(self) -> dict[str, Any]:
        """Return the comparison as one JSON document, in SI units."""
        columns = {
            "hardware": (self.hardware.position, self.hardware.rms),
            "nominal": (self.nominal.position.tolist(), self.nominal.rms_axes.tolist()),
            "calibrated": (self.twin.position.tolist(), self.twin.rms_axes.tolist()),
        }
        return {
            "arm": self.overlay.arm,
            "axis_distances_m": {
                label: dict(zip(columns, values, strict=True))
                for label, values in self.distances.items()
            },
            "rcm": {
                name: {"position_m": list(place), "rms_xyz_m": list(spread)}
                for name, (place, spread) in columns.items()
            },
        }


def paper_twin(arm: ArmDescription, watch: Callable[[str], None] = lambda _: None) -> PaperTwin:
    """Return the twin of the paper's own PSM or ECM.

    Args:
        arm: the nominal description
        watch: called with the name of each step

    Raises:
        InputError: an arm that the paper has not measured, or one that is calibrated already
    """
    loops = linkage(arm) if arm.type in TABLE7 and arm.mechanism.closures else None
    centre = None if loops is None else remote_centre_of(arm, loops)
    if loops is None or centre is None:
        raise InputError(
            f"{arm.name}: got a {arm.type}; allowed: the arms that the closed-loop paper measured,"
            " psm and ecm"
        )
    if arm.overlay is not None:
        raise InputError(
            f"{arm.name}: is already calibrated; allowed: the nominal description, without overlay"
        )
    links = centre_links(arm)
    basis, tilted = freedoms(loops, parallelogram=False), may_tilt(loops)
    drawn = Robot(loops, np.zeros((len(slots(loops)), 2)), {}, {loops.ground: np.eye(4)})
    own_axis = np.linalg.inv(loops.mechanism.frame(centre.turns).after)
    up = loops.frames[loops.bodies[loops.ground]][:3, :3].T @ loops.plane[:, 2]
    across = np.cross(up, own_axis[:3, 2])
    pairs, hardware = TABLE6[arm.type], TABLE7[arm.type]
    scale = np.repeat(
        [DISPLACED_M, TILTED_RAD, DISPLACED_M, TILTED_RAD],
        [basis.shape[1], 2 * len(tilted), 1, 1],
    )
    grid = np.linspace(-1.0, 1.0, POSITIONS)
    turns = np.stack(np.meshgrid(grid, grid, indexing="ij"), axis=-1).reshape(-1, 2)
    q = turns * list(SWEEP_RAD.values())

    def robot(x: Array) -> Mechanism:
        """Return the mechanism at displacements, tilts, and place and lean of the yaw axis."""
        direction = own_axis[:3, 2] + x[-1] * up
        axis = BaseAxis(
            own_axis[:3, 3] + x[-2] * across,
            direction / np.linalg.norm(direction),
            np.zeros((6, 6)),
        )
        moved = displaced(drawn, basis, tilted, x)
        return with_pins(calibrated(arm, moved, replace(centre, axis=axis)))

    def left(x: Array) -> Array:
        """Return the errors against the figures and the description, in standard deviations."""
        made = robot(x)
        found = own_centre(made, links, q)
        sides = axis_distances(arm, made)
        return np.concatenate([
            [(sides[label] - value) / DISTANCE_M for label, value in pairs.items()],
            (found.position - hardware[0].position) / CENTRE_M,
            (found.rms_axes - hardware[0].rms) / CENTRE_M,
            x / scale,
        ])  # fmt: skip

    def derivative(x: Array) -> Array:
        watch("geometry")
        return slopes(left, x)

    # At the description the spread is 0 and has no derivative: start beside it.
    solved = cast(
        Any,
        least_squares(
            left,
            0.1 * scale,
            jac=cast(Any, derivative),  # scipy takes a function; its stubs do not say so
            x_scale=scale,
            ftol=CHANGE,
            max_nfev=MOST_STEPS,
        ),
    )
    made = robot(np.asarray(solved.x))
    nominal, twin = (own_centre(one, links, q) for one in (arm.mechanism, made))
    described, sides = axis_distances(arm, arm.mechanism), axis_distances(arm, made)
    measured = {
        "axis_distances_m": {label: {"value": value} for label, value in pairs.items()},
        "rcm": {
            "sweep_rad": {joint: [-most, most] for joint, most in SWEEP_RAD.items()},
            "table7": {
                "position_m": list(hardware[0].position),
                "rms_xyz_m": list(hardware[0].rms),
            },
        },
    }
    overlay = replace(
        overlay_between(arm, replace(arm, mechanism=made)),
        measured=measured,
        source={
            "file": "closed-loop paper, Tables 6 and 7",
            "sha256": "",
            "version": f"trocar {__version__}",
        },
    )
    distances = {label: (value, described[label], sides[label]) for label, value in pairs.items()}
    return PaperTwin(hardware[0], nominal, twin, distances, overlay)


def axis_distances(arm: ArmDescription, mechanism: Mechanism) -> dict[str, float]:
    """Return the distances of axes that a calibration of an arm reports, {label: [m]}.

    Args:
        arm: whose plan says which
        mechanism: of the arm, calibrated or not
    """
    plan = arm.calibration or default_plan(arm.mechanism)
    lines = home_lines(mechanism, plan.axes)
    through = next(iter(lines.values())).point
    return {f"{a}-{b}": line_distance(lines[a], lines[b], through) for a, b in plan.distances}
