"""A dVRK system: arms, where they stand and who moves whom, from its configuration files."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from difflib import get_close_matches
from pathlib import Path
from typing import Any, Literal, cast

import numpy as np
from msgspec import structs
from numpy.typing import NDArray

from trocar.descriptions import names
from trocar.descriptions.endoscopes import ENDOSCOPES, EndoscopeType
from trocar.descriptions.records import REFERENCE_ARM, Generation
from trocar.descriptions.tool_versions import GEARED, tool_of_version
from trocar.errors import DescriptionError, InputError, UnknownNameError
from trocar.geometry.dh import modified_dh, standard_dh
from trocar.geometry.se3 import transform
from trocar.robot.dvrk_config import published
from trocar.robot.dvrk_config.files import (
    ArmEntry,
    ArmFile,
    Dh,
    DhRow,
    Gain,
    JsonFile,
    KinematicFile,
    PidFile,
    SetupEntry,
    SetupFile,
    Sources,
    SystemFile,
    TeleopEntry,
    TeleopParameters,
    ToolFile,
    ToolIndexEntry,
    ToolIndexFile,
    converted,
    parse_json,
)

Array = NDArray[np.float64]

#: Kinds of arms. Source: schema dvrk-system-arm; SUJ and PSM_SOCKET are those of older files.
KINDS = (
    *(
        f"{arm}{more}"
        for more in ("", "_DERIVED", "_GENERIC", "_SOCKET")
        for arm in ("MTM", "PSM", "ECM")
    ),
    *("SUJ_Classic", "SUJ_Si", "SUJ_Fixed", "SUJ", "FOCUS_CONTROLLER"),
)
NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
#: Arms that setup joints can hold, and the number of rows that move in the Classic's chains.
#: Source: mtsIntuitiveResearchKitSUJ.cpp.
CLASSIC_JOINTS = {"PSM1": 6, "PSM2": 6, "PSM3": 6, "ECM": 4}
POTENTIOMETERS = ("primary_offsets", "primary_scales", "secondary_offsets", "secondary_scales")
#: Joints in the order of a PID file. The dVRK closes a tool's loops on its four discs; trocar on
#: the joint that each moves most, with the same gains. Source: docs/simulation.md.
PID_JOINTS = {
    "PSM": ("yaw", "pitch", "insertion", "roll", "wrist_pitch", "wrist_yaw", "jaw"),
    "ECM": ("yaw", "pitch", "insertion", "roll"),
    "MTM": (
        *("outer_yaw", "shoulder_pitch", "elbow_pitch", "wrist_platform"),
        *("wrist_pitch", "wrist_yaw", "wrist_roll"),
    ),
}
#: Tolerance of angles that stand for a multiple of 5 degrees [rad]; the dVRK's files have four
#: decimals or more: 1.5708, 0.7853, -1.2217.
ROUNDED, STEP = 1.01e-4, math.radians(5.0)
#: Largest error of a rotation matrix, as from 0.866 for cos 30 deg. Source: our own choice.
SKEW = 1e-3
#: alpha and theta of the three rows of an instrument with a wrist of cables [rad], and its tip, the
#: rotation to Intuitive's convention. Source: share/tool/LARGE_NEEDLE_DRIVER_400006.json.
TOOL_ANGLES = ((0.0, 0.0), (-math.pi / 2, -math.pi / 2), (-math.pi / 2, -math.pi / 2))
TOOL_TIP = [
    [0.0, -1.0, 0.0, 0.0],
    [0.0, 0.0, 1.0, 0.0],
    [-1.0, 0.0, 0.0, 0.0],
    [0.0, 0.0, 0.0, 1.0],
]
WRIST = ("roll", "wrist_pitch", "wrist_yaw")
#: Tolerance of equal lengths [m].
SAME_LENGTH = 1e-7
#: Lean of setup joints that is still an arm's mounting pitch. Source: our own choice. [rad]
SAME_LEAN = math.radians(1.0)
#: Least determinant of a coupling. Source: our own choice; SAW's have 0.03 (stapler) to 3.
SINGULAR = 1e-6


@dataclass(frozen=True)
class DhRows:
    """Rows from the base outward, and their convention."""

    convention: Literal["modified", "standard"]
    rows: tuple[DhRow, ...]

    @property
    def moving(self) -> int:
        """Number of rows that joints move."""
        return sum(row.moves for row in self.rows)

    def tip(self, q: Array) -> Array:
        """Return the pose of the last row's frame in the base, (4, 4).

        Args:
            q: of the rows that move, (n,) [rad or m]
        """
        pose, values = np.eye(4), iter(q.tolist())
        place = modified_dh if self.convention == "modified" else standard_dh
        for row in self.rows:
            moved = next(values) if row.moves else 0.0
            turn, slide = (moved, 0.0) if row.type == "revolute" else (0.0, moved)
            pose = pose @ place(row.a, row.alpha, row.d + slide, row.theta + turn)
        return pose


@dataclass(frozen=True, eq=False)
class SetupArm:
    """Setup joints of one arm of a patient cart.

    Attributes:
        name: of the arm that they carry: "PSM1"
        file: where they stand
        generation: of the setup joints
        chain: from the column to the last joint, None where it is fixed or the dVRK's own
        column: T_cart_column (4, 4)
        tool_origin: T_tip_base, the carried arm's base on the last row (4, 4)
        q: simulated positions, None where the file has none [m, rad]
        fixed: T_cart_base of an arm on a mount of its own (4, 4), None where joints hold it
        potentiometers: {key: numbers} of their calibration
    """

    name: str
    file: str
    generation: Generation
    chain: DhRows | None
    column: Array
    tool_origin: Array
    q: Array | None
    fixed: Array | None
    potentiometers: Mapping[str, tuple[float, ...]]

    def base(self, q: Array) -> Array:
        """Return T_cart_base of the carried arm at joint positions, (4, 4)."""
        if self.fixed is not None:
            return self.fixed
        if self.chain is None:
            raise ValueError(f"{self.name}: has no chain")
        return self.column @ self.chain.tip(q) @ self.tool_origin


@dataclass(frozen=True, eq=False)
class Instrument:
    """An instrument's own file.

    Attributes:
        file: where it stands
        rows: of roll, wrist pitch and wrist yaw, and the limits of the jaw as a fourth
        coupling: q = A q_actuator, (4, 4)
        tip: T_yaw_tip, its tooltip_offset (4, 4)
        has_jaw: whether the jaw has a range and a torque; that of a probe or hook has neither
        virtual: joints of the wrist without a range: names
    """

    file: str
    rows: tuple[DhRow, ...]
    coupling: Array
    tip: Array
    has_jaw: bool
    virtual: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class LabArm:
    """A PSM, an ECM or an MTM.

    Attributes:
        name, type, generation: who it is
        file: the arm's own file, or the dVRK's name of one that is not there
        chain: its kinematics, None where they are the dVRK's own and were not found
        tool: "" where the file leaves it open
        instrument: the tool's own file, None where it is not here
        endoscope: of an ECM, None of others
        gains: {joint: its entry of the PID file}, empty where no file has them
        mounting_pitch: lean of its base about x, None where no file has it [rad]
        carrier: name of the setup arm that holds it, "" of others
        frame, pose: the frame that its base stands in and T_frame_base (4, 4); "", None of others
    """

    name: str
    type: Literal["PSM", "ECM", "MTM"]
    generation: Generation
    file: str
    chain: DhRows | None
    tool: str
    instrument: Instrument | None
    endoscope: EndoscopeType | None
    gains: Mapping[str, Gain]
    mounting_pitch: float | None = None
    carrier: str = ""
    frame: str = ""
    pose: Array | None = None


@dataclass(frozen=True)
class LabTeleop:
    """A teleoperation as the file has it; `given` are the entries of a rig's [[teleop]]."""

    place: str
    masters: tuple[str, ...]
    slave: str
    kind: Literal["psm", "ecm"]
    given: Mapping[str, float | bool]


