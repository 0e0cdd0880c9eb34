"""Arms and instruments of a lab as trocar's: the built-in ones, or TOML files that differ."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from msgspec import structs
from numpy.typing import NDArray

from trocar.descriptions import ArmDescription, load_arm, names
from trocar.descriptions.catalogue import document
from trocar.descriptions.endoscopes import ENDOSCOPES, EndoscopeType
from trocar.descriptions.table import toml_text
from trocar.errors import DescriptionError
from trocar.geometry.rotations import rotation_z
from trocar.geometry.se3 import inverse, pose_difference, transform, transform_points
from trocar.kinematics.forward import pose, poses
from trocar.kinematics.mechanism import Mechanism
from trocar.robot.dvrk_config.files import DhRow, Gain
from trocar.robot.dvrk_config.system import (
    SAME_LENGTH,
    TOOL_TIP,
    WRIST,
    DhRows,
    Instrument,
    LabArm,
)

Array = NDArray[np.float64]
Document = dict[str, Any]

#: Relative tolerance of equal limits and gains: 1.5708 for 90 degrees makes 4e-6.
SAME = 1e-5


@lru_cache(maxsize=64)
def known(name: str, tool: str | None = None) -> ArmDescription:
    """Return one of trocar's arms, read once."""
    return load_arm(name, tool)


def without(row: Document, name: str) -> None:
    """Take a quantity out of a table, whatever unit its key carries."""
    for key in [k for k in row if k == name or k.startswith(f"{name}_")]:
        del row[key]


def set_limits(document: Document, rows: tuple[DhRow, ...], source: str) -> bool:
    """Give joints the limits of a file, and say whether any of them changed.

    Poses of the document move inside them. An effort of 0 means that the file has none.
    """
    changed = False
    for joint, row in zip(document["joint"], rows, strict=False):
        turns = row.type == "revolute"
        unit, force = ("rad", "nm") if turns else ("m", "n")
        limits = {
            f"lower_{unit}": row.qmin,
            f"upper_{unit}": row.qmax,
            f"effort_max_{force}": row.ftmax or None,
        }
        for key, value in limits.items():
            name = key.rpartition("_")[0]
            if value is None or abs(limit(joint, name) - value) <= SAME * max(1.0, abs(value)):
                continue
            without(joint, name)
            joint[key], joint["source"], changed = value, source, True
    if changed:
        lower, upper = (
            np.array([limit(joint, name) for joint in document["joint"]])
            for name in ("lower", "upper")
        )
        for pose in document.get("pose", []):
            pose["q_rad_m"] = np.clip(np.array(pose["q_rad_m"]), lower, upper).tolist()
    return changed


def limit(joint: Document, name: str) -> float:
    """Return a limit of a document's joint in SI, infinity where it has none."""
    for key, value in joint.items():
        head, _, unit = key.rpartition("_")
        if head == name:
            return float(value) * {"deg": math.pi / 180.0, "mm": 1e-3}.get(unit, 1.0)
    return math.inf


def set_gains(document: Document, gains: Mapping[str, Gain], source: str) -> bool:
    """Give joints the gains of a file, as far as the document has these joints."""
    control = document["control"]["dvrk"]
    pid, changed = control["pid"], False
    for joint, given in gains.items():
        if joint in pid and not np.allclose(pid[joint], given.pid, rtol=SAME, atol=0.0):
            pid[joint], changed = given.pid, True
    if changed:
        control["source"] = source
    return changed


def set_observers(document: Document, gains: Mapping[str, Gain], source: str) -> bool:
    """Give an arm's joints the disturbance observers and caps of a file, or none as it has them."""
    control = document["control"]["dvrk"]
    own = {joint: given for joint, given in gains.items() if joint in control["pid"]}
    discs = [given.observer or [0.0, 0.0] for joint, given in gains.items() if joint not in own]
    found: dict[str, Any] = {
        "observer": {joint: g.observer for joint, g in own.items() if g.observer},
        "disc_observer": discs if np.any(discs) else [],
        "pid_output_max": {joint: g.output_max for joint, g in own.items() if g.output_max},
    }
    changed = False
    for key, entries in found.items():
        if own and entries != control.get(key, type(entries)()):
            control[key], control["source"], changed = entries, source, True
    return changed


def set_row(frame: Document, row: DhRow, extra_turn: float = 0.0) -> None:
    """Give a frame a row's constants; angles that are whole degrees are written as such."""
    for name in ("a", "alpha", "d", "theta", "xyz", "rotation", "rpy"):
        without(frame, name)
    for name, value in (("a_m", row.a), ("d_m", row.d)):
        if value:
            frame[name] = value
    for name, value in (("alpha", row.alpha), ("theta", row.theta + extra_turn)):
        degrees = round(math.degrees(value))
        if abs(math.radians(degrees) - value) < 1e-12:
            frame |= {f"{name}_deg": float(degrees)} if degrees else {}
        else:
            frame[f"{name}_rad"] = value


