"""A lab's configuration as a rig: read, written whole or not at all, compared with its file."""

from __future__ import annotations

import math
import re
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions import RigDescription, load_arm, load_rig
from trocar.descriptions.catalogue import DATA
from trocar.descriptions.endoscopes import EndoscopeType
from trocar.descriptions.records import DISPLAY, REFERENCE_ARM
from trocar.descriptions.table import toml_text
from trocar.errors import DescriptionError, InputError, UnknownNameError
from trocar.geometry.rotations import matrix_from_rotation_vector, rotation_x
from trocar.geometry.se3 import transform
from trocar.inputs import is_file
from trocar.outputs import check_file, whole_folder
from trocar.robot.dvrk_config.agreement import Gap, agreement
from trocar.robot.dvrk_config.arms import Document, Files, arm_entry, known, pose_entries
from trocar.robot.dvrk_config.setup_joints import CART, setup_entry
from trocar.robot.dvrk_config.system import SAME_LEAN, Lab, LabArm, SetupArm, read_system

Array = NDArray[np.float64]

#: Position of the first arm without a place in a file, and the step to the next [m]. Source: our
#: own choice, clear of the console and of a cart.
FREE, STEP = np.array([0.0, 0.0, 0.3]), np.array([0.5, 0.0, 0.0])
BESIDE_CONSOLE = np.array([0.0, -1.3, 0.0])
BESIDE_CART = np.array([-1.2, -0.8, 0.0])
#: Stand-in for the cart of setup joints that are not trocar's own.
COLUMN = {
    "name": "column",
    "source": "a stand-in: trocar has no model of the cart that carries these setup joints",
    "shape": [
        {"kind": "box", "center_m": z, "size_m": size, "round_m": 0.04, "material": look,
         "collide": False}
        for z, size, look in (
            ([0.0, -0.02, 0.05], [0.60, 0.70, 0.10], "casting"),
            ([0.0, -0.02, 0.95], [0.24, 0.20, 1.60], "cover"),
        )
    ],
}  # fmt: skip
#: Rig of an Si whose cart, table and poses an imported one has.
SI_CART = "full_cart_mtm_si"
#: Height of the lowest arm in a frame of the lab [m]. Source: our own choice.
LOW = 0.3


@dataclass(frozen=True)
class RigImportOptions:
    """Options of an import.

    Attributes:
        share: folders where files are looked for, too
        tools: {PSM: instrument} in place of the file's
        literal: take angles as they are printed: 1.5708, 0.7853
        overwrite: replace existing files
    """

    share: tuple[Path, ...] = ()
    tools: tuple[tuple[str, str], ...] = ()
    literal: bool = False
    overwrite: bool = False


@dataclass(frozen=True, eq=False)
class ImportedRig:
    """An imported rig.

    Attributes:
        rig: as it loads from its file
        files: written files, the rig first
        notes: what was chosen, left out or not found
        warnings: what is probably a mistake in the files
        idle: entries that have no counterpart in a simulation, "FILE: KEY, ..."
        unknown: entries that no version of the dVRK has, "FILE: KEY"
        agreement: {kind of pose or limit: how far the rig is from the files}
    """

    rig: RigDescription
    files: tuple[str, ...]
    notes: tuple[str, ...]
    warnings: tuple[str, ...]
    idle: tuple[str, ...]
    unknown: tuple[str, ...]
    agreement: Mapping[str, Gap]


