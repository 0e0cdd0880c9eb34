"""Collect episodes of a scene, in this process, on workers or on a cluster, into a dataset."""

from __future__ import annotations

import functools
import logging
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.calibrated import rig_overlays
from trocar.descriptions.scenes import Scene
from trocar.errors import InputError, TrocarError
from trocar.geometry.rotations import quaternion_from_matrix
from trocar.learning.cards import write_card
from trocar.learning.episodes import EpisodeLog, record_episode
from trocar.learning.films import Image
from trocar.learning.images import SceneCamera
from trocar.learning.lerobot import DatasetWriter, Feature
from trocar.learning.observations import StateEncoder
from trocar.outputs import whole_folder
from trocar.tasks import Episode, Task, make_task
from trocar.tasks.controller import PERIOD_S
from trocar.tasks.play import Script, each_seed, scripted

Array = NDArray[np.float64]

_log = logging.getLogger("trocar")

#: Frames a second: one for each action.
RATE_HZ = round(1.0 / PERIOD_S)
#: Images of the left eye. Source: names of LeRobot.
LEFT = "observation.images.left"
UNITS = {"revolute": "rad", "prismatic": "m"}
POSE = ("x_m", "y_m", "z_m", "qw", "qx", "qy", "qz")


@dataclass(frozen=True)
class Collection:
    """Episodes to collect; each follows from this and its seed alone, wherever it runs.

    Attributes:
        scene: a scene, its name, or the path of its file
        script: the policy
        policy: its name, for the card
        noise: as of `record_episode`
        images: width and height of the left eye's images [px], None for none; see `SceneCamera`
        mcap: also record the world of each episode

    Raises:
        InputError: a value that is not allowed
    """

    scene: Scene | str
    script: Script = scripted
    policy: str = "scripted"
    noise: float = 0.0
    images: tuple[int, int] | None = None
    mcap: bool = False

    def __post_init__(self) -> None:
        if not 0.0 <= self.noise <= 1.0:
            raise InputError(f"noise: got {self.noise:g}; allowed: 0 to 1")
        if any(side % 2 for side in self.images or ()):
            got = "{}x{}".format(*self.images or ())
            raise InputError(f"images: got {got}; allowed: even sides")


@dataclass(frozen=True)
class Collected:
    """Result of a collection.

    Attributes:
        episodes: all that ran, in the order of their seeds
        kept: number of those in the dataset
        frames: of the dataset
    """

    episodes: tuple[Episode, ...]
    kept: int
    frames: int


def episodes(
    collection: Collection, seeds: Sequence[int], workers: int = 1, cluster: str = ""
) -> Iterator[EpisodeLog]:
    """Yield the episodes of seeds in their order, as each is known.

    Args:
        collection: their settings
        seeds: of the episodes
        workers, cluster: as for `trocar.tasks.play`

    Raises:
        InputError, TrocarError: as for `trocar.tasks.play.each_seed`
    """
    if workers == 1 and not cluster:
        yield from (_episode(collection, seed) for seed in seeds)
        return
    run = functools.partial(_episode, collection)
    yield from each_seed(run, seeds, _name(collection.scene), workers, cluster)


