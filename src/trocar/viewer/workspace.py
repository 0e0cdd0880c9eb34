"""The workspace of the chosen arm: a translucent surface around what its tip reaches."""

from __future__ import annotations

import threading
from concurrent.futures import Future
from html import escape
from typing import TYPE_CHECKING

import numpy as np
import viser
from numpy.typing import NDArray

from trocar.errors import TrocarError
from trocar.geometry.rotations import quaternion_from_matrix
from trocar.kinematics.workspace import Workspace, workspace
from trocar.live.images import let_others_go_first
from trocar.viewer.help import hint
from trocar.viewer.server import when_touched

if TYPE_CHECKING:
    from trocar.kinematics import Mechanism
    from trocar.live.loop import Loop
    from trocar.simulation import World
    from trocar.viewer.desk import Desk

Floats = NDArray[np.float64]

COLOUR, OPACITY = (40, 130, 190), 0.22
"""Colour and opacity of the surface. Source: by eye."""

STILL = 1e-5
"""Least change of a pose that is sent [m, and of a quaternion]. Source: as of bodies."""

COMPUTED = "computing ..."


class WorkspaceSurface:
    """The surface of one browser's chosen arm, and its check box, in the container that is open.

    Args:
        desk: of the browser
        loop: of the world

    Attributes:
        box: the check box
        node: the surface; None while none is shown
        line: the arm that is shown, its volume, or the reason why nothing is
    """

    def __init__(self, desk: Desk, loop: Loop) -> None:
        self._desk, self._loop = desk, loop
        self._answer: Future[tuple[str, Mechanism | None, Floats]] | None = None
        self._made: tuple[Mechanism, Future[Workspace]] | None = None
        self._drawn: Mechanism | None = None
        self._pose = np.full(7, np.inf)
        self.node: viser.MeshHandle | None = None
        self.line = ""
        gui = desk.browser.gui
        self.box = gui.add_checkbox("Workspace", False, hint=hint("Workspace"))
        self._text = gui.add_html("", visible=False)
        when_touched(self.box, lambda _: None if self.box.value else self.close())

    def show(self) -> None:
        """Draw the surface where the arm stands, once it is computed."""
        if not self.box.value or self._desk.panel is None:
            return
        if self._answer is None:
            name = self._desk.panel.arm.name
            self._answer = self._loop.ask(lambda world: _read(world, name))
        elif self._answer.done():
            answer, self._answer = self._answer, None
            if not answer.cancelled() and answer.exception() is None:
                self._follow(*answer.result())

    def close(self) -> None:
        """Take the surface off the scene."""
        self._remove()
        self._say("")

    def _follow(self, arm: str, mechanism: Mechanism | None, T: Floats) -> None:
        if mechanism is None:
            self._remove()
            self._say(f"{arm} has no tip")
            return
        if self._made is None or self._made[0] is not mechanism:
            self._remove()
            self._made = mechanism, _begun(mechanism)
        made = self._made[1]
        if not made.done():
            self._say(f"{arm}: {COMPUTED}")
        elif (problem := made.exception()) is not None:
            self._say(str(problem))
        else:
            self._draw(arm, mechanism, made.result(), T)

    def _draw(self, arm: str, mechanism: Mechanism, found: Workspace, T: Floats) -> None:
        if self.node is None or self._drawn is not mechanism:
            self._remove()
            self.node = self._desk.browser.scene.add_mesh_simple(
                "/see/workspace",
                found.vertices.astype(np.float32),
                found.faces.astype(np.uint32),
                color=COLOUR,
                opacity=OPACITY,
                side="double",
                cast_shadow=False,
                receive_shadow=False,
            )
            self._drawn = mechanism
            self._say(f"{arm}: {1e3 * found.volume:.1f} l")
        pose = np.concatenate([T[:3, 3], quaternion_from_matrix(T[:3, :3])])
        if np.abs(pose - self._pose).max() > STILL:
            self.node.position, self.node.wxyz = pose[:3], pose[3:]
            self._pose = pose

    def _remove(self) -> None:
        if self.node is not None:
            self.node.remove()
        self.node = self._drawn = None
        self._pose = np.full(7, np.inf)

    def _say(self, text: str) -> None:
        if text != self.line:
            self.line = text
            self._text.content = f'<div class="trocar" data-trocar="workspace">{escape(text)}</div>'
            self._text.visible = bool(text)


def _read(world: World, name: str) -> tuple[str, Mechanism | None, Floats]:
    """Return an arm, its mechanism and T_world_reference; no mechanism of an arm without a tip."""
    description = world.arm(name).description
    if description.type == "SUJ":
        return name, None, np.eye(4)
    return name, description.mechanism, world.reference_pose(name)


def _begun(mechanism: Mechanism) -> Future[Workspace]:
    """Compute a workspace in a thread of its own, less urgent than the physics."""
    made: Future[Workspace] = Future()

    def compute() -> None:
        let_others_go_first()
        try:
            made.set_result(workspace(mechanism))
        except TrocarError as problem:
            made.set_exception(problem)

    threading.Thread(target=compute, name="trocar-workspace", daemon=True).start()
    return made
