"""Recordings from datasets, which `trocar replay` replays on the arms."""

from __future__ import annotations

import itertools
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions import load_arm
from trocar.errors import InputError, LogError, UnknownNameError
from trocar.learning.lerobot import INDEXES, Dataset, open_dataset
from trocar.outputs import check_file, whole_folder
from trocar.recording.bags import JointSamples, write_joint_states
from trocar.robot.recordings import recorded_joints
from trocar.robot.recordings.tip_poses import joints_of_tips, pose_from_numbers

Array = NDArray[np.float64]

MEASURED, JAW = "/measured_js", "/jaw/measured_js"
#: Arms that have a description: type and its name there.
ARMS = {"PSM": "psm", "ECM": "ecm", "MTML": "mtml", "MTMR": "mtmr", "MTM": "mtmr"}
#: Name of a number of a dataset: arm, joint and unit, "PSM1.yaw_rad", "psm1_joint_3.pos".
NAMED = re.compile(
    r"(?P<arm>(?:PSM|ECM|MTML|MTMR|MTM)\d*)[./_ -]+(?:outer_)?(?P<joint>[a-z_]*?(?:_?\d+)?)"
    r"(?:[._ ](?:pos|position|q))?(?:_(?P<unit>rad|deg|m|mm))?",
    re.IGNORECASE,
)
#: Name of a number of a tip's pose: "PSM1.x_m", "psm1_pose.orientation.w".
POSED = re.compile(
    r"(?P<arm>(?:PSM|ECM)\d*)[./_ -]+(?:(?:tip|pose|cp)[._ ])?(?:(?P<turn>orientation|q)[._ ]?"
    r"|position[._ ]?)?(?P<axis>[wxyz])(?:_(?P<unit>m|mm))?",
    re.IGNORECASE,
)
NUMBERED = re.compile(r"(?:joint|j|q)?_?(\d+)")
SCALES = {"rad": 1.0, "m": 1.0, "deg": float(np.pi / 180.0), "mm": 1e-3}
PARTS = ("x", "y", "z", "qw", "qx", "qy", "qz")
CHOSEN = re.compile(r"([^=\[\]]+)=([^=\[\]]+)\[(\d+):(\d+)\]")


def import_dataset(
    root: str | Path,
    output: str | Path,
    *,
    episode: int | None = None,
    columns: Sequence[str] = (),
    bases: Mapping[str, Array] | None = None,
    overwrite: bool = False,
) -> list[Path]:
    """Write episodes of a dataset as recordings that `trocar replay` replays on the arms.

    Args:
        root: folder of the dataset
        output: a file of `episode`, else a folder for all of them
        episode: its number; None: all
        columns: "ARM=COLUMN[FIRST:LAST]", numbers of a column in the order of the arm's joints, the
            last one left out; default: by the names of numbers
        bases: of arms whose poses of the tip are to be used, as there are no joints:
            {arm: T_frame_base (4, 4)}, its own base in the frame of the poses

    Returns:
        the files

    Raises:
        LogError: a torn dataset, or a pose that an arm does not reach
        InputError: no such episode, columns without joints of an arm, or an output that exists
        MissingExtraError: the extra `learn` or `record` is not installed
    """
    dataset = open_dataset(root)
    found: dict[str, _ArmNumbers | _TipNumbers] = {}
    found |= {arm: _tip_numbers(dataset, arm, T) for arm, T in (bases or {}).items()}
    if columns or not found:
        found |= _chosen(dataset, columns) if columns else _by_names(dataset)
    if episode is not None:
        target = check_file(output, overwrite)
        write_joint_states(target, _streams_of(dataset, episode, found), overwrite)
        return [target]
    with whole_folder(output, overwrite) as built:
        names = [f"episode_{k:06d}.mcap" for k in range(len(dataset))]
        for k, name in enumerate(names):
            write_joint_states(built / name, _streams_of(dataset, k, found))
    return [Path(output).expanduser() / name for name in names]


@dataclass(frozen=True)
class _ArmNumbers:
    """Numbers of a dataset that are an arm's joints.

    Attributes:
        column: of the dataset
        places: in it, in the order of the joints
        joints: their names
        jaw: whether the last one is the jaw
        scales: to rad or m
    """

    column: str
    places: tuple[int, ...]
    joints: tuple[str, ...]
    jaw: bool
    scales: tuple[float, ...]


