"""Gains on the parameter server: /PSM1/yaw_controller/{p,i,d}, read whenever they are set.

Source: paper, section 3.5.2; dvrk_env, whose plugin reads /<joint>_controller/{p,i,d}.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Mapping
from concurrent.futures import CancelledError
from concurrent.futures import TimeoutError as FutureTimeoutError
from typing import TYPE_CHECKING, Any, TypeGuard, TypeVar

from trocar.errors import TrocarError
from trocar.interfaces.commands import MoveJp, Verb
from trocar.interfaces.crtk.transports.ros1.older_gains import FIRST, first_positions, older_keys

if TYPE_CHECKING:
    from trocar.interfaces.crtk.core import Core
    from trocar.interfaces.crtk.transports.ros1.master import Master
    from trocar.simulation import World

_log = logging.getLogger("trocar")

LETTERS = ("p", "i", "d")
SUFFIX = "_controller"
ASK_S = 5.0
OLDER = "dvrk_env"
T = TypeVar("T")


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
        self._moved = False

    def start(self) -> None:
        """Take over the gains that are set already, and set the others.

        Raises:
            MasterError: the master does not answer
            TrocarError: the simulation does not run
        """
        found = self._found()
        own = {f"/{arm}/{joint}{SUFFIX}": (arm, joint) for arm, joint in found}
        older = older_keys(self._core.loop.world.rig) if OLDER in self._core.compat else {}
        self._joints = own | older
        self._cache.set_notifier(self.changed)
        for key, place in own.items():
            gains = dict(zip(LETTERS, found[place], strict=True))
            there = self._subscribed(key)
            given = {letter: there[letter] for letter in LETTERS if letter in there}
            self._cache.set(key, gains | given)
            if given != gains:
                self._take_over(key, given)
                self._master.ask("setParam", key, gains | given)
                if key not in self._set:
                    self._set.append(key)
        first: dict[tuple[str, str], float] = {}
        for key, place in older.items():
            there = self._subscribed(key)
            self._cache.set(key, dict.fromkeys(LETTERS, 0.0) | there)
            self._take_over(key, {letter: there[letter] for letter in LETTERS if letter in there})
            value = there.get(FIRST)
            if finite(value):
                first[place] = float(value)
        self._move_first(first)

    def _subscribed(self, key: str) -> dict[str, Any]:
        """Have the master tell changes of a parameter; return what it holds now."""
        _, _, there = self._master.ask("subscribeParam", self._uri, key)
        return there if isinstance(there, dict) else {}

    def _take_over(self, key: str, given: Mapping[str, object]) -> None:
        if given:
            _log.warning("ROS 1: gains are taken from the parameter %s: %s", key, dict(given))
            self.changed(key, given)

    def _move_first(self, first: Mapping[tuple[str, str], float]) -> None:
        """Move arms to the positions that dvrk_env's parameters have for the start, once."""
        if not first or self._moved:
            return
        self._moved = True
        rig = self._core.loop.world.rig
        now = self._ask(
            lambda world: {name: tuple(arm.setpoints()) for name, arm in world.arms.items()}
        )
        for arm, goal in first_positions(rig, first, now).items():
            _log.warning("ROS 1: %s moves to the parameters %s: %s", arm, FIRST, goal)
            self._core.loop.post(MoveJp(arm, goal))

    def changed(self, key: str, value: object) -> None:
        """Take over a parameter that was set: one gain, or all of a joint."""
        name, _, letter = key.rstrip("/").rpartition("/")
        values: Mapping[str, object]
        if letter in LETTERS and name in self._joints:
            values = {letter: value}
        elif key.rstrip("/") in self._joints and isinstance(value, Mapping):
            name, values = key.rstrip("/"), {k: v for k, v in value.items() if k in LETTERS}
        else:
            return
        arm, joint = self._joints[name]
        good = {k: float(v) for k, v in values.items() if usable(v)}
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

        return self._ask(look)

    def _ask(self, question: Callable[[World], T]) -> T:
        """Return what the loop answers, once it runs."""
        try:
            return self._core.loop.ask(question).result(ASK_S)
        except (CancelledError, FutureTimeoutError) as error:
            raise TrocarError("the simulation does not run") from error


def usable(value: object) -> TypeGuard[float]:
    """Tell whether a parameter can be a gain."""
    return finite(value) and value >= 0.0


def finite(value: object) -> TypeGuard[float]:
    """Tell whether a parameter is a finite number."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    return math.isfinite(value)