def pose_entries(T: Array) -> Document:
    """Return xyz and rotation of a pose, each where it is not nothing."""
    found: Document = {}
    if T[:3, 3].any():
        found["xyz_m"] = (T[:3, 3] + 0.0).tolist()
    if not np.array_equal(T[:3, :3], np.eye(3)):
        found["rotation"] = (T[:3, :3] + 0.0).tolist()
    return found


#: Tolerance of equal chains [m, rad]: 1.5708 for 90 degrees makes 4e-6.
SAME_CHAIN = 3e-5
#: Rotation about the shaft of the last row of the dVRK's PSM from trocar's, at which the frames of
#: a tool begin (psm.toml) [rad].
ROW_TURN = -np.pi / 2.0
#: Rotation of the last row of the dVRK's instruments from trocar's wrist yaw. Source: the tools'
#: frame `tip`, which is this times TOOL_TIP.
YAW_TURN = np.diag([-1.0, -1.0, 1.0, 1.0])
#: Joints without a range move by this to both sides, so that they can be simulated. Source: our own
#: choice: 1 um at the end of a jaw. [rad]
HELD = 5e-5
#: Gains of an Si where no file has them. Source: share/pid/sawControllersPID-{PSM,ECM}-Si.json.
SI_GAINS = {
    "PSM": {"yaw": (600.0, 0.0, 30.0), "pitch": (600.0, 0.0, 30.0), "insertion": (6e3, 0.0, 200.0)},
    "ECM": {
        "yaw": (600.0, 0.0, 30.0),
        "pitch": (600.0, 0.0, 30.0),
        "insertion": (15e3, 0.0, 500.0),
        "roll": (100.0, 0.0, 3.0),
    },
}

Point = tuple[float, float, float]

#: Arms by their serial chains, whose rows another chain replaces.
SERIAL = {kind: Path(__file__).with_name(f"serial_{kind.lower()}.toml") for kind in ("PSM", "ECM")}

STAND_IN = "a stand-in: trocar has no masses and shapes of this arm; these are our own choice"
#: Bodies of a PSM or ECM at q = 0 in its remote centre's frame (z up, the base towards -y): frame,
#: ends and radius of each capsule, mass [m, kg].
STAND_IN_ARM: tuple[tuple[str, tuple[tuple[Point, Point, float], ...], float], ...] = (
    ("yaw", (((0.0, -0.60, 0.0), (0.0, -0.46, 0.0), 0.055),), 2.0),
    (
        "pitch",
        (
            ((0.0, -0.46, 0.02), (0.0, -0.43, 0.26), 0.035),
            ((0.0, -0.43, 0.26), (0.0, -0.08, 0.31), 0.028),
            ((0.0, -0.43, 0.18), (0.0, -0.08, 0.23), 0.018),
            ((0.0, -0.08, 0.16), (0.0, -0.08, 0.58), 0.024),
        ),
        2.0,
    ),
    ("insertion", (((0.0, -0.055, 0.36), (0.0, -0.02, 0.40), 0.028),), 0.3),
)
#: Shaft of an endoscope, from its end outward.
STAND_IN_SCOPE = ((0.0, 0.0, 0.005), (0.0, 0.0, 0.40), 0.006)
#: The endoscope that each of trocar's ECMs holds. Source: ecm.toml, ecm_si.toml.
OWN_ENDOSCOPES = {
    "ecm": ENDOSCOPES["Classic_SD_STRAIGHT"],
    "ecm_si": ENDOSCOPES["Si_HD_STRAIGHT"],
}
#: Radius of a shaft that reaches past the ECM's own [m]. Source: ecm.toml.
SCOPE_RADIUS = 0.005
#: Links of setup joints: mass, and radius of links and of the hubs about their axes [kg, m].
LINK_MASS, LINK_RADIUS, HUB_RADIUS = 4.0, 0.038, 0.055
#: Distance from the end of the last link, the arm's base, ahead to the remote centre [m].
BASE_AHEAD = 0.58