def import_dvrk(
    system: str | Path, target: str | Path, options: RigImportOptions | None = None
) -> ImportedRig:
    """Turn a dVRK system's configuration into a rig, with files of the arms that differ.

    Args:
        system: system-*.json
        target: RIG.toml
        options: see `RigImportOptions`

    Raises:
        DescriptionError: a file is broken, missing or contradicts itself: file, key, got, allowed
        InputError: a target that is there already, or cannot be written
    """
    chosen, path, file = options or RigImportOptions(), Path(system), Path(target).expanduser()
    _check_target(file, chosen.overwrite)
    if not is_file(path):
        raise InputError(f"{system}: no such file; allowed: a dVRK system-*.json or console-*.json")
    lab = read_system(path, chosen.share, chosen.literal, dict(chosen.tools))
    psms = [arm.name for arm in lab.arms if arm.type == "PSM"]
    for name, _ in chosen.tools:
        if name not in psms:
            raise UnknownNameError("PSM", name, psms, str(path))
    with whole_folder(file.parent, overwrite=True) as place:
        files = Files(place, re.sub(r"[^A-Za-z0-9_]+", "_", file.stem))
        try:
            document = rig_document(lab, dict(chosen.tools), files)
            (files.folder / file.name).write_text(toml_text(document), encoding="utf-8")
            gap = agreement(lab, load_rig(files.folder / file.name))
        except DescriptionError as problem:  # in the user's file, not in ours, which goes
            written = Path(problem.file)
            if written.parent != files.folder:
                raise
            source = files.sources.get(written.name) or lab.file
            raise DescriptionError(source, problem.key, problem.problem) from problem
        names = [file.name, *files.names]
        for name in names[1:]:
            _check_target(file.parent / name, chosen.overwrite)
    written = tuple(str(file.parent / name) for name in names)
    if files.stand_ins:
        names = ", ".join(dict.fromkeys(files.stand_ins))
        files.notes.append(
            f"{names}: trocar has no masses and shapes of these arms; placeholders without"
            " collision are used"
        )
    notes = tuple(dict.fromkeys((*lab.notes, *files.notes)))
    return ImportedRig(load_rig(file), written, notes, lab.warnings, lab.idle, lab.unknown, gap)


def _check_target(file: Path, overwrite: bool) -> None:
    if file.suffix != ".toml":
        raise InputError(f"{file}: allowed: a rig file with extension .toml")
    if file.parent.is_dir():
        check_file(file, overwrite)


def rig_document(lab: Lab, tools: dict[str, str], files: Files) -> Document:
    """Return the rig of a lab; writes the files of arms that differ from trocar's.

    Args:
        lab: the system
        tools: {PSM: instrument} of --tool
        files: takes the arms' files
    """
    console = any(arm.frame == DISPLAY for arm in lab.arms)
    setup = {suj.name: suj for suj in lab.setup}
    carried = {arm.carrier for arm in lab.arms}
    entries: list[Document] = []
    at_centre: dict[str, bool] = {}  # whether setup joints hold the remote centre, not the base
    for suj in lab.setup:
        if suj.fixed is not None:
            continue
        description, at_centre[suj.name] = setup_entry(suj, files)
        pots = [f"{key} {list(values)}" for key, values in suj.potentiometers.items()]
        entries.append(
            {
                "name": f"SUJ_{suj.name}",
                "description": description,
                "on": "world",
                "xyz_m": list(CART[suj.generation]),
                "source": "potentiometers: " + "; ".join(pots) if pots else "",
            }
        )
        if suj.name not in carried:
            nothing = "carries no arm of the system"
            files.notes.append(f"SUJ {suj.name}: {nothing}")
    cart = bool(entries)
    frames = _frames_in_world(lab, cart)
    standing: dict[str, str] = {}
    free = 0
    for arm in sorted(
        lab.arms, key=lambda a: a.type == "ECM" and "ECM" not in (a.carrier, a.frame)
    ):
        place: Document = {"place": "base" if arm.type == "MTM" else "rcm"}
        if arm.carrier:
            place = _on_setup_joints(arm, setup[arm.carrier], at_centre)
        elif arm.pose is not None:
            key = f"{arm.frame} {np.round(arm.pose, 6).tolist()}"
            twin = standing.setdefault(key, arm.name)
            if twin != arm.name:
                files.notes.append(f"{arm.name}: omitted: same pose as {twin}")
                continue
            if arm.frame == DISPLAY:
                place = {"on": DISPLAY, **place, **pose_entries(arm.pose)}
                place["source"] = "the lab's base_frame"
            else:
                place |= pose_entries(frames[arm.frame] @ arm.pose)
                place["base_frame"] = {"name": arm.frame, **pose_entries(arm.pose)}
                own = f"the lab's base_frame; where {arm.frame} stands: our own choice"
                place["source"] = own
                lean = _lean(frames[arm.frame] @ arm.pose)
                if arm.mounting_pitch is None and lean > SAME_LEAN:
                    files.notes.append(
                        f"{arm.name}: leans by {math.degrees(lean):.1f} degrees: {arm.frame} stands"
                        " such that arms without mounting_pitch are upright on average"
                    )
        else:
            beside = BESIDE_CONSOLE * (console and not cart) + BESIDE_CART * cart
            at = FREE + beside + free * STEP * (-1.0 if cart else 1.0)
            lean = np.eye(3) if arm.mounting_pitch is None else rotation_x(arm.mounting_pitch)
            place, free = {**place, **pose_entries(transform(lean, at))}, free + 1
            place["base_frame"] = {"name": f"{arm.name}_base"}
            place["source"] = "our own choice: the lab's file does not place it"
            if arm.mounting_pitch is not None:
                place["source"] += "; it leans by the file's mounting_pitch"
        description = arm_entry(arm, tools.get(arm.name, arm.tool), files)
        entries.append({"name": arm.name, **description, **place})
    return _whole(lab, entries, files, console)


