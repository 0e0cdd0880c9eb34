"""The folder of a person's own files: upload, preview, handle, save, load."""

from __future__ import annotations

import asyncio
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import viser
from numpy.typing import NDArray

from trocar.errors import TrocarError
from trocar.geometry.rotations import matrix_from_quaternion, quaternion_from_matrix
from trocar.geometry.se3 import transform
from trocar.live.state import LoopState
from trocar.simulation import World
from trocar.viewer.gallery import Choice, Gallery
from trocar.viewer.help import hint
from trocar.viewer.scene import glb, parts_of
from trocar.viewer.server import Buttons
from trocar.viewer.uploads import (
    MESHES,
    ROBOTS,
    SYSTEMS,
    Understood,
    archive,
    check_size,
    placed_rig,
    understand,
)
from trocar.viewer.viser_hooks import check_uploads

if TYPE_CHECKING:
    from trocar.viewer.desk import Desk

Floats = NDArray[np.float64]

SAVE, LOAD, REMOVE = "Save", "Load", "Remove"
AS_IN_FILE, UNITS = "as in the file", ("m", "mm", "cm", "in")
PIECES, HULL = "convex pieces", "convex hull"
SCALE_M = 0.12
"""Size of the handle [m]. Source: chosen by eye."""

BESIDE_M = np.array([0.15, 0.0, 0.0])
"""From the middle of the tips to where a thing appears [m]. Source: chosen by eye."""


class OwnThings:
    """The folder, in the container that is open.

    Args:
        desk: of the browser
        gallery: loads the rig with the thing
        rig: file of the rig that runs; "" of a rig built in Python
        taken: names of its arms and props
        place: where a thing appears, (3,) [m]
    """

    def __init__(
        self, desk: Desk, gallery: Gallery, rig: str, taken: tuple[str, ...], place: Floats
    ) -> None:
        self._desk, self._gallery, self._rig, self._taken = desk, gallery, rig, taken
        self._place = place
        self._thing: Understood | None = None
        self._nodes: list[Any] = []
        self._handle: Any = None
        self._works = False
        gui = desk.browser.gui
        with gui.add_folder("Own files", expand_by_default=False):
            self._unit = gui.add_dropdown("Unit", (AS_IN_FILE, *UNITS), hint=hint("Unit"))
            self._contact = gui.add_dropdown("Contact", (PIECES, HULL), hint=hint("Contact"))
            self._movable = gui.add_checkbox("Movable", True, hint=hint("Movable"))
            self._upload = gui.add_upload_button(
                "Upload a file", mime_type=",".join((*MESHES, *ROBOTS, *SYSTEMS)),
                hint=hint("Upload a file"),
            )  # fmt: skip
            self._acts = Buttons(gui, "Thing", (SAVE, LOAD, REMOVE), self._press, hint("Thing"))
            self._text = gui.add_html("")
        self._acts.set_visible(visible=False)
        check_uploads(gui, self._check)

        @self._upload.on_upload
        async def _(event: viser.GuiEvent[Any]) -> None:
            file = event.target.value
            await self._receive(file.name, file.content)

    def show(self, state: LoopState) -> None:  # noqa: ARG002  as of a folder
        """Grey out what cannot act."""
        off = self._works or bool(self._desk.seat)
        if self._upload.disabled != off:
            self._upload.disabled = off
        self._acts.show((SAVE, LOAD, REMOVE), disabled=off)

    def close(self) -> None:
        """Take the preview off the scene."""
        for node in self._nodes:
            node.remove()
        self._nodes.clear()
        if self._handle is not None:
            self._handle.remove()
            self._handle = None

    @property
    def pose(self) -> Floats:
        """The thing's place, T_world_thing (4, 4)."""
        if self._handle is None:
            return transform(np.eye(3), self._place)
        turn = matrix_from_quaternion(np.array(self._handle.wxyz))
        return transform(turn, np.array(self._handle.position))

    # ------------------------------------------------------------------ inside

    def _check(self, name: str, size: int) -> None:
        """Refuse a file that is too large before it is sent."""
        try:
            check_size(name, size)
        except TrocarError as error:
            self._say_error(str(error))
            raise

    async def _receive(self, name: str, content: bytes) -> None:
        """Import a file in another thread; show it, or its error in a notice."""
        if self._works or self._desk.seat:
            return
        unit = "" if self._unit.value == AS_IN_FILE else self._unit.value
        hull = self._contact.value == HULL

        def work() -> Understood:
            return understand(name, content, unit=unit, hull=hull, taken=self._taken)

        self._say([f"importing {name} ..."])
        found = await self._worked(work)
        if found is None:
            return
        self.close()
        self._thing = found
        self._acts.set_visible(visible=True)
        self._say([f"{found.name}: {found.lines[0]}", *found.lines[1:]])
        if found.bodies:
            self._preview(found)

    def _preview(self, thing: Understood) -> None:
        scene = self._desk.browser.scene
        self._handle = scene.add_transform_controls(
            "/own/handle", scale=SCALE_M, depth_test=False, line_width=2.0, position=self._place
        )
        for k, (pose, shapes) in enumerate(thing.bodies):
            self._nodes.append(
                scene.add_glb(
                    f"/own/handle/body_{k}",
                    glb(parts_of(shapes)),
                    position=pose[:3, 3],
                    wxyz=quaternion_from_matrix(pose[:3, :3]),
                )
            )

    def _press(self, name: str) -> None:
        if self._desk.seat or self._works or self._thing is None:
            return
        if name == REMOVE:
            self.close()
            self._thing = None
            self._acts.set_visible(visible=False)
            self._say([])
            return
        asyncio.ensure_future(self._save() if name == SAVE else self._load())  # noqa: RUF006  in viser's loop

    async def _save(self) -> None:
        """Send the rig's file with what stands beside it to the browser."""
        thing, pose, movable = self._thing, self.pose, self._movable.value
        browser = self._desk.browser
        if thing is None or not isinstance(browser, viser.ClientHandle):
            return
        packed = await self._worked(
            lambda: archive(placed_rig(self._rig, thing, pose, movable=movable))
        )
        if packed is not None:
            browser.send_file_download(
                f"{thing.name}.zip", packed, chunk_size=CHUNK, save_immediately=True
            )

    async def _load(self) -> None:
        """Let the rig with the thing run in place of the one that runs."""
        thing, pose, movable = self._thing, self.pose, self._movable.value
        if thing is None:
            return

        def work() -> Path:
            file = placed_rig(self._rig, thing, pose, movable=movable)
            World(file)  # its error appears here, while the one before still runs
            return file

        self._say([f"building the rig with {thing.name}; {self._gallery.running} ends ..."])
        file = await self._worked(work)
        if file is not None:
            self._gallery.chosen = Choice("rig", str(file))

    async def _worked(self, work: Any) -> Any:
        """Call a function in another thread; return its result, None after its error."""
        self._works = True
        try:
            return await asyncio.to_thread(work)
        except TrocarError as error:
            self._say_error(str(error))
            return None
        finally:
            self._works = False

    def _say(self, lines: list[str]) -> None:
        text = "<br>".join(map(escape, lines))
        self._text.content = f'<div class="trocar" data-trocar="own">{text}</div>' if text else ""

    def _say_error(self, text: str) -> None:
        self._say([text])
        browser = self._desk.browser
        if isinstance(browser, viser.ClientHandle):
            browser.add_notification("Not imported", text, color="red", auto_close_seconds=20.0)


CHUNK = 512 * 1024
"""Bytes of a message to the browser. Source: as the browser sends."""