def collect(
    collection: Collection,
    seeds: Sequence[int],
    folder: str | Path,
    *,
    workers: int = 1,
    cluster: str = "",
    keep_failures: bool = False,
    overwrite: bool = False,
    command: str = "",
    watch: Callable[[int], None] = lambda _: None,
) -> Collected:
    """Write episodes as a dataset of LeRobot's, with a card, and their recordings.

    An interruption or an error after the first episode ends the dataset there, and is raised then.

    Args:
        collection, seeds, workers, cluster: as for `episodes`
        folder: a new or an empty one
        keep_failures: also keep episodes that ended without success
        overwrite: the folder may hold something
        command: that made the dataset, for its card
        watch: called with the number of episodes so far

    Raises:
        InputError: no episode succeeded, the folder cannot be written, or as for `episodes`
        MissingExtraError: the extra `learn` or `video` is not installed
        TrocarError: as for `episodes`
    """
    ended: BaseException | None = None
    found: list[Episode] = []
    kept: list[Episode] = []
    task = make_task(collection.scene)
    columns = EpisodeColumns(task, noisy=collection.noise > 0.0)
    cameras = {LEFT: collection.images} if collection.images else {}
    robot = "dvrk_" + "_".join(name.lower() for name in task.arms)
    with whole_folder(folder, overwrite) as built:
        with DatasetWriter(built, RATE_HZ, columns.features, robot, cameras) as writer:
            try:
                for log in episodes(collection, seeds, workers, cluster):
                    found.append(log.result)
                    if log.result.success or keep_failures:
                        if log.recording:
                            path = built / "recordings" / f"episode_{writer.episodes:06d}.mcap"
                            path.parent.mkdir(exist_ok=True)
                            path.write_bytes(log.recording)
                        about = {"seed": log.result.seed, "success": log.result.success}
                        values = columns.of(log)
                        writer.add(values, task.scene.title, log.films, **about)
                        kept.append(log.result)
                    watch(len(found))
            except (KeyboardInterrupt, TrocarError) as problem:
                if not writer.episodes:
                    raise
                ended = problem
            if not writer.episodes:
                raise InputError(
                    f"{task.scene.name}: none of {len(found)} episodes ended with success; allowed:"
                    " one or more, or --keep-failures"
                )
            kept = kept[: writer.episodes]
        card = _card(task, collection, found, kept, command)
        title = f"{task.scene.title}: {len(kept)} episodes"
        write_card(built, title, card, columns.features, simulated=True)
    if ended is not None:
        _log.warning("%s: ended after %d of %d episodes", folder, len(found), len(seeds))
        raise ended
    return Collected(tuple(found), len(kept), writer.frames)


class EpisodeColumns:
    """Columns of a dataset from episodes of a scene.

    Args:
        task: of the scene
        noisy: whether to keep the noise of actions

    Attributes:
        features: {column: names of its numbers}
    """

    def __init__(self, task: Task, *, noisy: bool = False) -> None:
        self._encoder, self._noisy = StateEncoder(task), noisy
        arms = {name: task.world.arms[name].description for name in task.arms}
        psms = [name for name, arm in arms.items() if arm.type == "PSM"]
        objects = [name for name in task.world.objects if name not in task.scene.hidden]
        self._psms, self._objects, self._arms = psms, objects, tuple(arms)
        joints = [
            (f"{name}.{joint.name}", UNITS[joint.kind])
            for name, arm in arms.items()
            for joint in arm.joints
        ]
        positions = tuple(f"{name}_{unit}" for name, unit in joints)
        tips = Feature(_poses(psms), frame="world")
        actions = tuple(one for name, arm in arms.items() for one in _action_names(name, arm.type))
        goals = self._encoder.goals
        features = {
            "observation.state": Feature(self._encoder.names),
            "observation.joints": Feature(positions),
            "observation.velocities": Feature(tuple(f"{name}_{unit}_s" for name, unit in joints)),
            "observation.tips": tips,
            "observation.objects": Feature(_poses(objects), frame="world"),
            "observation.goals": Feature(
                tuple(f"goal{k + 1}.{axis}_m" for k in range(goals) for axis in "xyz"),
                frame="world",
            ),
            "action": Feature(actions),
            **({"noise": Feature(actions)} if noisy else {}),
            "next.setpoints": Feature(positions),
            "next.tip_setpoints": tips,
            "next.reward": Feature(("reward",)),
            "next.done": Feature(("done",), "bool"),
            "next.success": Feature(("success",), "bool"),
        }
        self.features = {name: one for name, one in features.items() if one.names}

    def of(self, log: EpisodeLog) -> dict[str, NDArray[Any]]:
        """Return the columns of an episode, (n, d) each."""
        seen, count = log.readings, len(log)
        done = np.arange(count) == count - 1
        columns = {
            "observation.state": self._encoder.encode(seen)[:-1],
            "observation.joints": self._stacked(seen.q, self._arms)[:-1],
            "observation.velocities": self._stacked(seen.v, self._arms)[:-1],
            "observation.tips": self._stacked(_flat(seen.tips), self._psms)[:-1],
            "observation.objects": self._stacked(seen.objects, self._objects)[:-1],
            "observation.goals": seen.goals.reshape(count + 1, -1)[:-1],
            "action": log.actions,
            "noise": log.noise,
            "next.setpoints": self._stacked(seen.setpoints, self._arms)[1:],
            "next.tip_setpoints": self._stacked(_flat(seen.targets), self._psms)[1:],
            "next.reward": log.rewards,
            "next.done": done,
            "next.success": done & log.result.success,
        }
        return {name: columns[name] for name in self.features}

    def _stacked(self, parts: Mapping[str, Array], names: Sequence[str]) -> Array:
        return np.concatenate([parts[name] for name in names], axis=1) if names else np.zeros((0,))


