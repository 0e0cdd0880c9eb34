"""The window of the rig's cameras: one eye, both, or both as an anaglyph; depth and ids."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Collection, Mapping
from html import escape

import numpy as np
import viser

from trocar.live.images import Packer, Picture, Pictures, Shot
from trocar.rendering.frames import anaglyph, picture, side_by_side
from trocar.viewer.help import hint
from trocar.viewer.legends import depth_legend, ids_legend
from trocar.viewer.server import when_pressed, when_touched
from trocar.viewer.viser_hooks import show_packed

RATE_HZ = 30.0
"""Largest rate of pictures on the page. Source: our own choice, as often as the scene."""

SPAN = 30
"""Pictures over which their rate is measured."""

VISIBLE_S = 0.2
"""Time without a refresh after which the page is closed and no picture is drawn [s]."""

SLOWEST_HZ = 2.0
"""Least rate of pictures while the arms fall behind real time. Source: our own choice."""

YIELD, RECOVER = 1.5, 1.1
"""Factors by which pictures become rarer while the arms fall behind, and more frequent again, five
times a second. Source: our own choice."""

WIDTH, GAP = 345, 12
"""Width of the window and distance from the edges, in CSS pixels. Source: chosen by eye."""

COLOUR, DEPTH, IDS = "colour", "depth", "ids"
LEFT, RIGHT, BOTH, ANAGLYPH, OFF = "left", "right", "both", "anaglyph", "off"

#: client.js finds the picture beside the button; Escape ends the full screen.
BELOW = """<style>.trocar .below button { font: inherit; padding: 2px 9px;
  border-radius: 4px; border: 1px solid #1c6fa4; background: none; color: #1c6fa4;
  cursor: pointer; white-space: nowrap; }</style>