@dataclass
class Files:
    """The files that an import writes beside the rig.

    Attributes:
        folder: where they are built
        stem: what their names begin with
        names: those that were written
        sources: {name: the lab's file that its numbers are from}
        notes: remarks for the user
        stand_ins: arms whose masses and shapes are not known
    """

    folder: Path
    stem: str
    names: list[str] = field(default_factory=list[str])
    sources: dict[str, str] = field(default_factory=dict[str, str])
    notes: list[str] = field(default_factory=list[str])
    stand_ins: list[str] = field(default_factory=list[str])

    def write(self, name: str, document: Document, source: str = "") -> str:
        """Write a document, and return its name as a rig beside it calls it.

        Args:
            name: after the stem
            document: its content
            source: the lab's file that its numbers are from; "": the system's
        """
        file = f"{self.stem}_{name}.toml"
        self.sources[file] = source
        (self.folder / file).write_text(toml_text(document), encoding="utf-8")
        self.names.append(file)
        return file


def arm_entry(arm: LabArm, tool: str, files: Files) -> dict[str, Any]:
    """Return an arm's description, tool and mounting pitch as the controller has it.

    Writes the files that they name.

    Raises:
        DescriptionError: a chain that no arm of trocar's can have
    """
    own = _own_name(arm)
    found, changed = document("arms", own), False
    found.pop("erratum", None)  # of the source of trocar's arm
    base = known(own, "none" if arm.type == "PSM" else None)
    source = f"{Path(arm.file).name}, imported"
    rows = () if arm.chain is None else arm.chain.rows
    if arm.chain is not None and not _same_chain(arm.chain, base):
        found, base = _other_chain(arm, own, source)
        changed = True
        files.notes.append(
            f"{arm.name}: kinematic chain differs from {own}, simulated without closed loops"
        )
    changed |= set_limits(found, rows, source)
    if "body" not in found:
        _add_bodies(found, base, arm)
        changed = True
        files.stand_ins.append(arm.name)
    if arm.endoscope is not None and arm.endoscope != OWN_ENDOSCOPES[own]:
        _set_endoscope(found, arm.endoscope, source)
        changed = True
    changed |= set_gains(found, arm.gains, source)
    changed |= set_observers(found, arm.gains, source)
    discs = [g for j, g in arm.gains.items() if j not in found["control"]["dvrk"]["pid"]]
    if any(g.output_max for g in discs):
        files.notes.append(
            f"{arm.name}: pid_max_output of discs is not simulated: servos are those of joints"
        )
    entry: dict[str, Any] = {"description": own}
    if arm.mounting_pitch is not None and "gravity_link" in found:
        entry["mounting_pitch_rad"] = arm.mounting_pitch
    if changed:
        found["title"] = f"{found.get('title', own)}; as {arm.name} of the lab has it"
        entry["description"] = files.write(arm.name.lower(), found, arm.file)
    if arm.type == "PSM":
        entry["tool"] = _tool_entry(arm, tool or found["default_tool"], files)
    return entry


def _tool_entry(arm: LabArm, tool: str, files: Files) -> str:
    """Return the name of the instrument, or the file of one that differs from trocar's."""
    instrument, source = arm.instrument, arm.file
    found = None if instrument is None else tool_document(tool, instrument)
    if instrument is not None:
        source = instrument.file
    if found is not None and tool not in names("tools"):
        files.notes.append(f"{arm.name}: {tool}: uses the shape and masses of a needle driver")
    if instrument is None and not tool.endswith(".toml") and tool not in names("tools"):
        raise DescriptionError(
            arm.file,
            "tool",
            f"got {tool!r}, file tool/{tool.replace(':', '_')}.json not found; allowed:"
            f" {', '.join(names('tools'))} (--tool {arm.name}=TOOL sets one of these, or a"
            " TOML file)",
        )
    changed = found is not None
    found = found or document("tools", tool)
    changed |= set_gains(found, arm.gains, f"{Path(arm.file).name}, imported")
    if changed:
        return files.write(f"{arm.name.lower()}_tool", found, source)
    return str(Path(tool).resolve()) if tool.endswith(".toml") else tool


def _set_endoscope(found: Document, scope: EndoscopeType, source: str) -> None:
    """Give an ECM's document the tip, mass and length of an endoscope."""
    tip = next(frame for frame in found["frame"] if frame["name"] == "tip")
    without(tip, "xyz")
    bend = round(math.degrees(scope.bend), 9)
    tip |= {"rpy_deg": [bend, 0.0, -90.0], "source": f"{source}: endoscope {scope.name}"}
    body = next(body for body in found["body"] if body["frame"] == "roll")
    body |= {"mass_kg": scope.mass, "source": f"{body['source']}; mass: SAW's {scope.name}"}
    for link in found.get("gravity_link", []):
        if link["name"] == "insertion":
            link |= {"mass_kg": scope.mass, "source": f"{link['source']}; mass: {scope.name}"}
    if scope.reach:
        tip["xyz_m"] = [0.0, 0.0, scope.reach]
        end = _capsule(np.eye(4), (0.0, 0.0, 0.0), (0.0, 0.0, scope.reach), SCOPE_RADIUS)
        body["shape"].append({**end, "material": "steel"})


