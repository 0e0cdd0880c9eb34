"""One reader of kinematic recordings: bags, text of any layout, and datasets."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions import ArmDescription
from trocar.errors import InputError, LogError, UnknownNameError
from trocar.geometry.rotations import matrix_from_rpy
from trocar.recording import is_recording
from trocar.recording.bags import is_bag, open_bag
from trocar.robot.recordings.arm_motion import QUANTITIES, ArmMotion, checked_motion
from trocar.robot.recordings.columns import (
    ANGLES,
    ARM_WORDS,
    AXES,
    FEWEST_JOINTS,
    PARTS,
    UNITS,
    ArmPlaces,
    ScaledColumn,
    choose_arm,
    chosen_places,
    find_arms,
    is_time,
    lacking,
    time_scale,
)
from trocar.robot.recordings.layouts import (
    JIGSAWS,
    JIGSAWS_HZ,
    TableLayout,
    public_layout,
)
from trocar.robot.recordings.motor_side import Wrist, joints_from_motors, recorded_joints
from trocar.robot.recordings.parquet import is_parquet, read_parquet
from trocar.robot.recordings.tables import MOST_BEFORE, READABLE, NumberTable, read_table
from trocar.robot.recordings.tip_poses import joints_along, pose_from_numbers
from trocar.robot.recordings.topics import arm_topics, read_bag_motion, read_bag_tip

Array = NDArray[np.float64]
Kind = Literal["recording", "bag", "table", "rows"]

#: Rate of rows without times that have velocities, which confirm it [Hz]. Source: the recorder of
#: dvrk_dynamics_identification.
ROWS_HZ = 200.0
#: Range of rates by which a unit of time is told [Hz]. Source: our own choice; s, ms, us and ns are
#: a thousand apart.
RATES_HZ = 2.0, 10_000.0
#: Largest position of a tip [m]. Source: our own choice; a PSM reaches 0.3 m.
FARTHEST_M = 2.0
#: Position [m] and part of a rotation beyond which a pose is a row without one. Source: our own
#: choice; a part of a rotation is 1 at most.
MOST_M, MOST_TURN = 1e3, 2.0
#: Largest difference of a quaternion's norm from 1. Source: our own choice, numbers of four digits.
UNIT_ERROR = 1e-3
#: Columns beyond which a table without a header is perhaps transposed. Source: our own choice; a
#: pair of arms has 76.
MOST_WIDTH = 300


#: Least correlation of a joint's velocities with differences of its positions. Source: our own
#: choice.
ALIKE = 0.5
#: Differences of steps from the usual one in a column of times: with the jitter of a recorder, and
#: without. Source: our own choice.
ROUGHLY, EVENLY = 0.5, 1e-3


@dataclass(frozen=True)
class ReadSettings:
    """Settings for reading a recording.

    Attributes:
        rate_hz: of rows without times [Hz]; of motions with times the rate that they are read at
        wrist: of rows without a header: on which side of the coupling coupled joints were recorded
        topic, jaw: of a bag: topics of the joint states (or poses of the tip) and of the jaw; found
            by name when omitted
        of: name of the arm in the file, where it holds several
        columns: "[ARM.]WHAT=COLUMNS[UNIT]" of a table, see `chosen_places`; by its header when
            omitted
        units: of columns that do not say theirs, "deg/mm"; None: rad and m
        base: of poses of the tip: the arm's own base in their frame, (4, 4); "centred": where the
            mean pose is that of its home; None: the poses are in it
        episode: of a dataset
    """

    rate_hz: float | None = None
    wrist: Wrist = "motor"
    topic: str | None = None
    jaw: str | None = None
    of: str | None = None
    columns: tuple[str, ...] = ()
    units: str | None = None
    base: Array | Literal["centred"] | None = None
    episode: int | None = None

    def __post_init__(self) -> None:
        """Check the settings.

        Raises:
            InputError: a rate that is not above 0, or another wrist
        """
        if self.wrist not in ("motor", "joint"):
            raise InputError(f"wrist: got {self.wrist!r}; allowed: motor, joint")
        if self.rate_hz is not None and not 0.0 < self.rate_hz < np.inf:
            raise InputError(f"rate: got {self.rate_hz!r} Hz; allowed: more than 0")


def recording_kind(path: str | Path) -> Kind:
    """Determine the kind of a file: a recording, a bag, or a table with or without a header."""
    if is_parquet(path):
        return "table"
    if is_recording(path):
        return "recording"
    if is_bag(path):
        return "bag"
    return "table" if read_table(path, most_rows=MOST_BEFORE + 1).names else "rows"


def read_arm_motion(
    path: str | Path,
    arm: ArmDescription,
    how: ReadSettings | None = None,
    *,
    partial: bool = False,
) -> ArmMotion:
    """Read the motion of an arm.

    Args:
        path: a bag, a text file or a dataset
        arm: the recorded arm, with the tool that was mounted
        how: how to read it; the defaults when omitted
        partial: whether a table may lack any joints after the third, and not only all of them;
            they then are 0

    Raises:
        LogError: it cannot be read, or is no recording of this arm; file and row are named
        InputError: a setting, or one that is needed
        MissingExtraError: a library for this kind of file is not installed
    """
    how = how or ReadSettings()
    if not Path(path).expanduser().exists():
        raise LogError(str(path), f"no such file; allowed: {READABLE}")
    if not is_parquet(path) and is_bag(path):
        motion = read_bag_motion(open_bag(path), arm, how.topic, how.jaw, how.of, how.base)
        return checked_motion(motion, arm, rate_given=True)
    table = _table(path, how)
    layout = _layout(table, arm, how)
    if layout is None:
        return _bare_motion(table, arm, how)
    one = _one_arm(table, arm, how, layout.arms)
    motion = _motion_of(table, arm, how, one, _times(table, layout, how))
    joints = recorded_joints(arm)
    own = joints[: len(joints) - arm.has_jaw]
    absent = [joint for joint in own if joint not in motion.recorded[0]]
    if absent and not partial and len(absent) < len(own) - FEWEST_JOINTS:
        raise _lacks(table.file, absent, joints)
    return motion


def read_tip_positions(
    path: str | Path, arm: ArmDescription, how: ReadSettings
) -> tuple[str, Array, Array] | None:
    """Read the positions of an arm's tip from a table that holds them, or a bag without joints.

    Args:
        path: a bag, a text file or a dataset
        arm: the recorded arm
        how: how to read it

    Returns:
        name of the arm in the file, times (k,) [s], positions (k, 3) [m]; None from other files

    Raises:
        LogError, InputError: as for `read_arm_motion`
    """
    if not is_parquet(path) and is_bag(path):
        return read_bag_tip(open_bag(path), arm, how.topic, how.of)
    table = _table(path, how)
    layout = _layout(table, arm, how)
    if layout is None:
        return None
    one = _one_arm(table, arm, how, layout.arms)
    if not all(part in one.tip for part in "xyz"):
        return None
    times, _, _ = _times(table, layout, how)
    p = _places(table, how, one)
    known = np.isfinite(p).all(axis=1) & np.isfinite(times)
    return one.label, times[known], p[known]


def arms_in(path: str | Path, arm: ArmDescription, how: ReadSettings | None = None) -> list[str]:
    """List the arms of a bag or table that may be of a description's type, by their names in it.

    Args:
        path: a bag, a text file or a dataset
        arm: a description of their type
        how: how to read it
    """
    how = how or ReadSettings()
    if not is_parquet(path) and is_bag(path):
        labels = list(arm_topics(open_bag(path)))
    else:
        layout = _layout(_table(path, how), arm, how)
        labels = [""] if layout is None else [one.label for one in layout.arms]
    return [
        label
        for label in dict.fromkeys(labels)
        if label.upper().startswith(arm.type) or not ARM_WORDS.match(label)
    ]


def _table(path: str | Path, how: ReadSettings) -> NumberTable:
    table = read_parquet(path, how.episode) if is_parquet(path) else read_table(path)
    if not len(table.values):
        empty = "holds no rows of numbers" if table.names else "is empty"
        raise LogError(table.file, f"{empty}; allowed: 2 rows or more")
    return table


def _layout(table: NumberTable, arm: ArmDescription, how: ReadSettings) -> TableLayout | None:
    """Return the columns as they are given, by the header, or of a public layout."""
    joints, width = recorded_joints(arm), table.values.shape[1]
    rate = JIGSAWS_HZ if width == JIGSAWS else None
    if how.columns:
        time, arms = chosen_places(how.columns, table.names, width, joints)
        return TableLayout(tuple(arms), time, rate)
    if table.names:
        return TableLayout(tuple(find_arms(table.names, joints, arm.has_jaw)), rate_hz=rate)
    return public_layout(table.values, joints, arm.has_jaw)


def _one_arm(
    table: NumberTable, arm: ArmDescription, how: ReadSettings, found: Sequence[ArmPlaces]
) -> ArmPlaces:
    """Choose the arm's columns."""
    joints = recorded_joints(arm)
    own = joints[: len(joints) - arm.has_jaw]
    if not found:
        if missing := lacking(table.names, own):
            raise _lacks(table.file, missing, joints)
        seen = ", ".join(table.names)[:200]
        raise LogError(
            table.file,
            f"has no columns of the joints of {arm.name}: {seen}; allowed: {_allowed(joints)}",
            1,
        )
    label = choose_arm(table.file, [a.label for a in found], arm.name, arm.type, how.of)
    one = next(a for a in found if a.label == label)
    return one


