"""What stands on the parameter server: the robot's model, its gains, whose clock counts."""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING

from trocar.errors import InputError, MissingExtraError
from trocar.interfaces.crtk.robot_model import robot_model
from trocar.interfaces.crtk.transports.ros1.gains import Gains
from trocar.interfaces.crtk.transports.ros1.library import inner

if TYPE_CHECKING:
    from trocar.descriptions import RigDescription
    from trocar.interfaces.crtk.core import Core
    from trocar.interfaces.crtk.transports.ros1.library import Library
    from trocar.interfaces.crtk.transports.ros1.master import Master

_log = logging.getLogger("trocar")

MODEL = "/robot_description"
SIMULATED = "/use_sim_time"


class Parameters:
    """Set what viewers and clients ask the parameter server for.

    Args:
        core: what is simulated
        master: holds the parameters
        library: rospy
    """

    def __init__(self, core: Core, master: Master, library: Library) -> None:
        self._core, self._master = core, master
        cache = inner(library, "impl.paramserver").get_param_server_cache()
        self._gains = Gains(core, master, library.rospy.core.get_node_uri(), cache)
        self._set: list[str] = []
        self._described: RigDescription | None = None

    def start(self) -> None:
        """Set all.

        Raises:
            MasterError: the master does not answer
        """
        if self._core.stamper.mode == "sim":
            self._put(SIMULATED, True)
        self._gains.start()
        self._described = None
        self.follow()

    def follow(self) -> None:
        """Set the robot's model, anew after a tool was exchanged.

        Raises:
            MasterError: the master does not answer
        """
        rig = self._core.loop.world.rig
        if rig is self._described:
            return
        self._described = rig  # whether it can be or not: it is tried once
        try:
            self._put(MODEL, robot_model(rig).urdf)
        except (MissingExtraError, InputError) as error:
            _log.warning("ROS 1: no %s: %s", MODEL, error)

    def forget(self) -> None:
        """Delete what was set.

        Raises:
            MasterError: the master does not answer
        """
        self._gains.forget()
        for key in self._set:
            self._master.ask("deleteParam", key)
        self._set.clear()

    def _put(self, key: str, value: object) -> None:
        self._master.ask("setParam", key, value)
        if key not in self._set:
            self._set.append(key)
