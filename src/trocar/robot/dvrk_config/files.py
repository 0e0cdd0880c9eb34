"""JSON files of the dVRK: find them, and read their entries as records.

Source of the dialect: cisst reads these files with jsoncpp, which accepts comments; older files
spell keys with hyphens ("base-frame"), newer ones with underscores. Of the records: the schemas in
sawIntuitiveResearchKit share/schemas, and the files of share and of labs before version 2.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import (
    Annotated,
    Any,
    Generic,
    Literal,
    TypeVar,
    cast,
    get_args,
    get_origin,
    get_type_hints,
)

import msgspec

from trocar.errors import DescriptionError
from trocar.inputs import excess_of, is_file, read_input

#: Largest configuration file [bytes]. Source: our own choice; the dVRK's have up to 20 kB.
MOST_BYTES = 2_000_000
#: Keys that describe the file itself.
METADATA = ("$id", "$version", "$schema", "id", "version", "comment", "comments")
#: Folders of the dVRK's `share`. Source: sawIntuitiveResearchKit share/.
SHARE_FOLDERS = ("arm", "kinematic", "tool", "pid", "system")

T = TypeVar("T")
Flag = bool | Literal[0, 1]
Positive = Annotated[float, msgspec.Meta(gt=0.0)]
NotNegative = Annotated[float, msgspec.Meta(ge=0.0)]
Three = tuple[float, float, float]
Four = tuple[float, float, float, float]
Matrix4 = tuple[Four, Four, Four, Four]


class JsonRecord(msgspec.Struct):
    """An object of a JSON file; names are keys in lower case with underscores."""


class DhRow(JsonRecord):
    """A row of Denavit-Hartenberg parameters and the limits of its joint [m, rad, N, N m].

    `read_chain` adds the offset to d or theta, and leaves revolute or prismatic as type.
    """

    # Source: cisstRobot robJoint.cpp.
    type: Literal["revolute", "hinge", "prismatic", "slider"] = "revolute"
    mode: Literal["active", "passive"] = "active"
    a: float = 0.0
    alpha: float = 0.0
    d: float = 0.0
    theta: float = 0.0
    offset: float = 0.0
    qmin: float | None = None
    qmax: float | None = None
    ftmax: float | None = None
    convention: Literal["modified", "standard"] | None = None

    @property
    def moves(self) -> bool:
        """Whether a joint moves it."""
        return self.mode == "active"


class Dh(JsonRecord):
    """A kinematic chain; older files say `links`."""

    convention: Literal["modified", "standard"] | None = None
    joints: tuple[DhRow, ...] = ()
    links: tuple[DhRow, ...] = ()


class KinematicFile(JsonRecord):
    """kinematic/*.json, and the files of version 1 that hold an arm with its instrument."""

    dh: Dh


class InstrumentJaw(JsonRecord):
    """Limits of an instrument's jaw [rad, N m]."""

    qmin: float
    qmax: float
    ftmax: float = 0.0


class InstrumentCoupling(JsonRecord):
    """Coupling of an instrument's discs and joints."""

    actuator_to_joint: Matrix4 = msgspec.field(name="actuatortojointposition")


class ToolFile(JsonRecord):
    """tool/*.json: an instrument."""

    dh: Dh
    tooltip_offset: Matrix4
    jaw: InstrumentJaw
    coupling: InstrumentCoupling


class ToolIndexEntry(JsonRecord):
    """An instrument of an index: its full name is NAME:MODEL, by any of its names."""

    model: str
    names: tuple[str, ...]
    file: str
    description: str = ""
    generation: str = ""
    version_min: int = 0
    version_max: int | None = None


class ToolIndexFile(JsonRecord):
    """tool/index.json, or a lab's own list of instruments (custom_tool_index)."""

    instruments: tuple[ToolIndexEntry, ...] = ()


class Gain(JsonRecord):
    """PID gains of one joint, its disturbance observer and the cap of both."""

    index: int
    p_gain: NotNegative
    i_gain: NotNegative = 0.0
    d_gain: NotNegative = 0.0
    use_disturbance_observer: Flag = False
    nominal_mass: NotNegative | None = None
    disturbance_cutoff: NotNegative | None = None
    pid_max_output: float | None = None

    @property
    def pid(self) -> list[float]:
        """P, I, D."""
        return [self.p_gain, self.i_gain, self.d_gain]

    @property
    def observer(self) -> list[float] | None:
        """Nominal mass and cut-off of the observer, None where it does nothing."""
        if not (self.use_disturbance_observer and self.disturbance_cutoff):
            return None
        return [self.nominal_mass or 0.0, self.disturbance_cutoff]

    @property
    def output_max(self) -> float | None:
        """Largest effort of PID and observer, None without a limit."""
        most = self.pid_max_output
        return None if most is None or most < 0.0 else most


class PidFile(JsonRecord):
    """pid/sawControllersPID-*.json."""

    pid: tuple[Gain, ...] = ()


class PoseEntry(JsonRecord):
    """A pose as translation [m] and rotation matrix."""

    translation: Three
    rotation: tuple[Three, Three, Three]


class SetupEntry(JsonRecord):
    """The setup joints of one arm."""

    name: str
    simulated_position: tuple[float, ...] | None = None
    dh: Dh | None = None
    world_origin_to_suj: PoseEntry | None = None
    suj_tip_to_tool_origin: PoseEntry | None = None
    measured_cp: Matrix4 | None = None
    primary_offsets: tuple[float, ...] | None = None
    primary_scales: tuple[float, ...] | None = None
    secondary_offsets: tuple[float, ...] | None = None
    secondary_scales: tuple[float, ...] | None = None


class SetupFile(JsonRecord):
    """arm/suj*.json: the setup joints of a cart."""

    arms: tuple[SetupEntry, ...] = ()
    reference_arm: str = ""


class ArmFile(JsonRecord):
    """An arm's own file: NAME-SERIAL.json."""

    kinematic: str
    generation: Literal["Classic", "Si"] | None = None
    tool_detection: Literal["AUTOMATIC", "MANUAL", "FIXED"] = "AUTOMATIC"
    tool: str = ""
    custom_tool_index: str = ""
    endoscope: str = ""
    mounting_pitch: float | None = None


class BaseFrameEntry(JsonRecord):
    """The base of an arm: in a frame, or on another arm of a component."""

    transform: Matrix4 | None = None
    reference_frame: str | None = None
    component: str | None = None
    interface: str | None = None


class ArmEntry(JsonRecord):
    """An arm of a system. Systems of version 1 have `kinematic` in place of a file of its own."""

    name: str
    type: str
    serial: str = ""
    system: str = ""
    name_on_io: str = ""
    arm_file: str | None = None
    arm: str | None = None
    kinematic: str | None = None
    pid_file: str | None = None
    base_frame: BaseFrameEntry | None = None
    component: str = ""


class GripperScaling(JsonRecord):
    """Angles of a master's gripper [rad]."""

    zero: float | None = None
    max: float | None = None


class TeleopParameters(JsonRecord):
    """Parameters of a teleoperation, called as in a rig. Source: schema dvrk-teleop-PSM."""

    scale: Annotated[float, msgspec.Meta(gt=0.0, le=1.0)] | None = None
    orientation_tolerance_rad: NotNegative | None = msgspec.field(
        default=None, name="start_orientation_tolerance"
    )
    gripper_threshold_rad: NotNegative | None = msgspec.field(
        default=None, name="start_gripper_threshold"
    )
    roll_threshold_rad: NotNegative | None = msgspec.field(
        default=None, name="start_roll_threshold"
    )
    jaw_rate_rad_s: Positive | None = msgspec.field(default=None, name="jaw_rate")
    jaw_rate_after_clutch_rad_s: Positive | None = msgspec.field(
        default=None, name="jaw_rate_after_clutch"
    )
    jaw_rate_back_from_clutch: Positive | None = None
    ignore_jaw: Flag | None = None
    rotation_locked: Flag | None = None
    translation_locked: Flag | None = None
    align: Flag | None = msgspec.field(default=None, name="align_mtm")
    gripper_scaling: GripperScaling | None = None


class TeleopEntry(JsonRecord):
    """A pair of arms; older files say `master` and `slave`."""

    mtm: str | None = None
    psm: str | None = None
    mtml: str | None = None
    mtmr: str | None = None
    mtm_left: str | None = None
    mtm_right: str | None = None
    ecm: str | None = None
    master: str | None = None
    master_left: str | None = None
    master_right: str | None = None
    slave: str | None = None
    configure_parameter: TeleopParameters | None = None


class ConsoleEntry(JsonRecord):
    """Teleoperations of a console; version 2.3 and before have them in the system."""

    teleop_psms: tuple[TeleopEntry, ...] = ()
    psm_teleops: tuple[TeleopEntry, ...] = ()
    teleop_ecms: tuple[TeleopEntry, ...] = ()
    ecm_teleop: TeleopEntry | None = None


class ComponentEntry(JsonRecord):
    """A component that the system creates."""

    class_name: str = ""
    constructor_arg: Any = None


class ComponentManager(JsonRecord):
    """Components that the system creates; none of them is simulated."""

    components: tuple[ComponentEntry, ...] = ()


class Settings(JsonRecord):
    """Settings of a system."""

    path: tuple[str, ...] = ()


class SystemFile(ConsoleEntry):
    """system-*.json, or console-*.json of version 2.3 and before."""

    arms: tuple[ArmEntry, ...] = ()
    consoles: tuple[ConsoleEntry, ...] = ()
    settings: Settings | None = None
    component_manager: ComponentManager | None = None


#: Keys without a counterpart in a simulation; masses in a kinematic file are those of gravity
#: compensation.
IDLE = frozenset(
    re.findall(
        r"\w+",
        """
        io ios io_file io_gripper_file io_pedals io_head_sensor io_clutch io_camera hid_file
        io_operator_present io_pedals_interfaces pedals clutch camera operator_present
        component_clutch component_camera component_operator_present console_inputs input_type
        physical_footpedals_required endoscope_focus isi_focus_controller component_manager
        custom_components chatty audio_volume pid pid_period period simulation skip_ros_bridge
        socket socket_server remote_ip port system interface name type rotation psm_base_frame
        ecm_base_frame base_frame component kinematic_gc gravity_compensation gravity_tilt
        re_home kinematic_type homing_zero_position platform_gain
        always_home homing_goes_to_zero plug_number serial_number
        brake_release_current arduino_mac base_arduino_mac mtm_is_haptic
        use_mtm_linear_velocity use_mtm_angular_velocity use_mtm_velocity coupling
        tooltip_offset tool_engage_position tool_joint_limit tool_torque_limit
        p_measured_setpoint_tolerance p_deadband i_forget_rate i_limit position_limit_min
        position_limit_max effort_cut_off snake_like mass cx cy cz ixx iyy izz x1 x2 x3 y1
        y2 y3 z1 z2 z3
        """,
    )
)


@dataclass(frozen=True, eq=False)
class JsonFile(Generic[T]):
    """A file that was read.

    Attributes:
        name: its path, as messages have it
        data: its content as it stands
        entries: its content as a record
        prefix: path of the entry that this stands for, "" for the whole file
    """

    name: str
    data: Any
    entries: T
    prefix: str = ""

    def at(self, prefix: str) -> JsonFile[T]:
        """Return the same file with messages about what is under `prefix`."""
        return replace(self, prefix=f"{self.prefix}.{prefix}".strip("."))

    def place(self, key: str = "") -> str:
        """Return the path of an entry in the file's own spelling.

        Args:
            key: path below the prefix, with keys in lower case: "arms[0].base_frame"
        """
        data, spelled = self.data, ""
        for name, index in re.findall(r"(\w+)|\[(\d+)\]", f"{self.prefix}.{key}"):
            if index:
                spelled += f"[{index}]"
                data = cast(list[Any], data)[int(index)] if isinstance(data, list) else None
                continue
            inside = cast(dict[str, Any], data) if isinstance(data, dict) else {}
            own = next((k for k in inside if _plain(k) == name), name)
            data, spelled = inside.get(own), f"{spelled}.{own}".strip(".")
        return spelled

    def fail(self, key: str, problem: str) -> DescriptionError:
        """Return the error for an entry: file, key, what was got, what is allowed."""
        return DescriptionError(self.name, self.place(key), problem)


class Sources:
    """The files of one configuration: found as the dVRK finds them, each read once.

    They are looked for beside the system's file, in `share`, and in the folders above that look
    like the dVRK's `share`.

    Attributes:
        folders: where files are looked for
        warnings: files whose name differs from the one given
        absent: names of files that are not there, for which the dVRK's published content is taken
    """

    def __init__(self, system: Path, share: Iterable[Path]) -> None:
        beside = system.resolve().parent
        above = [
            folder
            for folder in (beside, *list(beside.parents)[:2])
            if any((folder / name).is_dir() for name in SHARE_FOLDERS)
        ]
        self.folders = list(dict.fromkeys([beside, *(p.expanduser() for p in share), *above]))
        self.warnings: list[str] = []
        self.absent: list[str] = []
        self._files: dict[Path, JsonFile[Any]] = {}

    def add(self, folders: Iterable[str]) -> None:
        """Look in these, too: relative ones from where the system's file lies, and from here."""
        for folder in folders:
            for place in (self.folders[0] / folder, Path(folder)):
                if place.is_dir() and place not in self.folders:
                    self.folders.append(place)

    def find(self, name: str) -> Path | None:
        """Return a file's path, whatever the case of letters, - or _; None where it is nowhere.

        A lab's own file that is not in the folder it names is taken from beside the system's.
        """
        first, beside = Path(name).parts[0], self.folders[0]
        # "jhu-dVRK/custom-tool/X.json" of a configuration that lies in jhu-dVRK
        own = [
            beside.parents[k - 1] for k, part in enumerate(beside.parts[::-1], 1) if part == first
        ]
        folders = [*self.folders, *own]
        exact = next((f / name for f in folders if os.path.isfile(f / name)), None)
        if exact is not None:
            return exact
        for folder in folders:
            found = [folder]
            for part in Path(name).parts:
                found = [p for f in found for p in _listed(f) if _plain(p.name) == _plain(part)]
            if found and is_file(found[0]):
                used = f"used {found[0]}, whose name differs in case, - or _"
                self.warnings.append(f"{name}: {used}")
                return found[0]
        if len(Path(name).parts) == 1 or _plain(first) in SHARE_FOLDERS:
            return None
        # "jhu-dVRK/X.json" of a folder that was copied or renamed
        last = _plain(Path(name).name)
        copied = next((p for p in _listed(beside) if _plain(p.name) == last and is_file(p)), None)
        if copied is not None:
            self.warnings.append(f"{name}: used {copied}, which lies beside the system's file")
        return copied

    def missing(self, file: JsonFile[Any], key: str, name: str) -> DescriptionError:
        """Return the error that says where a file was looked for."""
        places = ", ".join(str(folder) for folder in self.folders)
        return file.fail(
            key,
            f"got {name!r}, not found in {places}; allowed: a file in one of these, or in a"
            " folder given by --share (sawIntuitiveResearchKit/share)",
        )

    def read(self, path: Path, kind: type[T]) -> JsonFile[T]:
        """Return a file as a record, read once.

        Raises:
            DescriptionError: it cannot be read, is no JSON, or does not fit the record
        """
        if path not in self._files:
            data = parse_json(path)
            self._files[path] = JsonFile(str(path), data, converted(str(path), data, kind))
        return self._files[path]

    def leftovers(self) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """Return "FILE: KEY, ..." without counterpart in a simulation, and "FILE: KEY" unknown."""
        idle: list[str] = []
        unknown: list[str] = []
        for file in self._files.values():
            left = list(_leftovers(file.data, type(file.entries), ""))
            keys = dict.fromkeys(re.sub(r"\[\d+\]", "[]", key) for key, known in left if known)
            idle += [f"{file.name}: {', '.join(keys)}"] if keys else []
            unknown += [f"{file.name}: {key}" for key, known in left if not known]
        return tuple(idle), tuple(unknown)


def parse_json(path: Path) -> dict[str, Any]:
    """Return the content of a JSON file with comments.

    Raises:
        DescriptionError: it cannot be read, is no JSON (line and column are named), holds no
            object, or gives a key twice
    """
    file = str(path)

    def once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        seen: dict[str, str] = {}
        for key, _ in pairs:
            if _plain(key) in seen:
                before = seen[_plain(key)]
                raise DescriptionError(
                    file, key, f"is given twice (first as {before!r}); allowed: once"
                )
            seen[_plain(key)] = key
        return dict(pairs)

    def constant(name: str) -> None:
        raise DescriptionError(file, "", f"got {name}; allowed: finite numbers")

    try:
        text = read_input(path, MOST_BYTES).decode("utf-8-sig")
        # Strings stay; of comments only the line breaks stay, for the lines of error messages.
        text = re.sub(
            r'("(?:\\.|[^"\\])*")|//[^\n]*|/\*.*?(?:\*/|\Z)',
            lambda m: m[1] or re.sub(r"[^\n]", " ", m[0]),
            text,
            flags=re.DOTALL,
        )
        data = json.loads(text, object_pairs_hook=once, parse_constant=constant)
    except json.JSONDecodeError as problem:
        where = f"line {problem.lineno} column {problem.colno}"
        raise DescriptionError(file, "", f"is not JSON: {problem.msg} ({where})") from problem
    except (OSError, UnicodeDecodeError) as problem:
        raise DescriptionError(file, "", f"cannot be read: {problem}") from problem
    except RecursionError as problem:
        raise DescriptionError(file, "", "is not JSON: nested too deeply") from problem
    except ValueError as problem:  # an integer of thousands of digits
        raise DescriptionError(file, "", f"is not JSON: {problem}") from problem
    if excess := excess_of(data):
        raise DescriptionError(file, "", excess)
    if not isinstance(data, dict):
        raise DescriptionError(file, "", "is not a JSON object; allowed: {...} at the top level")
    return cast(dict[str, Any], data)


