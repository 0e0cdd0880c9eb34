"""`crtk`, the client's side of CRTK: `ral`, `utils`, conversions, and waiting for moves.

Source of names and behaviour: crtk_python_client 1.4.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from trocar.ros.topic import COMMAND, STATE
from trocar.scripts import kdl as own_kdl
from trocar.scripts.messages import BuiltinTime, Edition, message_class, service_class
from trocar.scripts.ros import Latest, own_arguments
from trocar.scripts.ros2_time import ClockType, RclDuration, RclTime

kdl: Any
try:
    import PyKDL  # pyright: ignore[reportMissingImports]

    kdl = PyKDL
except ImportError:
    kdl = own_kdl

Array = NDArray[np.float64]


class ral:  # noqa: N801  as scripts call it
    """The layer between a script and ROS.

    Args:
        node_name: of the script
        namespace: of its topics
        node: the one it shares; made by `create_child`
    """

    #: rospy beneath every layer of a run; set where the modules of a script are made.
    _node_of_run: ClassVar[Any]
    #: Whether readings come with their time, as in dVRK 2.4.
    _dated = True

    def __init__(self, node_name: str, namespace: str = "", node: Any = None) -> None:  # noqa: ARG002
        self._node_name, self._namespace = node_name, namespace.strip("/")
        self._node = self._node_of_run
        self._children: dict[str, ral] = {}
        self._publishers: list[Any] = []
        self._subscribers: list[Any] = []

    @staticmethod
    def ros_version() -> int:
        """Return 1: services are called as in ROS 1."""
        return 1

    @staticmethod
    def parse_argv(argv: Sequence[str]) -> list[str]:
        """Return a command line without ROS's own words."""
        return own_arguments(argv)

    def node_name(self) -> str:
        """Return the script's name."""
        return self._node_name

    def namespace(self) -> str:
        """Return the namespace of its topics."""
        return self._namespace

    def create_child(self, child_namespace: str) -> ral:
        """Return a layer of a namespace inside this one.

        Raises:
            RuntimeError: there is one of that name
        """
        if child_namespace in self._children:
            raise RuntimeError(f'ral object already has child "{child_namespace}"!')
        child = type(self)(self._node_name, self._named(child_namespace), self._node)
        child._dated = self._dated
        self._children[child_namespace] = child
        return child

    def now(self) -> Any:
        """Return the time of stamps."""
        return self._node.get_rostime()

    def get_timestamp(self, t: Any) -> Any:
        """Return the stamp of a message or a header; a stamp itself stays as it is."""
        found = getattr(t, "header", t)
        return getattr(found, "stamp", found)

    def set_timestamp(self, msg: Any) -> Any:
        """Stamp a message with the time now, if it has a header; return it."""
        if hasattr(msg, "header"):
            msg.header.stamp = self.now()
        return msg

    def to_sec(self, t: Any) -> float:
        """Return seconds of a time, a duration, or a message's stamp."""
        return self.get_timestamp(t).to_sec()

    def create_duration(self, d: float) -> Any:
        """Return a length of time [s]."""
        return self._node.Duration(float(d))

    def create_rate(self, rate_hz: float) -> Any:
        """Return a rate that keeps a loop to a frequency [Hz]."""
        return self._node.Rate(rate_hz)

    def create_time(self) -> Any:
        """Return time zero."""
        return self._node.Time()

    def spin(self) -> None:
        """Do nothing: callbacks run whenever the script waits."""

    def spin_and_execute(self, function: Callable[..., object], *arguments: Any) -> None:
        """Call a function, and shut down when it returns."""
        self.spin()
        function(*arguments)
        self.shutdown()

    def shutdown(self) -> None:
        """End the node; functions given to `on_shutdown` are called."""
        self._node.signal_shutdown("shutdown")

    def on_shutdown(self, callback: Callable[[], object]) -> None:
        """Have a function called at the end."""
        self._node.on_shutdown(callback)

    def is_shutdown(self) -> bool:
        """Return whether the node has ended."""
        return self._node.is_shutdown()

    def publisher(
        self,
        topic: str,
        msg_type: Any,
        queue_size: int = 10,
        latch: bool = False,
        *args: Any,  # noqa: ARG002  rospy's and rclpy's own
        **kwargs: Any,  # noqa: ARG002
    ) -> Any:
        """Return a publisher of a topic of this namespace."""
        name = f"/{self._named(topic)}"
        made = self._node.Publisher(name, msg_type, latch=latch, queue_size=queue_size)
        self._publishers.append(made)
        return made

    def subscriber(
        self,
        topic: str,
        msg_type: Any,
        callback: Callable[[Any], None],
        queue_size: int = 10,
        latch: bool = False,  # noqa: ARG002  latched messages come anyway
        *args: Any,  # noqa: ARG002
        **kwargs: Any,  # noqa: ARG002
    ) -> Any:
        """Have a function called with each message of a topic of this namespace."""
        name = f"/{self._named(topic)}"
        made = self._node.Subscriber(name, msg_type, callback=callback, queue_size=queue_size)
        self._subscribers.append(made)
        return made

    def service_client(self, name: str, srv_type: Any) -> Any:
        """Return a caller of a service of this namespace."""
        return self._node.ServiceProxy(f"/{self._named(name)}", srv_type)

    def get_topic_name(self, pubsub: Any) -> str:
        """Return the whole name of a publisher's or subscriber's topic."""
        return pubsub.name

    def check_connections(self, timeout_seconds: float = 5.0, check_children: bool = True) -> None:
        """Wait until every publisher and every subscriber is connected.

        Raises:
            TimeoutError: some are not; they are named
        """
        if timeout_seconds == 0.0:
            return
        pubs, subs = self._ends(check_children)
        every = [*pubs, *subs]
        self._wait(lambda: all(end.get_num_connections() for end in every), timeout_seconds)
        if all(end.get_num_connections() for end in every):
            return
        text = "Timed out waiting for publisher/subscriber connections to establish\n"
        for word, ends in (("Publishers:", pubs), ("Subscribers:", subs)):
            lost = [end.name for end in ends if not end.get_num_connections()]
            text += (
                f"    {word:<12} {len(ends) - len(lost)} connected, {len(lost)} not connected\n"
                f"                 not connected: [{', '.join(lost)}]\n\n"
            )
        raise TimeoutError(text[:-1] + self._hint(every))

    def _latest(self, topic: str, kind: str) -> Any:
        """Return a holder of the newest message of a topic; `kind` as "sensor_msgs/JointState"."""
        made = Latest(self._node, f"/{self._named(topic)}", self._message(kind))
        self._subscribers.append(made)
        return made

    def _listen(self, topic: str, kind: str, heard: Callable[[Any], None]) -> Any:
        """Have a function called with each message, at once, also before the script waits."""
        name, made = f"/{self._named(topic)}", self._message(kind)
        self._subscribers.append(self._node.Subscriber(name, made, heard, at_once=True))
        return self._subscribers[-1]

    def _wait(self, ready: Callable[[], bool], timeout_s: float | None = None) -> bool:
        """Wait until something holds; return whether it does before the node ends."""
        return self._node.wait(ready, timeout_s)

    def _look(self) -> None:
        """Count a reading by the script: time passes in loops of readings alone."""
        self._node.flow.look()

    @staticmethod
    def _message(kind: str) -> Any:
        """Return the class of a type of messages."""
        return message_class(kind)

    @staticmethod
    def _service_type(kind: str) -> Any:
        """Return the class of a type of services."""
        return service_class(kind)

    def _named(self, name: str) -> str:
        return f"{self._namespace}/{name.strip('/')}".strip("/")

    def _ends(self, children: bool) -> tuple[list[Any], list[Any]]:
        pubs, subs = list(self._publishers), list(self._subscribers)
        for child in self._children.values() if children else ():
            more = child._ends(children)
            pubs, subs = pubs + more[0], subs + more[1]
        return pubs, subs

    def _hint(self, ends: Sequence[Any]) -> str:
        """Name the rig's arms, where one is missing."""
        arms = self._node.flow.core.prefixes.values()
        lost = {end.name.split("/")[1] for end in ends if not end.get_num_connections()}
        known = {name.split("/")[0] for name in arms}
        if lost <= known:
            return ""
        return f"    The rig has {', '.join(arms)}; --rig chooses another (trocar list rigs)\n"


