"""`dvrk`, the Python classes of arms and console that dvrk_python 2.4 has, over `crtk`.

Called by a name alone, `dvrk.psm("PSM1")`, an arm is that of dVRK 2.2 and older: its readings have
no time, and it has the calls of dVRK 1.x, too. The same holds where a PSM or ECM gets the argument
`expected_interval` of dVRK 2.1 to 2.3.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from trocar.ros.topic import BOOL, COMMAND, EMPTY, FLOAT, STRING
from trocar.scripts.crtk_client import older_layer, utils
from trocar.scripts.dvrk_older import older_call

#: Openings of a jaw that is shut and open. Source: dvrk_python 2.4, psm.jaw. [rad]
SHUT, OPEN = math.radians(-20.0), math.radians(60.0)


def _add(features: utils, *names: str) -> None:
    for name in names:
        getattr(features, f"add_{name}")()


class Versioned(type):
    """Makes a class of dVRK 2.4 callable as before: by a name, without a layer."""

    #: Whether the class of 2.4 has the argument `expected_interval`.
    _has_interval = False

    def __call__(cls, *values: Any, **named: Any) -> Any:
        """Make an object, of dVRK 2.2 and older where no layer is given."""
        first = values[0] if values else named.get("ral", named.get("arm_name", ""))
        if not isinstance(first, str):
            if cls._has_interval or "expected_interval" not in named:
                return super().__call__(*values, **named)
            del named["expected_interval"]
            dated, first._dated = first._dated, False  # the arm's own layer takes it over
            try:
                return super().__call__(*values, **named)
            finally:
                first._dated = dated
        return cls.by_name(first)

    def by_name(cls, name: str) -> Any:
        """Make an object of dVRK 2.2 and older."""
        return super().__call__(older_layer("dvrk"), *([name] if name else []))


class _Part:
    """A part of an arm with a namespace of its own."""

    def __init__(self, ral: Any, namespace: str, timeout: float, *names: str) -> None:
        _add(utils(self, ral.create_child(namespace), timeout), *names)


class arm(metaclass=Versioned):  # noqa: N801  as scripts call it
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
        _add(
            utils(self, self._ral, connection_timeout),
            "operating_state", "setpoint_js", "setpoint_cp", "measured_js", "measured_cp",
            "measured_cv", "hold", "free", "servo_jp", "servo_jr", "servo_cp", "servo_jf",
            "move_jp", "move_jr", "move_cp", "forward_kinematics", "inverse_kinematics",
        )  # fmt: skip
        forces = "measured_cf", "servo_cf", "jacobian"
        poses = "measured_cp", "setpoint_cp", "forward_kinematics"
        self.spatial = _Part(self._ral, "spatial", connection_timeout, *forces)
        self.body = _Part(self._ral, "body", connection_timeout, *forces)
        self.local = _Part(self._ral, "local", connection_timeout, *poses)
        self._absolute = publisher(self._ral, "body/set_cf_orientation_absolute", BOOL, latch=True)
        self._gravity = publisher(self._ral, "use_gravity_compensation", BOOL, latch=True)
        self._set_ratio = publisher(self._ral, "trajectory_j/set_ratio", FLOAT, latch=True)
        self._ratio = 1.0
        self._ral._listen("trajectory_j/ratio", FLOAT, self._heard_ratio)

    def __getattr__(self, name: str) -> Any:
        """Return a call of dVRK 1.x, of an arm that was made as there."""
        made = self.__dict__.get("_ral")
        found = None if made is None or made._dated else older_call(self, name)
        if found is None:
            kind = type(self).__name__
            raise AttributeError(f"{kind!r} object has no attribute {name!r}", name=name, obj=self)
        return found

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
        """Slow down moves: a share of their velocities and accelerations, above 0, up to 1."""
        self._set_ratio(float(ratio))

    def trajectory_j_ratio(self) -> float:
        """Return the share that moves keep to."""
        self._ral._look()
        return self._ratio

    trajectory_j_get_ratio = trajectory_j_ratio

    def _heard_ratio(self, message: Any) -> None:
        self._ratio = message.data


def publisher(ral: Any, topic: str, kind: str, *, latch: bool = False) -> Callable[..., None]:
    """Return a function that publishes a message of a type of one field, or of none."""
    made = ral._message(kind)
    end = ral.publisher(topic, made, latch=latch, queue_size=1)
    names: tuple[str, ...] = made.__slots__

    def publish(*values: Any, **named: Any) -> None:
        end.publish(made(**dict(zip(names, values, strict=False)), **named))

    return publish


def _value(ral: Any, reading: Any) -> Any:
    """Return a reading without its time."""
    return reading[0] if ral._dated else reading


class _Deep(arm):
    """An arm that can go in along its shaft."""

    def __init__(self, ral: Any, arm_name: str, connection_timeout: float = 5.0) -> None:
        super().__init__(ral, arm_name, connection_timeout)

    def insert_jp(self, depth: float) -> Any:
        """Move the insertion alone, to a depth [m]; return a handle."""
        goal = np.copy(_value(self._ral, self.setpoint_jp()))
        goal[2] = depth
        return self.move_jp(goal)


class ecm(_Deep):  # noqa: N801  as scripts call it
    """The arm of the endoscope."""


class _Jaw:
    """The jaw of an instrument: measured_js, setpoint_js, servo_jp, move_jp, servo_jf."""

    move_jp: Callable[..., Any]

    def __init__(self, ral: Any, timeout: float, stateful: Any) -> None:
        features = utils(self, ral, timeout, operating_state_instance=stateful)
        _add(features, "measured_js", "setpoint_js", "servo_jp", "move_jp", "servo_jf")

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
        self._tool_present = publisher(self._ral, "emulate_tool_present", BOOL, latch=True)

    def set_tool_present(self, tool_present: bool) -> None:
        """Report a tool as mounted or removed, in place of the robot's own detection."""
        self._tool_present(tool_present)


