"""States of a teleoperation component, and what it says while it goes through them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

#: Source: SAW mtsTeleOperationPSM.cpp; mtsTeleOperationECM.cpp has all but the aligning.
DISABLED = "DISABLED"
SETTING = "SETTING_ARMS_STATE"
ALIGNING = "ALIGNING_MTM"
ENABLED = "ENABLED"
STATES = (DISABLED, SETTING, ALIGNING, ENABLED)

#: {what a client asks for: the state that is then desired}. Source: as above.
COMMANDS = {"enable": ENABLED, "disable": DISABLED, "align_mtm": ALIGNING}

#: Arms that were asked to get ready have so long. Source: SAW mtsTeleOperationPSM.cpp. [s]
READY_S = 60.0
#: What keeps a component from beginning is told so often. Source: SAW mtsTeleOperationPSM.cpp. [s]
TELL_S = 2.0

Level = Literal["error", "warning", "status"]
#: Called with what changed or happened: (key, value), as ("current_state", "ENABLED").
Tell = Callable[[str, object], None]


def nowhere(key: str, value: object) -> None:
    """Tell nobody."""
