"""Datasets from recordings of arms, simulated or real, and recordings from datasets."""

from __future__ import annotations

import itertools
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions import load_arm
from trocar.errors import InputError, LogError, UnknownNameError
from trocar.learning.cards import write_card
from trocar.learning.lerobot import INDEXES, Dataset, DatasetWriter, Feature, open_dataset
from trocar.outputs import check_file, check_folder, whole_folder
from trocar.recording.bags import (
    JOINT_STATE,
    POSES,
    Bag,
    JointSamples,
    open_bag,
    write_joint_states,
)
from trocar.robot.logs import recorded_joints

Array = NDArray[np.float64]

#: Rate of a dataset unless another is given. Source: our own choice, that of trocar's actions. [Hz]
RATE_HZ = 50
MEASURED, SETPOINT, POSE, JAW = "/measured_js", "/setpoint_js", "/measured_cp", "/jaw"
#: Beginning of the topics of objects. Source: `trocar.recording`.
OBJECTS = "scene/"
#: Arms that have a description: type and its name there.
ARMS = {"PSM": "psm", "ECM": "ecm", "MTML": "mtml", "MTMR": "mtmr", "MTM": "mtmr"}
#: Joint that slides. Source: descriptions of PSM and ECM.
SLIDES, SLIDES_AT = "insertion", 2
#: A frame within this time of a sample is that sample's [s]. Source: rounding of nanoseconds.
ROUNDING_S = 1e-6
#: Name of a number of a dataset: arm, joint and unit, "PSM1.yaw_rad", "psm1_joint_3.pos".
NAMED = re.compile(
    r"(?P<arm>(?:PSM|ECM|MTML|MTMR|MTM)\d*)[./_ -]+(?:outer_)?(?P<joint>[a-z_]*?(?:_?\d+)?)"
    r"(?:[._ ](?:pos|position|q))?(?:_(?P<unit>rad|deg|m|mm))?",
    re.IGNORECASE,
)
NUMBERED = re.compile(r"(?:joint|j|q)?_?(\d+)")
SCALES = {"rad": 1.0, "m": 1.0, "deg": float(np.pi / 180.0), "mm": 1e-3}
CHOSEN = re.compile(r"([^=\[\]]+)=([^=\[\]]+)\[(\d+):(\d+)\]")
POSE_PARTS = ("x_m", "y_m", "z_m", "qw", "qx", "qy", "qz")


@dataclass(frozen=True, eq=False)
class Motion:
    """An uninterrupted motion in a recording, at even times.

    Attributes:
        joints, velocities, setpoints: of all arms, (n, j) [rad or m, per s]
        tips, objects: poses with quaternion wxyz, (n, 7 a) and (n, 7 o) [m]
    """

    joints: Array
    velocities: Array
    setpoints: Array
    tips: Array
    objects: Array


@dataclass(frozen=True)
class Exported:
    """Result of an export: episodes, frames, and arms in the dataset."""

    episodes: int
    frames: int
    arms: tuple[str, ...]