@dataclass(frozen=True, eq=False)
class Lab:
    """A whole system.

    Attributes:
        file: the system's file
        arms, setup, teleops: what it has
        reference_arm: arm on setup joints whose tip frame the poses of the others are in
        notes: remarks for the user
        warnings: what is probably a mistake in the files
        idle: entries that have no counterpart in a simulation, "FILE: KEY, ..."
        unknown: entries that no version of the dVRK has, "FILE: KEY"
    """

    file: str
    arms: tuple[LabArm, ...]
    setup: tuple[SetupArm, ...]
    reference_arm: str
    teleops: tuple[LabTeleop, ...]
    notes: tuple[str, ...]
    warnings: tuple[str, ...]
    idle: tuple[str, ...]
    unknown: tuple[str, ...]


def read_system(
    path: Path,
    share: Sequence[Path] = (),
    literal: bool = False,
    tools: Mapping[str, str] | None = None,
) -> Lab:
    """Read a system and the files that it names.

    Args:
        path: system-*.json or console-*.json
        share: folders where files are looked for, too
        literal: take angles as they are printed: 1.5708, 0.7853
        tools: {PSM: instrument} in place of the files'; one that trocar lacks is looked up in
            them

    Raises:
        DescriptionError: naming file, key, what was got and what is allowed
    """
    return _SystemReader(path, share, literal, tools or {}).read()