def _on_setup_joints(arm: LabArm, suj: SetupArm, at_centre: dict[str, bool]) -> Document:
    """Place an arm on setup joints or a fixed mount."""
    if suj.fixed is not None:
        T = transform(np.eye(3), np.array(CART[suj.generation])) @ suj.fixed
        return {"place": "rcm", **pose_entries(T), "source": "SUJ_Fixed"}
    on = f"SUJ_{suj.name}"
    if at_centre[suj.name]:
        return {"on": on, "frame": "mount", "place": "rcm"}
    if (arm.type == "ECM") != (suj.name == "ECM"):
        return {"on": on, "frame": "tip", "place": "rcm"}
    return {"on": on, "frame": "mount"}


def _frames_in_world(lab: Lab, cart: bool) -> dict[str, Array]:
    """Place the frames of base_frame entries, for which no file has a pose, {name: (4, 4)}.

    Turned the short way so that up as the arms' mounting pitches have it (their z axes, where no
    file has one) points up on average; the lowest at LOW.
    """
    poses: dict[str, list[Array]] = {}
    ups: dict[str, list[Array]] = {}
    for arm in lab.arms:
        if arm.pose is not None:
            poses.setdefault(arm.frame, []).append(arm.pose)
            pitch = arm.mounting_pitch
            own = arm.pose[:3, 2] if pitch is None else arm.pose[:3, :3] @ rotation_x(pitch)[2]
            ups.setdefault(arm.frame, []).append(own)
    found: dict[str, Array] = {}
    for name, group in poses.items():
        turn = _turn_up(np.sum(ups[name], axis=0))
        lowest = min(float((turn @ T[:3, 3])[2]) for T in group)
        found[name] = transform(turn, np.array([0.0, 0.0, LOW - lowest]) + BESIDE_CART * cart)
    return found


def _lean(T_world_base: Array) -> float:
    """Return the angle between a base's z axis and the vertical [rad]."""
    return float(np.arccos(np.clip(T_world_base[2, 2], -1.0, 1.0)))


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


