"""Datasets from recordings of arms, simulated or real."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trocar.errors import InputError, LogError, UnknownNameError
from trocar.learning.cards import write_card
from trocar.learning.lerobot import DatasetWriter, Feature
from trocar.outputs import check_folder, whole_folder
from trocar.recording.bags import JOINT_STATE, POSES, Bag, open_bag

Array = NDArray[np.float64]

#: Rate of a dataset unless another is given. Source: our own choice, that of trocar's actions. [Hz]
RATE_HZ = 50
MEASURED, SETPOINT, POSE, JAW = "/measured_js", "/setpoint_js", "/measured_cp", "/jaw"
#: Beginning of the topics of objects. Source: `trocar.recording`.
OBJECTS = "scene/"
#: Joint that slides. Source: descriptions of PSM and ECM.
SLIDES, SLIDES_AT = "insertion", 2
#: A frame within this time of a sample is that sample's [s]. Source: rounding of nanoseconds.
ROUNDING_S = 1e-6
POSE_PARTS = ("x_m", "y_m", "z_m", "qw", "qx", "qy", "qz")


@dataclass(frozen=True, eq=False)
class EvenMotion:
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
    of the nearest sample. The action is the set-points at the next row, or the measured joints of
    a recording without set-points.

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

    def motions(self, rate_hz: int) -> Iterator[EvenMotion]:
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
            yield EvenMotion(q, v, goal, tips, objects)

    def columns(self, motion: EvenMotion) -> dict[str, NDArray[Any]]:
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
        for one in bag.poses(topics) if topics else ():
            times.setdefault(one.topic, []).append(one.time)
            values.setdefault(one.topic, []).append(one.pose)
            self._frames[one.topic] = one.frame
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