class _SystemReader:
    """Reads one system."""

    def __init__(
        self, path: Path, share: Sequence[Path], literal: bool, tools: Mapping[str, str]
    ) -> None:
        self._sources = Sources(path, share)
        self._notes: list[str] = []
        self._literal, self._tools = literal, tools
        self._root: JsonFile[SystemFile] = self._sources.read(path, SystemFile)
        self._setup: dict[str, list[SetupArm]] = {}
        self._carried: dict[str, str] = {}
        self._reference_arm = REFERENCE_ARM

    def read(self) -> Lab:
        root = self._root
        system = root.entries
        if system.settings is not None:
            self._sources.add(system.settings.path)
        if not system.arms:
            raise root.fail("arms", "is missing; allowed: a list of objects, one for each arm")
        kinds = self._kinds()
        entries = [(root.at(f"arms[{k}]"), arm) for k, arm in enumerate(system.arms)]
        for place, entry in entries:  # setup joints first, for the others stand on them
            if kinds[entry.name].startswith("SUJ"):
                self._setup[entry.name] = self._read_setup(place, entry, kinds[entry.name])
        left_out = {e.name: self._left_out(e, kinds[e.name]) for _, e in entries}
        self._notes += [f"{name}: left out: {why}" for name, why in left_out.items() if why]
        self._notes += [
            f"{name}: {kind} is simulated as the {kind[:3]} that it derives from"
            for name, kind in kinds.items()
            if kind.endswith("_DERIVED")
        ]
        arms = [
            self._arm(place, entry, kinds[entry.name])
            for place, entry in entries
            if not (left_out[entry.name] or kinds[entry.name].startswith("SUJ"))
        ]
        setup = tuple(arm for arms in self._setup.values() for arm in arms)
        if not arms and all(arm.fixed is not None for arm in setup):
            reasons: dict[str, list[str]] = {}
            for name, why in left_out.items():
                reasons.setdefault(why, []).append(name)
            because = "; ".join(
                f"{', '.join(found)}: {why}" for why, found in reasons.items() if why
            )
            problem = f"holds no arm that can be simulated ({because or 'fixed mounts alone'})"
            raise root.fail("arms", f"{problem}; allowed: one or more of MTM, PSM, ECM")
        teleops = self._teleops(kinds)
        if self._sources.absent:
            absent = ", ".join(dict.fromkeys(self._sources.absent))
            self._notes.append(f"not found, replaced by the dVRK's published files: {absent}")
        idle, unknown = self._sources.leftovers()
        notes = tuple(dict.fromkeys(self._notes))
        slips = tuple(dict.fromkeys(self._sources.warnings))
        return Lab(
            root.name, tuple(arms), setup, self._reference_arm, teleops, notes, slips, idle, unknown
        )

    def _kinds(self) -> dict[str, str]:
        """Return {name: kind} of the system's arms."""
        known = {kind.lower(): kind for kind in KINDS}
        kinds: dict[str, str] = {}
        for k, arm in enumerate(self._root.entries.arms):
            place = self._root.at(f"arms[{k}]")
            if not NAME.fullmatch(arm.name):
                raise place.fail("name", f"got {arm.name!r}; allowed: letters, digits and _")
            if arm.name in kinds:
                raise place.fail("name", f"got {arm.name!r} a second time; allowed: each arm once")
            if arm.type.lower() not in known:
                raise place.fail("type", f"got {arm.type!r}; allowed: {', '.join(KINDS)}")
            kinds[arm.name] = known[arm.type.lower()]
        return kinds

    def _left_out(self, entry: ArmEntry, kind: str) -> str:
        """Give the reason for not simulating an arm; "" for a simulated one."""
        elsewhere = ""
        if kind.endswith("_SOCKET"):
            elsewhere = f"a {kind} is an arm of another computer"
        elif kind.endswith("_GENERIC") and entry.component in self._from_ros():
            elsewhere = f"a {kind} from ROS is an arm of another program"
        elif kind.endswith("_GENERIC") or kind == "FOCUS_CONTROLLER":
            return f"a {kind} is a device that only the lab knows"
        return elsewhere and f"{elsewhere}; trocar mirror shows one from its topics"

    def _from_ros(self) -> list[str]:
        """Return the names of components that read an arm from ROS: dvrk_psm_from_ros, ..."""
        manager = self._root.entries.component_manager
        arguments = [
            component.constructor_arg
            for component in (() if manager is None else manager.components)
            if component.class_name.endswith("_from_ros")
        ]
        return [
            str(cast("dict[str, Any]", a).get("name", "")) if isinstance(a, dict) else str(a)
            for a in arguments
        ]

    # ------------------------------------------------------------------ setup joints

    def _read_setup(self, place: JsonFile[Any], entry: ArmEntry, kind: str) -> list[SetupArm]:
        file_name = entry.arm_file or entry.arm or entry.kinematic
        if not file_name:
            raise place.fail("arm_file", "is missing; required for setup joints")
        path = self._sources.find(file_name)
        if path is None:
            own = published.SETUP_FILES.get(Path(file_name).name)
            if own is None:
                raise self._sources.missing(
                    place, _given(entry, "arm_file", "arm", "kinematic"), file_name
                )
            if kind not in (own, "SUJ"):
                raise place.fail("type", f"got {kind!r}; allowed: {own}, as {file_name} has it")
            self._sources.absent.append(file_name)
            return _own_setup(own)
        file = self._sources.read(path, SetupFile)
        kind = "SUJ_Classic" if kind == "SUJ" else kind
        found: dict[str, SetupArm] = {}
        for k, arm in enumerate(file.entries.arms):
            at = file.at(f"arms[{k}]")
            if arm.name not in CLASSIC_JOINTS:
                allowed = ", ".join(CLASSIC_JOINTS)
                raise at.fail("name", f"got {arm.name!r}; allowed: {allowed}")
            if arm.name in found:
                raise at.fail("name", f"got {arm.name!r} a second time; allowed: each arm once")
            found[arm.name] = _setup_arm(at, arm, kind, self._literal)
        if not found:
            allowed = ", ".join(CLASSIC_JOINTS)
            raise file.fail("arms", f"is missing; allowed: a list of objects, for {allowed}")
        self._set_reference_arm(file, kind, list(found))
        return list(found.values())

    def _set_reference_arm(self, file: JsonFile[SetupFile], kind: str, held: list[str]) -> None:
        """Read the arm whose tip frame the poses of the others on setup joints are in."""
        name = file.entries.reference_arm or REFERENCE_ARM
        allowed = dict.fromkeys([REFERENCE_ARM, *held])
        if name not in allowed:
            raise file.fail("reference_arm", f"got {name!r}; allowed: {', '.join(allowed)}")
        self._reference_arm = name
        if kind == "SUJ_Fixed" and name != REFERENCE_ARM:
            self._notes.append(
                f"{file.name}: reference_arm is {name!r}; here poses of PSMs on fixed mounts are in"
                " the ECM's frame"
            )

    # ------------------------------------------------------------------ arms

    def _arm(self, place: JsonFile[Any], entry: ArmEntry, system_kind: str) -> LabArm:
        kind = cast(Literal["PSM", "ECM", "MTM"], system_kind[:3])
        file = self._arm_file(place, entry)
        arm = file.entries
        chain, own = self._chain(file, kind)
        meant: Generation = "Si" if own.endswith("_si") else "Classic"
        if arm.generation and own and arm.generation != meant:
            raise file.fail(
                "generation",
                f"got {arm.generation!r}; allowed: {meant}, for kinematic is {arm.kinematic!r}",
            )
        generation = arm.generation or meant
        pitch = arm.mounting_pitch
        if pitch is not None and not abs(pitch) <= math.pi / 2.0:
            raise file.fail(
                "mounting_pitch",
                f"got {pitch:g}; allowed: -1.571 to 1.571 rad (on an Si cart -0.785 for PSM1 and"
                " PSM2, -0.262 for PSM3, -1.222 for the ECM)",
            )
        tool, instrument = self._tool(file, entry) if kind == "PSM" else ("", None)
        endoscope = _endoscope(file) if kind == "ECM" else None
        if endoscope and arm.endoscope != endoscope.name:
            named = arm.endoscope or arm.kinematic
            self._notes.append(f"{entry.name}: endoscope {named!r} is taken as {endoscope.name}")
        gains = self._gains(place, entry, kind, generation)
        base = self._base(place, entry)
        if pitch is None and generation == "Si" and kind != "MTM":
            stands = "leans as its setup joints do" if base[0] else "stands upright"
            self._notes.append(
                f"{entry.name}: no mounting_pitch, without which the dVRK rejects an Si arm; it"
                f" {stands}"
            )
        if base[0]:
            self._check_carrier(file, place, generation, base[0])
        return LabArm(
            entry.name, kind, generation, file.name if not file.prefix else arm.kinematic, chain,
            tool, instrument, endoscope, gains, arm.mounting_pitch, *base,
        )  # fmt: skip

    def _check_carrier(
        self, file: JsonFile[ArmFile], place: JsonFile[Any], generation: Generation, carrier: str
    ) -> None:
        """Compare an arm with the setup joints that hold it: generation, and lean of an Si's."""
        suj = next(arm for arms in self._setup.values() for arm in arms if arm.name == carrier)
        if suj.fixed is not None:
            return
        if suj.generation != generation:
            raise place.fail(
                "base_frame.component",
                f"got setup joints of generation {suj.generation} for an arm of generation"
                f" {generation}; allowed: setup joints of generation {generation}",
            )
        pitch = file.entries.mounting_pitch
        if pitch is None or suj.chain is None or generation == "Classic":
            return
        up = suj.base(np.zeros(suj.chain.moving))[2, :3]
        lean = math.atan2(up[1], up[2])
        if abs(lean - pitch) > SAME_LEAN:
            self._notes.append(
                f"{file.name}: mounting_pitch is {math.degrees(pitch):.1f} degrees, and its setup"
                f" joints lean by {math.degrees(lean):.1f}; gravity compensation follows the former"
                " here, as on the dVRK"
            )

    def _arm_file(self, place: JsonFile[Any], entry: ArmEntry) -> JsonFile[ArmFile]:
        """Return an arm's own file, found as the dVRK finds it, or its entry in the system's."""
        serial = f"{entry.name_on_io or entry.name}-{entry.serial}.json" if entry.serial else ""
        file_name = entry.arm_file or entry.arm or serial
        if not file_name and entry.kinematic:
            return replace(place, entries=ArmFile(entry.kinematic))
        if not file_name:
            needed = "an arm needs arm_file, or its serial (in older systems arm, or kinematic)"
            raise place.fail("arm_file", f"is missing; {needed}")
        path = self._sources.find(file_name)
        if path is None and entry.system:  # the folder of a lab's robot
            path = self._sources.find(f"{entry.system}/{file_name}")
        if path is not None:
            return self._sources.read(path, ArmFile)
        own = published.own_arm_file(file_name)
        if own is None:
            key = _given(entry, "arm_file", "arm", "serial")
            raise self._sources.missing(place, key, file_name)
        self._sources.absent.append(file_name)
        return JsonFile(file_name, own, converted(file_name, own, ArmFile))

    def _chain(self, file: JsonFile[ArmFile], kind: str) -> tuple[DhRows | None, str]:
        """Return the chain, None where it is not here, and trocar's arm that has the dVRK's."""
        file_name = file.entries.kinematic
        own, path = published.own_arm(file_name), self._sources.find(file_name)
        if path is None:
            if not own:
                raise self._sources.missing(file, "kinematic", file_name)
            self._sources.absent.append(file_name)
            return None, own
        found = self._sources.read(path, KinematicFile)
        chain = read_chain(found, "dh", found.entries.dh, self._literal)
        if kind == "PSM" and len(chain.rows) > 3:  # of version 1: the arm with its instrument
            chain = replace(chain, rows=chain.rows[:3])
            self._notes.append(f"{found.name}: instrument rows are ignored")
        return chain, own

    def _tool(self, file: JsonFile[ArmFile], entry: ArmEntry) -> tuple[str, Instrument | None]:
        """Return the instrument that is requested or fixed by the files, and its own file.

        Its name is "" where the files leave it open.
        """
        arm, name = file.entries, entry.name
        choose = f"--tool {name}=NAME selects one"
        listed = self._tool_index(file)
        requested = self._tools.get(name, "")
        if requested in names("tools") or requested.endswith(".toml"):
            return requested, None
        if requested:
            return self._listed_tool(requested, file, entry, listed)
        if file.prefix:  # of version 1: psm-large-needle-driver.json
            words = Path(arm.kinematic).stem.lower().split("-")[1:]
            tool = next(
                (t for t in names("tools") if ":400" in t and all(w in t.lower() for w in words)),
                "",
            )
            if words and not tool:
                self._notes.append(f"{name}: {arm.kinematic}: not a built-in instrument; {choose}")
            return (tool if words else ""), None
        if arm.tool_detection != "FIXED":
            own = [f"{e.names[0]}:{e.model}" for e, custom in listed if custom and e.names]
            custom = f"; {arm.custom_tool_index} has {', '.join(own)}" if own else ""
            self._notes.append(
                f"{name}: tool_detection is {arm.tool_detection}, no instrument defined;"
                f" {choose}{custom}"
            )
            return "", None
        if not arm.tool:
            raise file.fail("tool", "is missing; allowed: a string")
        return self._listed_tool(arm.tool, file, entry, listed)

    def _tool_index(self, file: JsonFile[ArmFile]) -> list[tuple[ToolIndexEntry, bool]]:
        """Return the instruments of the dVRK's index, where it is here, and of the lab's own.

        Returns:
            each with whether it is the lab's own
        """
        index, own = self._sources.find("tool/index.json"), file.entries.custom_tool_index
        places = [(index, False)] if index is not None else []
        if own:
            path = self._sources.find(own)
            if path is None:
                raise self._sources.missing(file, "custom_tool_index", own)
            places.append((path, True))
        return [
            (entry, custom)
            for path, custom in places
            for entry in self._sources.read(path, ToolIndexFile).entries.instruments
        ]

    def _listed_tool(
        self,
        tool: str,
        file: JsonFile[ArmFile],
        entry: ArmEntry,
        listed: list[tuple[ToolIndexEntry, bool]],
    ) -> tuple[str, Instrument | None]:
        """Return an instrument's name and its file, None where that is not here.

        Args:
            tool: NAME:MODEL, :MODEL or NAME_MODEL, with or without a version "[2]", "[1..3]"
            file, entry: of the arm
            listed: as of `_tool_index`

        Raises:
            DescriptionError: its file is not there, or has an instrument that trocar cannot have
        """
        try:
            chosen = tool_of_version(re.sub(r"_(\d{6})(?=\[|$)", r":\1", tool))
        except InputError as problem:
            raise file.fail("tool", str(problem)) from problem
        plain = chosen.removesuffix(GEARED)
        name, _, model = plain.rpartition(":")
        version = re.search(r"\[(?:\.\.)?(\d+)", tool)  # of a range the first. Source: mtsToolList
        found = [
            (each, custom)
            for each, custom in listed
            if each.model == model
            and (not name or name.upper() in [n.upper() for n in each.names])
            and (version is None or _of_version(each, int(version[1])))
        ]
        if found:
            each, custom = found[0]
            aliases = [f"{n.upper()}:{model}" for n in each.names]
            built_in = [alias for alias in aliases if alias in names("tools")]
            full = next(iter([*built_in, *([plain.upper()] if name else aliases)]), plain)
            if chosen.endswith(GEARED) and full + GEARED in names("tools"):
                full += GEARED
            path = self._sources.find(each.file) or self._sources.find(f"tool/{each.file}")
            if path is not None:
                return full, self._instrument(path, file, entry.name, full)
            if custom or full not in names("tools"):
                key = "custom_tool_index" if custom else "tool"
                raise self._sources.missing(file, key, each.file)
            return full, None
        code = re.sub(r"^\d+MM_", "", plain).replace(":", "_")  # 5MM_NEEDLE_DRIVER:400117
        for stem in dict.fromkeys((plain.replace(":", "_"), code)):
            path = self._sources.find(f"tool/{stem}.json")
            if path is not None:
                return plain, self._instrument(path, file, entry.name, plain)
        if plain.startswith("5MM_"):
            raise _snake(file, entry.name, plain)
        if chosen in names("tools"):
            return chosen, None
        known = [*names("tools"), *(f"{n}:{each.model}" for each, _ in listed for n in each.names)]
        if entry.name in self._tools:
            raise UnknownNameError("tool", tool, dict.fromkeys(known), file.name)
        if listed:
            near = get_close_matches(plain, known, n=1)
            hint = f" (did you mean {near[0]!r}?)" if near else ""
            allowed = ", ".join(dict.fromkeys(known))
            raise file.fail("tool", f"got {tool!r}, which no index has{hint}; allowed: {allowed}")
        return plain, None

    def _instrument(self, path: Path, arm: JsonFile[Any], name: str, tool: str) -> Instrument:
        """Return the content of an instrument's file.

        Raises:
            DescriptionError: rows or a coupling that no tool of trocar's has
        """
        if any(parse_json(path).get(key) for key in ("snake_like", "snake-like")):
            raise _snake(arm, name, tool)
        file = self._sources.read(path, ToolFile)
        chain = read_chain(file, "dh", file.entries.dh, self._literal, rigid=True)
        got = tuple((row.alpha, row.theta) for row in chain.rows)
        fits = len(got) == 3 and np.allclose(got, TOOL_ANGLES, atol=1e-5)
        if chain.convention != "modified" or not fits or chain.moving < 3:
            degrees = ", ".join(f"({math.degrees(a):g}, {math.degrees(t):g})" for a, t in got)
            raise file.fail(
                "dh",
                f"unsupported chain of {len(got)} rows (alpha, theta + offset in degrees:"
                f" {degrees}); allowed: roll, wrist pitch and wrist yaw as of LARGE_NEEDLE_DRIVER:"
                " (0, 0), (-90, -90), (-90, -90) in the modified convention",
            )
        lengths = [(row.a, row.d) for row in chain.rows]
        if any(abs(v) > SAME_LENGTH for v in (lengths[0][0], *lengths[1], lengths[2][1])):
            allowed = "D of the first, A of the last row"
            raise file.fail("dh", f"got A, D of {lengths}; allowed: {allowed}")
        tip = _pose(file, "tooltip_offset", file.entries.tooltip_offset)
        jaw = file.entries.jaw
        if jaw.qmin > jaw.qmax:
            allowed = f"up to qmax, {jaw.qmax:g}"
            raise file.fail("jaw.qmin", f"got {jaw.qmin:g}; allowed: {allowed}")
        coupling = np.array(file.entries.coupling.actuator_to_joint)
        key = "coupling.actuatortojointposition"
        if not np.isfinite(coupling).all() or abs(np.linalg.det(coupling)) < SINGULAR:
            allowed = "an invertible matrix (ones on the diagonal of what a disc does not move)"
            raise file.fail(key, f"got {coupling.tolist()}; allowed: {allowed}")
        limits = DhRow(qmin=jaw.qmin, qmax=jaw.qmax, ftmax=jaw.ftmax)
        has_jaw = jaw.qmin < jaw.qmax and jaw.ftmax > 0.0
        if not has_jaw:
            why = "its jaw has no torque" if jaw.qmin < jaw.qmax else "its jaw has no range"
            self._notes.append(f"{name}: {tool} has no jaw ({why}): the fingers stay shut")
        rows = zip(WRIST, chain.rows, strict=True)
        virtual = tuple(
            joint for joint, row in rows if row.qmin is not None and row.qmin == row.qmax
        )
        if virtual:
            self._notes.append(f"{name}: {tool}: {', '.join(virtual)} without a range: held still")
        return Instrument(file.name, (*chain.rows, limits), coupling, tip, has_jaw, virtual)

    def _gains(
        self, place: JsonFile[Any], entry: ArmEntry, kind: str, generation: Generation
    ) -> Mapping[str, Gain]:
        """Return {joint: its entry of the PID file} of an arm, empty where no file has them."""
        si = "-Si" if generation == "Si" and kind != "MTM" else ""
        file_name = entry.pid_file or f"pid/sawControllersPID-{kind}{si}.json"
        path = self._sources.find(file_name)
        if path is None:
            if entry.pid_file:
                raise self._sources.missing(place, "pid_file", file_name)
            return {}
        if path.suffix != ".json":
            self._notes.append(
                f"{path}: only JSON is supported; gains of the built-in arm are used"
            )
            return {}
        file, joints = self._sources.read(path, PidFile), PID_JOINTS[kind]
        found: dict[str, Gain] = {}
        rows = file.entries.pid
        if len(rows) != len(joints):
            allowed = f"{len(joints)} for a {kind}"
            raise file.fail("pid", f"has {len(rows)} entries; allowed: {allowed}")
        for k, row in enumerate(rows):
            if row.index not in range(len(joints)) or joints[row.index] in found:
                allowed = f"0 to {len(joints) - 1}, each once"
                raise file.fail(f"pid[{k}].index", f"got {row.index}; allowed: {allowed}")
            if row.use_disturbance_observer:
                for key in ("nominal_mass", "disturbance_cutoff"):
                    if getattr(row, key) is None:
                        why = "0 or more, for use_disturbance_observer is true"
                        raise file.fail(f"pid[{k}].{key}", f"is missing; allowed: {why}")
            if row.pid_max_output == 0.0:
                allowed = "above 0, or below 0 for no limit"
                raise file.fail(f"pid[{k}].pid_max_output", f"got 0; allowed: {allowed}")
            found[joints[row.index]] = row
        return found

    def _base(self, place: JsonFile[Any], entry: ArmEntry) -> tuple[str, str, Array | None]:
        """Return `carrier`, `frame` and `pose` of an arm."""
        base = entry.base_frame
        if base is None:
            return "", "", None
        keys = ("transform", "reference_frame", "component", "interface")
        has = [key for key in keys if getattr(base, key) is not None]
        if base.transform and has == ["transform", "reference_frame"]:
            at = _pose(place, "base_frame.transform", base.transform)
            return "", base.reference_frame or "", at
        if has != ["component", "interface"]:
            raise place.fail(
                "base_frame",
                f"got {', '.join(has) or 'nothing'}; allowed: transform and reference_frame, or"
                " component and interface",
            )
        component, interface = base.component or "", base.interface or ""
        if component not in self._setup:
            known = ", ".join(self._setup) or "none, for the system has no setup joints"
            raise place.fail("base_frame.component", f"got {component!r}; allowed: {known}")
        held = [arm.name for arm in self._setup[component]]
        free = [name for name in held if name not in self._carried]
        if interface not in free:
            holds = f", which holds {self._carried[interface]}" if interface in held else ""
            allowed = ", ".join(free) or "none"
            raise place.fail(
                "base_frame.interface", f"got {interface!r}{holds}; allowed: {allowed}"
            )
        self._carried[interface] = entry.name
        return interface, "", None

    # ------------------------------------------------------------------ teleoperation

    def _teleops(self, kinds: Mapping[str, str]) -> tuple[LabTeleop, ...]:
        """Return every teleoperation of the consoles, each pair once."""
        system = self._root.entries
        found: dict[tuple[str, ...], LabTeleop] = {}
        consoles = [(f"consoles[{k}].", console) for k, console in enumerate(system.consoles)]
        for path, console in (*consoles, ("", system)):
            rows = [
                (f"{path}{key}[{k}]", entry, "psm")
                for key in ("teleop_psms", "psm_teleops")
                for k, entry in enumerate(getattr(console, key))
            ]
            if console.ecm_teleop is not None:
                rows.append((f"{path}ecm_teleop", console.ecm_teleop, "ecm"))
            rows += [
                (f"{path}teleop_ecms[{k}]", entry, "ecm")
                for k, entry in enumerate(console.teleop_ecms)
            ]
            for place, entry, kind in rows:
                teleop = self._teleop(self._root.at(place), entry, kind, kinds)
                pair = (*teleop.masters, teleop.slave)
                if pair in found:
                    twice = f"{' and '.join(pair)} are paired twice; the first is used"
                    self._notes.append(f"{teleop.place}: {twice}")
                found.setdefault(pair, teleop)
        return tuple(found.values())

    def _teleop(
        self, place: JsonFile[Any], entry: TeleopEntry, kind: str, kinds: Mapping[str, str]
    ) -> LabTeleop:
        def arm(*keys: str) -> str:
            key = next((key for key in keys if getattr(entry, key) is not None), keys[0])
            type_ = {"m": "MTM", "p": "PSM", "e": "ECM"}[keys[0][0]]
            able = [name for name, kind in kinds.items() if kind.startswith(type_)]
            name = getattr(entry, key)
            if name not in able:
                known = ", ".join(able) or "none"
                got = "is missing" if name is None else f"got {name!r}"
                allowed = f"{known} (the system's arms of that type)"
                raise place.fail(key, f"{got}; allowed: {allowed}")
            return name

        where = f"{place.name}: {place.place()}"
        given = _teleop_parameters(entry.configure_parameter)
        if kind == "psm":
            return LabTeleop(where, (arm("mtm", "master"),), arm("psm", "slave"), "psm", given)
        masters = (arm("mtml", "mtm_left", "master_left"), arm("mtmr", "mtm_right", "master_right"))
        return LabTeleop(where, masters, arm("ecm", "slave"), "ecm", given)