class mtm(arm):  # noqa: N801  as scripts call it
    """A master's arm.

    Args:
        ral: the layer that the arm's name is inside
        arm_name: "MTML" or "MTMR"
        expected_interval: period of its messages [s]; readings wait for a second at least

    Attributes:
        gripper: between the surgeon's fingers
    """

    _has_interval = True

    def __init__(self, ral: Any, arm_name: str, expected_interval: float = 0.01) -> None:
        patience = max(1.0, expected_interval)
        super().__init__(ral, arm_name, patience)
        self.gripper = _Part(self._ral, "gripper", patience, "measured_js")
        message = self._ral._message
        self._lock = self._ral.publisher("lock_orientation", message("geometry_msgs/Quaternion"))
        self._unlock = publisher(self._ral, "unlock_orientation", EMPTY, latch=True)
        self._gains = self._ral.publisher("servo_ci", message("crtk_msgs/CartesianImpedance"))

    def lock_orientation_as_is(self) -> None:
        """Let the gimbal hold the orientation that it has.

        Raises:
            RuntimeError: it is not known
        """
        current = self.setpoint_cp()
        if self._ral._dated and not current[1]:
            raise RuntimeError("setpoint_cp is not valid")
        self.lock_orientation(_value(self._ral, current).M)

    def lock_orientation(self, orientation: Any) -> None:
        """Let the gimbal hold an orientation."""
        message = self._ral._message("geometry_msgs/Quaternion")()
        message.x, message.y, message.z, message.w = orientation.GetQuaternion()
        self._lock.publish(message)

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
        _add(features, "operating_state", "measured_js", "measured_cp", "move_jp")
        self.local = _Part(ral, "local", timeout, "measured_cp")

    def ral(self) -> Any:
        """Return the layer of its namespace."""
        return self._ral


class SetupVersioned(Versioned):
    """Makes the setup joints of dVRK 2.2 and older, `dvrk.suj("PSM1")`: those of one arm."""

    def by_name(cls, name: str) -> Any:
        """Make those of an arm."""
        return _SetupArm(older_layer("dvrk").create_child(f"SUJ/{name}"), 1.0)


class suj(metaclass=SetupVersioned):  # noqa: N801  as scripts call it
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


