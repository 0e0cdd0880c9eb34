"""Small configurations in the dVRK's format, and what they mean, computed from their rows alone.

Numbers: jhu-dvrk/sawIntuitiveResearchKit@b37c435, share/system (system-full-system-simulated,
system-patient-cart-Si-simulated), share/arm (suj-simulated, suj-si-simulated), share/kinematic,
share/tool (LARGE_NEEDLE_DRIVER).
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

TURN = [[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
HRSV = [[-1.0, 0.0, 0.0], [0.0, 0.866025404, 0.5], [0.0, 0.5, -0.866025404]]
QUARTER = {
    0: [[1, 0], [0, 1]],
    90: [[0, -1], [1, 0]],
    180: [[-1, 0], [0, -1]],
    270: [[0, 1], [-1, 0]],
}


def row(alpha: float, A: float, D: float, offset: float = 0.0, **more: Any) -> dict[str, Any]:
    kind = {"type": "revolute", "mode": "active", **more}
    return {"alpha": alpha, "A": A, "D": D, "theta": 0.0, "offset": offset, **kind}


def slide(alpha: float, A: float, D: float, offset: float = 0.0, **more: Any) -> dict[str, Any]:
    return row(alpha, A, D, offset, type="prismatic", **more)


def limits(lower: float, upper: float, effort: float, name: str) -> dict[str, Any]:
    return {"qmin": lower, "qmax": upper, "ftmax": effort, "name": name}


PSM = [
    row(1.5708, 0.0, 0.0, 1.5708, **limits(-1.588, 1.588, 3.316101, "yaw")),
    row(-1.5708, 0.0, 0.0, -1.5708, **limits(-0.925025, 0.925025, 3.316101, "pitch")),
    slide(1.5708, 0.0, 0.0, -0.4318, **limits(0.0, 0.24, 9.877926, "insertion")),
]
ECM = [
    row(1.5708, 0.0, 0.0, 1.5708, **limits(-1.5708, 1.5708, 26.93208, "yaw")),
    row(-1.5708, 0.0, 0.0, -1.5708, **limits(-0.76794, 1.1344, 26.93208, "pitch")),
    slide(1.5708, 0.0, 0.0, -0.3822, **limits(0.0, 0.255, 80.6589483, "insertion")),
    row(0.0, 0.0, 0.3829, 0.0, **limits(-1.552, 1.552, 0.87658808, "roll")),
]
PSM_SI = [
    row(1.5708, 0.0, 0.0, 1.5708, **limits(-2.964, 2.964, 17.0845, "yaw")),
    row(-1.5708, 0.0, 0.0, -1.5708, **limits(-1.265, 1.301, 17.0845, "pitch")),
    slide(1.5708, 0.0, 0.0, -0.4826, **limits(0.0, 0.29, 40.9063, "insertion")),
]
ECM_SI = [
    row(1.5708, 0.0, 0.0, 1.5708, **limits(-2.964, 2.964, 17.0845, "yaw")),
    row(-1.5708, 0.0, 0.0, -1.5708, **limits(-1.10, 1.04, 34.0845, "pitch")),
    slide(1.5708, 0.0, 0.0, -0.3822, **limits(0.001, 0.259, 70.9, "insertion")),
    row(0.0, 0.0, 0.3829, 0.0, **limits(-1.54, 1.54, 6.81923, "roll")),
]
#: The large needle driver's rows after a PSM's: 400006 and 420006.
WRIST = [row(-1.5708, 0.0, 0.0, -1.5708), row(-1.5708, 0.0091, 0.0, -1.5708)]
TOOL = {"Classic": [row(0.0, 0.0, 0.4162), *WRIST], "Si": [row(0.0, 0.0, 0.4670), *WRIST]}
TOOLTIP = [[0.0, -1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [-1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
#: Of an ECM with any endoscope. Source: SAW mtsIntuitiveResearchKitECM.cpp, set_endoscope_type.
SCOPE_TIP = [
    [0.0, 1.0, 0.0, 0.0],
    [-1.0, 0.0, 0.0, 0.0],
    [0.0, 0.0, 1.0, 0.0],
    [0.0, 0.0, 0.0, 1.0],
]


def place(x: float, y: float, z: float, turn: int) -> dict[str, Any]:
    (a, b), (c, d) = QUARTER[turn]
    return {"Translation": [x, y, z], "Rotation": [[a, b, 0.0], [c, d, 0.0], [0.0, 0.0, 1.0]]}


def setup(name: str, q: list[float], rows: Any, column: Any, origin: Any) -> dict[str, Any]:
    return {
        "name": name,
        "simulated_position": q,
        "DH": {"links": [{"convention": "modified", **r} for r in rows]},
        "world_origin_to_SUJ": column,
        "SUJ_tip_to_tool_origin": origin,
    }


def classic_suj(d2: float, a3: float, d4: float) -> list[dict[str, Any]]:
    return [
        slide(0.0, 0.0896, 0.0),
        row(0.0, 0.0, d2),
        row(0.0, a3, 0.1429),
        row(0.0, 0.4318, d4, 1.5708),
        row(1.5708, 0.0, 0.4089),
        row(-1.5708, 0.0, -0.1029, -1.5708),
    ]


SUJ_ECM = [
    slide(0.0, 0.0896, 0.0),
    row(0.0, 0.0, 0.4166),
    row(0.0, 0.4318, 0.1429),
    row(0.0, 0.4318, -0.3459, 1.5708),
    row(-0.7853, 0.0, 0.0, 1.5708),
    row(0.0, -0.0667, 0.0),
]
SUJ_PSM, SUJ_PSM3 = classic_suj(0.4166, 0.4318, -0.1302), classic_suj(0.3404, 0.5842, 0.2571)
SCOPE_ORIGIN = {"Translation": [0.6126, 0.0, 0.1016], "Rotation": TURN}
ARM_ORIGIN = {"Translation": [0.4864, 0.0, 0.1524], "Rotation": TURN}
Q_ECM = [0.6647, 0.5782, -1.2662, 3.7818, 0.0, 0.0]
Q_PSM1 = [0.0007, -0.5892, -0.859, -0.6241, -0.2479, -0.4422]
Q_PSM2 = [0.0628, 0.0913, 1.9073, -0.1297, 0.4351, 0.0353]
Q_PSM3 = [-0.0261, -1.5892, 1.3076, 0.6994, 0.1361, 0.3359]
CLASSIC = [
    setup("ECM", Q_ECM, SUJ_ECM, place(0.0, 0.0, 0.43, 90), SCOPE_ORIGIN),
    setup("PSM1", Q_PSM1, SUJ_PSM, place(-0.1016, -0.1016, 0.43, 180), ARM_ORIGIN),
    setup("PSM2", Q_PSM2, SUJ_PSM, place(0.1016, -0.1016, 0.43, 0), ARM_ORIGIN),
    setup("PSM3", Q_PSM3, SUJ_PSM3, place(0.0, 0.0, 0.1264, 90), ARM_ORIGIN),
]


def wedge(a: float, angle: float) -> list[dict[str, Any]]:
    first = {**row(1.5708, a, 0.0, mode="passive"), "theta": angle}
    return [first, row(-1.5708, 0.0, 0.0, mode="passive")]


SI_ORIGIN = {"Translation": [0.8343, 0.0, 0.0], "Rotation": TURN}
SI_PSM = [slide(0.0, 0.0, 0.1471), row(0.0, 0.0, 0.6654), row(0.0, 0.4572, 0.1397)]
SI_PSM += [row(0.0, 0.4572, -0.1301), *wedge(0.049, -0.7854)]
SI_ECM = [slide(0.0, 0.0, 0.1471), row(0.0, 0.0, 0.5861), row(0.0, 0.3302, 0.1397)]
SI_ECM += [row(0.0, 0.3302, 0.0549), *wedge(0.1352, -1.2217)]
SI_PSM3 = [slide(0.0, 0.0, 0.0455), row(0.0, 0.0, 0.5887), row(0.0, 0.3429, -0.2667)]
SI_PSM3 += [row(0.0, 0.4572, 0.1397), row(0.0, 0.4572, -0.1864), *wedge(0.0483, -0.2618)]
SI = [
    setup(name, q, rows, column, SI_ORIGIN)
    for name, q, rows, column in (
        ("ECM", [0.3079, 1.1432, -1.9844, 0.7906], SI_ECM, place(0.0, 0.1262, 0.0, 90)),
        ("PSM1", [0.2171, -0.2899, -1.2963, -1.0814], SI_PSM, place(-0.2019, -0.0757, 0.0, 180)),
        ("PSM2", [0.1943, 0.2522, 1.4631, 0.8696], SI_PSM, place(0.2019, -0.0757, 0.0, 0)),
        ("PSM3", [0.2807, 1.6767, 0.0488, 1.4719, 0.4373], SI_PSM3, place(0.0, -0.2776, 0.0, 270)),
    )
]


def master(name: str, x: float) -> dict[str, Any]:
    rows = [[*HRSV[0], x], [*HRSV[1], 0.4], [*HRSV[2], 0.475], [0.0, 0.0, 0.0, 1.0]]
    base = {"reference_frame": "HRSV", "transform": rows}
    return {
        "name": name,
        "type": "MTM",
        "arm_file": f"arm/{name}_KIN_SIMULATED.json",
        "base_frame": base,
    }


def held(name: str, kind: str, file: str) -> dict[str, Any]:
    base = {"component": "SUJ", "interface": name}
    return {"name": name, "type": kind, "arm_file": file, "base_frame": base}


def system(generation: str = "Classic") -> dict[str, Any]:
    """Return a system like system-full-system-simulated."""
    si = generation == "Si"
    driver = "PSM_Si_KIN_SIMULATED_LARGE_NEEDLE_DRIVER_420006" if si else (
        "PSM_KIN_SIMULATED_LARGE_NEEDLE_DRIVER_400006"
    )  # fmt: skip
    scope = "ECM_Si_KIN_SIMULATED_STRAIGHT" if si else "ECM_KIN_SIMULATED_STRAIGHT"
    pair = {"MTM": "MTMR", "PSM": "PSM1", "configure_parameter": {"start_gripper_threshold": 0.0}}
    return {
        "$id": "dvrk-system.schema.json",
        "$version": "1",
        "arms": [
            master("MTML", 0.18),
            master("MTMR", -0.18),
            {"name": "SUJ", "type": f"SUJ_{generation}", "arm_file": "arm/suj.json"},
            *(held(name, "PSM", f"arm/{driver}.json") for name in ("PSM1", "PSM2", "PSM3")),
            held("ECM", "ECM", f"arm/{scope}.json"),
        ],
        "consoles": [
            {
                "name": "console",
                "input_type": "SIMULATED",
                "teleop_PSMs": [pair, {"MTM": "MTML", "PSM": "PSM2"}],
                "teleop_ECMs": [{"MTML": "MTML", "MTMR": "MTMR", "ECM": "ECM"}],
            }
        ],
    }


def write(folder: Path, files: Mapping[str, Any]) -> Path:
    """Write JSON files, and return the system's."""
    for name, content in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(content if isinstance(content, str) else json.dumps(content, indent=1))
    return folder / "system-lab.json"


