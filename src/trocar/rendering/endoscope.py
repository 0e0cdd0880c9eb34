"""The endoscope of a world: an image of one moment (`capture`), or many (`stream`)."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Collection, Mapping
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import cast

import numpy as np
from numpy.typing import ArrayLike

from trocar.cameras import Calibration
from trocar.descriptions.cameras import load_camera
from trocar.errors import InputError, TrocarError, UnknownNameError
from trocar.geometry.se3 import check_transform
from trocar.rendering.frames import StereoFrame
from trocar.rendering.latest_only import LatestOnly
from trocar.rendering.look import Look, style_of, vignette_of
from trocar.rendering.renderer import Channels, Renderer
from trocar.rendering.series import Series
from trocar.simulation import World
from trocar.simulation.cameras import CameraRecord
from trocar.simulation.records import Snapshot

_log = logging.getLogger("trocar")

Draw = Callable[[Snapshot, Mapping[str, CameraRecord]], StereoFrame]
#: Tolerance of a frame's time [s]. Source: rounding of sums of periods.
SLACK_S = 1e-9
#: Time limit of the last frame when a stream ends [s]. Source: our own choice.
FAREWELL_S = 10.0


def _is_rate(value: object) -> bool:
    return isinstance(value, (int, float)) and 0.0 < value < float("inf")


class Stream:
    """Take snapshots where the world is stepped, and draw them in another thread.

    A snapshot that is not drawn yet when the next one is due is dropped and counted; nothing waits
    in a queue, and the world never waits.

    Args:
        world: stepped by the caller
        draw: makes a frame
        rate_hz: frames a simulated second

    Attributes:
        made: frames drawn

    Raises:
        InputError: the rate is not above 0
    """

    def __init__(self, world: World, draw: Draw, rate_hz: float) -> None:
        if not _is_rate(rate_hz):
            raise InputError(f"rate_hz: got {rate_hz!r}; allowed: above 0")
        self._world, self._draw, self._period = world, draw, 1.0 / rate_hz
        self._worker = LatestOnly(self._make, "endoscope")
        self._changed = threading.Condition()
        self._newest: StereoFrame | None = None
        self._failure: TrocarError | None = None
        self._due = world.time
        self.made = 0
        self._leave: Callable[[], None] = lambda: None

    def __enter__(self) -> Stream:
        self._look()
        self._leave = self._world.observe(self._look, every=5)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        problem: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.stop()

    @property
    def dropped(self) -> int:
        """Snapshots that a newer one replaced before they were drawn."""
        return self._worker.dropped

    @property
    def newest(self) -> StereoFrame | None:
        """The newest frame, None before the first.

        Raises:
            TrocarError: the reason why no more are drawn
        """
        with self._changed:
            self._check()
            return self._newest

    def wait(self, after: StereoFrame | None = None, timeout_s: float = 10.0) -> StereoFrame:
        """Return a frame that is newer than another one, or the first.

        Raises:
            TrocarError: no new frame within the timeout, or the reason why no more are drawn
        """

        def fresh() -> bool:
            frame = self._newest
            return self._failure is not None or (frame is not None and frame is not after)

        with self._changed:
            if not self._changed.wait_for(fresh, timeout_s):
                raise TrocarError(f"no new picture after {timeout_s:g} s; was the world stepped?")
            self._check()
            return cast(StereoFrame, self._newest)

    def stop(self) -> None:
        """Draw no more; the newest frame stays."""
        self._leave()
        self._worker.close(FAREWELL_S)

    # ------------------------------------------------------------------ inside

    def _check(self) -> None:
        if self._failure is not None:
            raise self._failure

    def _look(self) -> None:
        """Take a snapshot when one is due; called where the world is stepped."""
        time = self._world.time
        if self._due - self._period <= time + SLACK_S < self._due:  # else it was reset
            return
        self._due = time + self._period - (time - self._due) % self._period
        self._worker.put((self._world.snapshot(), self._world.cameras()))

    def _make(self, moment: tuple[Snapshot, Mapping[str, CameraRecord]]) -> None:
        """Draw a moment; the first error ends the stream and is raised where frames are read."""
        if self._failure is not None:
            return
        frame, failure = None, None
        try:
            frame = self._draw(*moment)
        except TrocarError as problem:
            failure = problem
        except Exception as problem:  # noqa: BLE001  raised where a frame is requested
            _log.exception("no more pictures")
            failure = TrocarError(repr(problem))
        with self._changed:
            self._newest, self._failure = frame or self._newest, failure
            self.made += failure is None
            self._changed.notify_all()


class Endoscope:
    """A camera of a world: a scope with two eyes, or a view with one.

    Images do not change the motion of the world. `capture` and `stream` are called
    where the world is stepped; `render` from anywhere.

    Args:
        world: whose rig has cameras
        camera: which of them
        preset: other eyes in its place: a built-in camera ("dvrk_sd_640x480") or a calibration file
        calibration: the same as a record; at most one of the two
        angle_deg: a scope that is bent down by this (30 or -30) or straight (0); as the rig has it
            when omitted
        depth, ids, normals: whether frames have them
        visible: objects whose visible share frames have
        look: light, exposure, lens and sensor; in the rig's own style and vignette
            (`style_of`, `vignette_of`) when omitted

    Raises:
        UnknownNameError: no such camera or preset; the known ones are listed
        InputError: eyes that the camera cannot have, or an angle that no scope has
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
        visible: Collection[str] = (),
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
            Channels(depth, ids, normals, tuple(visible)),
            look or Look(style_of(world.rig), vignette=vignette_of(world.rig)),
        )
        self._series = Series(self.renderer)

    def capture(self) -> StereoFrame:
        """Draw the world as it is now, exposed for itself.

        Raises:
            InputError: a picture larger than the driver allows
            TrocarError: the graphics library was lost and cannot be opened again
        """
        return self.render(self.world.snapshot(), self.world.cameras())

    def capture_next(self) -> StereoFrame:
        """Draw the world as it is now, exposed as the next image of a series.

        Raises:
            InputError, TrocarError: as for `capture`
        """
        cameras = self._mounted(self.world.cameras())
        return self._series.render(self.world.snapshot(), cameras, self.camera)

    def render(
        self,
        snapshot: Snapshot,
        cameras: Mapping[str, CameraRecord],
        *,
        poses: Mapping[str, ArrayLike] | None = None,
        only: Collection[str] | None = None,
        T_world_camera: ArrayLike | None = None,
    ) -> StereoFrame:
        """Draw a snapshot, or the snapshot with objects or the camera elsewhere.

        Args:
            snapshot, cameras: of the world
            poses, only: objects that are elsewhere, objects that are there; see `Renderer.render`
            T_world_camera: pose of the camera instead, midway between its eyes (4, 4)

        Raises:
            InputError, TrocarError: as for `capture`
            UnknownNameError: no such object; the known ones are listed
        """
        mounted = self._mounted(cameras)
        if T_world_camera is not None:
            T, record = check_transform(T_world_camera), mounted[self.camera]
            free = replace(record, body=0, T_body_mount=T, angle=0.0)
            mounted = {self.camera: free}
        return self.renderer.render(snapshot, mounted, self.camera, poses=poses, only=only)

    def stream(self, rate_hz: float = 60.0) -> Stream:
        """Draw frames at a rate in simulated time, in a thread of its own.

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
        """Release the graphics library."""
        self.renderer.close()

    def _mounted(self, cameras: Mapping[str, CameraRecord]) -> dict[str, CameraRecord]:
        """Return the camera with the requested eyes and bend."""
        if self.camera not in cameras:
            where = f"rig {self.world.rig.name}"
            raise UnknownNameError("camera", self.camera, cameras, where)
        record = cameras[self.camera]
        if self._calibration is not None:
            record = record.seeing(self._calibration)
        if self._angle is not None:
            record = record.bent(self._angle)
        return {self.camera: record}