def export(
    recordings: Sequence[str | Path],
    folder: str | Path,
    *,
    rate_hz: int = RATE_HZ,
    arms: Sequence[str] = (),
    task: str = "",
    overwrite: bool = False,
    command: str = "",
    watch: Callable[[int], None] = lambda _: None,
) -> Exported:
    """Write recordings as a dataset of LeRobot's, with a card.

    A recording is an episode, and one more begins wherever its time goes back (the world was
    reset). Rows are at even times: joints between two samples are filled in evenly, poses are those
    of the nearest sample. The action is the set-points at the next row; where there are none, the
    measured joints.

    Args:
        recordings: bags of arms or recordings of worlds, all of the same arms and objects
        folder: a new or an empty one
        rate_hz: rows a second
        arms: to keep; default: all
        task: in words
        overwrite: the folder may hold something
        command: that made the dataset, for its card
        watch: called with the number of recordings so far

    Raises:
        LogError: a recording that cannot be used; it is named
        UnknownNameError: no such arm
        InputError: a rate that is not above 0, or a folder that cannot be written
        MissingExtraError: the extra `learn` or `bags` is not installed
    """
    if not 1 <= rate_hz <= 1000:
        raise InputError(f"rate: got {rate_hz}; allowed: 1 to 1000 Hz")
    check_folder(folder, overwrite)
    first = _Streams(open_bag(recordings[0]), arms)
    with whole_folder(folder, overwrite) as built:
        robot = "dvrk_" + "_".join(name.lower() for name in first.arms)
        with DatasetWriter(built, rate_hz, first.features, robot) as writer:
            sources: list[str] = []
            for number, path in enumerate(recordings, 1):
                streams = _Streams(open_bag(path), arms)
                if streams.features != first.features:
                    raise LogError(
                        str(path),
                        f"has {streams.label}; {recordings[0]} has {first.label}; allowed: the same"
                        " arms and objects in all recordings",
                    )
                for motion in streams.motions(rate_hz):
                    writer.add(streams.columns(motion), task or Path(path).stem, source=str(path))
                    sources.append(Path(path).name)
                watch(number)
            if not sources:
                raise LogError(str(recordings[-1]), f"lasts less than two rows at {rate_hz} Hz")
        about = {
            "arms": [*first.arms],
            "objects": [*first.objects],
            "policy": "recorded",
            "rate_hz": rate_hz,
            "episodes": len(sources),
            "recordings": sources,
            "command": command,
        }
        title = f"{len(sources)} recorded episodes of {', '.join(first.arms)}"
        write_card(built, title, about, first.features, simulated=bool(first.objects))
    return Exported(len(sources), writer.frames, first.arms)


def import_dataset(
    root: str | Path,
    output: str | Path,
    *,
    episode: int | None = None,
    columns: Sequence[str] = (),
    overwrite: bool = False,
) -> list[Path]:
    """Write episodes of a dataset as recordings that `trocar replay` replays on the arms.

    Args:
        root: folder of the dataset
        output: a file of `episode`, else a folder for all of them
        episode: its number; None: all
        columns: "ARM=COLUMN[FIRST:LAST]", numbers of a column in the order of the arm's joints, the
            last one left out; default: by the names of numbers

    Returns:
        the files

    Raises:
        LogError: a torn dataset
        InputError: no such episode, columns without joints of an arm, or an output that exists
        MissingExtraError: the extra `learn` or `record` is not installed
    """
    dataset = open_dataset(root)
    found = _chosen(dataset, columns) if columns else _by_names(dataset)
    if episode is not None:
        target = check_file(output, overwrite)
        write_joint_states(target, _streams_of(dataset, episode, found), overwrite)
        return [target]
    with whole_folder(output, overwrite) as built:
        names = [f"episode_{k:06d}.mcap" for k in range(len(dataset))]
        for k, name in enumerate(names):
            write_joint_states(built / name, _streams_of(dataset, k, found))
    return [Path(output).expanduser() / name for name in names]


# ------------------------------------------------------------------ recordings


