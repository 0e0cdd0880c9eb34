"""`dvrk.arm` and what is made of it: `psm`, `ecm`, `mtm`; and `suj`."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from trocar.interfaces.crtk.scripts.client.utils import utils

#: Openings of a jaw that is shut and open. Source: dvrk_python 2.4, psm.jaw. [rad]
SHUT, OPEN = math.radians(-20.0), math.radians(60.0)


class _Forces:
    """Wrenches of an arm in one frame: measured_cf, servo_cf, jacobian."""

    def __init__(self, ral: Any, timeout: float) -> None:
        features = utils(self, ral, timeout)
        features.add_measured_cf()
        features.add_servo_cf()
        features.add_jacobian()


class _Local:
    """Poses in the arm's own base frame: measured_cp, setpoint_cp, forward_kinematics."""

    def __init__(self, ral: Any, timeout: float) -> None:
        features = utils(self, ral, timeout)
        features.add_measured_cp()
        features.add_setpoint_cp()
        features.add_forward_kinematics()


class arm:  # noqa: N801  as scripts call it
    """An arm of the dVRK.

    Args:
        ral: the layer that the arm's name is inside
        arm_name: such as "PSM1"
        connection_timeout: how long a reading waits for a message [s]

    Attributes:
        spatial, body: measured_cf, servo_cf and jacobian in these frames
        local: poses in the arm's own base frame
    """

    move_jp: Callable[..., Any]
    setpoint_jp: Callable[..., Any]
    setpoint_cp: Callable[..., Any]

    def __init__(self, ral: Any, arm_name: str, connection_timeout: float = 1.0) -> None:
        self._name, self._ral = arm_name, ral.create_child(arm_name)
        features = utils(self, self._ral, connection_timeout)
        features.add_operating_state()
        for reading in ("setpoint_js", "setpoint_cp", "measured_js", "measured_cp", "measured_cv"):
            getattr(features, f"add_{reading}")()
        for verb in ("hold", "free", "servo_jp", "servo_jr", "servo_cp", "servo_jf"):
            getattr(features, f"add_{verb}")()
        for verb in ("move_jp", "move_jr", "move_cp", "forward_kinematics", "inverse_kinematics"):
            getattr(features, f"add_{verb}")()
        self.spatial = _Forces(self._ral.create_child("spatial"), connection_timeout)
        self.body = _Forces(self._ral.create_child("body"), connection_timeout)
        self.local = _Local(self._ral.create_child("local"), connection_timeout)
        self._absolute = self._publisher("body/set_cf_orientation_absolute", "std_msgs/Bool")
        self._gravity = self._publisher("use_gravity_compensation", "std_msgs/Bool")
        self._set_ratio = self._publisher("trajectory_j/set_ratio", "std_msgs/Float64")
        self._ratio = 1.0
        self._ral.listen("trajectory_j/ratio", "std_msgs/Float64", self._heard_ratio)

    def name(self) -> str:
        """Return the arm's name."""
        return self._name

    def ral(self) -> Any:
        """Return the layer of the arm's namespace."""
        return self._ral

    def check_connections(self, timeout: float = 5.0) -> None:
        """Wait until every topic of the arm is connected [s].

        Raises:
            TimeoutError: some are not
        """
        self._ral.check_connections(timeout)

    def body_set_cf_orientation_absolute(self, absolute: bool) -> None:
        """Have wrenches at the tip taken in axes of the reference frame (True) or its own."""
        self._absolute(absolute)

    def use_gravity_compensation(self, gravity_compensation: bool) -> None:
        """Switch gravity compensation."""
        self._gravity(gravity_compensation)

    def trajectory_j_set_ratio(self, ratio: float) -> None:
        """Slow down moves: a share of their velocities and accelerations, 0.002 to 1."""
        self._set_ratio(float(ratio))

    def trajectory_j_ratio(self) -> float:
        """Return the share that moves keep to."""
        self._ral.look()
        return self._ratio

    trajectory_j_get_ratio = trajectory_j_ratio

    def _heard_ratio(self, message: Any) -> None:
        self._ratio = message.data

    def _publisher(self, topic: str, kind: str) -> Callable[..., None]:
        """Return a function that publishes a message of one value."""
        return publisher(self._ral, topic, kind, latch=True)


def publisher(ral: Any, topic: str, kind: str, *, latch: bool = False) -> Callable[..., None]:
    """Return a function that publishes a message of a type of one field, or of none."""
    made = ral.message(kind)
    end = ral.publisher(topic, made, latch=latch, queue_size=1)
    return lambda *value: end.publish(made(*value))


