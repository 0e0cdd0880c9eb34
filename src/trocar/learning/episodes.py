"""Records of episodes: readings, actions, rewards and images, period by period."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trocar.learning.readings import SceneReadings, read_task
from trocar.recording import record
from trocar.rendering.film import video
from trocar.tasks import Episode, Task
from trocar.tasks.controller import PERIOD_S

Array = NDArray[np.float64]
Image = NDArray[np.uint8]
#: Returns the actions of a policy from a task that was reset, as `Task.policy` yields them.
Script = Callable[[Task], Iterator[Array]]

#: Ratio of the noise of a period that is left in the next one. Source: our own choice; a time
#: constant of 0.2 s moves the tip, where independent noise averages out.
MEMORY = 0.9
#: Second number of the noise's random seed, beside that of the episode. Source: our own choice.
STREAM = 1
#: Quality of a film, see `video`, and pictures between two that are stored whole. Source: CRF 20,
#: and the distance of 2 with which LeRobot writes, so that single pictures are read fast.
QUALITY, KEYFRAMES = 6.0, 2


@dataclass(frozen=True, eq=False)
class Film:
    """Images of an episode, one at the beginning of each period.

    Attributes:
        mp4: H.264, at the rate of the periods
        size: width, height [px]
        count: number of images
        low, high, mean, std: of red, green and blue over all pixels, (3,), from 0 to 1
    """

    mp4: bytes
    size: tuple[int, int]
    count: int
    low: Array
    high: Array
    mean: Array
    std: Array


@dataclass(frozen=True, eq=False)
class EpisodeLog:
    """One episode, period by period.

    Attributes:
        result: of the episode
        readings: at the beginning of each of n periods and at the end, as those of n + 1 worlds
        actions: of the policy, (n, k), see `TipController`
        noise: added to these before they were driven, (n, k); zeros without noise
        rewards: of each period, (n,)
        films: by camera
        recording: MCAP file of the world, b"" where none was made
    """

    result: Episode
    readings: SceneReadings
    actions: Array
    noise: Array
    rewards: Array
    films: Mapping[str, Film] = field(default_factory=dict[str, Film])
    recording: bytes = b""

    def __len__(self) -> int:
        return len(self.actions)


def record_episode(
    task: Task,
    seed: int,
    script: Script | None = None,
    *,
    noise: float = 0.0,
    cameras: Mapping[str, Callable[[], Image]] | None = None,
    mcap: bool = False,
) -> EpisodeLog:
    """Run an episode to its end and keep all of it; a function of the arguments.

    Args:
        task: reset first
        seed: of the episode, and of the noise
        script: the policy; default: that of the task
        noise: standard deviation of the changes of the noise from period to period, as a ratio of
            the greatest velocities; jaws have none
        cameras: return an image (h, w, 3), by name; the width and height are even
        mcap: also record the world

    Raises:
        InputError: no free place, no scripted policy, or an action that is not allowed
        DivergedError: the simulation diverged
    """
    rng, scale, push = np.random.default_rng((seed, STREAM)), _scale(task), 0.0
    readings: list[SceneReadings] = []
    actions: list[Array] = []
    pushes: list[Array] = []
    rewards: list[float] = []
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="trocar-")))
        recorder = record(task.world, folder / "episode.mcap") if mcap else None
        if recorder is not None:
            stack.enter_context(recorder)
        reels = {
            name: _Reel(capture, folder / f"{number}.mp4")
            for number, (name, capture) in enumerate((cameras or {}).items())
        }
        for reel in reels.values():
            stack.callback(reel.close)
        task.reset(seed)
        steps = (script or type(task).policy)(task)
        while not task.done:
            readings.append(read_task(task))
            for reel in reels.values():
                reel.take()
            action = next(steps, None)
            actions.append(task.stay() if action is None else np.asarray(action, np.float64))
            push = MEMORY * push + noise * scale * rng.standard_normal(len(scale))
            pushes.append(np.zeros(len(scale)) + push)
            rewards.append(task.command(actions[-1] + push if noise else actions[-1]))
        readings.append(read_task(task))
        films = {name: reel.film() for name, reel in reels.items()}
        if recorder is not None:
            recorder.stop()
        recording = (folder / "episode.mcap").read_bytes() if mcap else b""
    return EpisodeLog(
        task.result(seed),
        joined(readings),
        np.array(actions),
        np.array(pushes),
        np.array(rewards),
        films,
        recording,
    )


def joined(readings: Sequence[SceneReadings]) -> SceneReadings:
    """Return readings of one scene as one, its worlds after each other."""
    parts: dict[str, Any] = {}
    for one in fields(SceneReadings):
        values: list[Any] = [getattr(reading, one.name) for reading in readings]
        if one.name == "names":
            parts[one.name] = values[0]
        elif isinstance(values[0], Mapping):
            keys: Mapping[str, Any] = values[0]
            parts[one.name] = {key: np.concatenate([value[key] for value in values]) for key in keys}
        else:
            parts[one.name] = np.concatenate(values)
    return SceneReadings(**parts)


def _scale(task: Task) -> Array:
    """Return the greatest values of an action, 0 for jaws, (k,)."""
    scale, begin = task.limits[1].copy(), 0
    for name, part in task.controller.idle().items():
        begin += len(part)
        if task.world.arms[name].description.type == "PSM":
            scale[begin - 1] = 0.0
    return scale


class _Reel:
    """Writes the images of a camera into a file, and sums their colours."""

    def __init__(self, capture: Callable[[], Image], path: Path) -> None:
        self._capture, self._path = capture, path
        self._stack = ExitStack()
        self._add: Callable[[Image], None] | None = None
        self._size, self._count, self._pixels = (0, 0), 0, 0
        self._low, self._high = np.ones(3), np.zeros(3)
        self._sum, self._squares = np.zeros(3), np.zeros(3)

    def take(self) -> None:
        """Add the image of now."""
        image = self._capture()
        if self._add is None:
            self._size = image.shape[1], image.shape[0]
            self._add = self._stack.enter_context(
                video(
                    self._path, self._size, 1.0 / PERIOD_S, quality=QUALITY, keyframes=KEYFRAMES
                )
            )
        self._add(image)
        colours = image.reshape(-1, 3) / 255.0
        self._count, self._pixels = self._count + 1, self._pixels + len(colours)
        self._low = np.minimum(self._low, colours.min(axis=0))
        self._high = np.maximum(self._high, colours.max(axis=0))
        self._sum += colours.sum(axis=0)
        self._squares += (colours**2).sum(axis=0)

    def film(self) -> Film:
        """End the file and return it."""
        self.close()
        mean = self._sum / self._pixels
        std = np.sqrt(np.maximum(self._squares / self._pixels - mean**2, 0.0))
        data = self._path.read_bytes()
        return Film(data, self._size, self._count, self._low, self._high, mean, std)

    def close(self) -> None:
        """End the file."""
        self._stack.close()
