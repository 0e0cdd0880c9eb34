"""Bounds of mass distributions: the hull of a body and the range of its mass."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError  # pyright: ignore[reportMissingTypeStubs]

from trocar.descriptions import ArmDescription
from trocar.descriptions.records import Body, Shape
from trocar.errors import InputError

Array = NDArray[np.float64]

#: Masses of CAD models, where the description has a placeholder or our own choice [kg]. Source:
#: WPI-AIM/dvrk_env@675a3fa: psm.urdf, pitch_back_link and pitch_end_link; mtm_right.sdf, the links
#: of the wrist.
_WRIST = {"wrist_platform": 0.4, "wrist_pitch": 0.2, "wrist_yaw": 0.2, "wrist_roll": 0.1}
CAD_MASSES = {
    "psm": {"pitch_back": 0.98494, "pitch_end": 2.091},
    "mtml": _WRIST,
    "mtmr": _WRIST,
}
#: Margin around the hull of the drawn solid of a body [m]. Source: our own choice: the
#: solids of the masters are drawn without motors and covers, and no CAD model is published; with
#: 0.01 m less the recording of an MTM is explained 1.5 % worse in joints 2 to 4.
HULL_MARGINS_M = {"mtml": 0.02, "mtmr": 0.02}
#: Margin around single bodies whose size no drawing gives: our own drawings of a PSM's carriage and
#: counterweight reach too little along the insertion, so that efforts of centrifugal forces were
#: found as friction. Source: cross-validation on a recording of a PSM (docs/dynamics.md): held-out
#: errors of the insertion are 16.9 % without, 16.3, 15.9, 15.8 and 15.6 % with 0.01, 0.02, 0.03 and
#: 0.05 m, and those of yaw and pitch rise by 0.3 % of the efforts up to 0.05 m.
BODY_MARGINS_M = {("psm", "insertion"): 0.03, ("psm", "counterweight"): 0.03}
#: Arms whose masses and centres of mass in the description are a set that was fitted to gravity: of
#: those, only sums mean something, and centres lie beside the links that they are called after. The
#: hull of such a body reaches its centre of mass, and contains a homogeneous box of its inertia.
#: Source: sawIntuitiveResearchKit@9e535e6 share/kinematic/PSM_Si_physical.json and
#: ECM_Si_physical.json.
FITTED_TO_GRAVITY = ("psm_si", "ecm_si")
#: Least half edge of that box [m]. Source: our own choice, half of a link's width.
FITTED_ROOM_M = 0.04
#: Bounds of a mass, as ratios of the CAD estimate. Source: the roadmap's acceptance criteria.
MASS_RATIOS = (0.3, 3.0)


@dataclass(frozen=True, eq=False)
class BodyBounds:
    """Bounds of a body's mass distribution.

    Attributes:
        cad_mass: estimate that the bounds are ratios of [kg]
        lower, upper: of its mass [kg]
        normals, offsets: half spaces of its hull, normals @ point <= offsets, (m, 3), (m,) [m]
        middle, half: of the box about the hull, (3,) each [m]
    """

    cad_mass: float
    lower: float
    upper: float
    normals: Array
    offsets: Array
    middle: Array
    half: Array

    def contains(self, point: Array, tolerance: float = 1e-9) -> bool:
        """Test whether a point, (3,) [m], lies in the hull."""
        return bool((self.normals @ point <= self.offsets + tolerance).all())


def body_bounds(
    arm: ArmDescription, frame: str, ratios: tuple[float, float] = MASS_RATIOS
) -> BodyBounds:
    """Return the bounds of the arm's own body on a frame.

    The mass is within the ratios of the description's mass and of that of the CAD model.

    Raises:
        InputError: no mass, no solid, or bounds that exclude each other
    """
    own = [b for b in arm.bodies if b.frame == frame and b.part == arm.name]
    mass = sum(b.mass for b in own)
    if not mass > 0.0:
        raise InputError(f"{arm.name}: {frame}: has no mass; allowed: a description with masses")
    cad = CAD_MASSES.get(arm.name, {}).get(frame, mass)
    lower, upper = ratios[0] * max(cad, mass), ratios[1] * min(cad, mass)
    if not 0.0 < lower < upper:
        raise InputError(
            f"{arm.name}: {frame}: mass bounds: got {ratios[0]:g} to {ratios[1]:g} times {mass:g}"
            f" kg (CAD: {cad:g} kg), {lower:.4g} to {upper:.4g} kg; allowed: LOWER below UPPER,"
            " both above 0"
        )
    corners = [_corners(shape) for body in own for shape in body.shapes]
    if arm.name in FITTED_TO_GRAVITY:
        cube = np.array(list(product((-1.0, 1.0), repeat=3)))
        corners += [body.com + np.maximum(FITTED_ROOM_M, _half_box(body)) * cube for body in own]
    points = np.concatenate(corners) if corners else np.empty(0)
    try:
        hull = ConvexHull(points)
    except (QhullError, ValueError) as problem:
        raise InputError(f"{arm.name}: {frame}: its shapes have no volume") from problem
    margin = BODY_MARGINS_M.get((arm.name, frame), HULL_MARGINS_M.get(arm.name, 0.0))
    planes = np.unique(hull.equations.round(9), axis=0)
    low, high = points.min(axis=0), points.max(axis=0)
    return BodyBounds(
        cad,
        lower,
        upper,
        planes[:, :3],
        margin - planes[:, 3],
        0.5 * (low + high),
        0.5 * (high - low) + margin,
    )


def all_bounds(
    arm: ArmDescription, frames: tuple[str, ...], ratios: tuple[float, float] = MASS_RATIOS
) -> Mapping[str, BodyBounds]:
    """Return the bounds of the arm's own bodies, {frame: bounds}."""
    return {frame: body_bounds(arm, frame, ratios) for frame in frames}


def _half_box(body: Body) -> Array:
    """Return half edges of a homogeneous box with a body's inertia along its axes, (3,) [m]."""
    second = 0.5 * np.trace(body.inertia) - np.diag(body.inertia)
    return np.sqrt(3.0 * np.maximum(second, 0.0) / body.mass)


def _corners(shape: Shape) -> Array:
    """Return points whose hull contains a shape, in the body's frame, (k, 3) [m]."""
    if shape.kind == "mesh":
        points = np.zeros((0, 3)) if shape.mesh is None else np.asarray(shape.mesh.vertices)
    else:
        box = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)
        radius, length = shape.size[0], shape.size[1]
        half = {
            "box": shape.size,
            "sphere": np.full(3, radius),
            "cylinder": np.array([radius, radius, length]),
            "capsule": np.array([radius, radius, length + radius]),
        }[shape.kind]
        points = box * half
    return points @ shape.pose[:3, :3].T + shape.pose[:3, 3]
