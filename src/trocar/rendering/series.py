"""A series of images of moments that follow each other."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import replace

import numpy as np

from trocar.rendering.exposure import AIMED_S, followed
from trocar.rendering.frames import StereoFrame
from trocar.rendering.look import AUTO
from trocar.rendering.renderer import Renderer
from trocar.simulation.cameras import CameraRecord
from trocar.simulation.records import Snapshot

#: Gap after which automatic exposure restarts [s]. Source: our own choice.
GAP_S = 1.0
#: Motion of bodies below which the last image is used again [m, and rad]. Source: our own choice:
#: 10 mm ahead of an eye that is a tenth of a pixel of 1920x1080, and joints that settle are drawn
#: seldom.
STILL = 5e-7


def stands_still(before: Snapshot, now: Snapshot) -> bool:
    """Test whether no body of a world moved by as much as can be seen."""
    return before.build == now.build and all(
        bool((np.abs(a - b) < STILL).all())
        for a, b in ((before.positions, now.positions), (before.quaternions, now.quaternions))
    )


class Series:
    """Draw pictures that follow each other: the exposure of each follows from the one before.

    A camera's first picture is exposed for itself, as is one after a reset, an exchange of a tool
    or a gap of a second. Time is that of snapshots, so the same snapshots give the same pictures.
    While nothing moves, and nothing can bend, none is drawn: the one before is handed out with the
    new time.

    Args:
        renderer: its look sets whether exposure is automatic
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
            beside: "depth", "ids": channels beside those of the renderer
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
            and self._renderer.look.bleeding == 0.0
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
        """Return the stops of the next picture, None where the renderer's look sets them."""
        if self._renderer.look.exposure != AUTO or cameras[camera].kind != "endoscope":
            return None
        before = self._before.get(camera)
        passed = -1.0 if before is None else snapshot.time - before.time
        follows = before is not None and before.build == snapshot.build and 0.0 <= passed < GAP_S
        measured, aim = self._aims.get(camera, (-np.inf, 0.0))
        alone = 0.0
        if not follows or not 0.0 <= snapshot.time - measured < AIMED_S:
            alone, aim = self._renderer.meter(snapshot, cameras, camera)
            self._aims[camera] = snapshot.time, aim
        if before is None or not follows:
            return alone
        return followed(before.exposure, before.left, passed, aim)

    def close(self) -> None:
        """Release the graphics library."""
        self._renderer.close()