class Ros2Ral(ral):
    """The layer of a script for ROS 2: its times and messages are those of rclpy."""

    #: rclpy of a run.
    _rclpy: ClassVar[Any]

    @staticmethod
    def ros_version() -> int:
        """Return 2: services are called as in ROS 2."""
        return 2

    def now(self) -> RclTime:
        """Return the time of stamps."""
        self._node.flow.look()
        return RclTime(nanoseconds=self._node.flow.now_ns(), clock_type=ClockType.ROS_TIME)

    def get_timestamp(self, t: Any) -> Any:
        """Return the stamp of a message or a header; a stamp itself stays as it is."""
        found = super().get_timestamp(t)
        return RclTime.from_msg(found) if isinstance(found, BuiltinTime) else found

    def set_timestamp(self, msg: Any) -> Any:
        """Stamp a message with the time now, if it has a header; return it."""
        if hasattr(msg, "header"):
            msg.header.stamp = self.now().to_msg()
        return msg

    def to_sec(self, t: Any) -> float:
        """Return seconds of a time, a duration, or a message's stamp."""
        return self.get_timestamp(t).nanoseconds / 1e9

    def create_duration(self, d: float) -> RclDuration:
        """Return a length of time [s]."""
        return RclDuration(seconds=float(d))

    def create_time(self) -> RclTime:
        """Return time zero."""
        return RclTime(clock_type=ClockType.ROS_TIME)

    def shutdown(self) -> None:
        """End the node; functions given to `on_shutdown` are called."""
        super().shutdown()
        self._rclpy.try_shutdown()

    def is_shutdown(self) -> bool:
        """Return whether the node has ended."""
        return super().is_shutdown() or self._rclpy.default_context.ended

    @staticmethod
    def _message(kind: str) -> Any:
        return message_class(kind, 2)

    @staticmethod
    def _service_type(kind: str) -> Any:
        return service_class(kind, 2)


