"""Parameters on ROS 1's parameter server: the robot's model, gains, and whose clock counts."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, cast

from trocar.descriptions.records import RigDescription
from trocar.ros.parameters import LETTERS, MODEL, SIMULATED, Parameters

if TYPE_CHECKING:
    from trocar.ros.core import Core
    from trocar.ros.transports.ros1.master import RosMasterClient

_log = logging.getLogger("trocar")


class ServerParameters:
    """Set parameters on the server, and take over those that others set.

    Args:
        core: what is simulated
        master: holds the parameters
        node_uri: where the master reports changes
        cache: rospy's cache of parameters, which receives them
    """

    def __init__(self, core: Core, master: RosMasterClient, node_uri: str, cache: Any) -> None:
        self._core, self._master, self._uri, self._cache = core, master, node_uri, cache
        self._own = Parameters(core)
        #: (arm, joint) by the parameter that holds its gains.
        self._joints: dict[str, tuple[str, str]] = {}
        self._set: list[str] = []
        self._described: RigDescription | None = None

    def start(self) -> None:
        """Take over the gains that are set already, and set the others and the model.

        Raises:
            MasterError: the master does not answer
        """
        if self._own.simulated:
            self._put(f"/{SIMULATED}", True)
        self._joints = {f"/{name}": place for name, place in self._own.controllers.items()}
        self._cache.set_notifier(self.changed)
        for key in self._joints:
            _, _, there = self._master.ask("subscribeParam", self._uri, key)
            held = cast("dict[str, Any]", there if isinstance(there, dict) else {})
            given = {letter: held[letter] for letter in LETTERS if letter in held}
            gains = self._own.gains(key[1:])
            self._cache.set(key, gains | given)
            if given == gains:
                continue
            if given:
                text = "ROS 1: gains are taken from the parameter %s: %s"
                _log.warning(text, key, given)
                self.changed(key, given)
            self._put(key, gains | given)
        self._described = None
        self.follow()

    def follow(self) -> None:
        """Set the robot's model, anew after a tool was exchanged.

        Raises:
            MasterError: the master does not answer
        """
        rig = self._core.loop.world.rig
        if rig is not self._described:
            self._described = rig  # whether it can be or not: it is tried once
            model = self._own.model()
            if model is not None:
                self._put(f"/{MODEL}", model)

    def changed(self, key: str, value: object) -> None:
        """Take over a parameter that was set: one gain, or all of a joint."""
        key = key.rstrip("/")
        name, _, letter = key.rpartition("/")
        given: Mapping[str, object] = {}
        if letter in LETTERS and name in self._joints:
            given = {letter: value}
        elif key in self._joints and isinstance(value, Mapping):
            held = cast(Mapping[str, object], value)
            name, given = key, {k: v for k, v in held.items() if k in LETTERS}
        if given:
            self._own.set_gains(self._joints[name], name, given)

    def forget(self) -> None:
        """Delete the parameters that were set here.

        Raises:
            MasterError: the master does not answer
        """
        while self._set:
            self._master.ask("deleteParam", self._set[-1])
            self._set.pop()

    def _put(self, key: str, value: object) -> None:
        self._master.ask("setParam", key, value)
        if key not in self._set:
            self._set.append(key)
