"""The endoscope of a world: pictures of it, one by one or as a stream."""

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
from trocar.rendering.exposure import AIMED_S, followed
from trocar.rendering.frames import StereoFrame
from trocar.rendering.look import AUTO, Look
from trocar.rendering.renderer import Channels, Renderer
from trocar.simulation import World
from trocar.simulation.cameras import CameraRecord
from trocar.simulation.records import Snapshot

_log = logging.getLogger("trocar")

Draw = Callable[[Snapshot, Mapping[str, CameraRecord]], StereoFrame]
#: A snapshot that is this much early is in time. Source: rounding of sums of periods. [s]
SLACK_S = 1e-9
#: How long ending may take: a frame that is being drawn is drawn to its end [s].
FAREWELL_S = 10.0


class Stream:
    """Takes snapshots where the world is stepped, and draws them elsewhere.

    A snapshot that is not drawn yet when the next one is due is dropped and counted; nothing waits
    in a queue, and the world never waits.

    Args:
        world: stepped by whoever has it
        draw: makes a frame
        rate_hz: frames a simulated second

    Attributes:
        made, dropped: frames drawn; snapshots that were overtaken before

    Raises:
        InputError: the rate is not above 0
    """

    def __init__(self, world: World, draw: Draw, rate_hz: float) -> None:
        if not isinstance(rate_hz, (int, float)) or not 0.0 < rate_hz < float("inf"):
            raise InputError(f"rate_hz: got {rate_hz!r}; allowed: above 0")
        self._world, self._draw, self._period = world, draw, 1.0 / rate_hz
        self._changed = threading.Condition()
        self._order: tuple[Snapshot, Mapping[str, CameraRecord]] | None = None
        self._newest: StereoFrame | None = None
        self._failure: TrocarError | None = None
        self._over = False
        self._due = world.time
        self.made = self.dropped = 0
        self._thread = threading.Thread(target=self._run, name="endoscope", daemon=True)
        self._leave: Callable[[], None] = lambda: None

    def __enter__(self) -> Stream:
        self._thread.start()
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
    def newest(self) -> StereoFrame | None:
        """The newest frame, None before the first.

        Raises:
            TrocarError: why no more are drawn
        """
        with self._changed:
            self._check()
            return self._newest

    def wait(self, after: StereoFrame | None = None, timeout_s: float = 10.0) -> StereoFrame:
        """Return a frame that is newer than another one, or the first.

        Raises:
            TrocarError: there is none after the timeout, or why no more are drawn
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
        with self._changed:
            self._over = True
            self._changed.notify_all()
        if self._thread.ident is not None:
            self._thread.join(FAREWELL_S)

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
        order = self._world.snapshot(), self._world.cameras()
        with self._changed:
            self.dropped += self._order is not None
            self._order = order
            self._changed.notify_all()

    def _run(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._over or self._order is not None)
                order, self._order = self._order, None
                if self._over or order is None:
                    return
            try:
                frame = self._draw(*order)
            except Exception as problem:  # noqa: BLE001  raised where a frame is requested
                self._fail(problem)
                return
            with self._changed:
                self._newest = frame
                self.made += 1
                self._changed.notify_all()

    def _fail(self, problem: Exception) -> None:
        if not isinstance(problem, TrocarError):
            _log.exception("no more pictures")
        error = problem if isinstance(problem, TrocarError) else TrocarError(repr(problem))
        with self._changed:
            self._failure = error
            self._changed.notify_all()


#: After a gap of this much a series begins anew [s]. Source: our own choice.
GAP_S = 1.0
#: What moves less since it was drawn stands still [m, and rad]. Source: our own choice: 10 mm ahead
#: of an eye that is a tenth of a pixel of 1920x1080, and joints that settle are drawn seldom.
STILL = 5e-7


def stands_still(before: Snapshot, now: Snapshot) -> bool:
    """Return whether no body of a world moved by as much as can be seen."""
    return before.build == now.build and all(
        bool((np.abs(a - b) < STILL).all())
        for a, b in ((before.positions, now.positions), (before.quaternions, now.quaternions))
    )


class Series:
    """Pictures that follow each other: the exposure of each follows from the one before.

    A camera's first picture is exposed for itself, as is one after a reset, an exchange of a tool
    or a gap of a second. Time is that of snapshots, so the same snapshots give the same pictures.
    While nothing moves, and nothing can bend, none is drawn: the one before is handed out with the
    new time.

    Args:
        renderer: draws; its look says whether exposure is automatic
    """

    def __init__(self, renderer: Renderer) -> None:
        self._renderer = renderer
        self._before: dict[str, StereoFrame] = {}
        self._aims: dict[str, tuple[float, float]] = {}
        self._drawn: dict[str, tuple[Snapshot, tuple[object, ...]]] = {}

    def render(
        self,
        snapshot: Snapshot,
        cameras: Mapping[str, CameraRecord],
        camera: str,
        *,
        beside: Collection[str] = (),
    ) -> StereoFrame:
        """Draw what a camera sees, as `Renderer.render`.

        Args:
            snapshot, cameras, camera: as there
            beside: "depth", "ids": further channels beside those of the renderer
        """
        stops = self._stops(snapshot, cameras, camera)
        channels = self._renderer.channels.with_(beside)
        record = cameras[camera]
        requested = record.build, record.calibration, record.angle, stops, channels
        before, drawn = self._before.get(camera), self._drawn.get(camera)
        if (
            before is not None
            and drawn is not None
            and drawn[1] == requested
            and self._renderer.look.noise == 0.0
            and not drawn[0].drawings
            and not snapshot.drawings
            and stands_still(drawn[0], snapshot)
        ):
            frame = replace(before, time=snapshot.time, arms=snapshot.arms)
        else:
            draw = self._renderer.render
            frame = draw(snapshot, cameras, camera, stops=stops, channels=channels)
            self._drawn[camera] = snapshot, requested
        self._before[camera] = frame
        return frame

    def _stops(
        self, snapshot: Snapshot, cameras: Mapping[str, CameraRecord], camera: str
    ) -> float | None:
        """Return the stops of the next picture, None where none before it says."""
        before = self._before.get(camera)
        if before is None or self._renderer.look.exposure != AUTO:
            return None
        passed = snapshot.time - before.time
        if before.build != snapshot.build or not 0.0 <= passed < GAP_S:
            return None
        if cameras[camera].kind != "endoscope":
            return None
        measured, aim = self._aims.get(camera, (-np.inf, 0.0))
        if not 0.0 <= snapshot.time - measured < AIMED_S:
            aim = self._renderer.aim(snapshot, cameras, camera)
            self._aims[camera] = snapshot.time, aim
        return followed(before.exposure, before.left, passed, aim)

    def close(self) -> None:
        """Let go of the graphics library."""
        self._renderer.close()


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
        visible: objects whose visible share frames have
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
            look,
        )
        self._series = Series(self.renderer)

    def capture(self) -> StereoFrame:
        """Return what the camera sees now, exposed for itself.

        Raises:
            InputError: a picture larger than the driver allows
            TrocarError: the graphics library was lost and cannot be opened again
        """
        return self.render(self.world.snapshot(), self.world.cameras())

    def capture_next(self) -> StereoFrame:
        """Return what the camera sees now, exposed as the next of a film: light fades over.

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
        """Return what the camera sees where a snapshot has everything, or would see if.

        Args:
            snapshot, cameras: of the world
            poses, only: objects that are elsewhere, and those that are there; see `Renderer.render`
            T_world_camera: where the camera is instead, midway between its eyes (4, 4)

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