def _frame(position: Any, rotation: Any) -> Any:
    turn = kdl.Rotation.Quaternion(rotation.x, rotation.y, rotation.z, rotation.w)
    return kdl.Frame(turn, kdl.Vector(position.x, position.y, position.z))


def _put(frame: Any, position: Any, rotation: Any) -> None:
    rotation.x, rotation.y, rotation.z, rotation.w = frame.M.GetQuaternion()
    position.x, position.y, position.z = frame.p[0], frame.p[1], frame.p[2]


def _six(a: Any, b: Any) -> Array:
    return np.array([a.x, a.y, a.z, b.x, b.y, b.z])


def _spread(values: Any, a: Any, b: Any) -> None:
    a.x, a.y, a.z, b.x, b.y, b.z = (float(value) for value in values)


def FrameFromPoseMsg(p: Any) -> Any:
    """Return a frame of a geometry_msgs/Pose."""
    return _frame(p.position, p.orientation)


def FrameToPoseMsg(f: Any, made: Any) -> Any:
    """Fill a geometry_msgs/Pose with a frame; return it."""
    _put(f, made.position, made.orientation)
    return made


def FrameFromTransformMsg(t: Any) -> Any:
    """Return a frame of a geometry_msgs/Transform."""
    return _frame(t.translation, t.rotation)


def FrameToTransformMsg(f: Any, made: Any) -> Any:
    """Fill a geometry_msgs/Transform with a frame; return it."""
    _put(f, made.translation, made.rotation)
    return made


def ArrayFromTwistMsg(t: Any) -> Array:
    """Return (linear; angular) of a geometry_msgs/Twist, (6,) [m/s, rad/s]."""
    return _six(t.linear, t.angular)


def ArrayToTwistMsg(a: Any, made: Any) -> Any:
    """Fill a geometry_msgs/Twist with six numbers; return it."""
    _spread(a, made.linear, made.angular)
    return made


def ArrayFromWrenchMsg(w: Any) -> Array:
    """Return (force; torque) of a geometry_msgs/Wrench, (6,) [N, N m]."""
    return _six(w.force, w.torque)


def ArrayToWrenchMsg(a: Any, made: Any) -> Any:
    """Fill a geometry_msgs/Wrench with six numbers; return it."""
    _spread(a, made.force, made.torque)
    return made


def makers(edition: Edition) -> dict[str, Callable[[Any], Any]]:
    """Return the conversions that make messages of an edition, by name."""

    def maker(convert: Callable[[Any, Any], Any], kind: str) -> Callable[[Any], Any]:
        return lambda value: convert(value, message_class(f"geometry_msgs/{kind}", edition)())

    return {
        "FrameToPoseMsg": maker(FrameToPoseMsg, "Pose"),
        "FrameToTransformMsg": maker(FrameToTransformMsg, "Transform"),
        "ArrayToTwistMsg": maker(ArrayToTwistMsg, "Twist"),
        "ArrayToWrenchMsg": maker(ArrayToWrenchMsg, "Wrench"),
    }