@dataclass(frozen=True, eq=False)
class _TipNumbers:
    """Numbers of a dataset that are a pose of an arm's tip.

    Attributes:
        column: of the dataset
        places: in it, of `PARTS`
        jaw: column and place of the opening of the jaw, None without
        scale: of positions to m
        base: the arm's base in the frame of the poses, (4, 4)
    """

    column: str
    places: tuple[int, ...]
    jaw: tuple[str, int] | None
    scale: float
    base: Array


def _by_names(dataset: Dataset) -> dict[str, _ArmNumbers]:
    """Return the joints of arms by the names of numbers, from the first column that has all.

    Columns whose names have units come first.

    Raises:
        InputError: no column has those of an arm
    """
    columns = [name for name in dataset.features if name.startswith("observation.")]
    found: dict[str, _ArmNumbers] = {}
    # Names without units are perhaps those of scaled numbers: others are preferred.
    for units, column in itertools.product((True, False), columns):
        arms: dict[str, dict[str, tuple[int, float]]] = {}
        for place, name in enumerate(dataset.features[column].names):
            match = NAMED.fullmatch(name)
            if match is not None and bool(match["unit"]) is units:
                scale = SCALES[(match["unit"] or "rad").lower()]
                joint = match["joint"].lower().strip("_")
                arms.setdefault(match["arm"].upper(), {})[joint] = place, scale
        for arm, numbers in arms.items():
            if arm not in found and (one := _arm_numbers(arm, column, numbers)) is not None:
                found[arm] = one
    if found:
        return found
    seen = "; ".join(
        f"{name}: {', '.join(dataset.features[name].names[:8])}, ..." for name in columns
    )
    posed = dict.fromkeys(arm for name in columns for arm in _posed(dataset, name))
    more = (
        f", or the base of {' and '.join(posed)} in the frame of its poses, --base"
        f" {next(iter(posed))}=X,Y,Z,QW,QX,QY,QZ"
        if posed
        else ""
    )
    raise InputError(
        f"{dataset.root}: no column names all joints of an arm; got {seen or 'no observation'};"
        f" allowed: names such as PSM1.yaw_rad, --columns PSM1=observation.state[0:7]{more}"
    )


def _posed(dataset: Dataset, column: str) -> dict[str, dict[str, tuple[int, float]]]:
    """Return arms with the places and scales of `PARTS` that a column has of their tips."""
    arms: dict[str, dict[str, tuple[int, float]]] = {}
    for place, name in enumerate(dataset.features[column].names):
        if (match := POSED.fullmatch(name)) is not None:
            axis = match["axis"].lower()
            part = f"q{axis}" if match["turn"] else axis
            scale = SCALES[(match["unit"] or "m").lower()]
            arms.setdefault(match["arm"].upper(), {})[part] = place, scale
    return {arm: parts for arm, parts in arms.items() if set(parts) == set(PARTS)}


def _tip_numbers(dataset: Dataset, arm: str, base: Array) -> _TipNumbers:
    """Return the pose of an arm's tip, from the first column that has one.

    Raises:
        UnknownNameError: no column has one
    """
    known: dict[str, None] = {}
    for column in (name for name in dataset.features if name.startswith("observation.")):
        posed = _posed(dataset, column)
        known |= dict.fromkeys(posed)
        if arm in posed:
            places, scales = zip(*(posed[arm][part] for part in PARTS), strict=True)
            return _TipNumbers(column, places, _jaw_of(dataset, arm), scales[0], base)
    raise UnknownNameError("pose of the tip", arm, known, str(dataset.root))


def _jaw_of(dataset: Dataset, arm: str) -> tuple[str, int] | None:
    """Return column and place of the opening of an arm's jaw, None without."""
    for column in (name for name in dataset.features if name.startswith("observation.")):
        for place, name in enumerate(dataset.features[column].names):
            match = NAMED.fullmatch(name)
            if match and (match["arm"].upper(), match["joint"].lower()) == (arm, "jaw"):
                return column, place
    return None


def _arm_numbers(
    arm: str, column: str, numbers: Mapping[str, tuple[int, float]]
) -> _ArmNumbers | None:
    """Return the joints of an arm, None where one is missing."""
    joints, jaw = _joints_of(arm)
    own = joints[: len(joints) - jaw]
    named = dict(numbers)
    counted = {int(m[1]): n for n in numbers if (m := NUMBERED.fullmatch(n)) is not None}
    for place, number in enumerate(sorted(counted)):
        if number == min(counted) + place and place < len(joints):
            named.setdefault(joints[place], numbers[counted[number]])
    if not all(name in named for name in own):
        return None
    kept = joints if jaw and joints[-1] in named else own
    places, scales = zip(*(named[name] for name in kept), strict=True)
    return _ArmNumbers(column, places, kept, len(kept) > len(own), scales)