class console(metaclass=Versioned):  # noqa: N801  as scripts call it
    """The surgeon's console: teleoperation of the whole system."""

    def __init__(self, ral: Any, console_name: str = "console") -> None:
        self._ral = ral.create_child(console_name)
        self._enable = publisher(self._ral, "teleop/enable", BOOL)
        self._set_scale = publisher(self._ral, "teleop/set_scale", FLOAT)
        self._select = publisher(self._ral, "teleop/select", STRING)
        self._unselect = publisher(self._ral, "teleop/unselect", STRING)
        self._scale = _Value(self._ral, "teleop/scale")
        self._selected: dict[str, bool] = {}
        self._ral._listen("teleop/selected", STRING, self._heard_selected)
        self._ral._listen("teleop/unselected", STRING, self._heard_unselected)

    def _heard_selected(self, message: Any) -> None:
        self._selected[message.data] = True

    def _heard_unselected(self, message: Any) -> None:
        self._selected[message.data] = False

    def teleop_start(self) -> None:
        """Switch teleoperation on."""
        self._enable(True)

    def teleop_stop(self) -> None:
        """Switch teleoperation off."""
        self._enable(False)

    def teleop_set_scale(self, scale: float) -> None:
        """Set the ratio of the instruments' motion to the masters'."""
        self._set_scale(float(scale))

    def teleop_get_scale(self) -> float:
        """Return instruments' motion per masters' motion; 0 before the first message."""
        return self._scale.value()

    def teleop_select(self, teleop_name: str) -> None:
        """Select a component, such as "MTMR_PSM1"."""
        self._select(teleop_name)

    def teleop_unselect(self, teleop_name: str) -> None:
        """Unselect a component."""
        self._unselect(teleop_name)

    def teleop_is_selected(self, teleop_name: str) -> bool:
        """Return whether a component was selected last; False before the first message of it."""
        self._ral._look()
        return self._selected.get(teleop_name, False)


class system(metaclass=Versioned):  # noqa: N801  as scripts call it
    """The whole robot: power, homing, sounds."""

    def __init__(self, ral: Any, system_namespace: str = "system") -> None:
        self._ral = ral.create_child(system_namespace)
        self._power_off = publisher(self._ral, "power_off", EMPTY)
        self._power_on = publisher(self._ral, "power_on", EMPTY)
        self._home = publisher(self._ral, "home", EMPTY)
        self._set_volume = publisher(self._ral, "set_volume", FLOAT)
        self._speak = publisher(self._ral, "string_to_speech", STRING)
        self._matrix = self._ral._message("std_msgs/Float64MultiArray")
        self._beep = self._ral.publisher("beep", self._matrix, queue_size=1)

    def power_off(self) -> None:
        """Power all arms off."""
        self._power_off()

    def power_on(self) -> None:
        """Power all arms on."""
        self._power_on()

    def home(self) -> None:
        """Bring every arm home."""
        self._home()

    def set_volume(self, volume: float) -> None:
        """Set the volume of sounds, 0 to 1."""
        self._set_volume(float(volume))

    def beep(self, duration: float, frequency: float, volume: float = 1.0) -> None:
        """Beep for a duration [s] at a frequency [Hz] and a volume, 0 to 1."""
        message = self._matrix()
        message.data = [float(duration), float(frequency), float(volume)]
        shape = self._ral._message("std_msgs/MultiArrayDimension")()
        shape.label, shape.size, shape.stride = "values", len(message.data), 1
        message.layout.dim.append(shape)
        self._beep.publish(message)

    def string_to_speech(self, string: str) -> None:
        """Speak a text."""
        self._speak(string)


class teleop_psm(metaclass=Versioned):  # noqa: N801  as scripts call it
    """A component that lets an instrument follow a master."""

    def __init__(self, ral: Any, teleop_name: str) -> None:
        self._ral = ral.create_child(teleop_name)
        self._set_scale = publisher(self._ral, "set_scale", FLOAT)
        self._command = publisher(self._ral, "state_command", COMMAND)
        self._scale = _Value(self._ral, "scale")

    def set_scale(self, scale: float) -> None:
        """Set the ratio of the instrument's motion to the master's."""
        self._set_scale(float(scale))

    def get_scale(self) -> float:
        """Return instrument's motion per master's motion; 0 before the first message."""
        return self._scale.value()

    def enable(self) -> None:
        """Enable the component."""
        self._command(string="enable")

    def disable(self) -> None:
        """Disable the component."""
        self._command(string="disable")


class _Value:
    """The newest number of a topic."""

    def __init__(self, ral: Any, topic: str) -> None:
        self._ral, self._newest = ral, 0.0
        ral._listen(topic, FLOAT, self._heard)

    def _heard(self, message: Any) -> None:
        self._newest = message.data

    def value(self) -> float:
        """Return it; 0 before the first."""
        self._ral._look()
        return self._newest