def _whole(lab: Lab, entries: list[Document], files: Files, console: bool) -> Document:
    cart = any(entry["name"].startswith("SUJ_") for entry in entries)
    generations = {arm.generation for arm in lab.setup}
    own = cart and len(generations) == 1
    own &= not any(name.startswith("SUJ_") for name in files.stand_ins)
    cart_rig = SI_CART if generations == {"Si"} else "full_cart_mtm"
    model = _model(cart_rig if cart else "mtm")
    rig: Document = {
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
    hides += () if own else ("cart", "table")
    rig["prop"] = [prop for prop in model["prop"] if prop["name"] not in hides]
    placed = {entry["name"] for entry in entries}
    if cart and not own:
        rig["prop"].append(COLUMN)
    if own:
        rig["pose"].append(_test(model, placed))
        rig["test_sine"] = model["test_sine"]
    rig["camera"] = [
        _endoscope(arm.name, arm.endoscope)
        for arm in lab.arms
        if arm.endoscope is not None and arm.name in placed
    ]
    rig["camera"] += [view for view in model.get("camera", []) if view["name"] == "room" and cart]
    rig["teleop"] = [
        _teleop(teleop.kind, teleop.masters, teleop.slave, dict(teleop.given), teleop.place)
        for teleop in lab.teleops
        if teleop.slave in placed
    ]
    for teleop in lab.teleops:
        lacking = [name for name in teleop.masters if name not in placed]
        if teleop.slave not in placed:
            files.notes.append(f"{teleop.place}: omitted, because {teleop.slave} is omitted")
        elif lacking:
            files.notes.append(f"{teleop.place}: {' and '.join(lacking)} must be real masters")
    return {key: value for key, value in rig.items() if value != []}


def _model(rig: str) -> Document:
    """Return the entries of a rig of trocar's."""
    return tomllib.loads((DATA / "rigs" / f"{rig}.toml").read_text(encoding="utf-8"))


def _endoscope(arm: str, scope: EndoscopeType) -> Document:
    """Return the camera at the tip of an ECM's endoscope."""
    camera: Document = {"name": "endoscope", "kind": "endoscope", "arm": arm}
    if arm != "ECM":
        camera["name"] = f"endoscope_{arm}"
    camera["preset"] = "dvrk_sd_640x480" if "_SD_" in scope.name else "hd_1280x720"
    if scope.bend:
        camera["angle_deg"] = round(float(np.degrees(scope.bend)), 9)
    return {**camera, "source": f"endoscope {scope.name} of the lab's file"}


def _test(model: Document, placed: set[str]) -> Document:
    """Return the pose about which the arms of a cart can swing without touching."""
    pose = next(p for p in model["pose"] if p["name"] == "test")
    return {**pose, "q_rad_m": {k: q for k, q in pose["q_rad_m"].items() if k in placed}}


def _teleop(
    kind: str, masters: tuple[str, ...], slave: str, given: dict[str, Any], place: str
) -> Document:
    who: Document = {"kind": kind}
    who |= {"master": masters[0]} if kind == "psm" else {"masters": list(masters)}
    return {**who, "slave": slave, **given, "source": place}


def _poses(lab: Lab, entries: list[Document], files: Files, model: Document) -> list[Document]:
    """Return the poses "start" and "home", of trocar's own rigs where it has the arms."""
    rows = {pose["name"]: pose["q_rad_m"] for pose in model["pose"]}
    starts, homes = dict(rows["start"]), dict(rows["home"])
    standard = bool(lab.setup)
    si = {arm.name for arm in lab.arms if arm.generation == "Si" and arm.type != "MTM"}
    if standard and si:  # tools drawn back: where a file's setup joints stand is the lab's
        apart = _model(SI_CART)["pose"]
        away = next(pose for pose in apart if pose["name"] == "apart")["q_rad_m"]
        drawn_back = {name: q for name, q in away.items() if name in si}
        starts |= drawn_back
        homes |= drawn_back
    setup = {f"SUJ_{arm.name}": arm.q for arm in lab.setup}
    start: dict[str, list[float]] = {}
    home: dict[str, list[float]] = {}
    for entry in entries:
        name, described = entry["name"], entry["description"]
        path = str(files.folder / described) if described.endswith(".toml") else described
        tool = entry.get("tool")
        if tool and str(tool).endswith(".toml"):
            tool = str(files.folder / str(tool))
        arm = (load_arm if path.endswith(".toml") else known)(path, tool)
        lower, upper = arm.mechanism.lower, arm.mechanism.upper
        at_home = arm.poses.get("home", np.zeros(len(lower)))
        if name in setup:
            known_q = np.array(starts[name])
            given = setup[name]
            if given is not None:
                at_home = given
            elif len(known_q) == len(lower):
                at_home = known_q
        elif standard and len(homes.get(name, ())) == len(lower):
            at_home = np.array(homes[name])  # at the dVRK's yaw of 0 arms would meet
        home[name] = np.clip(at_home, lower, upper).tolist()
        use = name in starts and (standard or arm.type == "MTM") and name not in setup
        start[name] = np.clip(np.array(starts[name]), lower, upper).tolist() if use else home[name]
        if arm.type == "MTM" and name not in starts:
            twin = "MTML" if "mtml" in arm.name else "MTMR"
            start[name] = np.clip(np.array(starts[twin]), lower, upper).tolist()
    source = "the file's simulated positions where it has them; the rest as trocar's own rigs"
    return [
        {"name": "start", "source": source, "q_rad_m": start},
        {
            "name": "home",
            "source": "the dVRK's homing positions, or where arms on a cart do not meet",
            "q_rad_m": home,
        },
    ]