def _lacks(file: str, missing: Sequence[str], joints: Sequence[str]) -> LogError:
    names = ", ".join(f"{joint}_position" for joint in missing)
    return LogError(
        file,
        f"lacks columns {names}; allowed: {_allowed(joints)}, e.g. --columns"
        f" position={'+'.join(f'NAME{k + 1}' for k in range(FEWEST_JOINTS))}+...",
        1,
    )


def _allowed(joints: Sequence[str]) -> str:
    return (
        "time, and JOINT_position, JOINT_velocity (optional), JOINT_effort (optional) of"
        f" {', '.join(joints)} or their numbers, or --columns"
    )


def _motion_of(
    table: NumberTable,
    arm: ArmDescription,
    how: ReadSettings,
    places: ArmPlaces,
    timing: tuple[Array, bool, float],
) -> ArmMotion:
    """Collect an arm's columns, row by row."""
    joints = recorded_joints(arm)
    own = joints[: len(joints) - arm.has_jaw]
    times, timed, clock = timing
    slides = {j.name: j.kind == "prismatic" for j in arm.joints}
    rows = np.full((len(times), 3, len(joints)), np.nan)
    recorded = [set[str](), set[str](), set[str]()]
    solved = places.has_tip and not all(joint in places.position for joint in own)
    for quantity, given in enumerate((places.position, places.velocity, places.effort)):
        for joint, place in given.items():
            if joint not in joints or (solved and joint in own):
                continue
            kind = "" if quantity == 2 else "m" if slides[joint] else "rad"
            rows[:, quantity, joints.index(joint)] = _values(table, place, how, kind)
            recorded[quantity].add(joint)
    notes = [*table.notes]
    if solved:
        tip = _tips(table, how, places)
        known = np.isfinite(tip).all(axis=(1, 2)) & np.isfinite(times)
        q, note = joints_along(arm, tip[known], how.base, table.file, table.rows[known])
        rows[known, 0, : len(own)] = q
        recorded[0].update(own)
        notes.append(note)
    present = [joints.index(joint) for joint in own if joint in recorded[0]]
    known = np.isfinite(rows[:, 0, present]).all(axis=1) & np.isfinite(times)
    if not known.all():
        notes.append(f"{int((~known).sum())} of {len(known)} rows without positions left out")
    if known.sum() < 2:
        raise LogError(table.file, f"got {int(known.sum())} rows with positions; allowed: 2 rows"
                       " or more")  # fmt: skip
    for quantity in range(3):
        for k, joint in enumerate(joints):
            column = rows[:, quantity, k]
            has = np.isfinite(column) & np.isfinite(times)
            if not has.any():
                column[:] = 0.0
                recorded[quantity].discard(joint)
            elif not has[known].all():
                order = np.argsort(times[has], kind="stable")
                column[known] = np.interp(times[known], times[has][order], column[has][order])
    motion = ArmMotion(
        table.file,
        places.label or arm.name,
        joints,
        times[known],
        rows[known],
        (frozenset(recorded[0]), frozenset(recorded[1]), frozenset(recorded[2])),
        table.rows[known],
        timed=timed,
        clock=clock,
        notes=tuple(notes),
    )
    given = timed or how.rate_hz is not None
    return checked_motion(motion, arm, given)


