"""Gains on the parameter server: /PSM1/yaw_controller/{p,i,d}, read whenever they are set.

Source: paper, section 3.5.2; dvrk_env, whose plugin reads /<joint>_controller/{p,i,d}.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Mapping
from concurrent.futures import CancelledError
from concurrent.futures import TimeoutError as FutureTimeoutError
from typing import TYPE_CHECKING, Any

from trocar.errors import TrocarError
from trocar.interfaces.commands import Verb

if TYPE_CHECKING:
    from trocar.interfaces.crtk.core import Core
    from trocar.interfaces.crtk.transports.ros1.master import Master
    from trocar.simulation import World

_log = logging.getLogger("trocar")

LETTERS = ("p", "i", "d")
SUFFIX = "_controller"
ASK_S = 5.0


class Gains:
    """Keep the arms' gains and the parameter server's in step, from there to here.

    Args:
        core: whose loop takes the gains
        master: holds the parameters
        node_uri: where the master tells changes
        cache: rospy's cache of parameters, which hears of them
    """

    def __init__(self, core: Core, master: Master, node_uri: str, cache: Any) -> None:
        self._core, self._master, self._uri, self._cache = core, master, node_uri, cache
        #: (arm, joint) by the parameter that holds its gains.
        self._joints: dict[str, tuple[str, str]] = {}
        self._set: list[str] = []

    def start(self) -> None:
        """Take over the gains that are set already, and set the others.

        Raises:
            MasterError: the master does not answer
        """
        found = self._found()
        self._joints = {f"/{arm}/{joint}{SUFFIX}": (arm, joint) for arm, joint in found}
        self._cache.set_notifier(self.changed)
        for key, place in self._joints.items():
            _, _, there = self._master.ask("subscribeParam", self._uri, key)
            own = dict(zip(LETTERS, found[place], strict=True))
            given = {k: v for k, v in there.items() if k in own} if isinstance(there, dict) else {}
            self._cache.set(key, own | given)
            if given and given != own:
                _log.warning(
                    "ROS 1: gains of %s are taken from parameter %s: %s", place, key, given
                )
                self.changed(key, given)
            if given != own:
                self._master.ask("setParam", key, own | given)
                self._set.append(key)

    def changed(self, key: str, value: object) -> None:
        """Take over a parameter that was set: one gain, or all of a joint."""
        name, _, letter = key.rstrip("/").rpartition("/")
        values: Mapping[str, object]
        if letter in LETTERS and name in self._joints:
            values = {letter: value}
        elif key.rstrip("/") in self._joints and isinstance(value, dict):
            name, values = key.rstrip("/"), {k: v for k, v in value.items() if k in LETTERS}
        else:
            return
        arm, joint = self._joints[name]
        good = {k: float(v) for k, v in values.items() if usable(v)}  # type: ignore[arg-type]
        for letter in sorted(values.keys() - good.keys()):
            text = f"{name}/{letter}: got {values[letter]!r}; allowed: a number, 0 or more"
            _log.warning("ROS 1: parameter refused: %s", text)
            self._core.emit(f"{self._core.prefixes[arm]}/warning", {"data": text})
        if good:
            self._core.loop.post(Verb(arm, "set_gains", {"joint": joint, **good}))

    def forget(self) -> None:
        """Delete the parameters that were set here, so that they outlive nobody."""
        for key in self._set:
            self._master.ask("deleteParam", key)
        self._set.clear()

    def _found(self) -> dict[tuple[str, str], tuple[float, float, float]]:
        """Return the gains of every joint that has a motor, {(arm, joint): (p, i, d)}."""

        def look(world: World) -> dict[tuple[str, str], tuple[float, float, float]]:
            return {
                (name, joint): arm.gains(joint)
                for name, arm in world.arms.items()
                for joint in arm.joint_names
            }

        try:
            return self._core.loop.ask(look).result(ASK_S)
        except (CancelledError, FutureTimeoutError) as error:
            raise TrocarError("the simulation does not run") from error


def usable(value: object) -> bool:
    """Tell whether a parameter can be a gain."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    return math.isfinite(value) and value >= 0.0