def converted(name: str, data: Any, kind: type[T]) -> T:
    """Return JSON data as a record.

    Args:
        name: of the file, for messages
        data: as `parse_json` returns it
        kind: a child of `JsonRecord`

    Raises:
        DescriptionError: file, key, what was got, what is allowed
    """

    def plain(value: Any) -> Any:
        if isinstance(value, dict):
            return {_plain(k): plain(v) for k, v in cast(dict[str, Any], value).items()}
        return [plain(v) for v in cast(list[Any], value)] if isinstance(value, list) else value

    entries = plain(data)
    try:
        return msgspec.convert(entries, kind)
    except msgspec.ValidationError as problem:
        text, _, path = str(problem).partition(" - at `$")
        missing = re.match(r"Object missing required field `(\w+)`", text)
        steps = re.findall(r"(\w+)|\[(\d+)\]", path) + ([(missing[1], "")] if missing else [])
        expected, got, key = cast(Any, kind), entries, ""
        for step, index in steps:
            if get_origin(expected) is tuple and not _is_record(get_args(expected)[0]):
                break  # a list of numbers is named as a whole
            expected = _inner(get_args(expected)[0] if index else _hints(expected)[step])
            got = got[int(index)] if index else got.get(step)
            key += f"[{index}]" if index else f".{step}"
        problem_text = "is missing" if missing else f"got {got!r}"
        place = JsonFile(name, data, None).place(key)
        allowed = _allowed(expected)
        raise DescriptionError(name, place, f"{problem_text}; allowed: {allowed}") from problem


