"""The endoscope of a world: pictures of it, one by one or as a stream."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from trocar.cameras import Calibration
from trocar.descriptions.cameras import load_camera
from trocar.errors import UnknownNameError
from trocar.rendering.frames import StereoFrame
from trocar.rendering.look import Look
from trocar.rendering.renderer import Channels, Renderer
from trocar.rendering.series import Series
from trocar.rendering.stream import Stream
from trocar.simulation import World
from trocar.simulation.cameras import CameraRecord
from trocar.simulation.records import Snapshot


class Endoscope:
    """A camera of a world, a scope with two eyes or a view with one.

    The world is only looked at: it moves as it would without. `capture` and `stream` are called
    where the world is stepped; `render` from anywhere.

    Args:
        world: whose rig has cameras
        camera: which of them
        preset: other eyes in its place: a built-in camera ("dvrk_sd_640x480") or a calibration file
        calibration: the same as a record; at most one of the two
        angle_deg: a scope that is bent down by this (30 or -30) or straight (0); as the rig has it
            when omitted
        depth, ids, normals: whether frames have them
        look: light, exposure, lens and sensor

    Raises:
        UnknownNameError: no such camera or preset; the known ones are listed
        InputError: eyes that the camera cannot have, or a scope that nobody makes
        TrocarError: there is no OpenGL; the Debian packages that bring it are named
        MissingExtraError: the extra `scope` is not installed
    """

    def __init__(
        self,
        world: World,
        camera: str = "endoscope",
        *,
        preset: str | Path | None = None,
        calibration: Calibration | None = None,
        angle_deg: float | None = None,
        depth: bool = False,
        ids: bool = False,
        normals: bool = False,
        look: Look | None = None,
    ) -> None:
        self.world, self.camera = world, camera
        if preset is not None:
            calibration = load_camera(preset)
        self._calibration = calibration
        self._angle = None if angle_deg is None else float(np.deg2rad(angle_deg))
        self._mounted(world.cameras())
        self.renderer = Renderer(
            lambda: (world.snapshot(arms=False).build, world.shapes()),
            Channels(depth, ids, normals),
            look,
        )
        self._series = Series(self.renderer)

    def capture(self) -> StereoFrame:
        """Return what the camera sees now, exposed for itself.

        Raises:
            InputError: a picture larger than the driver allows
            TrocarError: the graphics library was lost and cannot be opened again
        """
        return self.render(self.world.snapshot(arms=False), self.world.cameras())

    def capture_next(self) -> StereoFrame:
        """Return what the camera sees now, exposed as the next of a film: light fades over.

        Raises:
            InputError, TrocarError: as for `capture`
        """
        cameras = self._mounted(self.world.cameras())
        return self._series.render(self.world.snapshot(arms=False), cameras, self.camera)

    def render(self, snapshot: Snapshot, cameras: Mapping[str, CameraRecord]) -> StereoFrame:
        """Return what the camera sees where a snapshot has everything.

        Raises:
            InputError, TrocarError: as for `capture`
        """
        return self.renderer.render(snapshot, self._mounted(cameras), self.camera)

    def stream(self, rate_hz: float = 60.0) -> Stream:
        """Draw in a thread of its own, so many frames a simulated second.

        Step the world inside `with scope.stream(60.0) as stream: ...`; `stream.newest` is the
        newest frame.

        Raises:
            InputError: the rate is not above 0
        """
        series = Series(self.renderer)

        def draw(snapshot: Snapshot, cameras: Mapping[str, CameraRecord]) -> StereoFrame:
            return series.render(snapshot, self._mounted(cameras), self.camera)

        return Stream(self.world, draw, rate_hz)

    def close(self) -> None:
        """Let go of the graphics library."""
        self.renderer.close()

    def _mounted(self, cameras: Mapping[str, CameraRecord]) -> dict[str, CameraRecord]:
        """Return the camera with the eyes and the bend that were asked for."""
        if self.camera not in cameras:
            where = f"rig {self.world.rig.name}"
            raise UnknownNameError("camera", self.camera, cameras, where)
        record = cameras[self.camera]
        if self._calibration is not None:
            record = record.seeing(self._calibration)
        if self._angle is not None:
            record = record.bent(self._angle)
        return {self.camera: record}
