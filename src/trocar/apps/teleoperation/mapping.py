"""What keys, sticks, buttons and pucks do: tables that the page and `--help` show, too."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass

from trocar.apps.teleoperation.drive import FAST, FINE, STICK, Drive

#: {key as a browser calls its place: (which of a drive, index, by how much)}. Source: KeyboardEvent
#: code values of W3C UI Events, which name places and not letters.
AXES = {
    "KeyD": ("move", 0, 1.0),
    "KeyA": ("move", 0, -1.0),
    "KeyW": ("move", 1, 1.0),
    "KeyS": ("move", 1, -1.0),
    "KeyR": ("move", 2, 1.0),
    "KeyF": ("move", 2, -1.0),
    "ArrowUp": ("turn", 0, 1.0),
    "ArrowDown": ("turn", 0, -1.0),
    "ArrowLeft": ("turn", 1, 1.0),
    "ArrowRight": ("turn", 1, -1.0),
    "KeyE": ("turn", 2, 1.0),
    "KeyQ": ("turn", 2, -1.0),
    "KeyO": ("grip", 0, 1.0),
    "KeyC": ("grip", 0, -1.0),
}
TOOLS = {f"Digit{k}": k for k in (1, 2, 3)}
FINE_KEYS, FAST_KEYS = {"KeyX"}, {"ShiftLeft", "ShiftRight"}
CAMERA_KEY = "KeyV"

#: A stick that is moved less is at rest. Source: our own choice; sticks come back that far. [0..1]
DEAD = 0.12


@dataclass(frozen=True)
class Line:
    """A line of a table: what is touched, and what it does."""

    touch: str
    does: str


KEYBOARD = (
    Line("A  D", "left, right"),
    Line("W  S", "up, down"),
    Line("R  F", "away, nearer"),
    Line("arrows", "turn up, down, left, right"),
    Line("Q  E", "roll left, right"),
    Line("C  O", "close, open the jaw"),
    Line("X (held)", f"fine: {FINE:g} of the speed"),
    Line("Shift (held)", f"fast: {FAST:g} times the speed"),
    Line("1  2  3", "use PSM1, PSM2, PSM3"),
    Line("V (held)", "drag the endoscope's picture instead"),
)
GAMEPAD = (
    Line("left stick", "left, right, up, down"),
    Line("right trigger, left trigger", "away, nearer"),
    Line("right stick", "turn left, right, up, down"),
    Line("left, right shoulder", "roll left, right"),
    Line("A  B", "close, open the jaw"),
    Line("X (held)", f"fine: {FINE:g} of the speed"),
    Line("Y (held)", "drag the endoscope's picture instead"),
    Line("left, right on the cross", "use the instrument before, the next one"),
)
SPACEMOUSE = (
    Line("push the cap", "left, right, up, down, away, nearer"),
    Line("turn the cap", "turn about the same axes"),
    Line("left, right button", "close, open the jaw"),
)
MASTERS = (
    Line("rings and arrows at the handles", "carry the simulated masters (drag them in the page)"),
    Line("gripper sliders", "pinch to begin; the jaw follows"),
)
TABLES = {
    "keyboard": KEYBOARD,
    "gamepad": GAMEPAD,
    "spacemouse": SPACEMOUSE,
    "masters": MASTERS,
}


def from_keys(held: Collection[str]) -> Drive:
    """Return what the keys that are held ask for; others do nothing."""
    sums = {"move": [0.0] * 3, "turn": [0.0] * 3, "grip": [0.0]}
    for key in held:
        if key in AXES:
            which, index, by = AXES[key]
            sums[which][index] += by
    pace = FINE if FINE_KEYS & set(held) else FAST if FAST_KEYS & set(held) else 1.0
    tool = next((TOOLS[key] for key in sorted(held) if key in TOOLS), 0)
    move, turn = (tuple(sums[which]) for which in ("move", "turn"))
    return Drive(move, turn, sums["grip"][0], pace, tool, 0, CAMERA_KEY in held)  # type: ignore[arg-type]  three each


def from_pad(axes: Sequence[float], buttons: Sequence[float]) -> Drive:
    """Return what a gamepad asks for.

    Args:
        axes, buttons: in the standard layout, -1 to 1 (down is above 0), and 0 to 1; how far the
            left and the right trigger are pulled may follow the four axes of the sticks. Source:
            W3C Gamepad, "standard gamepad"
    """

    def axis(index: int) -> float:
        return _beyond_rest(axes[index]) if index < len(axes) else 0.0

    def pressed(index: int) -> float:
        return min(max(buttons[index], 0.0), 1.0) if index < len(buttons) else 0.0

    def pulled(trigger: int) -> float:
        return axis(4 + trigger) if len(axes) >= 6 else _beyond_rest(pressed(6 + trigger))

    return Drive(
        move=(axis(0), -axis(1), pulled(1) - pulled(0)),
        turn=(-axis(3), -axis(2), pressed(5) - pressed(4)),
        grip=pressed(1) - pressed(0),
        pace=STICK * (FINE if pressed(2) > 0.5 else 1.0),
        step=int(pressed(15) > 0.5) - int(pressed(14) > 0.5),
        camera=pressed(3) > 0.5,
    )


def from_puck(push: Sequence[float], turn: Sequence[float], buttons: Sequence[bool]) -> Drive:
    """Return what a six-axis puck asks for.

    Args:
        push, turn: right, towards the hand, down; -1 to 1 each. Source: as 3Dconnexion's pucks
            report them
        buttons: left, right
    """
    soft: Callable[[float], float] = lambda v: min(max(_beyond_rest(v), -1.0), 1.0)  # noqa: E731
    right, near, down = (soft(v) for v in push)
    about_right, about_near, about_down = (soft(v) for v in turn)
    left_button, right_button = (*buttons, False, False)[:2]
    return Drive(
        move=(right, -down, -near),
        turn=(about_right, -about_down, -about_near),
        grip=float(right_button) - float(left_button),
        pace=STICK,
    )


def _beyond_rest(value: float) -> float:
    """Return a stick's deflection, gentle about its middle."""
    size = max(0.0, abs(value) - DEAD) / (1.0 - DEAD)
    return min(size, 1.0) ** 2 * (1.0 if value > 0.0 else -1.0)
