"""Columns of a table of numbers: which arm, quantity, joint and unit each one holds."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from trocar.errors import InputError, LogError, UnknownNameError

#: Words of a column's name by quantity. Source: headers of public recordings of da Vinci robots, of
#: rostopic, ros2 topic, bagpy and PlotJuggler.
QUANTITY_WORDS = {
    "position": "position positions pos q qs jp js angle angles theta state",
    "velocity": "velocity velocities vel vels qd dq qdot jv speed speeds v",
    "effort": "effort efforts torque torques tau force forces jf",
    "other": "acceleration accelerations acc qdd ddq jerk current currents temperature voltage"
    " error errors seq frame id nsecs wrench twist",
}
SETPOINT_WORDS = frozenset((
    "setpoint", "sp", "desired", "des", "goal", "commanded", "cmd", "command", "target", "ref",
    "reference", "action", "servo",
))  # fmt: skip
#: Words without a meaning of their own.
PLAIN_WORDS = frozenset((
    "joint", "joints", "j", "measured", "actual", "current", "data", "robot", "dvrk", "davinci",
    "field", "observation", "observations", "of", "the", "arm", "cp", "local", "tip", "tool",
    "tooltip", "pose", "ee", "cartesian", "trocar", "outer",
))  # fmt: skip
ARM_WORDS = re.compile(r"(?i)(psm|ecm|mtml|mtmr|mtm|suj)(\d*)")
UNITS = {
    "rad": ("angle", 1.0), "radian": ("angle", 1.0), "radians": ("angle", 1.0),
    "deg": ("angle", np.pi / 180.0), "degree": ("angle", np.pi / 180.0),
    "degrees": ("angle", np.pi / 180.0), "mrad": ("angle", 1e-3), "urad": ("angle", 1e-6),
    "m": ("length", 1.0), "meter": ("length", 1.0), "meters": ("length", 1.0),
    "mm": ("length", 1e-3), "cm": ("length", 1e-2), "um": ("length", 1e-6),
    "inch": ("length", 0.0254), "inches": ("length", 0.0254),
    "s": ("time", 1.0), "sec": ("time", 1.0), "secs": ("time", 1.0), "seconds": ("time", 1.0),
    "ms": ("time", 1e-3), "us": ("time", 1e-6), "ns": ("time", 1e-9), "nsec": ("time", 1e-9),
    "n": ("effort", 1.0), "nm": ("effort", 1.0), "mnm": ("effort", 1e-3), "nmm": ("effort", 1e-3),
}  # fmt: skip
TIME_NAMES = frozenset((
    "time", "t", "times", "timestamp", "timestamps", "stamp", "secs", "sec", "rosbagtimestamp",
    "rostime", "ros_time", "walltime", "header_stamp", "time_stamp", "elapsed", "elapsed_time",
    "epoch_time", "simtime", "seconds", "ros_timestamp", "clock",
))  # fmt: skip
#: Words of a tip's pose, whose roll, pitch and yaw are no joints.
TIP_WORDS = frozenset((
    "ee", "eef", "tcp", "tip", "tooltip", "cp", "cartesian", "euler", "rpy", "pose", "orientation",
))  # fmt: skip
#: Joints that an arm in a table has at least. Source: our own choice; a wrist may be unrecorded.
FEWEST_JOINTS = 3
PARTS = ("x", "y", "z", "qx", "qy", "qz", "qw")
#: Topics of dVRK 1.x. Source: its robot's topics, 1.4 to 1.7.
OLD_NAMES = re.compile(r"(state|position)_(joint|jaw)_current")
#: Angles of a tip about fixed axes: R = R_z(yaw) R_y(pitch) R_x(roll). Source: URDF; PyKDL, GetRPY.
ANGLES = ("roll", "pitch", "yaw")
#: The x and the z axis of a tip.
AXES = ("xx", "xy", "xz", "zx", "zy", "zz")
PLACE_WORDS = frozenset(["position", "translation", "trans", "xyz", "p"])
TURN_WORDS = frozenset(("r", "rot", "rotation", "rotm", "orientation", "matrix"))
#: "position=1:8[deg]" or "PSM1.jaw=gripper". Places count from 0, the last one left out.
CHOSEN = re.compile(r"(?:(?P<arm>[\w-]+)\.)?(?P<what>[a-z]+)=(?P<place>[^=\[\]]+)"
                    r"(?:\[(?P<units>[^\[\]]*)\])?")  # fmt: skip
WHATS = ("time", "position", "velocity", "effort", "jaw", "tip", "quaternion", "rotation", "rpy")


@dataclass(frozen=True)
class ScaledColumn:
    """A column of a table, and what brings its numbers to SI units; 0: to be found out."""

    column: int
    scale: float = 1.0


@dataclass(frozen=True)
class ArmPlaces:
    """Columns of one arm in a table.

    Attributes:
        label: name of the arm in the table, "" where it has none
        position, velocity, effort: {joint: its column}
        tip: {part of the tip's pose: its column}; parts are x y z, and qx qy qz qw, r0 ... r8, the
            rotation matrix row by row, `AXES` or `ANGLES`
    """

    label: str
    position: Mapping[str, ScaledColumn]
    velocity: Mapping[str, ScaledColumn]
    effort: Mapping[str, ScaledColumn]
    tip: Mapping[str, ScaledColumn]

    @property
    def has_tip(self) -> bool:
        """Whether the pose of the tip is complete."""
        turned = ("qx", "qy", "qz", "qw"), tuple(f"r{k}" for k in range(9)), AXES, ANGLES
        return all(part in self.tip for part in "xyz") and any(
            all(part in self.tip for part in parts) for parts in turned
        )


@dataclass(frozen=True)
class ColumnName:
    """A column's name, taken apart.

    Attributes:
        arm: "PSM1", words that nothing explains, or ""
        setpoint: whether it is commanded rather than measured
        quantity: "position", "velocity", "effort", "tip" or "other"
        joint: name or number of the joint, or the part of a pose; None: not said
        unit: as it is spelled, "" without
    """

    arm: str
    setpoint: bool
    quantity: str
    joint: str | int | None
    unit: str


def is_time(name: str) -> bool:
    """Return whether a column's name is one of times."""
    words = _words(_without_unit(name)[0])
    if not words:
        return False
    joined = "_".join(words)
    plain = joined.removeprefix("field_")
    return plain in TIME_NAMES or words[-1] in ("timestamp", "stamp")


def time_scale(name: str) -> float | None:
    """Return the unit that a name of times has [s]; None without one."""
    unit = _without_unit(name)[1]
    kind, scale = UNITS.get(unit, ("", 0.0))
    if kind == "time" and _words(_without_unit(name)[0]):
        return scale
    if name.strip().lower() in ("%time", "rosbagtimestamp", "field.header.stamp"):
        return 1e-9  # rostopic echo -p
    return None


def taken_apart(name: str, joints: Sequence[str]) -> ColumnName:
    """Take a column's name apart.

    Args:
        name: as in the header
        joints: of the arm, the jaw or gripper last
    """
    bare, unit = _without_unit(OLD_NAMES.sub(r"\2", name))
    words = _words(bare)
    arm, rest = _arm(words)
    setpoint = any(word in SETPOINT_WORDS for word in rest)
    rest = [word for word in rest if word not in SETPOINT_WORDS]
    joint, rest = _joint(rest, joints)
    quantity = ""
    for kind, known in QUANTITY_WORDS.items():
        if kind == "other" and quantity:  # the "current position" is no current
            rest = [word for word in rest if word != "current"]
        if any(word in known.split() for word in rest):
            quantity = kind if quantity != "other" else quantity
            rest = [word for word in rest if word not in known.split()]
    part = _part(words)
    if joint in ANGLES and TIP_WORDS & set(words):
        joint, part = None, joint
    if joint is None and part is not None and quantity in ("", "position"):
        turn = {"orientation", "rotation", "rot", "quaternion", "quat"}
        if part in "xyzw" and (turn & set(words) or part == "w"):
            part = f"q{part}"
        quantity, joint = "tip", part
        spent = turn | TURN_WORDS | PLACE_WORDS | TIP_WORDS
        rest = [w for w in rest if w not in spent and w != words[-1]]
    numbers = [word for word in rest if word.isdigit()]
    if joint is None and numbers:
        joint = int(numbers[-1])
    if isinstance(joint, int) and TIP_WORDS & set(words):
        return ColumnName(arm, setpoint, "other", None, unit)  # a vector of the tip's pose
    label = [w for w in rest if not w.isdigit() and w not in PLAIN_WORDS]
    if joint is not None and not quantity:
        quantity = "position"
    return ColumnName(arm or "_".join(label), setpoint, quantity or "other", joint, unit)


def find_arms(names: Sequence[str], joints: Sequence[str], has_end: bool) -> list[ArmPlaces]:
    """Find the arms whose joints or poses a header names.

    Args:
        names: of the columns
        joints: of the arm that is looked for; the jaw last where `has_end`
        has_end: whether the last joint may be missing

    Returns:
        arms with the positions of their first joints or the pose of their tip
    """
    groups: dict[tuple[str, bool], dict[str, dict[str | int, ScaledColumn]]] = {}
    for column, name in enumerate(names):
        if is_time(name):
            continue
        one = taken_apart(name, joints)
        if one.quantity == "other" or one.joint is None or one.arm.upper().startswith("SUJ"):
            continue
        kind, scale = UNITS.get(one.unit, ("", 0.0))
        scale = scale if kind in ("angle", "length", "effort") else 0.0
        group = groups.setdefault((one.arm, one.setpoint), {})
        group.setdefault(one.quantity, {}).setdefault(one.joint, ScaledColumn(column, scale))
    found: dict[str, ArmPlaces] = {}
    for (label, _), group in sorted(groups.items(), key=lambda item: item[0][1]):
        if label in found:
            continue
        named = {
            what: _by_joint(group.get(what, {}), joints)
            for what in ("position", "velocity", "effort")
        }
        tip = {str(k): place for k, place in group.get("tip", {}).items()}
        if "qw" not in tip and "qy" in tip and "roll" in tip:
            tip["yaw"] = tip.pop("qy")  # "rot r", "rot p", "rot y"
        one = ArmPlaces(label, named["position"], named["velocity"], named["effort"], tip)
        first = joints[: len(joints) - has_end][:FEWEST_JOINTS]
        if all(joint in one.position for joint in first) or one.has_tip:
            found[label] = one
    own = joints[: len(joints) - has_end]
    whole = [one for one in found.values() if one.has_tip or all(j in one.position for j in own)]
    return whole or list(found.values())


def lacking(names: Sequence[str], joints: Sequence[str]) -> list[str]:
    """List the joints of the arm that a header lacks, where it has some of them."""
    seen = {taken_apart(name, joints).joint for name in names}
    return [joint for joint in joints if joint not in seen] if seen & set(joints) else []


def chosen_places(
    texts: Sequence[str], names: Sequence[str], width: int, joints: Sequence[str]
) -> tuple[ScaledColumn | None, list[ArmPlaces]]:
    """Return the column of times and those of the arms, as they are given.

    Args:
        texts: "[ARM.]WHAT=COLUMNS[UNIT]" each, of `WHATS`; COLUMNS is a name or number, FIRST:LAST
            (from 0, LAST left out), or several joined by +; units of angle and length
        names: of the table's columns, if it has a header
        width: number of columns
        joints: of the arm

    Raises:
        InputError: a text that is none of these
        UnknownNameError: no such column
    """
    time: ScaledColumn | None = None
    arms: dict[str, dict[str, dict[str, ScaledColumn]]] = {}
    for text in texts:
        match = CHOSEN.fullmatch(text.strip())
        if match is None or match["what"] not in WHATS:
            raise InputError(
                f"--columns: got {text!r}; allowed: [ARM.]WHAT=COLUMNS[UNIT], WHAT one of"
                f" {', '.join(WHATS)}, e.g. time=0[ms], position=1:8[deg], PSM1.velocity=8:15"
            )
        places = _columns(match["place"], names, width)
        what, units = match["what"], [u for u in re.split(r"[/, ]+", match["units"] or "") if u]
        for unit in units:
            if unit.lower() not in UNITS:
                raise UnknownNameError("unit", unit, UNITS, "--columns")
        scales = dict(UNITS[unit.lower()] for unit in units)
        if what == "time":
            time = ScaledColumn(places[0], scales.get("time", 0.0))
            continue
        keys = {
            "position": joints, "velocity": joints, "effort": joints, "jaw": joints[-1:],
            "tip": PARTS, "quaternion": PARTS[3:], "rotation": [f"r{k}" for k in range(9)],
            "rpy": ANGLES,
        }[what]  # fmt: skip
        if what == "tip" and len(places) == 3:
            keys = PARTS[:3]
        if len(places) > len(keys) or (what == "rotation" and len(places) != 9):
            raise InputError(
                f"--columns: got {text!r}: {len(places)} columns; allowed: {len(keys)}"
                f" ({', '.join(keys)})"
            )
        group = arms.setdefault(match["arm"] or "", {})
        tips = dict.fromkeys(("quaternion", "rotation", "rpy"), "tip")
        quantity = {"jaw": "position", **tips}.get(what, what)
        for key, column in zip(keys, places, strict=False):
            length = key in PARTS[:3] or key == "insertion"
            kind = "effort" if what == "effort" else "length" if length else "angle"
            group.setdefault(quantity, {})[key] = ScaledColumn(column, scales.get(kind, 0.0))
    return time, [
        ArmPlaces(label, *(group.get(k, {}) for k in ("position", "velocity", "effort", "tip")))
        for label, group in arms.items()
    ]


def _columns(text: str, names: Sequence[str], width: int) -> list[int]:
    """Return the numbers of the columns that "1:8", "3" or "a+b" are."""
    if (match := re.fullmatch(r"(\d+):(\d+)", text)) is not None:
        first, last = int(match[1]), int(match[2])
        if not first < last <= width:
            raise InputError(f"--columns: got {text!r}; allowed: FIRST:LAST in 0:{width}")
        return list(range(first, last))
    places: list[int] = []
    for part in text.split("+"):
        if part in names:
            places.append(list(names).index(part))
        elif part.isdigit() and int(part) < width:
            places.append(int(part))
        else:
            raise UnknownNameError("column", part, names or [str(k) for k in range(width)])
    return places


def choose_arm(file: str, labels: Iterable[str], name: str, kind: str, of: str | None) -> str:
    """Choose an arm of a file.

    Args:
        file: for errors
        labels: names of its arms
        name, kind: of the described arm, "psm2" and "PSM"
        of: the chosen one; None: the only one, that of the same name, or the only one of its type

    Raises:
        LogError: several fit
        UnknownNameError: no such arm
    """
    known = list(dict.fromkeys(labels))
    if of is not None:
        same = [label for label in known if label.lower() == of.lower()]
        if not same:
            raise UnknownNameError("arm", of, known, file)
        return same[0]
    for fitting in (
        [label for label in known if label.lower() == name.lower()],
        [label for label in known if label.upper().startswith(kind)],
        known,
    ):
        if len(fitting) == 1:
            return fitting[0]
    raise LogError(file, f"holds {len(known)} arms; select one with --of: {', '.join(known)}")


def _by_joint(
    given: Mapping[str | int, ScaledColumn], joints: Sequence[str]
) -> dict[str, ScaledColumn]:
    """Name numbered joints, which count from 0 or 1."""
    named = {joint: given[joint] for joint in joints if joint in given}
    numbers = sorted(k for k in given if isinstance(k, int))
    if numbers and numbers[0] in (0, 1) and len(numbers) <= len(joints):
        for number in numbers:
            place = number - numbers[0]
            if place < len(joints):
                named.setdefault(joints[place], given[number])
    return named


def _without_unit(name: str) -> tuple[str, str]:
    """Return a name and its unit: "q1 [deg]", "yaw_rad", "insertion (mm)"."""
    text = name.strip()
    match = re.fullmatch(r"(.*?)\s*[\[(]\s*([A-Za-z/ .*^\d]+?)\s*[\])]", text)
    if match is not None:
        unit = re.split(r"[/ .*^]", match[2].lower())[0]
        whole = re.sub(r"[^a-z]", "", match[2].lower())
        unit = whole if whole in ("nm", "mnm", "nmm") else unit
        if unit in UNITS:
            return match[1], unit
    words = re.split(r"[_ ]+", text)
    if len(words) > 2 and words[-1].lower() == "s" and words[-2].lower() in UNITS:
        return "_".join(words[:-2]), words[-2].lower()
    if len(words) > 1 and words[-1].lower() in UNITS:
        return "_".join(words[:-1]), words[-1].lower()
    return text, ""


def _words(name: str) -> list[str]:
    """Return the lower-case words and numbers of a name."""
    spaced = re.sub(r"([a-z])([A-Z])", r"\1_\2", name)
    return re.findall(r"[a-z]+|\d+", spaced.lower())


def _arm(words: Sequence[str]) -> tuple[str, list[str]]:
    """Return the arm that words name, "PSM1", and the other words."""
    for place, word in enumerate(words):
        match = ARM_WORDS.fullmatch(word)
        if match is not None:
            rest = list(words[:place]) + list(words[place + 1 :])
            counted = word == "psm" and place < len(rest) and rest[place] in ("1", "2", "3")
            return word.upper() + (rest.pop(place) if counted else ""), rest
    return "", list(words)


def _joint(words: Sequence[str], joints: Sequence[str]) -> tuple[str | None, list[str]]:
    """Return the joint that words name, and the other words."""
    for joint in sorted(joints, key=len, reverse=True):
        spellings = [joint.split("_"), joint.removeprefix("outer_").split("_")]
        if joint == joints[-1] and joint in ("jaw", "gripper"):
            spellings += [["jaw"], ["gripper"], ["grip"], ["grasper"]]
        for spelled in spellings:
            for place in range(len(words) - len(spelled) + 1):
                if list(words[place : place + len(spelled)]) == spelled:
                    return joint, list(words[:place]) + list(words[place + len(spelled) :])
    return None, list(words)


def _part(words: Sequence[str]) -> str | None:
    """Return the part of a pose that a name ends with."""
    last = words[-1] if words else ""
    if last in ("x", "y", "z", "w", *PARTS):
        return last
    if last in ("r", "p") and words[-2:-1] in (["rot"], ["rotation"], ["orientation"]):
        return "roll" if last == "r" else "pitch"
    turned = TURN_WORDS & set(words)
    if turned and len(words) > 2 and all(w in ("1", "2", "3") for w in words[-2:]):
        return f"r{3 * (int(words[-2]) - 1) + int(last) - 1}"
    if len(words) > 1 and last.isdigit() and len(last) in (1, 2):
        before = words[-2]
        if before in TURN_WORDS:
            if len(last) == 2:
                row, column = int(last[0]) - 1, int(last[1]) - 1
                return f"r{3 * row + column}" if 0 <= row < 3 and 0 <= column < 3 else None
            return f"r{int(last)}" if int(last) < 9 else None
    return None