<div class="trocar"><div class="below" style="display:flex;gap:8px;align-items:center">
{buttons}<span style="opacity:.62" data-trocar="scope">{status}</span></div></div>"""
BUTTONS = """<button data-trocar="full-screen">Full screen</button>
<button data-trocar-send="cameras/save" title="Save the picture as PNG">Save</button>
"""


class CameraWindow:
    """The window; made and refreshed in viser's thread, pictures come in the drawing thread.

    Args:
        gui: the page's widgets
        pictures: draws the cameras
        cameras: {name: number of eyes}, the first one is shown
        width: of the window [CSS px]
        save: takes the name and the bytes of a picture that a person saves

    Attributes:
        image, line: the picture, and the line below it
        legend: of false colours
        period_s: time between two pictures; longer while the arms fall behind real time
        window: the panel
    """

    def __init__(
        self,
        gui: viser.GuiApi,
        pictures: Pictures,
        cameras: Mapping[str, int],
        width: int = WIDTH,
        save: Callable[[str, bytes], object] = lambda _, __: None,
    ) -> None:
        self._pictures, self._cameras, self._save = pictures, dict(cameras), save
        self._packer = Packer()
        self._camera, self._view, self._content = next(iter(cameras)), LEFT, COLOUR
        self._shown: tuple[Shot, str, str] | None = None
        self._legend = ""
        self._fresh: bytes | None = None
        self._awaited = False
        self._came: deque[float] = deque(maxlen=SPAN)
        self._due = self._seen = 0.0
        self.period_s = 1.0 / RATE_HZ
        self._overlaid = pictures.overlay is not None
        self.window = gui.add_panel()
        with self.window.add_tab("Cameras"):
            if len(cameras) > 1:
                choice = gui.add_dropdown("Camera", list(cameras), hint=hint("Camera"))
                when_touched(choice, self.choose_camera)
            both = max(cameras.values()) > 1
            views = (LEFT, RIGHT, BOTH, ANAGLYPH, OFF) if both else (LEFT, OFF)
            when_pressed(gui.add_button_group("View", views, hint=hint("View")), self.choose_view)
            contents = (COLOUR, DEPTH, IDS)
            when_pressed(
                gui.add_button_group("Content", contents, hint=hint("Content")),
                self.choose_content,
            )
            if self._overlaid:
                when_touched(
                    gui.add_checkbox("Overlays", True, hint=hint("Overlays")), self.choose_overlays
                )
            self.image = gui.add_image(np.zeros((480, 640, 3), np.uint8), format="jpeg")
            self.legend = gui.add_html("", visible=False)
            self.line = gui.add_html(_line(BUTTONS, ""))  # as high as later: the window stays
        self.window.float(x=GAP, y=-GAP, width=width)  # the arms stay in sight
        self.leave = pictures.add(self, self.beside)

    # ------------------------------------------------------------------ viser's thread

    def show(self, now_s: float) -> None:
        """Show the newest picture; to be called while the page is open."""
        self._seen = now_s
        fresh, self._fresh = self._fresh, None
        if fresh is not None:
            show_packed(self.image, fresh)

    def show_status(self) -> None:
        """Show the rate of pictures, or the reason why none come; leave the arms their time."""
        if self._pictures.behind:
            self.period_s = min(self.period_s * YIELD, 1.0 / SLOWEST_HZ)
        else:
            self.period_s = max(self.period_s / RECOVER, 1.0 / RATE_HZ)
        status = self._pictures.failure or self._figures()
        line = _line("" if self._view == OFF else BUTTONS, status)
        if line != self.line.content:
            self.line.content = line
        legend = "" if self._content == COLOUR or self._view == OFF else self._legend
        if legend != self.legend.content:
            self.legend.content = legend
            self.legend.visible = bool(legend)

    def press(self, words: str) -> None:
        """Save the picture that is shown as PNG, on "save"."""
        shown = self._shown
        if words == "save" and shown is not None:
            shot, view, content = shown
            data = Packer("png").pack(self._picture(shot, view, content))
            self._save(f"{shot.camera}-{content}.png", data)

    def _figures(self) -> str:
        if self._view == OFF:
            return "off"
        if len(self._came) < 2:
            return "no image yet"
        rate = (len(self._came) - 1) / max(self._came[-1] - self._came[0], 1e-9)
        if self.period_s > 2.0 / RATE_HZ:
            return f"{rate:.0f} a second: the arms keep time"
        dropped = self._pictures.dropped
        return f"{rate:.0f} a second" + (f", {dropped} dropped" if dropped else "")

    def choose_camera(self, camera: str) -> None:
        """Show another camera."""
        self._camera = camera
        self._came.clear()
        if self._cameras[camera] == 1 and self._view != OFF:
            self._view = LEFT

    def choose_view(self, view: str) -> None:
        """Show another view of the camera, or none."""
        self._view = view
        self.image.visible = view != OFF
        self._came.clear()

    def choose_content(self, content: str) -> None:
        """Show colours, depth or ids."""
        self._content = content
        self._legend = ""
        self._came.clear()

    def choose_overlays(self, shown: bool) -> None:
        """Show pictures with or without overlays."""
        self._overlaid = shown

    # ------------------------------------------------------------------ other threads

    def wanted(self) -> Collection[str]:
        """Return the chosen camera, if the page is open and a picture is due."""
        now = time.perf_counter()
        if self._view == OFF or now - self._seen > VISIBLE_S or now < self._due:
            return ()
        self._due = (self._due if now - self._due < self.period_s else now) + self.period_s
        self._awaited = True
        return (self._camera,)

    def take(self, shot: Shot) -> None:
        """Keep a picture that the page requested; others belong to other clients."""
        if shot.camera != self._camera or self._view == OFF or not self._awaited:
            return
        self._awaited = False
        # Read once: a person may choose something else meanwhile.
        view, content = self._view, self._content
        if content != COLOUR and getattr(shot.frame, content) is None:
            return  # chosen since the request
        self._shown = shot, view, content
        self._fresh = self._packed(shot, view, content)
        if content == DEPTH:
            self._legend = depth_legend(shot.frame.depth)
        elif content == IDS:
            self._legend = ids_legend(shot.frame.ids, shot.frame.names)
        self._came.append(time.perf_counter())

    def beside(self) -> Mapping[str, Collection[str]]:
        """Return the images that are requested beside colours."""
        if self._content == COLOUR or not self._awaited:
            return {}
        return {self._camera: (self._content,)}

    def _packed(self, shot: Shot, view: str, content: str) -> bytes:
        """Pack the shown part of a picture as a file, once for all browsers where it can be."""
        alone = self._cameras[shot.camera] == 1 or view in (LEFT, RIGHT)
        if content == COLOUR and alone and shot.format == self._packer.format:
            return shot.packed(self._eye(shot, view), overlaid=self._overlaid)
        return self._packer.pack(self._picture(shot, view, content))

    def _picture(self, shot: Shot, view: str, content: str) -> Picture:
        """Compose the shown part of a picture, (h, w, 3) or (h, 2 w, 3)."""
        if content != COLOUR:
            eye = BOTH if view == BOTH else self._eye(shot, view)
            return picture(shot.frame, eye, content)
        if self._cameras[shot.camera] == 1 or view in (LEFT, RIGHT):
            return shot.eye(self._eye(shot, view), overlaid=self._overlaid)
        compose = side_by_side if view == BOTH else anaglyph
        left, right = (shot.eye(eye, overlaid=self._overlaid) for eye in (LEFT, RIGHT))
        return compose(left, right)

    def _eye(self, shot: Shot, view: str) -> str:
        """Return the eye that is shown where one is."""
        return RIGHT if view == RIGHT and self._cameras[shot.camera] > 1 else LEFT


def _line(buttons: str, status: str) -> str:
    return BELOW.replace("{buttons}", buttons).replace("{status}", escape(status))
