"""`crtk.utils`: gives an object the methods of CRTK, one feature after the other."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from trocar.interfaces.crtk.scripts.client import conversions as convert
from trocar.interfaces.crtk.scripts.client.readings import Reading
from trocar.interfaces.crtk.scripts.client.state import OperatingState, wait_move_handle

JOINTS = "sensor_msgs/JointState"
POSE = "geometry_msgs/PoseStamped"
TWIST = "geometry_msgs/TwistStamped"
WRENCH = "geometry_msgs/WrenchStamped"
EMPTY = "std_msgs/Empty"
MATRIX = "std_msgs/Float64MultiArray"
FORWARD = "crtk_msgs/QueryForwardKinematics"
INVERSE = "crtk_msgs/QueryInverseKinematics"


class utils:  # noqa: N801  as scripts call it
    """Give an object methods that read topics, and methods that publish to them.

    Args:
        class_instance: the object
        ral: the layer of the device's namespace
        connection_timeout: how long a reading waits for its first message, and how old it may
            become [s]
        operating_state_instance: the object that knows when a move is over; this one, when it has
            its own operating state
        expected_interval: what `connection_timeout` was before version 1.4; not needed any more
    """

    def __init__(
        self,
        class_instance: Any,
        ral: Any,
        connection_timeout: float = 5.0,
        operating_state_instance: Any = None,
        expected_interval: float | None = None,  # noqa: ARG002
    ) -> None:
        self._instance, self._ral = class_instance, ral
        self._timeout = connection_timeout
        self._stateful = operating_state_instance

    # ------------------------------------------------------------------ state

    def add_operating_state(self) -> None:
        """Add operating_state, enable, disable, home, unhome, is_busy, ... and waiting for them."""
        self._refuse_twice("operating_state")
        if self._stateful is not None:
            raise RuntimeWarning(f"over writting operating state for {self._ral.namespace()}")
        state = OperatingState(self._ral)
        for name in OperatingState.METHODS:
            setattr(self._instance, name, getattr(state, name))
        self._stateful = self._instance

    # ------------------------------------------------------------------ readings

    def add_measured_js(self) -> None:
        """Add measured_js, measured_jp, measured_jv, measured_jf."""
        self._joints("measured")

    def add_setpoint_js(self) -> None:
        """Add setpoint_js, setpoint_jp, setpoint_jv, setpoint_jf."""
        self._joints("setpoint")

    def add_measured_cp(self) -> None:
        """Add measured_cp, a frame."""
        self._read("measured_cp", POSE, lambda m: convert.FrameFromPoseMsg(m.pose))

    def add_setpoint_cp(self) -> None:
        """Add setpoint_cp, a frame."""
        self._read("setpoint_cp", POSE, lambda m: convert.FrameFromPoseMsg(m.pose))

    def add_measured_cv(self) -> None:
        """Add measured_cv, (linear; angular), (6,) [m/s, rad/s]."""
        self._read("measured_cv", TWIST, lambda m: convert.ArrayFromTwistMsg(m.twist))

    def add_measured_cf(self) -> None:
        """Add measured_cf, (force; torque), (6,) [N, N m]."""
        self._read("measured_cf", WRENCH, lambda m: convert.ArrayFromWrenchMsg(m.wrench))

    def add_jacobian(self) -> None:
        """Add jacobian, (6, n)."""
        self._refuse_twice("jacobian")
        reading = Reading(self._ral, "jacobian", MATRIX, self._timeout)

        def jacobian() -> Any:
            message = reading.message()
            rows, columns = (dim.size for dim in message.layout.dim)
            return np.array(message.data).reshape(rows, columns)

        self._instance.jacobian = jacobian

    # ------------------------------------------------------------------ commands

    def add_hold(self) -> None:
        """Add hold: end every move and stay."""
        self._send("hold", EMPTY, lambda m: m)

    def add_free(self) -> None:
        """Add free: exert nothing but gravity compensation."""
        self._send("free", EMPTY, lambda m: m)

    def add_servo_jp(self) -> None:
        """Add servo_jp(positions, velocities)."""
        self._send("servo_jp", JOINTS, _positions)

    def add_servo_jr(self) -> None:
        """Add servo_jr(steps)."""
        self._send("servo_jr", JOINTS, _positions)

    def add_servo_jf(self) -> None:
        """Add servo_jf(efforts)."""
        self._send("servo_jf", JOINTS, _efforts)

    def add_servo_cp(self) -> None:
        """Add servo_cp(frame)."""
        self._send("servo_cp", POSE, _pose)

    def add_servo_cr(self) -> None:
        """Add servo_cr(frame), a step."""
        self._send("servo_cr", POSE, _pose)

    def add_servo_cv(self) -> None:
        """Add servo_cv(six numbers); no arm of the dVRK listens to it."""
        self._send("servo_cv", TWIST, _twist)

    def add_servo_cf(self) -> None:
        """Add servo_cf(six numbers)."""
        self._send("servo_cf", WRENCH, _wrench)

    def add_move_jp(self) -> None:
        """Add move_jp(positions), which returns a handle."""
        self._send("move_jp", JOINTS, _positions, move=True)

    def add_move_jr(self) -> None:
        """Add move_jr(steps), which returns a handle."""
        self._send("move_jr", JOINTS, _positions, move=True)

    def add_move_cp(self) -> None:
        """Add move_cp(frame), which returns a handle."""
        self._send("move_cp", POSE, _pose, move=True)

    # ------------------------------------------------------------------ services

    def add_forward_kinematics(self) -> None:
        """Add forward_kinematics(positions): a frame; `extra` adds result and message."""
        self._refuse_twice("forward_kinematics")
        kind = self._ral.service_type(FORWARD)
        client = self._ral.service_client("forward_kinematics", kind)

        def forward_kinematics(jp: Any, extra: Any = None) -> Any:
            request = kind._request_class()
            request.jp = _numbers(jp)
            answer = client.call(request)
            frame = convert.FrameFromPoseMsg(answer.cp)
            return (frame, answer.result, answer.message) if extra else frame

        self._instance.forward_kinematics = forward_kinematics

    def add_inverse_kinematics(self) -> None:
        """Add inverse_kinematics(seed, frame): positions; `extra` adds result and message."""
        self._refuse_twice("inverse_kinematics")
        kind = self._ral.service_type(INVERSE)
        client = self._ral.service_client("inverse_kinematics", kind)

        def inverse_kinematics(jp: Any, cp: Any, extra: Any = None) -> Any:
            request = kind._request_class()
            request.jp = _numbers(jp)
            convert.FrameToPoseMsg(cp, request.cp)
            answer = client.call(request)
            found = np.array(answer.jp)
            return (found, answer.result, answer.message) if extra else found

        self._instance.inverse_kinematics = inverse_kinematics

    # ------------------------------------------------------------------ inside

    def _refuse_twice(self, name: str) -> None:
        if hasattr(self._instance, name):
            raise RuntimeWarning(f"{name} already exists")

    def _read(self, name: str, kind: str, value: Callable[[Any], Any]) -> None:
        self._refuse_twice(name)
        reading = Reading(self._ral, name, kind, self._timeout)
        setattr(self._instance, name, reading.getter(value))

    def _joints(self, which: str) -> None:
        self._refuse_twice(f"{which}_js")
        reading = Reading(self._ral, f"{which}_js", JOINTS, self._timeout)
        parts = {"jp": "position", "jv": "velocity", "jf": "effort"}
        for short, part in parts.items():
            setattr(self._instance, f"{which}_{short}", reading.getter(_array_of(part)))
        setattr(self._instance, f"{which}_js", reading.whole(*map(_array_of, parts.values())))

    def _send(
        self, name: str, kind: str, fill: Callable[..., Any], *, move: bool = False
    ) -> None:  # fmt: skip
        self._refuse_twice(name)
        made = self._ral.message(kind)
        publisher = self._ral.publisher(name, made)

        def send(*values: Any, **named: Any) -> Any:
            message = fill(made(), *values, **named)
            handle = wait_move_handle(self._stateful, self._ral) if move else None
            publisher.publish(message)
            return handle

        send.__name__ = name
        setattr(self._instance, name, send)


def _array_of(part: str) -> Callable[[Any], Any]:
    return lambda message: np.array(getattr(message, part))


def _numbers(values: Any) -> list[float]:
    return np.asarray(values, dtype=np.float64).tolist()


def _positions(message: Any, setpoint_p: Any, setpoint_v: Any = ()) -> Any:
    message.position, message.velocity = _numbers(setpoint_p), _numbers(setpoint_v)
    return message


def _efforts(message: Any, setpoint: Any) -> Any:
    message.effort = _numbers(setpoint)
    return message


def _pose(message: Any, setpoint: Any) -> Any:
    convert.FrameToPoseMsg(setpoint, message.pose)
    return message


def _twist(message: Any, setpoint: Any) -> Any:
    convert.ArrayToTwistMsg(setpoint, message.twist)
    return message


def _wrench(message: Any, setpoint: Any) -> Any:
    convert.ArrayToWrenchMsg(setpoint, message.wrench)
    return message