class _Streams:
    """Joint states and poses of a recording."""

    def __init__(self, bag: Bag, wanted: Sequence[str]) -> None:
        self._file = bag.file
        joints = [name for name, kind in bag.topics.items() if kind == JOINT_STATE]
        known = sorted(
            name.removesuffix(MEASURED)
            for name in joints
            if name.endswith(MEASURED) and not name.endswith(JAW + MEASURED)
        )
        for name in wanted:
            if name not in known:
                raise UnknownNameError("arm", name, known, bag.file)
        if not known:
            raise LogError(bag.file, f"contains no joint states; allowed: a topic /ARM{MEASURED}")
        self.arms = tuple(name for name in known if not wanted or name in wanted)
        groups = [arm + part for arm in self.arms for part in ("", JAW)]
        measured = [name + MEASURED for name in groups if name + MEASURED in joints]
        setpoints = [name for name in joints if name.endswith(SETPOINT)]
        posed = [name for name, kind in bag.topics.items() if kind in POSES]
        tips = [arm + POSE for arm in self.arms if arm + POSE in posed]
        objects = sorted(n for n in posed if n.startswith(OBJECTS) and n.endswith(POSE))
        self.objects = tuple(n.removeprefix(OBJECTS).removesuffix(POSE) for n in objects)
        self._read_joints(bag, [*measured, *setpoints])
        self._read_poses(bag, [*tips, *objects])
        self._measured = [name for name in measured if name in self._joints]
        self._tips = [name for name in tips if name in self._poses]
        self._objects = [name for name in objects if name in self._poses]
        if not self._measured:
            raise LogError(bag.file, "contains no message of joint states")
        self.features = self._features()

    @property
    def label(self) -> str:
        """Arms and objects, for messages."""
        return ", ".join((*self.arms, *self.objects))

    def motions(self, rate_hz: int) -> Iterator[Motion]:
        """Yield the motions of at least two rows and the one after."""
        times = {
            **{name: part[0] for name, part in self._joints.items()},
            **{name: part[0] for name, part in self._poses.items()},
        }
        used = [times[name] for name in (*self._measured, *self._tips, *self._objects)]
        for begin, end in self._spans:
            inside = [t[(t >= begin) & (t < end)] for t in used]
            if any(len(part) < 2 for part in inside):
                continue
            low, high = max(part[0] for part in inside), min(part[-1] for part in inside)
            count = int((high - low + ROUNDING_S) * rate_hz) + 1
            if count < 3:
                continue
            even = np.minimum(low + np.arange(count) / rate_hz, high)
            measured = [self._filled(name, even) for name in self._measured]
            goals = [self._filled(self._goal_of(name), even) for name in self._measured]
            q = np.concatenate([part[:, 0] for part in measured], axis=1)
            v = np.concatenate([part[:, 1] for part in measured], axis=1)
            goal = np.concatenate([part[:, 0] for part in goals], axis=1)
            tips, objects = self._nearest(self._tips, even), self._nearest(self._objects, even)
            yield Motion(q, v, goal, tips, objects)

    def columns(self, motion: Motion) -> dict[str, NDArray[Any]]:
        """Return the columns of an episode; the last row of a motion is only its action's."""
        count = len(motion.joints) - 1
        columns = {
            "observation.state": motion.joints[:-1],
            "observation.velocities": motion.velocities[:-1],
            "observation.tips": motion.tips[:-1],
            "observation.objects": motion.objects[:-1],
            "action": motion.setpoints[1:],
            "next.done": np.arange(count) == count - 1,
        }
        return {name: columns[name] for name in self.features}

    def _read_joints(self, bag: Bag, topics: Sequence[str]) -> None:
        """Read joint states, and the spans in which time does not go back."""
        times: dict[str, list[float]] = {}
        values: dict[str, list[tuple[Any, Any]]] = {}
        self._names: dict[str, tuple[str, ...]] = {}
        begins, latest = [0.0], dict[str, float]()
        for topic, time, fields in bag.messages(topics):
            if fields["stamp"] < latest.get(topic, 0.0) and time > begins[-1]:
                begins.append(time)
                latest.clear()
            latest[topic] = fields["stamp"]
            position, velocity = (np.asarray(fields[k], float) for k in ("position", "velocity"))
            names = self._names.setdefault(
                topic, tuple(fields["name"]) or tuple(map(str, range(len(position))))
            )
            if len(position) != len(names):
                raise LogError(
                    bag.file, f"/{topic}: got {len(position)} positions; allowed: {len(names)}"
                )
            if times.setdefault(topic, []) and time <= times[topic][-1]:
                continue
            times[topic].append(time)
            full = velocity if len(velocity) == len(position) else np.full(len(position), np.nan)
            values.setdefault(topic, []).append((position, full))
        self._spans = [*zip(begins, [*begins[1:], np.inf], strict=True)]
        self._joints: dict[str, tuple[Array, Array]] = {}
        for topic, rows in values.items():
            table, time = np.array(rows), np.array(times[topic])
            if np.isnan(table[:, 1]).any() and len(time) > 1:
                table[:, 1] = np.gradient(table[:, 0], time, axis=0)
            self._joints[topic] = time, np.nan_to_num(table)

    def _read_poses(self, bag: Bag, topics: Sequence[str]) -> None:
        times: dict[str, list[float]] = {}
        values: dict[str, list[Array]] = {}
        self._frames: dict[str, str] = {}
        for topic, time, frame, pose in bag.poses(topics) if topics else ():
            times.setdefault(topic, []).append(time)
            values.setdefault(topic, []).append(pose)
            self._frames[topic] = frame
        self._poses = {name: (np.array(times[name]), np.array(values[name])) for name in values}

    def _features(self) -> dict[str, Feature]:
        joints = tuple(
            f"{topic.removesuffix(MEASURED).removesuffix(JAW)}.{_with_unit(topic, name, place)}"
            for topic in self._measured
            for place, name in enumerate(self._names[topic])
        )
        velocities = tuple(f"{name}_s" for name in joints)
        arms = [name.removesuffix(POSE) for name in self._tips]
        frames = dict.fromkeys(self._frames[name] for name in self._tips)
        objects = [n.removeprefix(OBJECTS).removesuffix(POSE) for n in self._objects]
        features = {
            "observation.state": Feature(joints),
            "observation.velocities": Feature(velocities),
            "observation.tips": Feature(_poses(arms), frame=", ".join(frames)),
            "observation.objects": Feature(_poses(objects), frame="world"),
            "action": Feature(joints),
            "next.done": Feature(("done",), "bool"),
        }
        return {name: one for name, one in features.items() if one.names}

    def _goal_of(self, measured: str) -> str:
        """Return the topic of set-points that belongs to a measured one, itself without."""
        topic = measured.removesuffix(MEASURED) + SETPOINT
        same = topic in self._joints and self._names[topic] == self._names[measured]
        return topic if same else measured

    def _filled(self, topic: str, even: Array) -> Array:
        """Return positions and velocities at other times, (n, 2, j)."""
        times, table = self._joints[topic]
        flat = table.reshape(len(table), -1)
        filled = np.stack([np.interp(even, times, column) for column in flat.T], axis=1)
        return filled.reshape(len(even), *table.shape[1:])

    def _nearest(self, topics: Sequence[str], even: Array) -> Array:
        """Return the poses of the samples nearest to other times, (n, 7 k)."""
        parts = [np.zeros((len(even), 0))]
        for topic in topics:
            times, table = self._poses[topic]
            after = np.clip(np.searchsorted(times, even), 1, len(times) - 1)
            earlier = even - times[after - 1] < times[after] - even
            parts.append(table[after - earlier])
        return np.concatenate(parts, axis=1)


