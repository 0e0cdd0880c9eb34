"""Run plans on an arm over ROS 1 and record its answers.

The same script runs against the dVRK's own software (a Python with rospy, numpy, crtk_msgs and
cisst_msgs) and, by `trocar run`, on the simulation:

    python -m benchmarks.genuine.drive psm -o OUT.json [--only A,C]
"""

from __future__ import annotations

import argparse
import importlib
import json
import threading
import time
from collections.abc import Sequence
from functools import reduce
from pathlib import Path
from typing import Any

import numpy as np
import rospy  # pyright: ignore[reportMissingImports]

from benchmarks.genuine.plans import PLANS, Plan
from benchmarks.genuine.steps import Step, matrix, quaternion

#: Topics of every arm that a step records or waits for.
TYPES = {
    "operating_state": "crtk_msgs/OperatingState", "desired_state": "std_msgs/String",
    "error": "std_msgs/String", "warning": "std_msgs/String", "status": "std_msgs/String",
    "goal_reached": "std_msgs/Bool", "setpoint_js": "sensor_msgs/JointState",
    "measured_js": "sensor_msgs/JointState", "setpoint_cp": "geometry_msgs/PoseStamped",
}  # fmt: skip
#: Messages of these are events of a step.
EVENTS = ("operating_state", "desired_state", "error", "warning", "goal_reached")


class Arm:
    """An arm of a ROS 1 graph, a `Driven`.

    Args:
        name: of its topics
        more: {topic: type} of further topics, absolute with a leading /
    """

    def __init__(self, name: str, more: dict[str, str]) -> None:
        self.name = name
        self.events: list[tuple[float, str, dict[str, Any]]] = []
        self.facts: dict[str, Any] = {}
        self._last: dict[str, dict[str, Any]] = {}
        self._lock = threading.Lock()
        self._publishers: dict[str, Any] = {}
        self._events = {*EVENTS, *(topic for topic in more if not topic.endswith(("_js", "_cp")))}
        self._subscribers = [
            rospy.Subscriber(
                self._full(topic), kind(name), self._receive, topic, queue_size=50, tcp_nodelay=True
            )
            for topic, name in {**TYPES, **more}.items()
        ]

    def _full(self, topic: str) -> str:
        return topic if topic.startswith("/") else f"/{self.name}/{topic}"

    def _receive(self, message: Any, topic: str) -> None:
        found = plain(message)
        with self._lock:
            self._last[topic] = found
            if topic in self._events:
                self.events.append((time.time(), topic, found))

    def advertise(self, topic: str, kind_name: str) -> None:
        """As `Driven`."""
        self._publisher(topic, kind(kind_name))

    def send(self, topic: str, kind_name: str, **fields: Any) -> None:
        """As `Driven`."""
        message = kind(kind_name)()
        for name, value in fields.items():
            *path, last = name.split("__")
            setattr(reduce(getattr, path, message), last, value)
        if hasattr(message, "header"):
            message.header.stamp = rospy.Time.now()
        self._publisher(topic, type(message)).publish(message)

    def _publisher(self, topic: str, cls: type) -> Any:
        if topic not in self._publishers:
            made = rospy.Publisher(self._full(topic), cls, queue_size=100, tcp_nodelay=True)
            self._publishers[topic] = made
            end = time.time() + 1.5
            while made.get_num_connections() == 0 and time.time() < end:
                time.sleep(0.01)
        return self._publishers[topic]

    def call(self, service: str, kind_name: str, **fields: Any) -> Any:
        """As `Driven`."""
        try:
            return plain(rospy.ServiceProxy(self._full(service), kind(kind_name, "srv"))(**fields))
        except (rospy.ServiceException, rospy.ROSException) as problem:
            return str(problem)

    def inverse(self, jp: Sequence[float], p: Any, R: Any) -> Any:
        """As `Driven`."""
        pose = kind("geometry_msgs/Pose")()
        for target, names, values in (
            (pose.position, "xyz", p),
            (pose.orientation, "xyzw", quaternion(R)),
        ):
            for name, value in zip(names, values, strict=True):
                setattr(target, name, float(value))
        return self.call("inverse_kinematics", "crtk_msgs/QueryInverseKinematics", jp=jp, cp=pose)

    def joints(self, topic: str, positions: Any, **fields: Any) -> None:
        """As `Driven`."""
        numbers = [float(x) for x in positions]
        self.send(topic, "sensor_msgs/JointState", position=numbers, **fields)

    def state(self, command: str) -> None:
        """As `Driven`."""
        self.send("state_command", "crtk_msgs/StringStamped", string=command)

    def pose(self, topic: str, p: Any, R: Any, frame: str = "") -> None:
        """As `Driven`."""
        turned = quaternion(R) if np.shape(R) == (3, 3) else R
        fields: dict[str, Any] = {f"pose__position__{k}": v for k, v in zip("xyz", p, strict=True)}
        fields |= {f"pose__orientation__{k}": v for k, v in zip("xyzw", turned, strict=True)}
        self.send(topic, "geometry_msgs/PoseStamped", header__frame_id=frame, **fields)

    def get(self, topic: str) -> dict[str, Any] | None:
        """As `Driven`."""
        with self._lock:
            return self._last.get(topic)

    def q(self, topic: str = "setpoint_js") -> Any:
        """As `Driven`."""
        return np.array((self.get(topic) or {"position": []})["position"], dtype=float)

    def tip(self) -> tuple[Any, Any]:
        """As `Driven`."""
        pose = (self.get("setpoint_cp") or {})["pose"]
        p = np.array([pose["position"][k] for k in "xyz"])
        return p, matrix([pose["orientation"][k] for k in "xyzw"])

    def sleep(self, seconds: float) -> None:
        """As `Driven`."""
        time.sleep(seconds)

    def wait_busy(self, timeout: float = 15.0, settle: float = 0.3) -> None:
        """As `Driven`."""
        end = time.time() + timeout
        time.sleep(0.15)
        while time.time() < end:
            seen = self.get("operating_state")
            if seen and not seen["is_busy"]:
                break
            time.sleep(0.005)
        time.sleep(settle)

    def fact(self, name: str, value: Any) -> None:
        """As `Driven`."""
        self.facts[name] = rounded(value)

    def run(self, step: Step) -> dict[str, Any]:
        """Run a step and return its record: events, and where set-points ended."""
        with self._lock:
            self.events.clear()
        began = time.time()
        if step.act is not None:
            step.act()
        if step.wait is None:
            self.wait_busy(step.timeout)
        else:
            time.sleep(step.wait)
        with self._lock:
            events = list(self.events)
        record: dict[str, Any] = {"step": step.name, "events": brief(events, began)}
        for topic in ("setpoint_js", "jaw/setpoint_js"):
            if self.get(topic) is not None:
                record[topic] = [round(float(x), 6) for x in self.q(topic)]
        return record