class Reading:
    """Reads a topic.

    Args:
        ral: the layer of the device's namespace
        name: of the topic
        kind: of its messages
        timeout_s: how old a message may be, and how long to wait for one [s]
    """

    def __init__(self, ral: Any, name: str, kind: str, timeout_s: float) -> None:
        self._ral, self._name, self._timeout = ral, name, timeout_s
        self._latest = ral._latest(name, kind)

    def message(self, age: float | None = None, wait: float | None = None) -> Any:
        """Return the newest message.

        Args:
            age: how old it may be [s]; 0: any that came; as the object was made, when omitted
            wait: how long to wait for a newer one [s]; as the object was made, when omitted

        Raises:
            TimeoutError: none came
        """
        self._ral._look()
        newest = self._latest.get()
        most = self._timeout if age is None else age
        if newest is not None and (self._latest.fresh or self._young(newest, most)):
            return newest
        patience = self._timeout if wait is None else wait
        if patience > 0.0 and self._ral._wait(lambda: self._latest.get() is not newest, patience):
            found = self._latest.get()
            if found is not None:
                return found
        raise TimeoutError(
            f"unable to get {self._name} ({self._latest.name}): no message within {patience:g} s"
        )

    def getter(self, *values: Callable[[Any], Any]) -> Callable[..., Any]:
        """Return a method that returns values of the newest message, and their time [s]."""

        def get(
            age: float | None = None,
            wait: float | None = None,
            extra: Any = None,  # noqa: ARG001  before 1.4: with its time
            wait_timeout: float | None = None,
        ) -> Any:
            message = self.message(age, wait if wait_timeout is None else wait_timeout)
            found = [value(message) for value in values]
            if not self._ral._dated:
                return found[0] if len(found) == 1 else tuple(found)
            return (*found, self._ral.to_sec(message))

        get.__name__ = self._name
        return get

    def _young(self, message: Any, age: float) -> bool:
        if age == 0.0 or not hasattr(message, "header"):
            return True
        return self._ral.to_sec(self._ral.now() - self._ral.get_timestamp(message)) <= age


#: Longest time of a move. Source: crtk_python_client, wait_move_handle. [s]
MOVE_S = 30.0


