"""Handles at the tips of instruments, and at objects while time stands still."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
import viser
from numpy.typing import NDArray

from trocar.geometry.rotations import matrix_from_quaternion, quaternion_from_matrix
from trocar.geometry.se3 import transform
from trocar.live.inbox import Command
from trocar.live.state import LoopState
from trocar.live.tip_goals import TipGoals
from trocar.viewer.help import hint
from trocar.viewer.server import Buttons

if TYPE_CHECKING:
    from concurrent.futures import Future

    from trocar.live.loop import Loop
    from trocar.simulation import World
    from trocar.viewer.desk import Desk

Floats = NDArray[np.float64]

CHOSEN, ALL, NONE = "of the chosen arm", "of all arms", "none"
SCALE_M, OBJECT_SCALE_M = 0.06, 0.08
"""Size of the handles [m]. Source: chosen by eye."""

GHOST, GHOST_RADIUS_M = (214, 60, 40), 0.004
"""Colour and radius of the ball at a goal that is out of reach [m]. Source: chosen by eye."""

UNDO = "Undo"


def free_objects(world: World) -> dict[str, Floats]:
    """Return poses of objects that may be placed, T_world_object; call it through `Loop.ask`."""
    return {
        name: thing.measured_cp().matrix
        for name, thing in world.objects.items()
        if thing.description.joint is None
    }


class TipHandles:
    """The handles of one browser, and their folder, in the container that is open.

    A handle follows its tip until a person drags it; then the tip follows the handle, and stays
    where it is let go. Where the goal is out of reach, a red ball with the reason stands there.

    Args:
        desk: of the browser
        goals: bring the tips there
        arms: with inverse kinematics
        things: objects that may be placed while time stands still
        loop: of the world
    """

    def __init__(
        self,
        desk: Desk,
        goals: TipGoals,
        arms: tuple[str, ...],
        things: tuple[str, ...],
        loop: Loop,
    ) -> None:
        self._desk, self._goals, self._loop = desk, goals, loop
        self._arms = arms
        gui, scene = desk.browser.gui, desk.browser.scene
        self._dragged: str | None = None
        self._before: list[tuple[str, str, Floats]] = []
        self._objects: dict[str, Any] = {}
        self._answer: Future[dict[str, dict[str, Floats]]] | None = None
        self._tips: Mapping[str, Floats] = {}
        self._placed: Mapping[str, Floats] = {}
        with gui.add_folder("Hands"):
            self._which = gui.add_dropdown(
                "Tip handles", [CHOSEN, ALL, NONE], initial_value=CHOSEN, hint=hint("Tip handles")
            )
            self._thing = gui.add_dropdown(
                "Object handle", [NONE, *things], visible=bool(things), hint=hint("Object handle")
            )
            self._undo = Buttons(gui, "Placement", (UNDO,), self._press, hint("Placement"))
            self._why = gui.add_html("", visible=False)
        self._nodes = {arm: self._handle(scene, arm) for arm in arms}
        self._ghosts = {
            arm: (
                scene.add_icosphere(
                    f"/hands/ghost_{arm}", radius=GHOST_RADIUS_M, color=GHOST, opacity=0.6,
                    visible=False,
                ),
                scene.add_label(f"/hands/why_{arm}", "", anchor="bottom-left", visible=False),
            )
            for arm in arms
        }  # fmt: skip

    @property
    def nodes(self) -> Mapping[str, viser.TransformControlsHandle]:
        """{arm: its handle}."""
        return self._nodes

    def show(self, state: LoopState) -> None:
        """Move handles to their tips, and show the goals that are out of reach."""
        if self._answer is None:
            self._answer = self._loop.ask(_poses(self._arms))
        elif self._answer.done():
            answer, self._answer = self._answer, None
            if not answer.cancelled() and answer.exception() is None:
                self._follow(answer.result(), state)

    def close(self) -> None:
        """Take the handles off the scene."""
        for node in (*self._nodes.values(), *self._objects.values()):
            node.remove()
        for ball, label in self._ghosts.values():
            ball.remove()
            label.remove()
        if self._dragged is not None:
            self._goals.stop(self._dragged)

    def drag(self, arm: str, pose: Floats, phase: str) -> None:
        """Bring a tip to its handle.

        Args:
            arm: its name
            pose: of the handle, T_world_tip (4, 4)
            phase: "start", "update" or "end" of a drag
        """
        if why := self._desk.blocked(arm):
            self._say(why)
            return
        if phase == "start":
            self._dragged = arm
            if arm in self._tips:
                self._before.append((arm, "", self._tips[arm]))
            return
        self._goals.set(arm, pose)
        if phase == "end":
            self._dragged = None

    def place(self, name: str, pose: Floats, phase: str) -> None:
        """Put an object to its handle at the end of a drag; as `drag`."""
        if why := self._desk.seat:
            self._say(why)
        elif phase == "start":
            self._dragged = name
        elif phase == "end":
            self._dragged = None
            before = self._placed.get(name)
            if before is not None:
                self._before.append(("", name, before))
            self._loop.post(Command(name, "set_cp", {"T": pose}))

    def undo(self) -> None:
        """Bring back what was placed last: the tip slowly, an object at once."""
        if not self._before or self._desk.seat:
            return
        arm, thing, pose = self._before.pop()
        if arm:
            self._goals.set(arm, pose)
        else:
            self._loop.post(Command(thing, "set_cp", {"T": pose}))

    # ------------------------------------------------------------------ inside

    def _follow(self, poses: Mapping[str, Mapping[str, Floats]], state: LoopState) -> None:
        self._tips, self._placed = poses["tips"], poses["objects"]
        which, panel = self._which.value, self._desk.panel
        chosen = "" if panel is None else panel.arm.name
        missed = self._goals.missed
        reasons: list[str] = []
        for arm, node in self._nodes.items():
            wanted = which == ALL or (which == CHOSEN and arm == chosen)
            blocked = self._desk.blocked(arm)
            _set_visible(node, wanted and not blocked)
            if blocked:
                self._goals.stop(arm)
            if self._dragged != arm and arm in self._tips and arm not in missed:
                _put(node, self._tips[arm])
            ball, label = self._ghosts[arm]
            why = missed.get(arm, "")
            _set_visible(ball, bool(why))
            _set_visible(label, bool(why))
            if why:
                ball.position = label.position = np.array(node.position)
                lines = why.replace("; ", "\n")
                if label.text != lines:
                    label.text = lines
                reasons.append(f"{arm}: {why}")
        self._show_objects(state)
        self._undo.show((UNDO,), disabled=not self._before or bool(self._desk.seat))
        self._say("; ".join(reasons))

    def _show_objects(self, state: LoopState) -> None:
        """Show handles of objects while time stands still."""
        free = state.paused and not self._desk.blocked("")
        wanted = {n: T for n, T in self._placed.items() if free and n == self._thing.value}
        for name in self._objects.keys() - wanted.keys():
            self._objects.pop(name).remove()
        for name, pose in wanted.items():
            if name not in self._objects:
                self._objects[name] = self._handle(self._desk.browser.scene, name, thing=True)
            if self._dragged != name:
                _put(self._objects[name], pose)

    def _handle(self, scene: viser.SceneApi, name: str, *, thing: bool = False) -> Any:
        node = scene.add_transform_controls(
            f"/hands/{'object' if thing else 'tip'}_{name}",
            scale=OBJECT_SCALE_M if thing else SCALE_M,
            depth_test=False,
            line_width=2.0,
            opacity=0.9,
            visible=thing,
        )

        @node.on_update
        async def _(event: viser.TransformControlsEvent) -> None:
            at = event.target
            pose = transform(matrix_from_quaternion(np.array(at.wxyz)), np.array(at.position))
            (self.place if thing else self.drag)(name, pose, event.phase)

        return node

    def _press(self, _: str) -> None:
        self.undo()

    def _say(self, why: str) -> None:
        text = f'<div class="trocar"><div class="why" data-trocar="reach">{why}</div></div>'
        if self._why.content != text:
            self._why.content = text
        if self._why.visible != bool(why):
            self._why.visible = bool(why)


def _poses(arms: tuple[str, ...]) -> Any:
    def read(world: World) -> dict[str, dict[str, Floats]]:
        tips = {name: world.arm(name).setpoint_cp("world").matrix for name in arms}
        return {"tips": tips, "objects": free_objects(world)}

    return read


def _put(node: Any, pose: Floats) -> None:
    at, turn = pose[:3, 3], quaternion_from_matrix(pose[:3, :3])
    if np.abs(np.array(node.position) - at).max() > 1e-5:
        node.position = at
    if np.abs(np.array(node.wxyz) - turn).max() > 1e-5:
        node.wxyz = turn


def _set_visible(node: Any, visible: bool) -> None:
    if node.visible != visible:
        node.visible = visible