def _own_name(arm: LabArm) -> str:
    """Return the arm of trocar's that this one is, by its kind, generation and side."""
    if arm.type == "MTM":
        return "mtml" if "MTML" in arm.name.upper() or "mtml" in arm.file.lower() else "mtmr"
    return arm.type.lower() + ("_si" if arm.generation == "Si" else "")


def last_row(arm: ArmDescription, q: Array) -> Array:
    """Return the pose of what is the last row of an arm's own chain in the dVRK, (4, 4).

    Args:
        arm: trocar's, with or without an instrument
        q: of all of its joints, (n,) [rad or m]
    """
    if arm.type == "PSM":
        turn = transform(rotation_z(-ROW_TURN), np.zeros(3))
        return pose(arm.mechanism, q, "insertion") @ turn
    return pose(arm.mechanism, q, "roll" if arm.type == "ECM" else None)


def largest_gap(one: Array, other: Array) -> Array:
    """Compute the distance and the angle between two poses, (2,) [m, rad]."""
    return np.array([float(np.max(part)) for part in pose_difference(one, other)])


def _same_chain(chain: DhRows, own: ArmDescription) -> bool:
    if chain.moving != own.own_joints:
        return False
    lower, upper = own.mechanism.lower, own.mechanism.upper
    return all(
        largest_gap(chain.tip(q[: chain.moving]), last_row(own, q)).max() < SAME_CHAIN
        for q in np.random.default_rng(0).uniform(lower, upper, (8, len(lower)))
    )


def _other_chain(arm: LabArm, own: str, source: str) -> tuple[Document, ArmDescription]:
    """Return the document of a PSM or ECM with another chain, and trocar's serial one like it."""
    chain = arm.chain
    moving = ("yaw", "pitch", "insertion", "roll")[: 4 if arm.type == "ECM" else 3]
    kinds = ("revolute", "revolute", "prismatic", "revolute")[: len(moving)]
    got = () if chain is None else tuple(row.type for row in chain.rows)
    if arm.type == "MTM" or chain is None or chain.convention != "modified" or got != kinds:
        raise DescriptionError(
            arm.file,
            "kinematic",
            f"unsupported kinematic chain for {own} (got {', '.join(got)}); allowed: that of"
            f" {own}, or for a PSM or ECM one of {', '.join(kinds)} in the modified convention",
        )
    serial = SERIAL[arm.type]
    found = document("arms", serial)
    found["name"], found["generation"] = f"{own}_lab", arm.generation
    for name, row in zip(moving, chain.rows, strict=True):
        frame = next(f for f in found["frame"] if f["name"] == name)
        turn = ROW_TURN if arm.type == "PSM" and name == "insertion" else 0.0
        set_row(frame, row, turn)
        frame["source"] = source
    return found, known(str(serial), "none" if arm.type == "PSM" else None)


def _add_bodies(found: Document, base: ArmDescription, arm: LabArm) -> None:
    """Give a serial arm bodies and gains, so that it can be simulated."""
    found["body"] = arm_bodies(base.mechanism, arm.type == "ECM")
    found["control"] = {
        "dvrk": {
            "source": "share/pid of the dVRK for the Si",
            "pid": {joint: list(pid) for joint, pid in SI_GAINS[arm.type].items()},
        }
    }
    found["missing"] = [
        {"what": "masses, inertias, shapes, friction", "why": "trocar has none; stand-ins"}
    ]