class OperatingStateClient:
    """Subscribes to `operating_state`, and sends `state_command`.

    Args:
        ral: the layer of the arm's namespace
    """

    #: Methods that are attached to an arm's object under the same names.
    METHODS = (
        "operating_state", "wait_for_operating_state", "state_command", "is_enabled", "enable",
        "is_disabled", "disable", "home", "unhome", "is_homed", "is_busy", "wait_for_busy",
    )  # fmt: skip

    def __init__(self, ral: Any) -> None:
        self._ral = ral
        self._data = ral._message(STATE)()
        self._last_busy = ral.now()
        self._count = 0
        self._commander = ral.publisher("state_command", ral._message(COMMAND), latch=True)
        ral._listen("operating_state", STATE, self._heard)

    def _heard(self, message: Any) -> None:
        when = self._ral.get_timestamp(message)
        if message.is_busy and when > self._last_busy:
            self._last_busy = when
        if when > self._ral.get_timestamp(self._data):
            self._data = message
        self._count += 1

    def _now(self, value: Callable[[Any], Any], extra: Any = None) -> Any:
        self._ral._look()
        found = value(self._data)
        return (found, self._ral.to_sec(self._data)) if extra else found

    def operating_state(self, extra: Any = None) -> Any:
        """Return the state, such as "ENABLED"; with `extra`, its time as well [s]."""
        return self._now(lambda data: data.state, extra)

    def is_homed(self, extra: Any = None) -> Any:
        """Return whether the arm is home; with `extra`, the time of that state as well [s]."""
        return self._now(lambda data: data.is_homed, extra)

    def is_enabled(self) -> bool:
        """Return whether the arm is ENABLED."""
        return self._now(lambda data: data.state == "ENABLED")

    def is_disabled(self) -> bool:
        """Return whether the arm is DISABLED."""
        return self._now(lambda data: data.state == "DISABLED")

    def is_busy(self, start_time: Any = None, extra: Any = None) -> Any:
        """Return whether the arm is busy; it counts as busy until a newer state."""
        start = self._ral.now() if start_time is None else start_time

        def busy(data: Any) -> bool:
            return data.is_busy or self._ral.get_timestamp(data) <= start

        return self._now(busy, extra)

    def state_command(self, state: str) -> None:
        """Send a command: enable, disable, home, unhome, pause, resume."""
        message = self._ral._message(COMMAND)()
        message.string = state
        self._commander.publish(message)

    def wait_for_operating_state(self, expected_state: str, timeout: float) -> bool:
        """Wait for a state; return whether it came in time [s]."""
        if timeout < 0.0:
            return False
        return self._ral._wait(lambda: self._data.state == expected_state, timeout)

    def enable(self, timeout: float = 0) -> bool:
        """Enable the arm; return whether it is within some time [s]."""
        return self._reach("enable", "ENABLED", timeout)

    def disable(self, timeout: float = 0) -> bool:
        """Disable the arm; return whether it is within some time [s]."""
        return self._reach("disable", "DISABLED", timeout)

    def home(self, timeout: float = 0) -> bool:
        """Bring the arm home; return whether it is within some time [s]."""
        return self._settle("home", True, timeout)

    def unhome(self, timeout: float = 0) -> bool:
        """Forget that the arm is home; return whether it has within some time [s]."""
        return self._settle("unhome", False, timeout)

    def wait_for_busy(
        self, is_busy: bool = False, start_time: Any = None, timeout: float = MOVE_S
    ) -> bool:
        """Wait until the arm is busy, or until it was since a time and is no longer.

        Args:
            is_busy: which
            start_time: as `ral.now()` gives it; now, when omitted
            timeout: how long since then at most [s]
        """
        start = self._ral.now() if start_time is None else start_time
        left = timeout - self._ral.to_sec(self._ral.now() - start)

        def over() -> bool:
            return self._last_busy > start and (is_busy or not self._data.is_busy)

        return left >= 0.0 and self._ral._wait(over, left)

    def _reach(self, command: str, state: str, timeout: float) -> bool:
        there = self._data.state == state
        self.state_command(command)
        return there or self.wait_for_operating_state(state, timeout)

    def _settle(self, command: str, homed: bool, timeout: float) -> bool:
        there, before = self._data.is_homed == homed, self._count
        self.state_command(command)

        def over() -> bool:
            data = self._data
            return self._count > before and data.is_homed == homed and not data.is_busy

        return there or (timeout >= 0.0 and self._ral._wait(over, timeout))


class wait_move_handle:  # noqa: N801  as scripts call it
    """Waits for a move that was just sent.

    Args:
        class_instance: the arm's object, with its operating state
        ral: the layer of its namespace
    """

    def __init__(self, class_instance: Any, ral: Any) -> None:
        self._instance, self._ral = class_instance, ral
        self._start = ral.now()

    def wait(self, is_busy: bool = False, timeout: float = MOVE_S) -> bool:
        """Wait until the move has begun (`is_busy`), or until it is over; return whether it is."""
        if self._ral.is_shutdown():
            return False
        return self._known().wait_for_busy(is_busy=is_busy, start_time=self._start, timeout=timeout)

    def is_busy(self, timeout: float = MOVE_S) -> bool:
        """Return whether the move goes on.

        Raises:
            RuntimeWarning: it was sent longer ago than `timeout` [s]
        """
        if self._ral.now() - self._start > self._ral.create_duration(timeout):
            raise RuntimeWarning("is_busy() called after timeout")
        return self._known().is_busy(start_time=self._start)

    def _known(self) -> Any:
        if not self._instance:
            raise RuntimeWarning("can't wait, class doesn't support CRTK operating state")
        return self._instance


def older_layer(node_name: str, namespace: str = "") -> Any:
    """Return a layer of the run whose readings have no time, as of dVRK 2.2 and older."""
    made = utils._layer_of_run(node_name, namespace)  # pyright: ignore[reportPrivateUsage] - hidden from scripts
    made._dated = False
    return made