def lab(folder: Path, generation: str = "Classic", files: Mapping[str, Any] | None = None) -> Path:
    """Write a lab's folder: its system, setup joints, and kinematics; return the system's file."""
    psm, ecm = (PSM, ECM) if generation == "Classic" else (PSM_SI, ECM_SI)
    more = "" if generation == "Classic" else "_Si"
    return write(
        folder,
        {
            "system-lab.json": system(generation),
            "arm/suj.json": {"arms": CLASSIC if generation == "Classic" else SI},
            f"kinematic/PSM{more}.json": {"DH": {"convention": "modified", "joints": psm}},
            f"kinematic/ECM{more}.json": {"DH": {"convention": "modified", "links": ecm}},
            **(files or {}),
        },
    )


# ---------------------------------------------------------------------- what the files mean


def meant(value: float, literal: bool) -> float:
    """Return 1.5708 as 90 degrees and so on, or as it is printed."""
    for degrees in (15, 45, 70, 90):
        if not literal and abs(abs(value) - math.radians(degrees)) < 2e-4:
            return math.copysign(math.radians(degrees), value)
    return value


def chain(rows: list[dict[str, Any]], q: Any, literal: bool = False) -> np.ndarray:
    """Return the pose of the last row's frame, (4, 4): Rx(alpha) Tx(A) Rz(theta) Tz(D)."""
    T, values = np.eye(4), iter(q)
    for r in rows:
        moved = next(values, 0.0) if r["mode"] == "active" else 0.0
        turns = r["type"] == "revolute"
        theta = meant(r["theta"], literal) + (meant(r["offset"], literal) + moved if turns else 0.0)
        d = r["D"] + (0.0 if turns else r["offset"] + moved)
        alpha = meant(r["alpha"], literal)
        ca, sa, ct, st = math.cos(alpha), math.sin(alpha), math.cos(theta), math.sin(theta)
        T = T @ np.array(
            [
                [ct, -st, 0.0, r["A"]],
                [st * ca, ct * ca, -sa, -d * sa],
                [st * sa, ct * sa, ca, d * ca],
                [0.0, 0.0, 0.0, 1.0],
            ]
        )
    return T


def pose_of(place: Mapping[str, Any]) -> np.ndarray:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = place["Rotation"], place["Translation"]
    return T


def base(suj: dict[str, Any], q: Any, literal: bool = False) -> np.ndarray:
    """Return where the held arm's base stands on the cart, (4, 4)."""
    links = suj["DH"]["links"]
    tip = chain(links, q, literal)
    return pose_of(suj["world_origin_to_SUJ"]) @ tip @ pose_of(suj["SUJ_tip_to_tool_origin"])
