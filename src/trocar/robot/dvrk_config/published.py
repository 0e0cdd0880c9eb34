"""The dVRK's own configuration files by name, for systems that name them and do not have them.

Source of the numbers: jhu-dvrk/sawIntuitiveResearchKit@b37c435 share/arm; those of the Classic
setup joints stand in trocar's own arms.
"""

from __future__ import annotations

import math
import re
from pathlib import PurePosixPath
from typing import Any

import numpy as np

from trocar.geometry.rotations import rotation_z
from trocar.geometry.se3 import transform

ARM_FILES = re.compile(r"arm/(PSM|ECM|MTML|MTMR)(_Si)?_KIN_SIMULATED(?:_(.+))?\.json")
SETUP_FILES = {
    "suj-simulated.json": "SUJ_Classic",
    "suj-si-simulated.json": "SUJ_Si",
    "suj-fixed-simulated.json": "SUJ_Fixed",
}
#: Poses of arms on the Classic's setup joints. Source: share/arm/suj-simulated.json.
CLASSIC_ORIGIN = {
    "PSM": transform(np.round(rotation_z(-math.pi / 2.0), 15), np.array([0.4864, 0.0, 0.1524])),
    "ECM": transform(np.round(rotation_z(-math.pi / 2.0), 15), np.array([0.6126, 0.0, 0.1016])),
}


def own_arm_file(name: str) -> dict[str, str] | None:
    """Return the content of the dVRK's simulated arm of that name, or None without one."""
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
        found |= {"tool_detection": "FIXED", "tool": rest}
    return found


def own_arm(kinematic: str) -> str:
    """Return trocar's arm that has the dVRK's chain of that file name, "" for none.

    "mtm" stands for both masters, whose chains are the same; psm-large-needle-driver.json and
    ecm-straight.json are files of version 1.
    """
    stem = PurePosixPath(kinematic).stem.lower().replace("-", "_")
    if stem in ("psm", "ecm", "mtm", "mtml", "mtmr", "psm_si", "ecm_si"):
        return stem
    return stem[:3] if re.match(r"(psm|ecm)_(?!si)", stem) else ""


def _setup(
    name: str, q: list[float], place: tuple[float, ...], rows: list[tuple[float, float]],
    wedge: tuple[float, float],
) -> dict[str, Any]:  # fmt: skip
    """Return an entry of the Si's setup joints.

    Args:
        name: of the held arm
        q: simulated positions
        place: x, y of the column, and its angle [m, deg]
        rows: A, D of the joints; the first slides
        wedge: A [m] and angle [deg] of the fixed wedge that follows them
    """
    x, y, turn = place
    right = math.pi / 2.0
    links: list[dict[str, Any]] = [{"a": a, "d": d} for a, d in rows]
    links[0]["type"] = "prismatic"
    links.append({"a": wedge[0], "alpha": right, "theta": math.radians(wedge[1])})
    links.append({"alpha": -right})
    for link in links[-2:]:
        link["mode"] = "passive"
    return {
        "name": name,
        "simulated_position": q,
        "dh": {"convention": "modified", "links": links},
        "world_origin_to_suj": {
            "translation": [x, y, 0.0],
            "rotation": np.round(rotation_z(math.radians(turn)), 15).tolist(),
        },
        "suj_tip_to_tool_origin": {
            "translation": [0.8343, 0.0, 0.0],
            "rotation": np.round(rotation_z(-right), 15).tolist(),
        },
    }


def _mount(name: str, y: float, z: float) -> dict[str, Any]:
    at = np.eye(4)
    at[1:3, 3] = y, z
    return {"name": name, "measured_cp": at.tolist()}


_SI_PSM = [(0.0, 0.1471), (0.0, 0.6654), (0.4572, 0.1397), (0.4572, -0.1301)]
#: The dVRK's own setup joints as their files have them. Source: share/arm/suj-si-simulated.json
#: and share/arm/suj-fixed-simulated.json.
SETUPS: dict[str, list[dict[str, Any]]] = {
    "SUJ_Classic": [{"name": name} for name in ("PSM1", "PSM2", "PSM3", "ECM")],
    "SUJ_Si": [
        _setup(
            "PSM1",
            [0.21713328162535497, -0.28985294982172416, -1.296300785720703, -1.081429816020683],
            (-0.2019, -0.0757, 180.0), _SI_PSM, (0.0490, -45.0),
        ),
        _setup(
            "PSM2",
            [0.19430774368524248, 0.2521927675957645, 1.463079476018301, 0.8695928416300226],
            (0.2019, -0.0757, 0.0), _SI_PSM, (0.0490, -45.0),
        ),
        _setup(
            "PSM3",
            [0.2806527579034114, 1.6766721211508346, 0.048778656425950806, 1.471882438882154,
             0.43725492343646566],
            (0.0, -0.2776, -90.0),
            [(0.0, 0.0455), (0.0, 0.5887), (0.3429, -0.2667), (0.4572, 0.1397), (0.4572, -0.1864)],
            (0.0483, -15.0),
        ),
        _setup(
            "ECM",
            [0.3079020566881523, 1.1432499826443978, -1.9844024129709243, 0.790592362875],
            (0.0, 0.1262, 90.0),
            [(0.0, 0.1471), (0.0, 0.5861), (0.3302, 0.1397), (0.3302, 0.0549)], (0.1352, -70.0),
        ),
    ],
    "SUJ_Fixed": [
        _mount("ECM", 0.0, 0.0), _mount("PSM1", 1.0, 0.0), _mount("PSM2", 2.0, 0.0),
        _mount("PSM3", 0.0, 3.0),
    ],
}  # fmt: skip
