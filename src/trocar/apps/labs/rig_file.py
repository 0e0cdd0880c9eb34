"""The rig: which of a lab's arms stand where, what they are doing when it begins."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trocar.apps.labs import documents
from trocar.apps.labs.arm_files import Files, arm_entry
from trocar.apps.labs.records import Lab, LabArm, SetupArm
from trocar.apps.labs.setup_arms import setup_entry
from trocar.descriptions import load_arm
from trocar.descriptions.records import DISPLAY, REFERENCE_ARM
from trocar.errors import DescriptionError
from trocar.geometry.rotations import matrix_from_rotation_vector
from trocar.geometry.se3 import transform

Array = NDArray[np.float64]

#: The cart's reference above the floor [m]. Source: dvrk_env suj.sdf, as in full_cart.
CART = (0.0, 0.0, 0.167458)
#: Where arms stand that no file places: the first, and the step to the next [m]. Source: our own
#: choice, clear of the console and of a cart.
FREE, STEP = np.array([0.0, 0.0, 0.3]), np.array([0.5, 0.0, 0.0])
BESIDE_CONSOLE = np.array([0.0, -1.3, 0.0])
BESIDE_CART = np.array([-1.2, -0.8, 0.0])
#: What carries setup joints whose cart nobody has drawn.
COLUMN = {
    "name": "column",
    "source": "a stand-in: the cart that carries these setup joints is not published",
    "shape": [
        {"kind": "box", "center_m": z, "size_m": size, "round_m": 0.04, "material": look,
         "collide": False}
        for z, size, look in (
            ([0.0, -0.02, 0.05], [0.60, 0.70, 0.10], "casting"),
            ([0.0, -0.02, 0.95], [0.24, 0.20, 1.60], "cover"),
        )
    ],
}  # fmt: skip
#: How endoscopes are bent [deg]. Source: mtsIntuitiveResearchKitECM.cpp, 30 degrees.
BENT = {"STRAIGHT": 0.0, "NONE": 0.0, "UP": -30.0, "DOWN": 30.0}
#: How high the lowest arm of a frame of the lab's stands [m]. Source: our own choice.
LOW = 0.3


def rig_document(lab: Lab, tools: dict[str, str], files: Files) -> documents.Document:
    """Return the rig of a lab; writes the files of arms that differ from trocar's.

    Args:
        lab: the system
        tools: {PSM: instrument} that the user asked for
        files: takes the arms' files
    """
    console = any(arm.base.on == "frame" and arm.base.name == DISPLAY for arm in lab.arms)
    held = {arm.base.name: arm for arm in lab.arms if arm.base.on == "setup"}
    setup = [arm for arm in lab.setup if arm.fixed is None]
    entries, origins = _setup_entries(setup, files)
    frames = _frames_in_world(lab, bool(setup))
    standing: dict[str, str] = {}
    free = 0
    for arm in sorted(lab.arms, key=lambda a: a.type == "ECM" and a.base.name != "ECM"):
        entry: documents.Document = {"name": arm.name, **arm_entry(arm, _tool(arm, tools), files)}
        place, twin = _place(arm, lab, origins, standing)
        if twin:
            files.said.append(f"{arm.name}: left out: it would stand where {twin} stands")
            continue
        if place is None:
            T = transform(np.eye(3), _free_place(free, console, bool(setup)))
            place, free = {"place": _base_frame(arm), **documents.pose_entries(T)}, free + 1
            place["base_frame"] = {"name": f"{arm.name}_base"}
            place["source"] = "our own choice: the lab's file does not place it"
        elif arm.base.on == "frame" and arm.base.name != DISPLAY:
            pose = arm.base.pose if arm.base.pose is not None else np.eye(4)
            world = frames[arm.base.name]
            place = {"place": _base_frame(arm), **documents.pose_entries(world @ pose)}
            place["base_frame"] = {"name": arm.base.name, **documents.pose_entries(pose)}
            place["source"] = f"the lab's base_frame; where {arm.base.name} stands: our own choice"
        entries.append(entry | place)
    for name in [arm.name for arm in lab.setup if arm.name not in held and arm.fixed is None]:
        files.said.append(f"SUJ {name}: carries nothing, for the system has no such arm on it")
    if not entries:
        raise DescriptionError(lab.file, "arms", "has no arm that can be simulated")
    return _whole(lab, entries, files, console)


def _tool(arm: LabArm, tools: dict[str, str]) -> str:
    return tools.get(arm.name, arm.tool)


def _base_frame(arm: LabArm) -> str:
    return "base" if arm.type == "MTM" else "rcm"


def _setup_entries(
    setup: list[SetupArm], files: Files
) -> tuple[list[documents.Document], dict[str, bool]]:
    """Return the setup joints' entries, and which hold the remote centre instead of the base."""
    entries: list[documents.Document] = []
    origins: dict[str, bool] = {}
    for arm in setup:
        description, origins[arm.name] = setup_entry(arm, files)
        entries.append(
            {
                "name": f"SUJ_{arm.name}",
                "description": description,
                "on": "world",
                "xyz_m": list(CART),
                "source": _potentiometers(arm),
            }
        )
    return entries, origins


