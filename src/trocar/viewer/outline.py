"""The outline of the world: arms, links and objects by name, to hide, to find and to pick."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from concurrent.futures import Future
from dataclasses import dataclass
from html import escape
from typing import TYPE_CHECKING, Any, cast

import numpy as np
import viser
from numpy.typing import NDArray

from trocar.geometry.rotations import matrix_from_quaternion
from trocar.live.state import LoopState
from trocar.rendering.primitives import joined, surface
from trocar.viewer.help import hint
from trocar.viewer.scene import body_names, drawing_node, node_of
from trocar.viewer.server import Buttons

if TYPE_CHECKING:
    from trocar.live.loop import Loop
    from trocar.rendering.primitives import TriangleSurface
    from trocar.simulation import World
    from trocar.simulation.records import ShapeRecord, Snapshot
    from trocar.viewer.desk import Desk

Floats = NDArray[np.float64]

LINK_AXES_M, LINK_RADIUS_M = 0.12, 0.003
"""Length and radius of the axes of the picked link [m]. Source: by eye."""

SLIVER_M2, EDGE = 1e-12, 1e-9
"""Area of triangles that no ray meets, as at the poles of balls [m2], and the part of a triangle by
which it reaches over its edges, so that no ray passes between two. Source: our own choice."""

OBJECTS, DRAWN = "objects", "tissue and threads"
PICK, CLICK = "Click in the scene", "click a link ... (cancel)"

STYLE = """<style>
.trocar .tree button { font: inherit; border: none; background: none; padding: 0 3px;
  cursor: pointer; color: inherit; text-align: left; }
