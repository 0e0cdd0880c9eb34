"""The dVRK's own configuration files by name, for systems that name them and do not have them.

Source of the numbers: jhu-dvrk/sawIntuitiveResearchKit@b37c435 share/arm; those of the Classic
setup joints stand in trocar's own arms.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from pathlib import PurePosixPath

import numpy as np
from numpy.typing import NDArray

from trocar.apps.labs.records import Chain, Generation, Row
from trocar.geometry.rotations import rotation_z
from trocar.geometry.se3 import transform

Array = NDArray[np.float64]

ARM_FILES = re.compile(r"arm/(PSM|ECM|MTML|MTMR)(_Si)?_KIN_SIMULATED(?:_(.+))?\.json")
SETUP_FILES = {"arm/suj-simulated.json": "Classic", "arm/suj-si-simulated.json": "Si"}
#: File of a chain, in small letters and without hyphens -> the arm of trocar's that has it.
KINEMATICS = {name: name for name in ("psm", "ecm", "mtml", "mtmr", "psm_si", "ecm_si")}


@dataclass(frozen=True, eq=False)
class SetupNumbers:
    """What the dVRK publishes of an arm's setup joints."""

    chain: Chain
    column: Array
    tool_origin: Array
    q: Array


def own_arm_file(name: str) -> dict[str, str] | None:
    """Return what the dVRK's simulated arm of that name says, None where it is none of them."""
    match = ARM_FILES.fullmatch(name)
    if match is None:
        return None
    arm, si, rest = match.groups()
    generation = "Si" if si else "Classic"
    found = {"kinematic": f"kinematic/{arm}{si or ''}.json", "generation": generation}
    if arm == "ECM" and rest:
        found["endoscope"] = f"Classic_SD_{rest}"
    if rest == "MANUAL":
        found["tool_detection"] = "MANUAL"
    elif arm == "PSM" and rest:
        head, _, code = rest.rpartition("_")
        found |= {"tool_detection": "FIXED", "tool": f"{head}:{code}"}
    return found


def own_arm(kinematic: str) -> str:
    """Return the arm of trocar's that has the dVRK's chain of that file name, "" for none."""
    stem = PurePosixPath(kinematic).stem.lower().replace("-", "_")
    return KINEMATICS.get(stem, "")


def generation_of(kinematic: str) -> Generation:
    """Return the generation that a kinematic file's name says."""
    return "Si" if own_arm(kinematic).endswith("_si") else "Classic"


def _si(rows: list[tuple[float, float, bool]], tilt: tuple[float, float]) -> Chain:
    """Return the chain of an Si's setup joints.

    Args:
        rows: a, d of the joints, and whether each slides
        tilt: a [m] and angle [deg] of the fixed wedge that follows them
    """
    joints = [
        Row("", "prismatic" if slides else "revolute", True, a, 0.0, d, 0.0, None, None, None)
        for a, d, slides in rows
    ]
    a, turn = tilt
    right = math.pi / 2.0
    wedge = Row("", "revolute", False, a, right, 0.0, math.radians(turn), None, None, None)
    last = Row("", "revolute", False, 0.0, -right, 0.0, 0.0, None, None, None)
    return Chain("modified", (*joints, wedge, last))


def _turned(degrees: float, at: tuple[float, float, float]) -> Array:
    return transform(np.round(rotation_z(math.radians(degrees)), 15), np.array(at))


#: From the Classic's setup joints to the arm that they hold. Source: share/arm/suj-simulated.json.
CLASSIC_ORIGIN = {
    "PSM": _turned(-90.0, (0.4864, 0.0, 0.1524)),
    "ECM": _turned(-90.0, (0.6126, 0.0, 0.1016)),
}
#: From an Si's setup joints to the arm that they hold.
SI_ORIGIN = _turned(-90.0, (0.8343, 0.0, 0.0))
_SI_SHORT = [(0.0, 0.1471, True), (0.0, 0.6654, False), (0.4572, 0.1397, False)]
_SI_PSM = _si([*_SI_SHORT, (0.4572, -0.1301, False)], (0.0490, -45.0))
_SI_ECM = _si(
    [(0.0, 0.1471, True), (0.0, 0.5861, False), (0.3302, 0.1397, False), (0.3302, 0.0549, False)],
    (0.1352, -70.0),
)
_SI_PSM3 = _si(
    [
        *((0.0, 0.0455, True), (0.0, 0.5887, False), (0.3429, -0.2667, False)),
        *((0.4572, 0.1397, False), (0.4572, -0.1864, False)),
    ],
    (0.0483, -15.0),
)
#: Setup joints of the Si. Source: share/arm/suj-si-simulated.json.
SI = {
    "ECM": SetupNumbers(
        _SI_ECM,
        _turned(90.0, (0.0, 0.1262, 0.0)),
        SI_ORIGIN,
        np.array([0.3079020566881523, 1.1432499826443978, -1.9844024129709243, 0.790592362875]),
    ),
    "PSM1": SetupNumbers(
        _SI_PSM,
        _turned(180.0, (-0.2019, -0.0757, 0.0)),
        SI_ORIGIN,
        np.array(
            [0.21713328162535497, -0.28985294982172416, -1.296300785720703, -1.081429816020683]
        ),
    ),
    "PSM2": SetupNumbers(
        _SI_PSM,
        _turned(0.0, (0.2019, -0.0757, 0.0)),
        SI_ORIGIN,
        np.array([0.19430774368524248, 0.2521927675957645, 1.463079476018301, 0.8695928416300226]),
    ),
    "PSM3": SetupNumbers(
        _SI_PSM3,
        _turned(-90.0, (0.0, -0.2776, 0.0)),
        SI_ORIGIN,
        np.array(
            [
                *(0.2806527579034114, 1.6766721211508346, 0.048778656425950806),
                *(1.471882438882154, 0.43725492343646566),
            ]
        ),
    ),
}