def tool_document(tool: str, instrument: Instrument) -> Document | None:
    """Return a tool with a file's numbers, None where trocar's own has them already.

    Args:
        tool: "NAME:CODE"
        instrument: the content of its file
    """
    own = tool in names("tools")
    like = f"LARGE_NEEDLE_DRIVER:{'400006' if tool.rpartition(':')[2][:3] == '400' else '420006'}"
    like = tool if own else like
    found = document("tools", like)
    frames: Mapping[str, Document] = {f["name"]: f for f in found["frame"]}
    changed = set_limits(found, _held(instrument), instrument.file)
    roll, _, yaw, _ = instrument.rows
    for frame, key, length in (("roll", "d", roll.d), ("wrist_yaw", "a", -yaw.a)):
        if abs(limit(frames[frame], key) - length) > SAME_LENGTH:
            without(frames[frame], key)
            frames[frame] |= {f"{key}_m": length, "source": instrument.file}
            changed = True
    coupling = found["coupling"]
    if not np.allclose(coupling["actuator_to_joint"], instrument.coupling, atol=1e-9):
        coupling |= {"actuator_to_joint": instrument.coupling.tolist(), "source": instrument.file}
        changed = True
    if not np.allclose(instrument.tip, TOOL_TIP, atol=1e-6):
        tip = frames["tip"]
        without(tip, "xyz")
        T = YAW_TURN @ instrument.tip + 0.0
        tip |= {"xyz_m": T[:3, 3].tolist(), "rotation": T[:3, :3].tolist()}
        tip["source"] = f"{instrument.file}: tooltip_offset"
        changed = True
    if own and not changed:
        return None
    found["name"] = tool
    found["title"] = f"{tool}, as its file has it; shape and masses of {like}"
    found["source"] = instrument.file
    for joint in found["joint"]:  # stops lie inside the limits
        lower, upper = limit(joint, "lower"), limit(joint, "upper")
        for key in ("stop_lower", "stop_upper"):
            stop = limit(joint, key)
            if math.isfinite(stop) and not lower <= stop <= upper:
                without(joint, key)
                joint[f"{key}_rad"] = min(max(stop, lower), upper)
    return found


def _held(instrument: Instrument) -> tuple[DhRow, ...]:
    """Return an instrument's rows with a range for every joint, and a jaw that stays shut."""
    rows: dict[str, DhRow] = dict(zip((*WRIST, "jaw"), instrument.rows, strict=True))
    still = [*instrument.virtual, *([] if instrument.has_jaw else ["jaw"])]
    for name in still:
        at = rows[name].qmin or 0.0
        rows[name] = structs.replace(rows[name], qmin=at - HELD, qmax=at + HELD)
    return tuple(rows.values())


def arm_bodies(mechanism: Mechanism, scope: bool) -> list[Document]:
    """Return bodies of a PSM or ECM whose chain begins at its remote centre.

    Args:
        mechanism: frames rcm, yaw, pitch, insertion, and roll of an endoscope
        scope: whether it is an ECM
    """
    at = poses(mechanism, np.clip(np.zeros(len(mechanism.joints)), mechanism.lower, None), "rcm")
    found: list[Document] = []
    shaft = ("roll", (STAND_IN_SCOPE,), OWN_ENDOSCOPES["ecm"].mass)
    for frame, capsules, mass in (*STAND_IN_ARM, *([shaft] if scope else [])):
        ends = inverse(at[frame])
        shapes = [_capsule(ends, start, stop, radius) for start, stop, radius in capsules]
        found.append({"frame": frame, "mass_kg": mass, "source": STAND_IN, "shape": shapes})
    return found


def link_bodies(mechanism: Mechanism, frames: list[str]) -> list[Document]:
    """Return bodies along a chain: a capsule from each frame to the next.

    Args:
        mechanism: the chain
        frames: those that move, from the base outward, and what the last one carries
    """
    at = poses(mechanism, np.zeros(len(mechanism.joints)), mechanism.reference)
    found: list[Document] = []
    for frame, following in pairwise(frames):
        own = inverse(at[frame])
        last = following == frames[-1]
        end = at[following] @ np.array([0.0, -BASE_AHEAD * last, 0.0, 1.0])
        tip = transform_points(own, end[:3])
        bend = np.array([0.0, 0.0, tip[2]])  # up the own axis, then along the link
        ends = [np.zeros(3), bend, tip]
        pieces = [(a, b) for a, b in pairwise(ends) if np.linalg.norm(b - a) > 0.02] or [
            (np.array([0.0, 0.0, -0.03]), np.array([0.0, 0.0, 0.03]))
        ]
        still, hub = np.eye(4), np.array([0.0, 0.0, 0.05])
        shapes = [_capsule(still, tuple(a), tuple(b), LINK_RADIUS) for a, b in pieces]
        for middle in {tuple(ends[0]), tuple(bend)} if frame != frames[0] else set[Point]():
            shape = _capsule(still, np.array(middle) - hub, np.array(middle) + hub, HUB_RADIUS)
            shapes.append({**shape, "kind": "cylinder", "material": "joint"})
        found.append({"frame": frame, "mass_kg": LINK_MASS, "source": STAND_IN, "shape": shapes})
    return found


def _capsule(T: Array, start: Any, stop: Any, radius: float) -> Document:
    ends = np.round(transform_points(T, np.array([start, stop], dtype=np.float64)), 6) + 0.0
    return {
        "kind": "capsule",
        "from_m": ends[0].tolist(),
        "to_m": ends[1].tolist(),
        "radius_m": radius,
        "material": "cover",
        "collide": False,
    }