def _teleop_parameters(entry: TeleopParameters | None) -> dict[str, float | bool]:
    """Return the parameters of a teleoperation as a rig has them."""
    given = {k: v for k, v in structs.asdict(entry or TeleopParameters()).items() if v is not None}
    for key in ("ignore_jaw", "rotation_locked", "translation_locked", "align"):
        given |= {key: bool(given[key])} if key in given else {}
    if "jaw_rate_back_from_clutch" in given:
        given["jaw_rate_after_clutch_rad_s"] = given.pop("jaw_rate_back_from_clutch")
    scaling = given.pop("gripper_scaling", None)
    for key in ("zero", "max"):
        if scaling is not None and getattr(scaling, key) is not None:
            given[f"gripper_{key}_rad"] = getattr(scaling, key)
    return given


def _endoscope(file: JsonFile[ArmFile]) -> EndoscopeType:
    """Return the endoscope of an ECM's file, which the dVRK, too, refuses without one.

    Files of version 2.0 and before name no generation: HD_UP, UP. Those of version 1 name a
    kinematic file, ecm-straight.json.
    """
    got = file.entries.endoscope
    if not got and file.prefix and "straight" in file.entries.kinematic.lower():
        got = "STRAIGHT"
    for name in (got, f"Classic_{got}", f"Classic_SD_{got}"):
        if name in ENDOSCOPES:
            return ENDOSCOPES[name]
    problem = f"got {got!r}" if got else "is missing"
    raise file.fail("endoscope", f"{problem}; allowed: {', '.join(ENDOSCOPES)}")


