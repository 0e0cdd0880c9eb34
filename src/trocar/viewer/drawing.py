"""Levels of drawing: light, shadows and reflections that a browser manages."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import viser

from trocar.viewer.channel import BrowserReport

AUTOMATIC = "automatic"

SLOW_HZ = 8.0
"""Frames a second below which the next lighter level is tried. Source: our own choice: an arm that
moves is then still seen to move."""

SMOOTH_HZ = 24.0
"""Frames a second from which the next richer level is tried, once. Source: as of a film."""

PATIENT = 2
"""Reports in a row that change the level. Source: our own choice: one may be of a busy moment."""


@dataclass(frozen=True)
class DrawingLevel:
    """A level of drawing.

    Attributes:
        shadows, reflections: whether there are any
        scale: pixels drawn over pixels of the screen, along each edge
        key, fill, sky: intensity of the lights
        joined: whether client.js draws all bodies in one go, lit at their vertices
    """

    name: str
    shadows: bool
    reflections: bool
    scale: float
    key: float
    fill: float
    sky: float
    joined: bool = False


LEVELS = (
    DrawingLevel("full", True, True, 1.0, 2.3, 0.5, 0.3),
    DrawingLevel("no shadows", False, True, 1.0, 2.3, 0.5, 0.3),
    DrawingLevel("plain", False, False, 0.7, 2.4, 0.0, 1.5, joined=True),
)
"""From rich to light. Source: intensities chosen by eye, so that levels look alike."""


class Drawing:
    """Draw the scene of one browser at a level, which is chosen by hand or by what it manages.

    Args:
        scene: the browser's

    Attributes:
        choice: name of the level that was chosen, or `AUTOMATIC`
        index: of the level in `LEVELS`; -1 before the first report
        frames_hz: frames a second when the scene last moved; None before
    """

    def __init__(self, scene: viser.SceneApi) -> None:
        self._scene = scene
        self.choice = AUTOMATIC
        self._slow = self._smooth = 0
        self._richest = 0
        self.index = -1
        self.frames_hz: float | None = None

    @property
    def level(self) -> DrawingLevel:
        """The level in force; the richest before the first report."""
        return LEVELS[max(self.index, 0)]

    def follow(self, report: BrowserReport) -> None:
        """Choose by a report: light without a graphics card, lighter where frames are few."""
        if report.frames_hz is not None:
            self.frames_hz = report.frames_hz
        if self.choice != AUTOMATIC:
            return
        if self.index < 0:
            self._show(len(LEVELS) - 1 if report.software else 0)
            return
        if report.frames_hz is None:
            return
        self._slow = self._slow + 1 if report.frames_hz < SLOW_HZ else 0
        self._smooth = self._smooth + 1 if report.frames_hz > SMOOTH_HZ else 0
        if self._slow >= PATIENT and self.index < len(LEVELS) - 1:
            self._richest = self.index + 1
            self._show(self.index + 1)
        elif self._smooth >= PATIENT and self.index > self._richest:
            self._show(self.index - 1)

    def choose(self, name: str) -> None:
        """Draw at the level of a name, or at the one that the browser manages: `AUTOMATIC`."""
        self.choice = name
        self._richest = 0
        if name != AUTOMATIC:
            self._show([level.name for level in LEVELS].index(name))

    def _show(self, index: int) -> None:
        self._slow = self._smooth = 0
        if index == self.index:
            return
        before, level = self.level if self.index >= 0 else None, LEVELS[index]
        self.index = index
        scene = self._scene
        if before is None or before.reflections != level.reflections:
            scene.configure_environment_map(
                "studio" if level.reflections else None, environment_intensity=0.25
            )
        scene.add_light_directional(
            "/light/key",
            color=(255, 247, 235),
            intensity=level.key,
            cast_shadow=level.shadows,
            position=(3, 1.2, 4),
        )
        scene.add_light_directional(
            "/light/fill",
            color=(214, 228, 255),
            intensity=level.fill,
            position=(-2, 4, 1.5),
            visible=level.fill > 0.0,
        )
        scene.add_light_hemisphere(
            "/light/sky",
            sky_color=(236, 242, 255),
            ground_color=(120, 118, 115),
            intensity=level.sky,
        )


def names() -> Sequence[str]:
    """Return the choices of a level."""
    return AUTOMATIC, *(level.name for level in LEVELS)
