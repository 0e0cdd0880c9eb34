"""A renderer that needs no graphics library: it paints where points land, and can be slow."""

from __future__ import annotations

import threading
from types import SimpleNamespace
from typing import Any

import numpy as np

from trocar.cameras.lens import project
from trocar.errors import InputError, OvertakenError, TrocarError
from trocar.geometry.se3 import inverse


class FakeRenderer:
    """Paints one pixel white for each point of the world that an eye sees.

    Args:
        points: in the world, (n, 3) [m]
        gate: drawing waits until it is set
        fails_after: no picture comes after so many
        refuses: so many pictures, the first ones
        refusal: what it says then
    """

    def __init__(
        self,
        points=(),
        gate: threading.Event | None = None,
        fails_after=None,
        refuses: int = 0,
        refusal: type[InputError] = OvertakenError,
    ) -> None:
        self.refuses, self.refusal = refuses, refusal
        self.points = np.reshape(points, (-1, 3))
        self.gate, self.fails_after = gate, fails_after
        self.threads: set[str] = set()
        self.names = {7: "point"}
        self.beside: set[str] = set()
        self.drawn = 0
        self.closed = False

    def render(self, snapshot: Any, cameras: Any, camera: str, *, beside: Any = ()) -> Any:
        self.threads.add(threading.current_thread().name)
        if self.fails_after is not None and self.drawn >= self.fails_after:
            raise TrocarError("no OpenGL")
        if self.refuses > 0:
            self.refuses -= 1
            raise self.refusal("of another build")
        if self.gate is not None:
            assert self.gate.wait(10)
        self.drawn += 1
        record = cameras[camera]
        eyes = zip(record.calibration.eyes, record.T_world_eyes, strict=True)
        pictures = [self._seen(eye, at) for eye, at in eyes]
        right = pictures[1] if len(pictures) > 1 else None
        self.beside = set(beside)
        depth, ids = (
            np.stack([scale * (each[..., 0] > 0) for each in pictures]).astype(kind)
            if name in beside
            else None
            for name, scale, kind in (("depth", 0.1, np.float32), ("ids", 7, np.int32))
        )
        return SimpleNamespace(
            left=pictures[0],
            right=right,
            depth=depth,
            ids=ids,
            names=self.names,
            time=snapshot.time,
            calibration=record.calibration,
        )

    def _seen(self, eye: Any, T_world_eye: np.ndarray) -> np.ndarray:
        picture = np.zeros((eye.height, eye.width, 3), np.uint8)
        ahead = self.points @ inverse(T_world_eye)[:3, :3].T + inverse(T_world_eye)[:3, 3]
        for u, v in np.round(project(ahead, eye.K, eye.distortion)):
            if 0 <= u < eye.width and 0 <= v < eye.height:
                picture[int(v), int(u)] = 255
        return picture

    def close(self) -> None:
        self.closed = True
