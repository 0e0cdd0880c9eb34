"""What a message that somebody published makes the simulator do."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from trocar.errors import InputError
from trocar.interfaces.commands import Verb

if TYPE_CHECKING:
    from trocar.interfaces.crtk.core import Core
    from trocar.interfaces.crtk.topics import Topic


def handle(core: Core, topic: Topic, message: dict[str, Any]) -> None:
    """Check a message and post the command that it is.

    Raises:
        InputError: what is wrong with it; nothing changes
    """
    if topic.arm and topic.key in ("servo_jp", "move_jp"):
        position = np.asarray(message.get("position", ()), dtype=np.float64)
        _post(core, topic.arm, topic.key, {"q": position})
    elif topic.arm and topic.key == "state_command":
        _post(core, topic.arm, topic.key, {"name": str(message.get("string", ""))})
    else:
        raise InputError("is not obeyed yet")


def _post(core: Core, arm: str, verb: str, values: dict[str, Any]) -> None:
    if not core.loop.post(Verb(arm, verb, values)):
        raise InputError("too many commands wait already")