def _given(entry: ArmEntry, *keys: str) -> str:
    """Return the first of some keys that an entry has."""
    return next((key for key in keys if getattr(entry, key)), keys[0])


def _of_version(entry: ToolIndexEntry, version: int) -> bool:
    most = math.inf if entry.version_max is None else entry.version_max
    return entry.version_min <= version <= most


def _snake(file: JsonFile[Any], name: str, tool: str) -> DescriptionError:
    return file.fail(
        "tool",
        f"got {tool!r}, whose snake-like wrist of several segments is not supported: trocar's"
        f" instruments have one wrist pitch and one wrist yaw; allowed: {', '.join(names('tools'))}"
        f" (--tool {name}=TOOL takes one of these in its place)",
    )


def _own_setup(kind: str) -> list[SetupArm]:
    """Return the setup joints that the dVRK publishes; the Classic's chains are trocar's own."""
    data = {"arms": published.SETUPS[kind]}
    file = JsonFile("", data, converted("", data, SetupFile))
    return [
        _setup_arm(file.at(f"arms[{k}]"), arm, kind, literal=True)
        for k, arm in enumerate(file.entries.arms)
    ]


def _setup_arm(at: JsonFile[Any], arm: SetupEntry, kind: str, literal: bool) -> SetupArm:
    """Return the setup joints of one arm; a file without numbers has the dVRK's own."""
    name, still = arm.name, np.eye(4)
    if kind == "SUJ_Fixed":
        if arm.measured_cp is None:
            raise at.fail("measured_cp", "is missing; allowed: 4 rows of 4 numbers")
        fixed = _pose(at, "measured_cp", arm.measured_cp)
        return SetupArm(name, at.name, "Classic", None, still, still, None, fixed, {})
    generation: Generation = "Si" if kind == "SUJ_Si" else "Classic"
    column, tip = arm.world_origin_to_suj, arm.suj_tip_to_tool_origin
    keys = ("dh", "world_origin_to_suj", "suj_tip_to_tool_origin")
    given = [key for key in keys if getattr(arm, key) is not None]
    if given and len(given) < 3:
        raise at.fail(
            given[0],
            "is incomplete; allowed: DH, world_origin_to_SUJ and"
            " SUJ_tip_to_tool_origin together, or none of them (then the dVRK's own are taken)",
        )
    published_q = {row["name"]: row.get("simulated_position") for row in published.SETUPS[kind]}
    if arm.dh is not None and column is not None and tip is not None:
        chain = read_chain(at, "dh", arm.dh, literal)
        if generation == "Classic":
            chain = _classic_chain(at, chain, CLASSIC_JOINTS[name])
        stand, origin = (
            transform(_rotation(at, f"{key}.rotation", p.rotation), np.array(p.translation))
            for key, p in zip(keys[1:], (column, tip), strict=True)
        )
        q = np.array(published_q[name] or [])
        q = q if len(q) == chain.moving else None
        own = SetupArm(name, at.name, generation, chain, stand, origin, q, None, {})
    elif generation == "Si":
        (own,) = (suj for suj in _own_setup(kind) if suj.name == name)
    else:
        origin = published.CLASSIC_ORIGIN["ECM" if name == "ECM" else "PSM"]
        own = SetupArm(name, at.name, "Classic", None, still, origin, None, None, {})
    q = own.q
    if arm.simulated_position is not None:
        count = CLASSIC_JOINTS[name] if own.chain is None else own.chain.moving
        q = np.array(arm.simulated_position)
        if len(q) < count or q[count:].any():  # zeros for rows that do not move may follow
            allowed = f"{count} numbers (and zeros)"
            raise at.fail("simulated_position", f"got {q.tolist()}; allowed: {allowed}")
        q = q[:count]
    pots = {key: getattr(arm, key) for key in POTENTIOMETERS if getattr(arm, key) is not None}
    return replace(own, file=at.name, q=q, potentiometers=pots)