def _places(table: NumberTable, how: ReadSettings, places: ArmPlaces) -> Array:
    """Return the positions of the tip, (k, 3) [m].

    Raises:
        LogError: too far away for an arm
    """
    p = np.stack([_values(table, places.tip[part], how, "m") for part in "xyz"], axis=1)
    if np.nanmedian(np.abs(p)) > FARTHEST_M:
        raise LogError(
            table.file,
            f"the tip is {np.nanmedian(np.abs(p)):.3g} m away; allowed: {FARTHEST_M:g} m (another"
            " unit: --units rad/mm)",
        )
    return p


def _tips(table: NumberTable, how: ReadSettings, places: ArmPlaces) -> Array:
    """Return the poses of the tip, (k, 4, 4); NaN in rows without one."""
    p = _places(table, how, places)
    parts = ("qw", "qx", "qy", "qz") if "qw" in places.tip else tuple(f"r{k}" for k in range(9))
    if AXES[-1] in places.tip:
        axes = np.stack([_values(table, places.tip[part], how, "") for part in AXES], axis=1)
        x, z = axes[:, :3], axes[:, 3:]
        turn = np.stack([x, np.cross(z, x), z], axis=2).reshape(-1, 9)
    elif parts[-1] in places.tip:
        turn = np.stack([_values(table, places.tip[part], how, "") for part in parts], axis=1)
    else:
        rpy = np.stack([_values(table, places.tip[part], how, "rad") for part in ANGLES], axis=1)
        turn = np.stack([matrix_from_rpy(*angles).ravel() for angles in rpy.tolist()])
    found = np.full((len(p), 4, 4), np.nan)
    near = (np.abs(p) < MOST_M).all(axis=1) & (np.abs(turn) < MOST_TURN).all(axis=1)
    for k in np.flatnonzero(near).tolist():
        found[k] = pose_from_numbers(table.file, f"row {table.rows[k]}", p[k], turn[k])
    return found


