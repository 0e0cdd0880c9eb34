"""Records of episodes: readings, actions, rewards and images, period by period."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from trocar.learning.films import Film, FilmWriter, Image
from trocar.learning.readings import SceneReadings, read_task
from trocar.recording import record
from trocar.tasks import Episode, Task
from trocar.tasks.controller import PERIOD_S
from trocar.tasks.play import Script, scripted

Array = NDArray[np.float64]

#: Ratio of the noise of a period that is left in the next one. Source: our own choice; a time
#: constant of 0.2 s moves the tip, where independent noise averages out.
MEMORY = 0.9
#: Second number of the noise's random seed, beside that of the episode. Source: our own choice.
STREAM = 1


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
    script: Script = scripted,
    *,
    noise: float = 0.0,
    cameras: Mapping[str, Callable[[], Image]] | None = None,
    mcap: bool = False,
) -> EpisodeLog:
    """Run an episode to its end and keep all of it; a function of the arguments.

    Args:
        task: reset first
        seed: of the episode, and of the noise
        script: returns the actions of the episode, after whose end the arms stay where they are
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
    task.reset(seed)  # before the recording, which has what led here since the reset
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="trocar-")))
        recorder = record(task.world, folder / "episode.mcap") if mcap else None
        if recorder is not None:
            stack.enter_context(recorder)
        reels = {
            name: (capture, stack.enter_context(FilmWriter(1.0 / PERIOD_S)))
            for name, capture in (cameras or {}).items()
        }
        steps = script(task)
        while not task.done:
            readings.append(read_task(task))
            for capture, reel in reels.values():
                reel.add(capture())
            action = next(steps, None)
            actions.append(task.stay() if action is None else np.asarray(action, np.float64))
            push = MEMORY * push + noise * scale * rng.standard_normal(len(scale))
            pushes.append(np.zeros(len(scale)) + push)
            rewards.append(task.command(actions[-1] + push if noise else actions[-1]))
        readings.append(read_task(task))
        films = {name: reel.film() for name, (_, reel) in reels.items()}
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
            first = cast(Mapping[str, Any], values[0])
            parts[one.name] = {k: np.concatenate([value[k] for value in values]) for k in first}
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
