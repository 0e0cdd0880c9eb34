"""The folder of a training: its policy, curve, log and a video of an episode."""

from __future__ import annotations

import csv
import io
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trocar.errors import InputError, MissingExtraError
from trocar.learning.policies import TrainedPolicy, save_policy
from trocar.outputs import json_text, whole_file
from trocar.plotting.drawing import MEASURED, new_figure, png
from trocar.rendering import Endoscope
from trocar.rendering.film import video
from trocar.rendering.frames import picture
from trocar.tasks import Episode, Task

Array = NDArray[np.float64]

POLICY, CURVE, LOG, VIDEO = "policy.toml", "curve.csv", "training.json", "episode.mp4"
#: Points of a curve below which each is marked. Source: our own choice.
SPARSE = 20
#: Frames of a video a second. Source: our own choice.
VIDEO_HZ = 25.0


class RunFolder:
    """A folder that a training writes.

    Args:
        path: of the folder, which is made
        overwrite: files of an earlier training in it are replaced

    Attributes:
        path: as given
        rows: of the curve, {column: value}

    Raises:
        InputError: it has a policy already, or cannot be made
    """

    def __init__(self, path: str | Path, overwrite: bool = False) -> None:
        self.path, self._overwrite = Path(path).expanduser(), overwrite
        if (self.path / POLICY).exists() and not overwrite:
            raise InputError(f"{self.path / POLICY}: exists; allowed: a new folder, or --overwrite")
        try:
            self.path.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(f"{self.path}: cannot be made: {error.strerror or error}") from None
        self.rows: list[dict[str, float]] = []
        self._begin = time.process_time()

    def add(self, **row: float) -> None:
        """Add a point to the curve, with the processor time of this process so far [s]."""
        self.rows.append({**row, "cpu_s": round(time.process_time() - self._begin, 2)})

    def write(self, policy: TrainedPolicy, log: Mapping[str, Any]) -> list[Path]:
        """Write policy, curve and log; return the files.

        The picture of the curve is left out where matplotlib is not installed.

        Args:
            policy: that was trained
            log: settings and results of the training, plain values
        """
        save_policy(self.path / POLICY, policy, overwrite=True)
        written = [POLICY, str(Path(POLICY).with_suffix(".safetensors")), CURVE, LOG]
        self._text(CURVE, self._csv())
        self._text(LOG, json_text(log) + "\n")
        with suppress(MissingExtraError):
            with whole_file(self.path / "curve.png", overwrite=True) as part:
                part.write_bytes(self._drawn())
            written.append("curve.png")
        return [self.path / name for name in written]

    def _text(self, name: str, text: str) -> None:
        with whole_file(self.path / name, overwrite=True) as part:
            part.write_text(text, encoding="utf-8")

    def _csv(self) -> str:
        text = io.StringIO()
        table = csv.DictWriter(text, list(self.rows[0]) if self.rows else [], lineterminator="\n")
        table.writeheader()
        table.writerows(self.rows)
        return text.getvalue()

    def _drawn(self) -> bytes:
        """Draw the second column over the first."""
        figure = new_figure(6.0, 3.5, "drawing a curve of training")
        axes: Any = figure.subplots()
        if self.rows:
            over, value, *_ = self.rows[0]
            xy = ([row[name] for row in self.rows] for name in (over, value))
            axes.plot(*xy, color=MEASURED, marker="." if len(self.rows) < SPARSE else "")
            axes.set(xlabel=over, ylabel=value)
            axes.set_xlim(left=0.0)
            if value == "loss":
                axes.set_yscale("log")
            else:
                axes.set_ylim(-0.02, 1.02)
        axes.grid(alpha=0.3)
        return png(figure)


def film_episode(
    task: Task, script: Callable[[Task], Iterator[Array]], seed: int, path: Path
) -> Episode:
    """Film an episode through the left eye of the endoscope; return its result.

    Args:
        task: reset first; its rig has an endoscope
        script: returns the actions of an episode, as `Task.policy`
        seed: of the episode
        path: of the .mp4 file, which is replaced

    Raises:
        InputError: the rig has no endoscope
        MissingExtraError: what draws or what writes videos is not installed
    """
    scopes = [camera.name for camera in task.world.rig.cameras if camera.kind == "endoscope"]
    if not scopes:
        raise InputError(f"{task.scene.name}: its rig has no endoscope, so nothing is filmed")
    scope = Endoscope(task.world, scopes[0])
    try:
        task.reset(seed)
        every = round(1.0 / (VIDEO_HZ * task.world.timestep))

        def capture() -> NDArray[np.uint8]:
            return task.picture(lambda: picture(scope.capture(), "left", "colour"))

        height, width = capture().shape[:2]
        with video(path, (width, height), VIDEO_HZ, overwrite=True) as add:
            forget = task.world.observe(
                lambda: add(capture()) if task.world.periods % every == 0 else None, every=every
            )
            actions = script(task)
            while not task.done:
                action = next(actions, None)
                task.command(task.stay() if action is None else action)
            forget()
    finally:
        scope.close()
    return task.result(seed)