def _values(table: NumberTable, place: ScaledColumn, how: ReadSettings, kind: str) -> Array:
    """Return a column in SI units.

    Args:
        table, place: the column
        how: has the units of columns that do not say theirs
        kind: "rad", "m", or "" for what has no other unit

    Raises:
        LogError: a field that is neither a number nor empty
    """
    if place.column in table.texts:
        row, text = table.texts[place.column]
        name = table.names[place.column] if table.names else f"column {place.column + 1}"
        raise LogError(table.file, f"{name}: got {text!r}; allowed: a number", row)
    scale = place.scale or _units(how.units).get(kind, 1.0)
    return table.values[:, place.column] * scale


def _units(text: str | None) -> Mapping[str, float]:
    """Return the factors that bring angles and lengths without a unit to SI."""
    found: dict[str, float] = {}
    for word in re.split(r"[/, ]+", text) if text else ():
        kind, scale = UNITS.get(word.lower(), ("", 0.0))
        if kind not in ("angle", "length"):
            known = [unit for unit, (k, _) in UNITS.items() if k in ("angle", "length")]
            raise UnknownNameError("unit", word, known, "--units")
        found["rad" if kind == "angle" else "m"] = scale
    return found


def _times(table: NumberTable, layout: TableLayout, how: ReadSettings) -> tuple[Array, bool, float]:
    """Return the times of the rows [s], whether the file has them, and its clock at time 0 [s]."""
    place = layout.time
    names = [name.strip() for name in table.names]
    lower = [name.lower() for name in names]
    split = next(
        (
            (lower.index(name), lower.index(name.removesuffix(a) + b))
            for a, b in (("secs", "nsecs"), ("sec", "nanosec"), ("sec", "nsec"))
            for name in lower
            if name.endswith(a) and name.removesuffix(a) + b in lower
        ),
        None,
    )
    if place is None and split is not None:
        times = table.values[:, split[0]] + 1e-9 * table.values[:, split[1]]
        if len(np.unique(times)) > 1:  # 0 where nobody stamped the messages
            return times, True, 0.0
    if place is None:
        known = [k for k, name in enumerate(names)
                 if is_time(name) and k not in table.texts
                 and np.isfinite(table.values[:, k]).any()]  # fmt: skip
        stamps = [k for k in known if "stamp" in lower[k] and "header" in lower[k]]
        if known:
            column = (stamps or known)[0]
            place = ScaledColumn(column, time_scale(names[column]) or 0.0)
    if place is None and table.dates:
        place = ScaledColumn(min(table.dates), 1.0)
    if place is None:
        rate = how.rate_hz or layout.rate_hz
        if not rate:
            raise InputError(f"{table.file}: has no times; give the rate of its rows, --rate HZ")
        return np.arange(len(table.values)) / rate, False, 0.0
    times = _values(table, ScaledColumn(place.column, 1.0), how, "")
    steps = np.diff(times[np.isfinite(times)])
    usual = float(np.median(steps[steps > 0.0])) if (steps > 0.0).any() else 0.0
    if not usual > 0.0 and len(steps):
        raise LogError(table.file, "the times do not rise; name their column, --columns time=NAME")
    scale = 1.0 if place.column in table.dates else place.scale
    if not scale:
        units = (1.0, 1e-3, 1e-6, 1e-9)
        fitting = [s for s in units if 1.0 / RATES_HZ[1] < usual * s < 1.0 / RATES_HZ[0]]
        scale = fitting[0] if fitting else 1.0
    # whole nanoseconds of today lose their last digits as float64: count from the first
    first = times[np.flatnonzero(np.isfinite(times))[0]]
    return (times - first) * scale, True, float(first * scale)


