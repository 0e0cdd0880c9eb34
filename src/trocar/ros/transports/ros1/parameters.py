"""Parameters on ROS 1's parameter server: the robot's model, gains, and whose clock counts.

With the topics of dvrk_env, its parameters count, too, which its users load before they start.

Source: WPI-AIM/dvrk_env@07023a1: the plugin reads, of every joint that has a motor,
/dvrk/psm1/yaw_joint_controller/{p,i,d,init_joint}; config/dvrk.yaml holds them.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from trocar.descriptions.records import RigDescription
from trocar.live.inbox import Command
from trocar.ros.compat import joints_of
from trocar.ros.parameters import LETTERS, MODEL, SIMULATED, Parameters, is_finite

if TYPE_CHECKING:
    from trocar.ros.core import Core
    from trocar.ros.transports.ros1.master import RosMasterClient

_log = logging.getLogger("trocar")

OLDER = "dvrk_env"
#: The parameter with a joint's first position [rad or m].
FIRST = "init_joint"


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
        self._moved = False

    def start(self) -> None:
        """Take over the gains that are set already, and set the others and the model.

        Raises:
            MasterError: the master does not answer
        """
        if self._own.simulated:
            self._put(f"/{SIMULATED}", True)
        older = older_keys(self._core.loop.world.rig) if OLDER in self._core.compat else {}
        self._joints = {f"/{name}": place for name, place in self._own.controllers.items()} | older
        self._cache.set_notifier(self.changed)
        first: dict[tuple[str, str], float] = {}
        for key, place in self._joints.items():
            _, _, there = self._master.ask("subscribeParam", self._uri, key)
            there = there if isinstance(there, dict) else {}
            given = {letter: there[letter] for letter in LETTERS if letter in there}
            if key in older:
                gains = dict.fromkeys(LETTERS, 0.0)
                if is_finite(there.get(FIRST)):
                    first[place] = float(there[FIRST])
            else:
                gains = self._own.gains(key[1:])
            self._cache.set(key, gains | given)
            if given and given != gains:
                text = "ROS 1: gains are taken from the parameter %s: %s"
                _log.warning(text, key, given)
                self.changed(key, given)
            if key not in older and given != gains:
                self._put(key, gains | given)
        self._move_first(first)
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
            name, given = key, {k: v for k, v in value.items() if k in LETTERS}
        if given:
            self._own.set_gains(self._joints[name], name, given)

    def forget(self) -> None:
        """Delete the parameters that were set here, so that they outlive nobody.

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

    def _move_first(self, first: Mapping[tuple[str, str], float]) -> None:
        """Move arms to the positions that dvrk_env's parameters have for the start, once.

        Args:
            first: {(arm, joint): position [rad or m]}; other joints keep their set-points
        """
        if not first or self._moved:
            return
        self._moved = True
        now = self._core.loop.latest.arms
        for arm in self._core.loop.world.rig.arms:
            names = arm.arm.mechanism.joint_names[: arm.arm.own_joints]
            if any((arm.name, name) in first for name in names):
                held = now[arm.name].setpoint
                goal = tuple(
                    first.get((arm.name, name), float(held[k])) for k, name in enumerate(names)
                )
                text = "ROS 1: %s moves to the parameters %s: %s"
                _log.warning(text, arm.name, FIRST, goal)
                self._core.loop.post(Command(arm.name, "move_jp", {"q": goal}))


def older_keys(rig: RigDescription) -> dict[str, tuple[str, str]]:
    """Return {dvrk_env's parameter of a joint's gains: (arm, joint)}.

    Fingers are left out: there each has a motor, here the jaw has one.
    """
    return {
        f"/dvrk/{arm.name.lower()}/{joint.name}_controller": (arm.name, joint.own)
        for arm in rig.arms
        for joint in joints_of(arm.arm)
        if joint.driven and joint.ratio == 1.0
    }
