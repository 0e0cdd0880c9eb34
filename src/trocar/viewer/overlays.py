"""Contact forces as arrows, paths of tips, and a workspace, over the scene of one browser."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from concurrent.futures import Future
from typing import TYPE_CHECKING, Any

import numpy as np
import viser
from numpy.typing import NDArray

from trocar.live.state import LoopState
from trocar.viewer.help import hint
from trocar.viewer.scene import tips_of
from trocar.viewer.server import when_touched
from trocar.viewer.workspace import WorkspaceSurface

if TYPE_CHECKING:
    from trocar.live.loop import Loop
    from trocar.simulation import World
    from trocar.viewer.desk import Desk

Floats = NDArray[np.float64]

M_PER_N, SHORTEST_N, LONGEST_M = 0.01, 0.02, 0.15
"""Length of an arrow per newton, least force that is drawn, and longest arrow. Source: by eye."""

LABELLED = 6
"""Contacts with their newtons beside them, the largest first. Source: by eye."""

ARROW = (206, 32, 112)
PATHS = ((28, 111, 196), (224, 122, 24), (46, 139, 62), (150, 70, 190), (90, 90, 90))
"""Colours of arrows and paths. Source: by eye."""

PATH_S, PATH_STEP_M = 10.0, 2e-4
"""Time that a path keeps, and least way between its points. Source: our own choice."""


class Overlays:
    """Arrows, paths and a workspace over the scene, and their folder, in the open container.

    Args:
        desk: of the browser
        loop: of the world

    Attributes:
        workspace: of the chosen arm
    """

    def __init__(self, desk: Desk, loop: Loop) -> None:
        self._scene, self._loop = desk.browser.scene, loop
        self._answer: Future[tuple[float, Floats, dict[str, Floats]]] | None = None
        self._arrows: viser.ArrowsHandle | None = None
        self._labels: list[viser.LabelHandle] = []
        self._paths: dict[str, deque[tuple[float, Floats]]] = {}
        self._lines: dict[str, viser.LineSegmentsHandle] = {}
        gui = desk.browser.gui
        with gui.add_folder("See", expand_by_default=False):
            self._forces = gui.add_checkbox("Contact forces", False, hint=hint("Contact forces"))
            self._trails = gui.add_checkbox("Tip paths", False, hint=hint("Tip paths"))
            self.workspace = WorkspaceSurface(desk, loop)
        for box in (self._forces, self._trails):
            when_touched(box, lambda _: self._clear())

    @property
    def shown(self) -> tuple[int, Mapping[str, int]]:
        """Number of arrows, and of the points of each path."""
        arrows = 0 if self._arrows is None else len(self._arrows.points)
        return arrows, {name: len(path) for name, path in self._paths.items()}

    def show(self, state: LoopState) -> None:  # noqa: ARG002  as of a folder
        """Draw what is chosen."""
        self.workspace.show()
        if not (self._forces.value or self._trails.value):
            return
        if self._answer is None:
            self._answer = self._loop.ask(_read)
        elif self._answer.done():
            answer, self._answer = self._answer, None
            if not answer.cancelled() and answer.exception() is None:
                time_s, contacts, tips = answer.result()
                if self._forces.value:
                    self._draw_forces(contacts)
                if self._trails.value:
                    self._draw_paths(time_s, tips)

    def close(self) -> None:
        """Take everything off the scene."""
        self._clear()
        self.workspace.close()

    def _clear(self) -> None:
        for node in (self._arrows, *self._labels, *self._lines.values()):
            if node is not None:
                node.remove()
        self._arrows = None
        self._labels.clear()
        self._lines.clear()
        self._paths.clear()

    def _draw_forces(self, contacts: Floats) -> None:
        """Draw arrows from the points of contact: (n, 6), point [m] and force [N]."""
        newtons = np.linalg.norm(contacts[:, 3:], axis=1)
        order = np.argsort(-newtons)
        order = order[newtons[order] > SHORTEST_N]
        at, force, size = contacts[order, :3], contacts[order, 3:], newtons[order]
        length = np.minimum(M_PER_N * size, LONGEST_M) / np.maximum(size, SHORTEST_N)
        points = np.stack([at, at + force * length[:, None]], axis=1).astype(np.float32)
        if self._arrows is not None:
            self._arrows.remove()
            self._arrows = None
        if len(points):
            self._arrows = self._scene.add_arrows(
                "/see/forces", points, ARROW,
                shaft_radius=0.0012, head_radius=0.003, head_length=0.007,
            )  # fmt: skip
        texts = [f"{newton:.2f} N" for newton in size[:LABELLED]]
        while len(self._labels) > len(texts):
            self._labels.pop().remove()
        for number, text in enumerate(texts):
            if number == len(self._labels):
                label = self._scene.add_label(
                    f"/see/newtons_{number}", text, anchor="bottom-left", font_screen_scale=0.7
                )
                self._labels.append(label)
            label = self._labels[number]
            if label.text != text:
                label.text = text
            label.position = points[number, 1]

    def _draw_paths(self, time_s: float, tips: Mapping[str, Floats]) -> None:
        for number, (name, tip) in enumerate(tips.items()):
            path = self._paths.setdefault(name, deque())
            at = tip[:3, 3]
            if path and time_s < path[-1][0]:
                path.clear()
            if not path or np.linalg.norm(at - path[-1][1]) > PATH_STEP_M:
                path.append((time_s, at))
            while path and time_s - path[0][0] > PATH_S:
                path.popleft()
            if (line := self._lines.pop(name, None)) is not None:
                line.remove()
            if len(path) > 1:
                points = np.array([point for _, point in path])
                self._lines[name] = self._scene.add_line_segments(
                    f"/see/path_{name}",
                    np.stack([points[:-1], points[1:]], axis=1).astype(np.float32),
                    PATHS[number % len(PATHS)],
                    thickness=0.0015,
                )


def _read(world: World) -> tuple[float, Floats, dict[str, Floats]]:
    contacts: Any = [(*c.point, *c.force) for c in world.contacts().contacts]
    return world.time, np.array(contacts, dtype=np.float64).reshape(-1, 6), tips_of(world)