def _is_record(expected: Any) -> bool:
    return isinstance(expected, type) and issubclass(expected, JsonRecord)


def _hints(kind: Any) -> dict[str, Any]:
    """Return the types of a record's entries by key."""
    types = get_type_hints(kind, include_extras=True)
    fields = zip(kind.__struct_encode_fields__, kind.__struct_fields__, strict=True)
    return {key: types[field] for key, field in fields}


def _inner(expected: Any) -> Any:
    """Return a type without `None` as an alternative."""
    given = [kind for kind in get_args(expected) if kind is not type(None)]
    return given[0] if type(None) in get_args(expected) and len(given) == 1 else expected


def _allowed(expected: Any) -> str:
    """Describe what an entry of some type may be."""
    args = get_args(expected)
    if get_origin(expected) is Literal:
        return ", ".join(str(value) for value in args)
    if get_origin(expected) is Annotated:
        meta = args[1]
        top = "" if meta.le is None else f" to {meta.le:g}"
        return ("above 0" if meta.ge is None else "0") + (top or (" or more" * (meta.gt is None)))
    if get_origin(expected) is tuple:
        if args[-1] is not ...:
            rows = get_args(args[0])
            return f"{len(args)} rows of {len(rows)} numbers" if rows else f"{len(args)} numbers"
        return "a list of " + ("objects" if _is_record(args[0]) else f"{_NAMES[args[0]]}s")
    if bool in args:
        return "true, false"
    return "an object {...}" if _is_record(expected) else _ONE[expected]


_NAMES: dict[Any, str] = {float: "number", str: "text"}
_ONE: dict[Any, str] = {float: "a finite number", str: "a text", int: "a whole number"}


def _leftovers(data: Any, expected: Any, path: str) -> Iterator[tuple[str, bool]]:
    """Yield the keys that no record takes, and whether each is known."""
    expected = _inner(expected)
    if get_origin(expected) is tuple and isinstance(data, list):
        for k, item in enumerate(cast(list[Any], data)):
            yield from _leftovers(item, get_args(expected)[0], f"{path}[{k}]")
    elif _is_record(expected) and isinstance(data, dict):
        hints = _hints(expected)
        for key, value in cast(dict[str, Any], data).items():
            place = f"{path}.{key}".strip(".")
            if _plain(key) in hints and _inner(hints[_plain(key)]) is not ComponentManager:
                yield from _leftovers(value, hints[_plain(key)], place)
            elif _plain(key) not in METADATA:
                yield place, _plain(key) in IDLE


def _listed(folder: Path) -> list[Path]:
    return sorted(folder.iterdir()) if folder.is_dir() else []


def _plain(key: str) -> str:
    return key.lower().replace("-", "_")
