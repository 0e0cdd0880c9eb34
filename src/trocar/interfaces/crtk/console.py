"""The system and the surgeon's console: power, homing, sounds, and pedals that are emulated."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from typing import Any

from trocar.interfaces.crtk.fields import Message, RefusedError, button, number, text, vector

_log = logging.getLogger("trocar")

#: Called with a topic and the fields of its message, the header left out.
Tell = Callable[[str, Mapping[str, Any]], None]

#: What a switch of the whole system asks of every arm. Before version 2.4 of the dVRK the same
#: topics lay under console/.
EVERY_ARM = {
    f"{place}/{verb}": asked
    for place in ("system", "console")
    for verb, asked in (("power_on", "enable"), ("power_off", "disable"), ("home", "home"))
}
#: {topic that emulates a button: topics that tell of the button}. Source: dvrk_python, console.py;
#: a pedal is told of under both names.
BUTTONS = {
    "console/emulate_operator_present": ("console/operator_present",),
    "console/emulate_clutch": ("console/clutch", "footpedals/clutch"),
    "console/emulate_camera": ("console/camera", "footpedals/camera"),
}
#: Names of what a beep consists of, and the largest of each. Source: SAW system component; the
#: bounds are our own choice, the frequency's is what dvrk_python's own example asks for.
#: [s, Hz, 0 to 1]
BEEP = (("duration", 60.0), ("frequency", 50_000.0), ("volume", 1.0))


def _volume(message: Message, tell: Tell) -> None:
    volume = number(message, "data")
    if not 0.0 <= volume <= 1.0:
        raise RefusedError("volume", f"got a volume of {volume:g}; allowed: 0 to 1")
    tell("system/volume", {"data": volume})


def _beep(message: Message, tell: Tell) -> None:
    values = vector(message, "data")
    if not 1 <= len(values) <= len(BEEP):
        raise RefusedError(
            "shape", f"got {len(values)} numbers in data; allowed: [duration, frequency, volume]"
        )
    said: list[str] = []
    for value, (name, most) in zip(values, BEEP, strict=False):
        if not 0.0 <= value <= most:
            raise RefusedError("beep", f"got a {name} of {value:g}; allowed: 0 to {most:g}")
        said.append(f"{name} {value:g}")
    tell("system/status", {"data": f"beep: {', '.join(said)}"})


def _speech(message: Message, tell: Tell) -> None:
    said = text(message, "data")
    _log.info("said: %r", said)
    tell("system/status", {"data": f"said: {said}"})


def _emulated(topic: str) -> Callable[[Message, Tell], None]:
    def push(message: Message, tell: Tell) -> None:
        state = button(message)
        for shown in BUTTONS[topic]:
            tell(shown, {"axes": [], "buttons": [state]})

    return push


#: What nobody presses when the simulator starts.
RELEASED = (
    *(shown for topics in BUTTONS.values() for shown in topics),
    *(f"footpedals/{pedal}" for pedal in ("cam_minus", "cam_plus", "bicoag", "coag")),
)
VOLUME = 1.0


def begin(tell: Tell) -> None:
    """Say how everything stands when the simulator starts."""
    tell("system/volume", {"data": VOLUME})
    for name in RELEASED:
        tell(name, {"axes": [], "buttons": [0]})


#: {topic: what its messages do}; each checks first and tells then.
DEEDS: Mapping[str, Callable[[Message, Tell], None]] = {
    "system/set_volume": _volume,
    "system/beep": _beep,
    "system/string_to_speech": _speech,
    **{topic: _emulated(topic) for topic in BUTTONS},
}
