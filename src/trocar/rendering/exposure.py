"""Automatic exposure, as a scope's video processor has it.

The measure is the median brightness of what is lit: a white board or a black corner is not half of
the picture, and leaves the rest as it is.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import replace
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.cameras import Calibration
from trocar.rendering.frames import Picture, StereoFrame
from trocar.rendering.look import AUTO
from trocar.simulation.cameras import CameraRecord
from trocar.simulation.records import Snapshot

if TYPE_CHECKING:
    from trocar.rendering.renderer import Renderer

#: Median brightness that is aimed at, as a share of white. Source: chosen by eye.
TARGET = 0.38
#: Fewest and most stops. Source: chosen by eye: beyond, light is all from the curve's flat end.
LEAST, MOST = -3.0, 4.0
#: So many stops shows what something is like in endless light.
ENDLESS = 20.0
#: A picture with a smaller share that is lit says nothing. Source: our own choice.
LIT = 0.02
#: Pixels between two that are looked at, and the height of a picture that is drawn to be measured.
#: Source: our own choice: a thousand pixels and more.
APART, MEASURED_HEIGHT = 16, 60
#: How fast exposure follows [s]. Source: our own choice; those of cameras take about half a second.
SETTLING_S = 0.25
#: A picture that is so near to it is left as it is [stops]. Source: our own choice, not seen.
STEADY = 0.1
#: Stops from one picture to the next of a series, for each of light: what is shown grows with the
#: root of light at first, and ever slower. Source: `shaders`.
GAIN = 2.0
#: After a gap of this much a series begins anew [s]. Source: our own choice.
GAP_S = 1.0
#: What moves less since it was drawn stands still [m, and rad]. Source: our own choice: a hundredth
#: of a pixel is more, at any distance.
STILL = 1e-7
#: How bright red, green and blue are. Source: ITU-R BT.601.
LUMA = np.array([0.299, 0.587, 0.114])

Array = NDArray[np.float64]


def luma(picture: Picture, apart: int = 1) -> Array:
    """Return the brightness of every so-manieth pixel as a share of white, (n,)."""
    return (picture[apart // 2 :: apart, apart // 2 :: apart] @ LUMA).ravel() / 255.0


def stops_of(plain: Picture, endless: Picture) -> float:
    """Return the stops at which a picture is as bright as it is to be.

    Light a is shown as c sqrt(a / (1 + a)), c in endless light, so two pictures tell of each pixel
    how it is shown at any exposure.

    Args:
        plain: taken with 0 stops, (h, w, 3)
        endless: the same with ENDLESS
    """
    least, most = luma(plain), luma(endless)
    seen = most > 0.0
    if seen.mean() < LIT:
        return 0.0
    share = np.clip((least[seen] / most[seen]) ** 2, 1e-6, 1.0 - 1e-6)
    light = share / (1.0 - share)
    stops = np.arange(LEAST, MOST + 0.125, 0.25)
    shown = light * 2.0 ** stops[:, None]
    medians = np.median(most[seen] * np.sqrt(shown / (1.0 + shown)), axis=1)
    return float(np.interp(TARGET, medians, stops))


def followed(stops: float, picture: Picture, passed_s: float) -> float:
    """Return the stops of the picture after one that was taken with some.

    Args:
        stops: that it was taken with
        picture: what it shows, (h, w, 3)
        passed_s: time between the two [s]
    """
    shown = luma(picture, APART)
    seen = shown[shown > 0.0]
    if len(seen) < LIT * len(shown):
        return stops
    off = GAIN * float(np.log2(TARGET / np.median(seen)))
    if abs(off) < STEADY:
        return stops
    share = 1.0 - float(np.exp(-passed_s / SETTLING_S))
    return float(np.clip(stops + share * off, LEAST, MOST))


def stands_still(before: Snapshot, now: Snapshot) -> bool:
    """Return whether no body of a world moved by as much as can be seen."""
    return before.build == now.build and all(
        bool((np.abs(a - b) < STILL).all())
        for a, b in ((before.positions, now.positions), (before.quaternions, now.quaternions))
    )


@lru_cache(maxsize=16)
def to_be_measured(calibration: Calibration) -> Calibration:
    """Return eyes whose pictures are small and show the same."""
    width, height = calibration.eyes[0].size
    small = max(1, round(width * MEASURED_HEIGHT / height)), MEASURED_HEIGHT
    return calibration.undistorted().resized(*small)


class Series:
    """Pictures that follow each other: the exposure of each follows from the one before.

    A camera's first picture is exposed for itself, as is one after a reset, an exchange of a tool
    or a gap of a second. Time is that of snapshots, so the same snapshots give the same pictures.
    While nothing moves, none is drawn: the one before is handed out with the new time.

    Args:
        renderer: draws; its look says whether exposure is automatic
    """

    def __init__(self, renderer: Renderer) -> None:
        self._renderer = renderer
        self._before: dict[str, StereoFrame] = {}
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
            beside: "depth", "ids": what is wanted more than the renderer has anyway
        """
        stops = self._stops(snapshot, cameras, camera)
        channels = self._renderer.channels.with_(beside)
        record = cameras[camera]
        wanted = record.build, record.calibration, record.angle, stops, channels
        before, drawn = self._before.get(camera), self._drawn.get(camera)
        if (
            before is not None
            and drawn is not None
            and drawn[1] == wanted
            and self._renderer.look.noise == 0.0
            and stands_still(drawn[0], snapshot)
        ):
            frame = replace(before, time=snapshot.time)
        else:
            draw = self._renderer.render
            frame = draw(snapshot, cameras, camera, stops=stops, channels=channels)
            self._drawn[camera] = snapshot, wanted
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
        return followed(before.exposure, before.left, passed)

    def close(self) -> None:
        """Let go of the graphics library."""
        self._renderer.close()