def _classic_chain(at: JsonFile[Any], chain: DhRows, count: int) -> DhRows:
    """Return a chain of which just the first rows move."""
    if len(chain.rows) < count:
        raise at.fail("dh", f"has {len(chain.rows)} rows; allowed: {count} or more")
    modes = ["active" if k < count else "passive" for k in range(len(chain.rows))]
    rows = [structs.replace(r, mode=m) for r, m in zip(chain.rows, modes, strict=True)]
    return replace(chain, rows=tuple(rows))


def read_chain(file: JsonFile[Any], key: str, dh: Dh, literal: bool, rigid: bool = False) -> DhRows:
    """Return the rows of a chain in SI.

    Args:
        file, key: where they stand
        dh: the rows
        literal: take angles as they are printed
        rigid: take joints without a range, qmin = qmax, as instruments have

    Raises:
        DescriptionError: no rows, several conventions, or limits in the wrong order
    """
    given, rows = ("joints", dh.joints) if dh.joints else ("links", dh.links)
    if not rows:
        raise file.fail(f"{key}.joints", "is missing; allowed: a list of objects (or links)")
    conventions = list(dict.fromkeys(dh.convention or row.convention for row in rows))
    if len(conventions) > 1 or conventions[0] is None:
        got = ", ".join(str(name) for name in conventions)
        allowed = "modified or standard, the same in all rows"
        raise file.fail(f"{key}.{given}[0].convention", f"got {got}; allowed: {allowed}")
    for k, row in enumerate(rows):
        none = row.qmin is not None and row.qmax is not None and not row.qmin < row.qmax
        if none and not (rigid and row.qmin == row.qmax):
            problem = f"got {row.qmin:g}; allowed: less than qmax, {row.qmax:g}"
            raise file.fail(f"{key}.{given}[{k}].qmin", problem)
    convention = cast(Literal["modified", "standard"], conventions[0])
    return DhRows(convention, tuple(_row(row, literal) for row in rows))