.trocar .tree button.eye { width: 22px; text-align: center; color: #1c6fa4; }
.trocar .tree .off { opacity: .45; }
.trocar .tree .picked { background: #1c6fa4; color: white; border-radius: 3px; }
.trocar .tree .leaf { padding-left: 18px; }
</style>"""


@dataclass(frozen=True)
class OutlineEntry:
    """A line of the outline.

    Attributes:
        name: of MuJoCo's body, as "PSM1/wrist_yaw" and "table", or of a drawing
        node: of the scene
        body: number of the body; None of a drawing, which has no frame
    """

    name: str
    node: str
    body: int | None


class Outline:
    """The tree of one browser, in the container that is open.

    What is hidden is hidden in this browser alone: an empty node of its own scene takes the place
    of the node that all browsers share.

    Args:
        desk: of the browser
        loop: of the world

    Attributes:
        groups: {arm, or a heading: its entries}
        hidden: names of the entries that are hidden
        opened: groups that show their entries
        picked: the entry whose name and axes are in the scene; None: none
    """

    def __init__(self, desk: Desk, loop: Loop) -> None:
        self._scene, self._loop = desk.browser.scene, loop
        self._answer: Future[tuple[int, tuple[ShapeRecord, ...]]] | None = None
        self._build: int | None = None
        self._shapes: tuple[ShapeRecord, ...] = ()
        self._drawn: tuple[str, ...] = ()
        self._surfaces: dict[int, TriangleSurface] = {}
        self._now: Snapshot = loop.latest
        self._covers: dict[str, viser.FrameHandle] = {}
        self._axes: viser.FrameHandle | None = None
        self._label: viser.LabelHandle | None = None
        self._picking = False
        self.groups: Mapping[str, Sequence[OutlineEntry]] = {}
        self.hidden: set[str] = set()
        self.opened: set[str] = set()
        self.picked: OutlineEntry | None = None
        desk.pressers["outline"] = self.press
        gui = desk.browser.gui
        with gui.add_folder("Outline", expand_by_default=False):
            self._pick = Buttons(gui, "Pick", (PICK,), lambda _: self._arm_pick(), hint("Pick"))
            self._tree = gui.add_html("")

    # ------------------------------------------------------------------ refreshing

    def show(self, state: LoopState) -> None:
        """Follow the picked link; read the world again after a tool exchange."""
        now = self._now = state.snapshot
        if self._answer is not None and self._answer.done():
            answer, self._answer = self._answer, None
            if not answer.cancelled() and answer.exception() is None:
                self._build, self._shapes = answer.result()
                self._surfaces.clear()
                self._renew()
        drawn = tuple(drawing.name for drawing in now.drawings)
        if drawn != self._drawn:
            self._drawn = drawn
            self._renew()
        if now.build != self._build and self._answer is None:
            self._answer = self._loop.ask(_read)
        self._place()

    def close(self) -> None:
        """Take marks off the scene, and show everything."""
        self._stop_pick()
        self._unmark()
        for cover in self._covers.values():
            cover.remove()
        self._covers.clear()
        self.hidden.clear()

    def _renew(self) -> None:
        """Bring the tree in line with the world."""
        self.groups = outline(self._shapes, self._drawn)
        there = {entry.name for entries in self.groups.values() for entry in entries}
        for name in self.hidden - there:
            self._covers.pop(name).remove()
        self.hidden &= there
        if self.picked is not None:
            name = self.picked.name
            self._unmark()
            if name in there:
                self.pick(name)
        self._draw()

    # ------------------------------------------------------------------ a person's choices

    def press(self, words: str) -> None:
        """Act on "open/GROUP", "see/GROUP", "see/NAME" or "pick/NAME"; ignore unknown names."""
        kind, _, name = words.partition("/")
        entries = {entry.name: entry for group in self.groups.values() for entry in group}
        if kind == "open" and name in self.groups:
            self.opened ^= {name}
        elif kind == "see" and name in self.groups:
            self._see(self.groups[name])
        elif kind == "see" and name in entries:
            self._see([entries[name]])
        elif kind == "pick" and name in entries:
            self.pick("" if self.picked == entries[name] else name)
        self._draw()

    def pick(self, name: str) -> None:
        """Mark a link by its name and the axes of its frame; "": none."""
        self._unmark()
        for group, entries in self.groups.items():
            for entry in entries:
                if entry.name == name and entry.body is not None:
                    self.picked = entry
                    self.opened.add(group)
        if self.picked is not None:
            self._axes = self._scene.add_frame(
                "/see/picked", axes_length=LINK_AXES_M, axes_radius=LINK_RADIUS_M
            )
            self._label = self._scene.add_label("/see/picked_name", name, anchor="bottom-left")
            self._place()
        self._draw()

    def _see(self, entries: Sequence[OutlineEntry]) -> None:
        """Hide entries, or show them where all of them are hidden."""
        hide = any(entry.name not in self.hidden for entry in entries)
        for entry in entries:
            if hide and entry.name not in self.hidden:
                self._covers[entry.name] = self._scene.add_frame(entry.node, show_axes=False)
                self.hidden.add(entry.name)
            elif not hide:
                self._covers.pop(entry.name).remove()
                self.hidden.discard(entry.name)

    # ------------------------------------------------------------------ the scene

    def _place(self) -> None:
        """Move the marks to the picked link."""
        if self.picked is None or self._axes is None or self._label is None:
            return
        at, turn = self._now.positions, self._now.quaternions
        if self._now.build == self._build and self.picked.body is not None:
            body = self.picked.body
            self._axes.position, self._axes.wxyz = at[body], turn[body]
            self._label.position = at[body]

    def _unmark(self) -> None:
        for mark in (self._axes, self._label):
            if mark is not None:
                mark.remove()
        self._axes = self._label = self.picked = None

    def _arm_pick(self) -> None:
        """Pick with the next click in the scene, or no longer."""
        if self._picking:
            self._stop_pick()
            return
        self._picking = True
        self._pick.show((CLICK,))
        cast(Any, self._scene).on_click()(self._clicked)  # typed for plain functions alone

    def _stop_pick(self) -> None:
        if self._picking:
            self._picking = False
            cast(Any, self._scene).remove_click_callback(self._clicked)
            self._pick.show((PICK,))

    async def _clicked(self, event: viser.SceneClickEvent) -> None:
        self._stop_pick()
        seen = self.under(np.array(event.ray_origin), np.array(event.ray_direction))
        self.pick(seen)

    def under(self, origin: Floats, direction: Floats) -> str:
        """Return the name of the first link that a ray meets, of those that are shown; "": none."""
        if self._now.build != self._build:
            return ""
        names = body_names(self._shapes)
        if not self._surfaces:
            for body in names:
                parts = [surface(shape) for shape in self._shapes if shape.body == body]
                self._surfaces[body] = joined(parts)
        nearest, found = np.inf, ""
        for body, name in names.items():
            if name in self.hidden:
                continue
            R = matrix_from_quaternion(self._now.quaternions[body])
            start = (origin - self._now.positions[body]) @ R
            far = first_hit(self._surfaces[body], start, direction @ R)
            if far < nearest:
                nearest, found = far, name
        return found

    # ------------------------------------------------------------------ the tree

    def _draw(self) -> None:
        picked = None if self.picked is None else self.picked.name
        html = tree_html(self.groups, self.opened, self.hidden, picked)
        if html != self._tree.content:
            self._tree.content = html


def outline(shapes: Sequence[ShapeRecord], drawn: Sequence[str]) -> dict[str, list[OutlineEntry]]:
    """Return the entries of the world, by arm; then objects, then tissue and threads.

    Args:
        shapes: of the world
        drawn: names of what bends
    """
    owner = {shape.body: shape.arm for shape in shapes}
    groups: dict[str, list[OutlineEntry]] = {}
    for body, name in sorted(body_names(shapes).items()):
        group = owner[body] or OBJECTS
        groups.setdefault(group, []).append(OutlineEntry(name, node_of(name), body))
    if OBJECTS in groups:
        groups[OBJECTS] = groups.pop(OBJECTS)
    if drawn:
        groups[DRAWN] = [OutlineEntry(name, drawing_node(name), None) for name in drawn]
    return groups


def first_hit(triangles: TriangleSurface, origin: Floats, direction: Floats) -> float:
    """Return the distance along a ray to a surface, in lengths of the direction; inf: not met.

    Source: Moeller, Trumbore 1997, Fast, Minimum Storage Ray/Triangle Intersection.

    Args:
        triangles: of the surface
        origin, direction: of the ray, (3,) each, in the frame of the surface [m]
    """
    middle = 0.5 * (triangles.points.min(axis=0) + triangles.points.max(axis=0))
    radius = float(np.linalg.norm(triangles.points - middle, axis=1).max())
    if np.linalg.norm(np.cross(middle - origin, direction)) > radius * np.linalg.norm(direction):
        return np.inf
    a, b, c = (triangles.points[triangles.faces[:, k]] for k in range(3))
    across = np.cross(direction, c - a)
    size = np.sum((b - a) * across, axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        u = np.sum((origin - a) * across, axis=1) / size
        ahead = np.cross(origin - a, b - a)
        v = ahead @ direction / size
        far = np.sum((c - a) * ahead, axis=1) / size
        met = (u >= -EDGE) & (v >= -EDGE) & (u + v <= 1.0 + EDGE) & (far > 0.0)
        met &= np.abs(size) > SLIVER_M2
    return float(far[met].min()) if met.any() else np.inf


def tree_html(
    groups: Mapping[str, Sequence[OutlineEntry]],
    opened: Collection[str],
    hidden: Collection[str],
    picked: str | None,
) -> str:
    """Return the tree as HTML; its buttons send "outline/..."."""
    rows: list[str] = []
    for group, entries in groups.items():
        gone = all(entry.name in hidden for entry in entries)
        mark = "&#9662;" if group in opened else "&#9656;"
        title = _button(f"open/{group}", f"{mark} {escape(group)} ({len(entries)})")
        rows.append(_row(_eye(group, gone) + title, gone))
        for entry in entries if group in opened else ():
            gone, short = entry.name in hidden, escape(entry.name.removeprefix(f"{group}/"))
            style = "picked" if entry.name == picked else ""
            leaf = short if entry.body is None else _button(f"pick/{entry.name}", short, style)
            rows.append(_row(_eye(entry.name, gone) + leaf, gone, "leaf"))
    inside = f'<div class="tree" data-trocar="outline">{"".join(rows)}</div>'
    return f'{STYLE}<div class="trocar">{inside}</div>'


def _row(inside: str, gone: bool, style: str = "") -> str:
    return f'<div class="{style}{" off" if gone else ""}">{inside}</div>'


def _eye(name: str, gone: bool) -> str:
    title = "show" if gone else "hide"
    mark = "&#9675;" if gone else "&#9679;"
    return _button(f"see/{name}", mark, "eye", f"{title} {name}")


def _button(words: str, inside: str, style: str = "", title: str = "") -> str:
    return (
        f'<button type="button" class="{style}" title="{escape(title)}"'
        f' data-trocar-send="outline/{escape(words)}">{inside}</button>'
    )


def _read(world: World) -> tuple[int, tuple[ShapeRecord, ...]]:
    return world.snapshot().build, world.shapes()