class _Deep(arm):
    """An arm that can go in along its shaft."""

    def __init__(self, ral: Any, arm_name: str, connection_timeout: float = 5.0) -> None:
        super().__init__(ral, arm_name, connection_timeout)

    def insert_jp(self, depth: float) -> Any:
        """Move the insertion alone, to a depth [m]; return a handle."""
        goal = np.copy(self.setpoint_jp()[0])
        goal[2] = depth
        return self.move_jp(goal)


class ecm(_Deep):  # noqa: N801  as scripts call it
    """The arm of the endoscope."""


class _Jaw:
    """The jaw of an instrument: measured_js, setpoint_js, servo_jp, move_jp, servo_jf."""

    move_jp: Callable[..., Any]

    def __init__(self, ral: Any, timeout: float, stateful: Any) -> None:
        features = utils(self, ral, timeout, operating_state_instance=stateful)
        for feature in ("measured_js", "setpoint_js", "servo_jp", "move_jp", "servo_jf"):
            getattr(features, f"add_{feature}")()

    def close(self) -> Any:
        """Shut the jaw, which grips; return a handle."""
        return self.move_jp(np.array([SHUT]))

    def open(self, angle: float = OPEN) -> Any:
        """Open the jaw to an angle [rad]; return a handle."""
        return self.move_jp(np.array([angle]))


class psm(_Deep):  # noqa: N801  as scripts call it
    """An arm that holds an instrument.

    Attributes:
        jaw: of the instrument
    """

    def __init__(self, ral: Any, arm_name: str, connection_timeout: float = 5.0) -> None:
        super().__init__(ral, arm_name, connection_timeout)
        self.jaw = _Jaw(self._ral.create_child("jaw"), connection_timeout, self)
        self._tool_present = self._publisher("emulate_tool_present", "std_msgs/Bool")

    def set_tool_present(self, tool_present: bool) -> None:
        """Say that a tool was put on or taken off that cannot be told by itself."""
        self._tool_present(tool_present)


class _Gripper:
    """The gripper of a master: measured_js."""

    def __init__(self, ral: Any, timeout: float) -> None:
        utils(self, ral, timeout).add_measured_js()


class mtm(arm):  # noqa: N801  as scripts call it
    """A master's arm.

    Args:
        ral: the layer that the arm's name is inside
        arm_name: "MTML" or "MTMR"
        expected_interval: how often it is thought to tell [s]; readings wait for a second at least

    Attributes:
        gripper: between the surgeon's fingers
    """

    def __init__(self, ral: Any, arm_name: str, expected_interval: float = 0.01) -> None:
        patience = max(1.0, expected_interval)
        super().__init__(ral, arm_name, patience)
        self.gripper = _Gripper(self._ral.create_child("gripper"), patience)
        message = self._ral.message
        self._lock = self._ral.publisher("lock_orientation", message("geometry_msgs/Quaternion"))
        self._unlock = publisher(self._ral, "unlock_orientation", "std_msgs/Empty", latch=True)
        self._gains = self._ral.publisher("servo_ci", message("crtk_msgs/CartesianImpedance"))

    def lock_orientation_as_is(self) -> None:
        """Let the gimbal hold the orientation that it has.

        Raises:
            RuntimeError: it is not known
        """
        current, when = self.setpoint_cp()
        if not when:
            raise RuntimeError("setpoint_cp is not valid")
        self.lock_orientation(current.M)

    def lock_orientation(self, orientation: Any) -> None:
        """Let the gimbal hold an orientation."""
        self._lock.publish(
            self._ral.message("geometry_msgs/Quaternion")(*orientation.GetQuaternion())
        )

    def unlock_orientation(self) -> None:
        """Let the gimbal go."""
        self._unlock()

    def servo_ci(self, gains: Any) -> None:
        """Send a crtk_msgs/CartesianImpedance: a spring and damper about a pose."""
        self._gains.publish(gains)


class _SetupArm:
    """The setup joints of one arm."""

    def __init__(self, ral: Any, timeout: float) -> None:
        self._ral = ral
        features = utils(self, ral, timeout)
        features.add_operating_state()
        features.add_measured_js()
        features.add_measured_cp()
        features.add_move_jp()
        self.local = _LocalPose(ral.create_child("local"), timeout)

    def ral(self) -> Any:
        """Return the layer of its namespace."""
        return self._ral


class _LocalPose:
    def __init__(self, ral: Any, timeout: float) -> None:
        utils(self, ral, timeout).add_measured_cp()


class suj:  # noqa: N801  as scripts call it
    """The setup joints.

    Attributes:
        ECM, PSM1, PSM2, PSM3: those of each arm
    """

    def __init__(self, ral: Any, connection_timeout: float = 1.0) -> None:
        self._ral = ral.create_child("SUJ")
        for name in ("ECM", "PSM1", "PSM2", "PSM3"):
            setattr(self, name, _SetupArm(self._ral.create_child(name), connection_timeout))

    def ral(self) -> Any:
        """Return the layer of their namespace."""
        return self._ral
