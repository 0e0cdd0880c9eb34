"""The topics of teleoperation: what clients may ask, and what is told to them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from trocar.apps.teleoperation.component import Component as Teleop
from trocar.apps.teleoperation.console import Console
from trocar.apps.teleoperation.engine import Ask, Teleoperation
from trocar.apps.teleoperation.states import COMMANDS
from trocar.apps.teleoperation.tool import ToolTeleoperation
from trocar.interfaces.crtk import Component, Topic, say
from trocar.interfaces.crtk.component import served
from trocar.interfaces.crtk.fields import Message, RefusedError, button, flag, number, text
from trocar.interfaces.crtk.teleop_rows import topics_of
from trocar.interfaces.crtk.topics import topics_from

if TYPE_CHECKING:
    from trocar.interfaces.crtk import Core
    from trocar.interfaces.crtk.clock import Stamp
    from trocar.interfaces.crtk.sample import RigFigures

#: What is told as a button. Source: SAW system_ROS.cpp declares these as Joy.
JOYS = ("rotation_locked", "translation_locked")
#: {key that the console tells: its topic}.
CONSOLE = "console/teleop"


def component(engine: Teleoperation) -> Component:
    """Return what a core serves of teleoperation."""
    return _Served(engine).component()


class _Served:
    """Connects an engine with a core.

    Every request becomes something that the engine does in the loop's thread; what it refuses
    there is told on `system/warning`.
    """

    def __init__(self, engine: Teleoperation) -> None:
        self._engine = engine
        self._core: Core | None = None

    def component(self) -> Component:
        """Return rows and what they do."""
        engine = self._engine
        rows = topics_of([c.says for c in engine.components.values()])
        handlers: dict[str, Callable[[Topic, Message], None]] = {}
        makers: dict[str, Any] = {}
        for one in engine.components.values():
            for key, act in self._asked_of(one).items():
                handlers[f"{one.name}/{key}"] = act
            if isinstance(one, ToolTeleoperation):
                makers[f"{one.name}/alignment_offset"] = partial(_offset, one)
        for key, act in self._asked_of_console(engine.console).items():
            handlers[f"{CONSOLE}/{key}"] = act
        return Component(
            served(topics_from(rows)), handlers, self._begin, self._heard(engine.console), makers
        )

    # ------------------------------------------------------------------ in

    def _asked_of(self, one: Teleop) -> dict[str, Callable[[Topic, Message], None]]:
        found = {
            "state_command": self._ask(_word, one.command),
            "set_scale": self._ask(_scale, one.set_scale),
        }
        if isinstance(one, ToolTeleoperation):
            found |= {
                "lock_rotation": self._ask(_flag, one.lock_rotation),
                "lock_translation": self._ask(_flag, one.lock_translation),
                "set_align_MTM": self._ask(_flag, one.set_align),
            }
        return found

    def _asked_of_console(self, console: Console) -> dict[str, Callable[[Topic, Message], None]]:
        return {
            "enable": self._ask(_flag, console.enable),
            "select": self._ask(self._name, console.select),
            "unselect": self._ask(self._name, console.unselect),
            "set_scale": self._ask(_scale, console.set_scale),
        }

    def _heard(self, console: Console) -> dict[str, Callable[[Topic, Message], None]]:
        """Return what pedals do, beside being told of."""
        return {
            "console/emulate_operator_present": self._ask(_pressed, console.see_operator),
            "console/emulate_clutch": self._ask(_pressed, console.press_clutch),
            "console/emulate_camera": self._ask(_pressed, console.press_camera),
        }

    def _ask(
        self, read: Callable[[Message], Any], act: Callable[[Any], None]
    ) -> Callable[[Topic, Message], None]:
        def handle(topic: Topic, message: Message) -> None:  # noqa: ARG001  as every handler
            value = read(message)
            if self._core is not None:
                self._core.incoming.post(Ask(lambda: act(value)))

        return handle

    def _name(self, message: Message) -> str:
        name = text(message, "data")
        if name not in self._engine.components:
            allowed = ", ".join(self._engine.components)
            raise RefusedError("component", f"got {name!r}; allowed: {allowed}")
        return name

    # ------------------------------------------------------------------ out

    def _begin(self, core: Core) -> Callable[[], None]:
        """Tell how everything stands, and of each change from now on."""
        self._core = core
        for one in self._engine.components.values():
            one.tell = partial(self._tell, one.name)
            for key, value in _standing(one).items():
                one.tell(key, value)
        console = self._engine.console
        console.tell = partial(self._tell, CONSOLE)
        console.tell("enabled", console.enabled)
        console.tell("scale", console.scale)
        for name in console.selected:
            console.tell("selected", name)
        return self._engine.start()

    def _tell(self, before: str, key: str, value: object) -> None:
        if self._core is not None:
            fields = say.joy(int(bool(value))) if key in JOYS else {"data": value}
            self._core.emit(f"{before}/{key}", fields)


def _standing(one: Teleop) -> Mapping[str, object]:
    """Return what a component tells before anything happens."""
    found: dict[str, object] = {
        "current_state": one.current,
        "desired_state": one.desired,
        "following": one.following,
        "scale": one.scale,
    }
    if isinstance(one, ToolTeleoperation):
        found |= {
            "rotation_locked": one.rotation_locked,
            "translation_locked": one.translation_locked,
            "align_mtm": one.align,
        }
    return found


def _offset(one: ToolTeleoperation, rig: RigFigures, stamp: Stamp) -> dict[str, Any]:  # noqa: ARG001
    """Return a geometry_msgs/QuaternionStamped of the rotation from handle to tip."""
    T = np.eye(4)
    T[:3, :3] = one.offset
    return {"header": say.header(stamp, one.masters[0].name), "quaternion": say.quaternion(T)}


def _word(message: Message) -> str:
    asked = text(message, "string")
    if asked not in COMMANDS:
        raise RefusedError("state", f"got {asked!r}; allowed: {', '.join(COMMANDS)}")
    return asked


def _flag(message: Message) -> bool:
    return flag(message, "data")


def _scale(message: Message) -> float:
    scale = number(message, "data")
    if not 0.0 < scale <= 1.0:
        raise RefusedError("scale", f"got a scale of {scale:g}; allowed: above 0 to 1")
    return scale


def _pressed(message: Message) -> bool:
    """Return whether a pedal is down; a quick tap has been released again."""
    return button(message) == 1