def _chosen(dataset: Dataset, columns: Sequence[str]) -> dict[str, _ArmNumbers]:
    """Return the joints of arms as they were chosen."""
    found: dict[str, _ArmNumbers] = {}
    for text in columns:
        if (match := CHOSEN.fullmatch(text)) is None:
            raise InputError(
                f"--columns: got {text!r}; allowed: ARM=COLUMN[FIRST:LAST], e.g."
                " PSM1=observation.state[0:7]"
            )
        arm, column = match[1], match[2]
        if column not in dataset.features:
            raise UnknownNameError("column", column, dataset.features, str(dataset.root))
        joints, jaw = _joints_of(arm)
        names = dataset.features[column].names
        places = range(int(match[3]), int(match[4]))
        counts = (len(joints), len(joints) - jaw) if jaw else (len(joints),)
        if len(places) not in counts or places.stop > len(names):
            allowed = " or ".join(map(str, counts))
            raise InputError(
                f"--columns: got {text!r}: {len(places)} of {len(names)} numbers; allowed:"
                f" {allowed} ({', '.join(joints)})"
            )
        units = [re.search(r"_(rad|deg|mm|m)$", names[k]) for k in places]
        scales = tuple(SCALES[unit[1]] if unit else 1.0 for unit in units)
        kept = joints[: len(places)]
        found[arm] = _ArmNumbers(
            column, tuple(places), kept, jaw and len(kept) == counts[0], scales
        )
    return found


def _joints_of(arm: str) -> tuple[tuple[str, ...], bool]:
    """Return the joints of an arm by its name, the jaw last, and whether it has one."""
    kind = arm.upper().rstrip("0123456789")
    if kind not in ARMS:
        raise UnknownNameError("arm", arm, ("PSM1", "PSM2", "PSM3", "ECM", "MTML", "MTMR"))
    described = load_arm(ARMS[kind])
    return recorded_joints(described), described.has_jaw


def _streams_of(
    dataset: Dataset, episode: int, found: Mapping[str, _ArmNumbers | _TipNumbers]
) -> dict[str, JointSamples]:
    """Return the joint states of an episode, {topic: samples}."""
    rows = dataset.rows(episode)
    times = np.asarray(rows[INDEXES[1]], np.float64) / dataset.rate_hz
    streams: dict[str, JointSamples] = {}
    for arm, one in found.items():
        joints, has_jaw = _joints_of(arm)
        if isinstance(one, _TipNumbers):
            q = _solved(dataset, episode, arm, one)
            jaw = has_jaw and one.jaw is not None
        else:
            q = np.asarray(rows[one.column], np.float64)[:, one.places] * np.array(one.scales)
            joints, jaw = one.joints, one.jaw
        if not np.isfinite(q).all():
            raise LogError(
                str(dataset.data_file(episode)),
                f"{one.column}: episode {episode} has positions of {arm} that are not finite",
            )
        own = q.shape[1] - jaw
        streams[f"/{arm}{MEASURED}"] = JointSamples(joints[:own], times, q[:, :own])
        if jaw:
            streams[f"/{arm}{JAW}"] = JointSamples(joints[own : own + 1], times, q[:, own:])
    return streams


def _solved(dataset: Dataset, episode: int, arm: str, one: _TipNumbers) -> Array:
    """Return the joints that bring an arm's tip to its poses, the jaw last, (n, j)."""
    described, rows = load_arm(ARMS[arm.rstrip("0123456789")]), dataset.rows(episode)
    poses = np.asarray(rows[one.column], np.float64)[:, one.places]
    file = str(dataset.data_file(episode))

    def where(frame: int) -> str:
        return f"{one.column}: episode {episode}, frame {frame}: {arm}"

    tips = [
        pose_from_numbers(file, where(k), one.scale * pose[:3], pose[3:])
        for k, pose in enumerate(poses)
    ]
    q = joints_of_tips(described, np.array(tips), one.base, file, where)
    if one.jaw is None:
        return q
    column, place = one.jaw
    return np.column_stack([q, np.asarray(rows[column], np.float64)[:, place]])
