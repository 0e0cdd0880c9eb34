"""Parameters of ROS: the robot's model, the gains of every joint, and whether time is simulated.

ROS 1 has them on its server (/PSM1/yaw_controller/p), ROS 2 on the node (PSM1.yaw_controller.p).

Source: paper, section 3.5.2; dvrk_env, whose plugin reads /<joint>_controller/{p,i,d}.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, TypeGuard

from trocar.errors import TrocarError
from trocar.live.inbox import Command
from trocar.ros.robot_model import robot_model

if TYPE_CHECKING:
    from trocar.ros.core import Core

_log = logging.getLogger("trocar")

MODEL, SIMULATED = "robot_description", "use_sim_time"
LETTERS = ("p", "i", "d")
Value = bool | float | str


class Parameters:
    """Read and set the parameters of a running simulation; from any thread.

    Args:
        core: whose loop takes gains

    Attributes:
        controllers: {"PSM1/yaw_controller": (arm, joint)} of every joint that has a motor
    """

    def __init__(self, core: Core) -> None:
        self._core = core
        self.controllers = {
            f"{name}/{joint}_controller": (name, joint)
            for name, arm in core.loop.world.arms.items()
            for joint in arm.joints.names
        }

    @property
    def simulated(self) -> bool:
        """Whether header stamps are in simulated time."""
        return self._core.stamper.mode == "sim"

    def model(self) -> str | None:
        """Return the robot's model as URDF, which may take seconds; None where that fails."""
        try:
            return robot_model(self._core.loop.world.rig).urdf
        except TrocarError as error:
            _log.warning("cannot set parameter %s: %s", MODEL, error)
            return None

    def gains(self, controller: str) -> dict[str, float]:
        """Return the gains of a joint, {"p": ..., "i": ..., "d": ...}."""
        arm, joint = self.controllers[controller]
        return dict(zip(LETTERS, self._core.loop.world.arm(arm).joints.gains(joint), strict=True))

    def set_gains(self, place: tuple[str, str], name: str, given: Mapping[str, object]) -> str:
        """Set gains of a joint; return why some are rejected, which is published, too, or "".

        Args:
            place: (arm, joint)
            name: of the parameter, for the warning
            given: by letter
        """
        arm, joint = place
        good = {k: float(v) for k, v in given.items() if is_finite(v) and v >= 0.0}
        bad = [rejection(f"{name}/{k}", v) for k, v in sorted(given.items()) if k not in good]
        for text in bad:
            _log.warning("parameter rejected: %s", text)
            self._core.emit(f"{self._core.prefixes[arm]}/warning", {"data": text})
        if good:
            self._core.loop.post(Command(arm, "set_gains", {"joint": joint, **good}))
        return "; ".join(bad)

    # ------------------------------------------------------------------ as ROS 2 names them

    def names(self) -> list[str]:
        """Return the names of all parameters."""
        gains = [f"{name}.{letter}" for name in self.controllers for letter in LETTERS]
        return [MODEL, SIMULATED, *(name.replace("/", ".") for name in gains)]

    def read(self, names: Iterable[str]) -> dict[str, Value | None]:
        """Return the values of parameters, None where there is no such parameter."""
        found: dict[str, Value | None] = {}
        for name in names:
            controller, letter = _parts(name)
            if name == MODEL:
                found[name] = self.model()
            elif name == SIMULATED:
                found[name] = self.simulated
            else:
                known = controller in self.controllers and letter in LETTERS
                found[name] = self.gains(controller)[letter] if known else None
        return found

    def problem(self, name: str, value: object) -> str:
        """Return the reason that a parameter cannot be set to a value, or ""."""
        controller, letter = _parts(name)
        if controller not in self.controllers or letter not in LETTERS:
            read_only = name in (MODEL, SIMULATED)
            return f"{name}: {'read-only' if read_only else 'no such parameter'}"
        return "" if is_finite(value) and value >= 0.0 else rejection(name, value)

    def write(self, name: str, value: object) -> str:
        """Set a parameter; return why it is rejected, or ""."""
        controller, letter = _parts(name)
        if controller not in self.controllers:
            return self.problem(name, value)
        return self.set_gains(self.controllers[controller], controller, {letter: value})


def _parts(name: str) -> tuple[str, str]:
    """Return the controller and the letter of "PSM1.yaw_controller.p"."""
    controller, _, letter = name.rpartition(".")
    return controller.replace(".", "/", 1), letter


def rejection(name: str, value: object) -> str:
    """Return the error of a gain that cannot be set."""
    return f"{name}: got {value!r}; allowed: a number, 0 or more"


def is_finite(value: object) -> TypeGuard[float]:
    """Whether a parameter is a finite number."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    return math.isfinite(value)