class utils:  # noqa: N801  as scripts call it
    """Give an object methods that read topics, and methods that publish to them.

    `add_measured_cp()` gives it `measured_cp`, and so for every name of `JOINT_READINGS` (with
    `..._jp`, `_jv` and `_jf`), `READINGS`, `COMMANDS` (moves return a handle) and `SERVICES`.

    Args:
        class_instance: the object
        ral: the layer of the device's namespace; the namespace itself in dVRK 2.2 and older
        connection_timeout: how long a reading waits for its first message, and how old it may
            become [s]
        operating_state_instance: the object whose operating state ends a move; this one, when it
            has its own
        expected_interval: `connection_timeout` before version 1.4; not needed any more
    """

    #: Class of the layers of a run; set where the modules of a script are made.
    _layer_of_run: ClassVar[Any]

    def __init__(
        self,
        class_instance: Any,
        ral: Any,
        connection_timeout: float = 5.0,
        operating_state_instance: Any = None,
        expected_interval: float | None = None,  # noqa: ARG002
    ) -> None:
        if isinstance(ral, str):  # before dVRK 2.3: a namespace, and a period of messages
            ral, connection_timeout = older_layer("crtk", ral), 5.0
        self._instance, self._ral = class_instance, ral
        self._timeout = connection_timeout
        self._stateful = operating_state_instance

    def _add(self, *names: str) -> None:
        """Add methods by their names.

        Raises:
            RuntimeWarning: the object has such a method already
        """
        for name in names:
            if hasattr(self._instance, name):
                raise RuntimeWarning(f"{name} already exists")
            if name in JOINT_READINGS:
                self._add_joints(name)
            elif name in READINGS:
                kind, value = READINGS[name]
                reading = Reading(self._ral, name, kind, self._timeout)
                setattr(self._instance, name, reading.getter(value))
            elif name in COMMANDS:
                self._add_command(name, *COMMANDS[name])
            else:
                getattr(self, f"_add_{name}")()

    def _add_operating_state(self) -> None:
        if self._stateful is not None:
            raise RuntimeWarning(f"over writting operating state for {self._ral.namespace()}")
        state = OperatingStateClient(self._ral)
        for name in OperatingStateClient.METHODS:
            setattr(self._instance, name, getattr(state, name))
        self._stateful = self._instance

    def _add_joints(self, name: str) -> None:
        reading = Reading(self._ral, name, JOINTS, self._timeout)
        parts = {"jp": "position", "jv": "velocity", "jf": "effort"}
        for short, part in parts.items():
            method = f"{name.removesuffix('js')}{short}"
            setattr(self._instance, method, reading.getter(_array_of(part)))
        setattr(self._instance, name, reading.getter(*map(_array_of, parts.values())))

    def _add_command(self, name: str, kind: str, fill: Callable[..., Any]) -> None:
        made = self._ral._message(kind)
        publisher = self._ral.publisher(name, made)

        def send(*values: Any, **named: Any) -> Any:
            message = fill(made(), *values, **named)
            moves = name.startswith("move_")
            handle = wait_move_handle(self._stateful, self._ral) if moves else None
            publisher.publish(message)
            return handle

        send.__name__ = name
        setattr(self._instance, name, send)

    def _add_jacobian(self) -> None:
        reading = Reading(self._ral, "jacobian", "std_msgs/Float64MultiArray", self._timeout)

        def jacobian() -> Array:
            """Return the Jacobian, (6, n)."""
            message = reading.message()
            rows, columns = (dim.size for dim in message.layout.dim)
            return np.array(message.data).reshape(rows, columns)

        self._instance.jacobian = jacobian

    def _add_forward_kinematics(self) -> None:
        kind = self._ral._service_type("crtk_msgs/QueryForwardKinematics")
        client = self._ral.service_client("forward_kinematics", kind)

        def forward_kinematics(jp: Any, extra: Any = None) -> Any:
            """Return a frame; with `extra`, result and message as well."""
            request = kind._request_class()
            request.jp = _numbers(jp)
            answer = client.call(request)
            frame = FrameFromPoseMsg(answer.cp)
            return (frame, answer.result, answer.message) if extra else frame

        self._instance.forward_kinematics = forward_kinematics

    def _add_inverse_kinematics(self) -> None:
        kind = self._ral._service_type("crtk_msgs/QueryInverseKinematics")
        client = self._ral.service_client("inverse_kinematics", kind)

        def inverse_kinematics(jp: Any, cp: Any, extra: Any = None) -> Any:
            """Return positions, from a seed; with `extra`, result and message as well."""
            request = kind._request_class()
            request.jp = _numbers(jp)
            FrameToPoseMsg(cp, request.cp)
            answer = client.call(request)
            found = np.array(answer.jp)
            return (found, answer.result, answer.message) if extra else found

        self._instance.inverse_kinematics = inverse_kinematics


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