def _bare_motion(table: NumberTable, arm: ArmDescription, how: ReadSettings) -> ArmMotion:
    """Read rows without a header: positions, velocities, efforts of all joints, in this order.

    A first or a further last column that rises evenly is the time. Velocities and efforts may be
    missing; all three may be those of the first three joints alone.
    """
    joints = recorded_joints(arm)
    if table.holes:
        column, (row, text) = min(table.holes.items(), key=lambda one: one[1][0])
        raise LogError(table.file, f"column {column + 1}: got {text!r}; allowed: a number", row)
    own = len(joints) - arm.has_jaw
    counts = {k * n: (k, n) for n in (own, len(joints)) for k in (1, 2, 3)}
    counts.setdefault(3 * FEWEST_JOINTS, (3, FEWEST_JOINTS))
    width = table.values.shape[1]
    asked = width not in counts or (how.rate_hz is None and width <= len(joints))
    time: int | None = None
    if width - 1 in counts and asked:
        time = _time_column(table, (0,) if width in counts else (0, width - 1), own)
    timed = time is not None
    if not timed and width not in counts:
        example = f", e.g. --columns position=0:{min(own, width)}"
        if width == len("xyz"):
            example += f", of the tip alone, for `trocar score`, --columns tip=0:{width}"
        raise LogError(
            table.file,
            f"got {width} column{'s' * (width != 1)}; allowed: {3 * len(joints)}"
            f" ({', '.join(QUANTITIES)} of {', '.join(joints)}), {2 * len(joints)} or"
            f" {len(joints)}, {3 * FEWEST_JOINTS} (of the first {FEWEST_JOINTS}), a column of times"
            f" before or after them, or --columns{example if width >= FEWEST_JOINTS else ''}"
            + (" (a sample a row: is this table transposed?)" if width > MOST_WIDTH else ""),
            int(table.rows[0]),
        )
    parts, count = counts[width - timed]
    own_columns = np.delete(table.values, time, axis=1) if timed else table.values
    values = own_columns.reshape(-1, parts, count)
    if parts == 1 and count == len(PARTS) and _are_quaternions(values[:, 0, 3:]):
        first = f"{int(time == 0)}:{int(time == 0) + len(PARTS)}"
        raise InputError(
            f"{table.file}: the last four columns are quaternions of poses, no joints; name them,"
            f" --columns {f'time={time},' if timed else ''}tip={first} ({', '.join(PARTS)})"
        )
    if parts == 2 and not _alike(values[:, 0], values[:, 1]):
        raise InputError(
            f"{table.file}: {2 * count} columns are not positions and their velocities; name them,"
            f" e.g. --columns PSM1.position=0:{count},PSM2.position={count}:{2 * count}"
        )
    rows = np.zeros((len(values), 3, len(joints)))
    rows[:, :parts, :count] = values
    if how.wrist == "motor" and count == len(joints):
        rows = joints_from_motors(rows, arm)
    units = _units(how.units)
    slides = np.array([joint.kind == "prismatic" for joint in arm.joints[: len(joints)]])
    rows[:, :2] *= np.where(slides, units.get("m", 1.0), units.get("rad", 1.0))
    known, none = frozenset(joints[:count]), frozenset[str]()
    velocities = known if parts > 1 and rows[:, 1].any() else none
    efforts = known if parts > 2 and rows[:, 2].any() else none
    clock = 0.0
    if time is not None:
        times, _, clock = _times(table, TableLayout((), ScaledColumn(time, 0.0)), how)
    else:
        if how.rate_hz is None and not velocities and rows[:, 0].any():
            raise InputError(f"{table.file}: has no times; give the rate of its rows, --rate HZ")
        times = np.arange(len(rows)) / (how.rate_hz or ROWS_HZ)
    motion = ArmMotion(
        table.file, arm.name, joints, times, rows, (known, velocities, efforts), table.rows,
        timed=timed, clock=clock, notes=table.notes,
    )  # fmt: skip
    return checked_motion(motion, arm, timed or how.rate_hz is not None)