def _potentiometers(arm: SetupArm) -> str:
    """Return the calibration of the potentiometers, which a simulation keeps and does not need."""
    told = [f"{key} {values.tolist()}" for key, values in arm.potentiometers.items()]
    return "potentiometers: " + "; ".join(told) if told else ""


def _place(
    arm: LabArm, lab: Lab, origins: dict[str, bool], standing: dict[str, str]
) -> tuple[documents.Document | None, str]:
    """Return where an arm stands, None where nothing says it, and who stands there already."""
    base = arm.base
    if base.on == "nothing":
        return None, ""
    if base.on == "setup":
        suj = next(suj for suj in lab.setup if suj.name == base.name)
        if suj.fixed is not None:
            T = transform(np.eye(3), np.array(CART)) @ suj.fixed
            return {"place": "rcm", **documents.pose_entries(T), "source": "SUJ_Fixed"}, ""
        if not origins[base.name] and (arm.type == "ECM") != (base.name == "ECM"):
            return {"on": f"SUJ_{base.name}", "frame": "tip", "place": "rcm"}, ""
        entry: documents.Document = {"on": f"SUJ_{base.name}", "frame": "mount"}
        return (entry | {"place": "rcm"} if origins[base.name] else entry), ""
    pose = base.pose if base.pose is not None else np.eye(4)
    twin = standing.setdefault(f"{base.name} {np.round(pose, 6).tolist()}", arm.name)
    twin = "" if twin == arm.name else twin
    if base.name != DISPLAY:
        return {}, twin
    return {
        "on": DISPLAY,
        "place": _base_frame(arm),
        **documents.pose_entries(pose),
        "source": "the lab's base_frame",
    }, twin


def _free_place(count: int, console: bool, cart: bool) -> Array:
    beside = BESIDE_CONSOLE * (console and not cart) + BESIDE_CART * cart
    return FREE + beside + count * STEP * (-1.0 if cart else 1.0)


def _frames_in_world(lab: Lab, cart: bool) -> dict[str, Array]:
    """Return where the frames stand that arms are placed in and nobody places, {name: (4, 4)}.

    Turned the short way so that the arms' z axes point up on average; the lowest at LOW.
    """
    found: dict[str, Array] = {}
    for name in dict.fromkeys(arm.base.name for arm in lab.arms if arm.base.on == "frame"):
        poses = [
            arm.base.pose
            for arm in lab.arms
            if arm.base.on == "frame" and arm.base.name == name and arm.base.pose is not None
        ]
        up = np.sum([T[:3, 2] for T in poses], axis=0)
        turn = _turn_up(up)
        lowest = min(float((turn @ T[:3, 3])[2]) for T in poses)
        shift = np.array([0.0, 0.0, LOW - lowest]) + (BESIDE_CART * cart)
        found[name] = transform(turn, shift)
    return found


def _turn_up(up: Array) -> Array:
    """Return the shortest rotation that brings a direction to z, (3, 3)."""
    length = float(np.linalg.norm(up))
    if length < 1e-6:
        return np.eye(3)
    axis = np.cross(up / length, [0.0, 0.0, 1.0])
    sine, cosine = float(np.linalg.norm(axis)), float(up[2]) / length
    if sine < 1e-12:
        return np.eye(3) if cosine > 0.0 else np.diag([1.0, -1.0, -1.0])
    return matrix_from_rotation_vector(axis / sine * np.arctan2(sine, cosine))