def _filled(part: str, fill: Callable[[Any, Any], Any]) -> Callable[..., Any]:
    """Return a function that fills a part of a message with a set-point and returns it."""

    def put(message: Any, setpoint: Any) -> Any:
        fill(setpoint, getattr(message, part))
        return message

    return put


def _empty(message: Any) -> Any:
    return message


JOINTS, EMPTY = "sensor_msgs/JointState", "std_msgs/Empty"
POSE, TWIST, WRENCH = (f"geometry_msgs/{name}Stamped" for name in ("Pose", "Twist", "Wrench"))
JOINT_READINGS = ("measured_js", "setpoint_js")
#: {method: (type of its topic, what it returns of a message)}
READINGS: dict[str, tuple[str, Callable[[Any], Any]]] = {
    "measured_cp": (POSE, lambda message: FrameFromPoseMsg(message.pose)),
    "setpoint_cp": (POSE, lambda message: FrameFromPoseMsg(message.pose)),
    "measured_cv": (TWIST, lambda message: ArrayFromTwistMsg(message.twist)),
    "measured_cf": (WRENCH, lambda message: ArrayFromWrenchMsg(message.wrench)),
}
#: {method: (type of its topic, what puts its arguments into a message)}
COMMANDS: dict[str, tuple[str, Callable[..., Any]]] = {
    **dict.fromkeys(("hold", "free"), (EMPTY, _empty)),
    **dict.fromkeys(("servo_jp", "servo_jr", "move_jp", "move_jr"), (JOINTS, _positions)),
    "servo_jf": (JOINTS, _efforts),
    **dict.fromkeys(("servo_cp", "move_cp"), (POSE, _filled("pose", FrameToPoseMsg))),
    "servo_cv": (TWIST, _filled("twist", ArrayToTwistMsg)),
    "servo_cf": (WRENCH, _filled("wrench", ArrayToWrenchMsg)),
}
SERVICES = ("jacobian", "forward_kinematics", "inverse_kinematics", "operating_state")


def _adder(name: str) -> Callable[[Any], None]:
    def add(self: Any) -> None:
        self._add(name)

    add.__name__, add.__doc__ = f"add_{name}", f"Add {name}."
    return add


for _name in (*JOINT_READINGS, *READINGS, *COMMANDS, *SERVICES):
    setattr(utils, f"add_{_name}", _adder(_name))


class joystick_button:  # noqa: N801  as scripts call it
    """One button of a sensor_msgs/Joy.

    Args:
        ral: the layer that the topic's name is inside
        button_name: of the topic, such as "footpedals/coag"
        index: which button of the message
    """

    def __init__(self, ral: Any, button_name: str, index: int = 0) -> None:
        self._ral, self._index = ral, index
        self._value: int | None = None
        self._count = 0
        self._callback: Callable[[int], None] | None = None
        ral.subscriber(button_name, ral._message("sensor_msgs/Joy"), self._heard)

    def _heard(self, message: Any) -> None:
        value: int = message.buttons[self._index]
        self._value, self._count = value, self._count + 1
        if self._callback is not None:
            self._callback(value)

    def set_callback(self, callback: Callable[[int], None] | None = None) -> None:
        """Have a function called with each value."""
        self._callback = callback

    def value(self) -> int | None:
        """Return the last value: 0 released, 1 pressed, 2 quick tap; None before the first."""
        self._ral._look()
        return self._value

    def wait(self, timeout: float | None = None, value: int | None = None) -> bool:
        """Wait for the next value, or for this one; return whether it came in time [s]."""
        before = self._count

        def came() -> bool:
            return self._count > before and (value is None or value == self._value)

        return self._ral._wait(came, timeout)


class measured_cp:  # noqa: N801  as scripts call it
    """A device that only measures its pose: the method `measured_cp()`."""

    measured_cp: Callable[..., Any]

    def __init__(self, ral: Any, expected_interval: float = 0.01) -> None:
        features: Any = utils(self, ral, max(1.0, expected_interval))
        features.add_measured_cp()
