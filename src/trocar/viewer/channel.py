"""Messages between a browser and the simulator besides those of viser's widgets.

A hidden text field of viser's carries JSON both ways: client.js reads the simulator's facts from it
and writes the browser's reports into it.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, cast

import viser

from trocar.viewer.server import when_touched

LABEL = "trocar"
"""Label of the hidden field, by which client.js finds it."""

LONGEST = 1000
"""Most characters of a report. Source: our own choice, several times what client.js sends."""


@dataclass(frozen=True)
class BrowserReport:
    """Report of a browser about itself.

    Attributes:
        width: of its window [CSS px]
        software: whether it draws without a graphics card
        frames_hz: frames drawn a second while the scene moved; None while it stands still
        drawn: whether the scene is on its screen
        query: which its page shows to the server's sockets
    """

    width: int = 1920
    software: bool = False
    frames_hz: float | None = None
    drawn: bool = False
    query: str = ""


class Channel:
    """The hidden field of one browser; in viser's thread.

    Args:
        gui: the browser's widgets
        reported: called with each report
        pressed: called with the words of a pressed element that has `data-trocar-send`

    Attributes:
        report: the last one
    """

    def __init__(
        self,
        gui: viser.GuiApi,
        reported: Callable[[BrowserReport], object],
        pressed: Callable[[str], object],
    ) -> None:
        self._reported, self._pressed = reported, pressed
        self._facts: dict[str, Any] = {}
        self.report: BrowserReport | None = None
        self._field = gui.add_text(LABEL, "{}", visible=False)
        when_touched(self._field, self.receive)

    def send(self, facts: Mapping[str, Any]) -> None:
        """Send facts that changed."""
        if facts != self._facts:
            self._facts = dict(facts)
            self._field.value = json.dumps(self._facts)

    def receive(self, text: str) -> None:
        """Read what the browser wrote; ignore what client.js does not write."""
        found = _read(text)
        if isinstance(words := found.get("press"), str):
            self._pressed(words)
        elif (report := _report(found)) is not None:
            self.report = report
            self._reported(report)


def _read(text: str) -> dict[str, Any]:
    if len(text) > LONGEST:
        return {}
    try:
        found = json.loads(text)
    except (ValueError, RecursionError):
        return {}
    return cast("dict[str, Any]", found) if isinstance(found, dict) else {}


def _report(found: Mapping[str, Any]) -> BrowserReport | None:
    width, frames = found.get("width"), found.get("frames")
    if not isinstance(width, int) or not isinstance(frames, int | float | None):
        return None
    return BrowserReport(
        width,
        found.get("software") is True,
        None if frames is None else float(frames),
        found.get("drawn") is True,
        query if isinstance(query := found.get("query"), str) else "",
    )