def _whole(
    lab: Lab, entries: list[documents.Document], files: Files, console: bool
) -> documents.Document:
    cart = any(entry["name"].startswith("SUJ_") for entry in entries)
    classic = cart and all(arm.generation == "Classic" for arm in lab.setup)
    model = documents.own_rig("full_cart_mtm" if cart else "mtm")
    rig: documents.Document = {
        "schema": 1,
        "name": files.stem,
        "title": f"{Path(lab.file).name}, imported",
        "source": "trocar import-dvrk of " + Path(lab.file).name,
    }
    if cart and lab.reference_arm != REFERENCE_ARM:
        rig["reference_arm"] = lab.reference_arm
    if console:
        rig["display"] = model["display"]
    rig["arm"] = entries
    rig["pose"] = _poses(lab, entries, files, model)
    hides = () if console else ("console", "stereo_display")
    hides += () if classic else ("cart", "table")
    rig["prop"] = [prop for prop in model["prop"] if prop["name"] not in hides]
    placed = {entry["name"] for entry in entries}
    if cart and not classic:
        rig["prop"].append(COLUMN)
    if classic:
        rig["pose"].append(_test(model, placed))
        rig["test_sine"] = model["test_sine"]
    rig["camera"] = [_endoscope(arm, files) for arm in lab.arms if arm.type == "ECM"]
    rig["camera"] += [view for view in model.get("camera", []) if view["name"] == "room" and cart]
    rig["teleop"] = [
        _teleop(teleop.kind, teleop.masters, teleop.slave, dict(teleop.given), teleop.place)
        for teleop in lab.teleops
        if teleop.slave in placed
    ]
    for teleop in lab.teleops:
        lacking = [name for name in teleop.masters if name not in placed]
        if teleop.slave not in placed:
            files.said.append(f"{teleop.place}: left out, for {teleop.slave} was left out")
        elif lacking:
            files.said.append(f"{teleop.place}: {' and '.join(lacking)} can only be a real master")
    return {key: value for key, value in rig.items() if value != []}


def _endoscope(arm: LabArm, files: Files) -> documents.Document:
    """Return the camera at the end of an ECM: how it is bent, and how fine its pictures are."""
    bent = BENT[arm.endoscope.rpartition("_")[2] or "STRAIGHT"]
    if bent:
        files.said.append(
            f"{arm.name}: {arm.endoscope}: its pictures are bent by {abs(bent):g} degrees; the"
            " ECM's own measured_cp, and the PSMs' in it, are told as of a straight scope"
        )
    camera: documents.Document = {"name": "endoscope", "kind": "endoscope", "arm": arm.name}
    if arm.name != "ECM":
        camera["name"] = f"endoscope_{arm.name}"
    camera["preset"] = "dvrk_sd_640x480" if "_SD_" in arm.endoscope else "hd_1280x720"
    if bent:
        camera["angle_deg"] = bent
    return {**camera, "source": f"endoscope {arm.endoscope or 'not named'} of the lab's file"}


def _test(model: documents.Document, placed: set[str]) -> documents.Document:
    """Return the pose about which the arms of a cart can swing without touching."""
    pose = next(p for p in model["pose"] if p["name"] == "test")
    return {**pose, "q_rad_m": {k: q for k, q in pose["q_rad_m"].items() if k in placed}}


def _teleop(
    kind: str, masters: tuple[str, ...], slave: str, given: dict[str, Any], place: str
) -> documents.Document:
    who: documents.Document = {"kind": kind}
    who |= {"master": masters[0]} if kind == "psm" else {"masters": list(masters)}
    return {**who, "slave": slave, **given, "source": place}


def _poses(
    lab: Lab, entries: list[documents.Document], files: Files, model: documents.Document
) -> list[documents.Document]:
    """Return the poses "start" (of trocar's own rigs where it has the arms) and "home"."""
    known = next(pose for pose in model["pose"] if pose["name"] == "start")["q_rad_m"]
    standard = all(arm.generation == "Classic" for arm in lab.setup) and bool(lab.setup)
    setup = {f"SUJ_{arm.name}": arm.q for arm in lab.setup}
    start: dict[str, list[float]] = {}
    home: dict[str, list[float]] = {}
    for entry in entries:
        name, described = entry["name"], entry["description"]
        path = str(files.folder / described) if described.endswith(".toml") else described
        tool = entry.get("tool")
        if tool and str(tool).endswith(".toml"):
            tool = str(files.folder / str(tool))
        arm = (load_arm if path.endswith(".toml") else documents.known)(path, tool)
        lower, upper = arm.mechanism.lower, arm.mechanism.upper
        at_home = arm.poses.get("home", np.zeros(len(lower)))
        if name in setup:
            told = setup[name]
            at_home = np.array(known[name]) if told is None else told
        home[name] = np.clip(at_home, lower, upper).tolist()
        use = name in known and (standard or arm.type == "MTM") and name not in setup
        start[name] = np.clip(np.array(known[name]), lower, upper).tolist() if use else home[name]
        if arm.type == "MTM" and name not in known:
            twin = "MTML" if "mtml" in arm.name else "MTMR"
            start[name] = np.clip(np.array(known[twin]), lower, upper).tolist()
    source = "the file's simulated positions where it has them; the rest as trocar's own rigs"
    return [
        {"name": "start", "source": source, "q_rad_m": start},
        {"name": "home", "source": "each arm's homing position", "q_rad_m": home},
    ]