def _time_column(table: NumberTable, ends: Sequence[int], own: int) -> int | None:
    """Return the column, of those at the ends of the rows, that rises as times do.

    Raises:
        InputError: both do, equally evenly
    """
    rising = [k for k in ends if _rises(table.values[:, k], ROUGHLY)]
    even = [k for k in rising if _rises(table.values[:, k], EVENLY)]
    if len(even) > 1:
        last = ends[-1]
        raise InputError(
            f"{table.file}: the first and the last of {last + 1} columns rise as times do; name"
            f" them, --columns time=0,position=1:{own + 1} or time={last},position=0:{own}"
        )
    return next(iter(even or rising), None)


def _rises(column: Array, apart: float) -> bool:
    """Return whether numbers rise in steps this much apart at most, but for pauses."""
    steps = np.diff(column)
    if not len(steps):
        return False
    usual = float(np.median(steps))
    return usual > 0.0 and float(np.mean(np.abs(steps - usual) < apart * usual)) > 0.9


def _are_quaternions(columns: Array) -> bool:
    """Return whether the numbers of every row, (k, 4), have the norm of a turn."""
    return bool((np.abs(np.linalg.norm(columns, axis=1) - 1.0) < UNIT_ERROR).all())


def _alike(positions: Array, velocities: Array) -> bool:
    """Return whether most of the joints that move have the velocities of their positions."""
    moved = np.diff(positions, axis=0)
    told = 0.5 * (velocities[:-1] + velocities[1:])
    sizes = np.linalg.norm(moved, axis=0) * np.linalg.norm(told, axis=0)
    ratios = (moved * told).sum(axis=0)[sizes > 0.0] / sizes[sizes > 0.0]
    return not len(ratios) or float(np.median(ratios)) > ALIKE
