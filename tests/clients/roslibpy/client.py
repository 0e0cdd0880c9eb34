"""python client.py ws://127.0.0.1:9090 : lists topics, calls services, moves PSM1, follows it.

roslibpy is a client that is not ours. It prints what it was told as one JSON document.
"""

from __future__ import annotations

import json
import sys
import threading
from collections.abc import Callable
from typing import Any

import roslibpy  # pyright: ignore[reportMissingTypeStubs]

PATIENCE_S = 30.0


def follow(topic: Any, fits: Callable[[dict[str, Any]], bool]) -> tuple[threading.Event, list[Any]]:
    """Begin to listen; return what is set when a message fits, and the messages."""
    found, messages = threading.Event(), []

    def hear(message: dict[str, Any]) -> None:
        messages.append(dict(message))
        if fits(message):
            found.set()

    topic.subscribe(hear)
    return found, messages


ros = roslibpy.Ros(sys.argv[1])
ros.run()
told: dict[str, Any] = {
    "topics": ros.get_topics(),
    "type": ros.get_topic_type("/PSM1/measured_js"),
    "of_type": ros.get_topics_for_type("sensor_msgs/JointState"),
    "services": ros.get_services(),
    "nodes": ros.get_nodes(),
    "details": ros.get_message_details("sensor_msgs/JointState"),
    "time": dict(ros.get_time() or {})["secs"],
}

measured = roslibpy.Topic(ros, "/PSM1/measured_js", "sensor_msgs/JointState", throttle_rate=10)
state = roslibpy.Topic(ros, "/PSM1/operating_state", "crtk_msgs/OperatingState")
there, _ = follow(measured, lambda m: abs(m["position"][0] - 0.2) < 1e-3)
_, states = follow(state, lambda _: False)
move = roslibpy.Topic(ros, "/PSM1/move_jp", "sensor_msgs/JointState")
move.publish(roslibpy.Message({"position": [0.2, 0.0, 0.12, 0.0, 0.0, 0.0]}))
told["arrived"] = there.wait(PATIENCE_S)
told["busy"] = [state["is_busy"] for state in states]

kinematics = roslibpy.Service(
    ros, "/PSM1/local/forward_kinematics", "crtk_msgs/QueryForwardKinematics"
)
request = roslibpy.ServiceRequest({"jp": [0.0, 0.0, 0.12, 0.0, 0.0, 0.0]})
told["pose"] = dict(kinematics.call(request, timeout=PATIENCE_S) or {})
try:
    absent = roslibpy.Service(ros, "/nothing", "std_srvs/Trigger")
    absent.call(roslibpy.ServiceRequest(), timeout=PATIENCE_S)
except Exception as error:  # noqa: BLE001  whatever roslibpy makes of a refusal
    told["refused"] = str(error)

sys.stdout.write(json.dumps(told, default=dict))
ros.terminate()