def _with_unit(topic: str, name: str, place: int) -> str:
    """Return a joint's name with its unit; the dVRK numbers joints from "0"."""
    arm = topic.split("/")[-2 if topic.count("/") else 0]
    numbered = name.isdigit() and arm.startswith(("PSM", "ECM")) and place == SLIDES_AT
    return f"{name}_{'m' if SLIDES in name or numbered else 'rad'}"


def _poses(names: Sequence[str]) -> tuple[str, ...]:
    return tuple(f"{name}.{part}" for name in names for part in POSE_PARTS)


# ------------------------------------------------------------------ datasets


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
    raise InputError(
        f"{dataset.root}: no column names all joints of an arm; got {seen or 'no observation'};"
        " allowed: names such as PSM1.yaw_rad, or --columns PSM1=observation.state[0:7]"
    )


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
        found[arm] = _ArmNumbers(column, tuple(places), kept, len(kept) == counts[0], scales)
    return found


def _joints_of(arm: str) -> tuple[tuple[str, ...], bool]:
    """Return the joints of an arm by its name, the jaw last, and whether it has one."""
    kind = arm.upper().rstrip("0123456789")
    if kind not in ARMS:
        raise UnknownNameError("arm", arm, ("PSM1", "PSM2", "PSM3", "ECM", "MTML", "MTMR"))
    described = load_arm(ARMS[kind])
    return recorded_joints(described), described.has_jaw


def _streams_of(
    dataset: Dataset, episode: int, found: Mapping[str, _ArmNumbers]
) -> dict[str, JointSamples]:
    """Return the joint states of an episode, {topic: samples}."""
    rows = dataset.rows(episode)
    times = np.asarray(rows[INDEXES[1]], np.float64) / dataset.rate_hz
    streams: dict[str, JointSamples] = {}
    for arm, one in found.items():
        q = np.asarray(rows[one.column], np.float64)[:, one.places] * np.array(one.scales)
        if not np.isfinite(q).all():
            raise LogError(
                str(dataset.data_file(episode)),
                f"{one.column}: episode {episode} has positions of {arm} that are not finite",
            )
        own = len(one.joints) - one.jaw
        streams[f"/{arm}{MEASURED}"] = JointSamples(one.joints[:own], times, q[:, :own])
        if one.jaw:
            jaw = JointSamples(one.joints[own:], times, q[:, own:])
            streams[f"/{arm}{JAW}{MEASURED}"] = jaw
    return streams