def kind(name: str, part: str = "msg") -> Any:
    """Return the class of a message or service type, such as `std_msgs/Bool`."""
    package, own = name.split("/")
    return getattr(importlib.import_module(f"{package}.{part}"), own)


def plain(message: Any) -> Any:
    """Return a message as dictionaries, lists and numbers; a header as its frame_id."""
    if isinstance(message, list | tuple):
        return [plain(each) for each in message]
    if not hasattr(message, "__slots__"):
        return message
    found = {name: getattr(message, name) for name in message.__slots__}
    if "header" in found:
        header = found.pop("header")
        return {"frame_id": header.frame_id} | {name: plain(v) for name, v in found.items()}
    return {name: plain(value) for name, value in found.items()}


def brief(events: Sequence[tuple[float, str, dict[str, Any]]], began: float) -> list[list[Any]]:
    """Return events as [s after the step began, topic, value], repeated states left out."""
    found: list[list[Any]] = []
    before = None
    for when, topic, message in events:
        value: Any = message
        if topic == "operating_state":
            state, sub = message["state"], message.get("sub_state", "-")
            flags = f"homed={int(message['is_homed'])} busy={int(message['is_busy'])}"
            value = f"{state} {flags} sub={sub}"
            if value == before:
                continue
            before = value
        elif len(message) == 1:
            (value,) = message.values()
        elif "string" in message:
            value = message["string"]
        found.append([round(when - began, 3), topic, rounded(value)])
    return found


def rounded(value: Any) -> Any:
    """Return a value with its numbers rounded to 1e-6."""
    if isinstance(value, bool | str) or value is None:
        return value
    if isinstance(value, dict):
        return {name: rounded(each) for name, each in value.items()}
    if isinstance(value, list | tuple | np.ndarray):
        return [rounded(each) for each in value]
    return round(float(value), 6) if isinstance(value, float) else value


def main() -> None:
    """Run a plan and write its record."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("plan", choices=PLANS)
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--only", default="", help="parts of the plan, such as A,C")
    args = parser.parse_args()
    rospy.init_node("recorder", anonymous=True, disable_signals=True)
    plan: Plan = PLANS[args.plan]
    arm = Arm(plan.arm, plan.more)
    time.sleep(1.5)
    steps: list[dict[str, Any]] = []
    try:
        for part in args.only.split(",") if args.only else plan.usual or plan.parts:
            for step in plan.parts[part](arm):
                steps.append(arm.run(step))
                print(steps[-1]["step"], json.dumps(steps[-1]["events"])[:300], flush=True)
    finally:
        record = {"plan": args.plan, "steps": steps, "facts": arm.facts}
        args.output.write_text(json.dumps(record))


if __name__ == "__main__":
    main()
