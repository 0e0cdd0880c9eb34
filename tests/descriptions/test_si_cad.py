"""The overlay psm_si_cad has the masses of the CAD model of an Si PSM, link by link."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from trocar import World
from trocar.descriptions import ArmDescription, load_arm, load_rig
from trocar.geometry.rotations import matrix_from_rpy
from trocar.geometry.se3 import inverse, transform
from trocar.kinematics.forward import poses

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


def cad_bodies(arm: ArmDescription) -> dict[str, tuple[float, Array, Array]]:
    """Return mass, centre and inertia of the upper links in the frames of psm_si."""
    own = poses(arm.mechanism, np.zeros(len(arm.joints)))
    base, turn = CAD_BASE
    T = transform(matrix_from_rpy(*turn), np.array(base))
    found: dict[str, tuple[float, Array, Array]] = {}
    for link in CAD:
        T = T @ transform(matrix_from_rpy(*link.rpy), np.array(link.xyz))
        T = T @ transform(matrix_from_rpy(0.0, link.axis * CAD_ZERO, 0.0), np.zeros(3))
        here = inverse(own[link.frame]) @ T
        xx, yy, zz, xy, xz, yz = link.inertia
        inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        R = here[:3, :3]
        found[link.frame] = link.mass, (here @ [*link.com, 1.0])[:3], R @ inertia @ R.T
    return found


def test_psm_si_cad_has_the_links_of_the_cad_model() -> None:
    arm = load_arm("psm_si", calibration="psm_si_cad")
    bodies = {body.frame: body for body in arm.bodies if body.part == arm.name}
    for frame, (mass, com, inertia) in cad_bodies(load_arm("psm_si")).items():
        assert bodies[frame].mass == mass
        np.testing.assert_allclose(bodies[frame].com, com, atol=1e-9)
        np.testing.assert_allclose(bodies[frame].inertia, inertia, atol=1e-9)


def test_friction_of_psm_si_cad_is_that_of_the_description() -> None:
    described, own = load_arm("psm_si"), load_arm("psm_si", calibration="psm_si_cad")
    for joint in ("yaw", "pitch", "insertion"):
        (train,) = (t for t in own.overlay.dynamics.drivetrains.values() if joint in t.along)  # type: ignore[union-attr]
        friction = described.friction["identified"][joint]
        assert train.terms == {"coulomb": (friction.coulomb,), "viscous": (friction.viscous,)}


def test_the_controller_of_psm_si_cad_computes_the_weight_of_its_own_coefficients() -> None:
    held: list[Array] = []
    for rig in (load_rig("psm_si"), load_rig("psm_si", {"PSM1": "psm_si_cad"})):
        world = World(rig)
        world.set_state("PSM1", np.array([0.3, 0.2, 0.12, 0.0, 0.0, 0.0, 0.0]))
        held.append(world.servos.holding[:3].copy())
    np.testing.assert_allclose(held[1], held[0], atol=1e-9)
    assert np.abs(held[0]).min() > 0.1