# ------------------------------------------------------------------ inside


def _episode(collection: Collection, seed: int) -> EpisodeLog:
    """Run an episode in a process that has perhaps run others before."""
    task, cameras = _stage(collection.scene, collection.images)
    return record_episode(
        task,
        seed,
        collection.script,
        noise=collection.noise,
        cameras=cameras,
        mcap=collection.mcap,
    )


@functools.cache
def _stage(
    scene: Scene | str, images: tuple[int, int] | None
) -> tuple[Task, Mapping[str, Callable[[], Image]]]:
    """Return the task of a scene, and its cameras."""
    task = make_task(scene)
    return task, {LEFT: SceneCamera(task, images).capture} if images else {}


def _name(scene: Scene | str) -> str:
    return scene if isinstance(scene, str) else scene.name


def _poses(names: Sequence[str]) -> tuple[str, ...]:
    return tuple(f"{name}.{part}" for name in names for part in POSE)


def _action_names(arm: str, kind: str) -> list[str]:
    """Return names of the numbers of an arm's part of an action, see `TipController`."""
    if kind != "PSM":
        units = zip(("yaw", "pitch", "insertion", "roll"), ("rad", "rad", "m", "rad"), strict=True)
        return [f"{arm}.{joint}_{unit}_s" for joint, unit in units]
    moves = [f"v{axis}_m_s" for axis in "xyz"] + [f"w{axis}_rad_s" for axis in "xyz"]
    return [f"{arm}.{name}" for name in (*moves, "jaw_rad")]


def _flat(poses: Mapping[str, Array]) -> dict[str, Array]:
    """Return poses (n, 4, 4) as position and quaternion wxyz, (n, 7)."""
    return {
        name: np.concatenate([T[:, :3, 3], quaternion_from_matrix(T[:, :3, :3])], axis=1)
        for name, T in poses.items()
    }


def _card(
    task: Task,
    collection: Collection,
    found: Sequence[Episode],
    kept: Sequence[Episode],
    command: str,
) -> dict[str, Any]:
    """Return the entries of a dataset's card."""
    rig = task.world.first_rig
    size = collection.images
    return {
        "scene": task.scene.name,
        "title": task.scene.title,
        "rig": rig.name,
        "arms": [*task.arms],
        "grasp": rig.grasp,
        "dynamics": rig.dynamics,
        "robot_errors": rig.errors is not None,
        "calibration": {arm: overlay.file for arm, overlay in rig_overlays(rig).items()},
        "policy": collection.policy,
        "noise": collection.noise,
        "images": [] if size is None else [*size],
        "recordings": collection.mcap,
        "rate_hz": RATE_HZ,
        "episodes": len(kept),
        "attempted": len(found),
        "successes": sum(one.success for one in found),
        "seeds": [one.seed for one in kept],
        "failed_seeds": [one.seed for one in found if not one.success],
        "mean_time_s": float(np.mean([one.time_s for one in kept])),
        "command": command,
    }