def _row(row: DhRow, literal: bool) -> DhRow:
    turns = row.type in ("revolute", "hinge")

    def angle(value: float) -> float:
        near = STEP * round(value / STEP)
        return near if not literal and abs(near - value) <= ROUNDED else value

    return structs.replace(
        row,
        type="revolute" if turns else "prismatic",
        alpha=angle(row.alpha),
        d=row.d + (0.0 if turns else row.offset),
        theta=angle(row.theta) + (angle(row.offset) if turns else 0.0),
        offset=0.0,
    )


def _pose(file: JsonFile[Any], key: str, rows: tuple[tuple[float, ...], ...]) -> Array:
    """Return a (4, 4) matrix that must be a pose."""
    T = np.array(rows)
    if not np.isfinite(T).all():
        raise file.fail(key, f"got {T.tolist()}; allowed: finite numbers")
    if not np.allclose(T[3], [0.0, 0.0, 0.0, 1.0], atol=1e-9):
        raise file.fail(key, f"got {T[3].tolist()} as the last row; allowed: [0, 0, 0, 1]")
    return transform(_rotation(file, key, T[:3, :3]), T[:3, 3])


def _rotation(file: JsonFile[Any], key: str, rows: Any) -> Array:
    """Return the rotation next to a matrix that was printed with few decimals."""
    R = np.array(rows)
    if not np.isfinite(R).all():  # LAPACK does not return from infinite elements
        raise file.fail(key, f"got {R.tolist()}; allowed: finite numbers")
    U, sizes, V = np.linalg.svd(R)
    if np.abs(sizes - 1.0).max() > SKEW or np.linalg.det(R) < 0.0:
        raise file.fail(
            key,
            f"got {R.tolist()}, whose determinant is {np.linalg.det(R):.4g}; allowed: a rotation"
            f" (rows at right angles, of length 1 within {SKEW:g}, right-handed)",
        )
    return U @ V
