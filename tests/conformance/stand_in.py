"""An arm of ours beneath the kit, without sockets and in simulated time, and one with faults."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from tests.ros.served import Served
from trocar.errors import TrocarError
from trocar.messages import blank
from trocar.ros.client import CALL_S, DEPTH, Graph, Take
from trocar.ros.topic import JOINTS
from trocar.simulation import World

PEER = "kit"
TICK_S = 0.001


class ServedClient:
    """A client of a served world; time passes in `sleep` alone."""

    name = "memory"

    def __init__(self, rig: str | World = "psm") -> None:
        self.served = Served(rig, wanted=(), rate_hz=100.0)  # the dVRK's rate
        self.takes: dict[str, list[Take]] = {}
        self._count: dict[str, int] = {}

    def start(self) -> None:
        self.sleep(0.05)

    def close(self) -> None:
        self.served.core.close()

    def now(self) -> float:
        return self.served.clock.now()

    def sleep(self, seconds: float) -> None:
        for _ in range(max(1, round(seconds / TICK_S))):
            self.served.run(TICK_S)
            self._deliver()

    def graph(self) -> Graph:
        topics = [t for t in self.served.core.topics.values() if not t.later]
        return Graph(
            {t.name: t.type for t in topics if t.direction == "pub"},
            {t.name: t.type for t in topics if t.direction == "sub"},
            {s.name: s.type for s in self.served.core.services.values()},
        )

    def latched(self, topic: str) -> bool | None:
        return self.served.core.topics[topic].latched

    def subscribe(
        self,
        topic: str,
        kind: str,
        take: Take,
        depth: int = DEPTH,  # noqa: ARG002
    ) -> Callable[[], None]:
        assert self.served.core.topics[topic].type == kind
        takes = self.takes.setdefault(topic, [])
        takes.append(take)
        self.served.transport.want(*self.takes)
        last = self.served.core.latched(topic)
        if last is not None and self.latched(topic):
            self.hand(topic, last, take)
        return lambda: takes.remove(take)

    def advertise(self, topic: str, kind: str) -> None:
        assert self.served.core.topics[topic].type == kind

    def publish(self, topic: str, kind: str, fields: Mapping[str, Any]) -> None:
        self.served.core.receive(topic, {**blank(kind), **fields}, PEER)

    def call(
        self,
        service: str,
        kind: str,
        fields: Mapping[str, Any],
        timeout_s: float = CALL_S,
    ) -> Mapping[str, Any]:
        row = self.served.core.services.get(service)
        if row is None or row.type != kind:
            raise TrocarError(f"{service}: no such service")
        return self.served.core.call(service, dict(fields), timeout_s)

    def hand(self, topic: str, message: Mapping[str, Any], take: Take) -> None:  # noqa: ARG002
        """Give a message to a subscriber."""
        take(message)

    def _deliver(self) -> None:
        received = self.served.transport.received
        for topic, messages in received.items():
            for message in messages:
                for take in tuple(self.takes.get(topic, ())):
                    self.hand(topic, message, take)
            messages.clear()


class FaultyClient(ServedClient):
    """The same arm with one thing wrong; each fault overrides what it distorts."""

    #: The checks that find it.
    found_by: tuple[str, ...] = ()
    #: Whether it takes moves to find it.
    moves = False

    def arm(self, topic: str) -> str:
        """Return the topic without the arm's name."""
        return topic.partition("/")[2]

    def changed(self, key: str, message: dict[str, Any]) -> dict[str, Any] | None:  # noqa: ARG002
        """Return what the stand-in publishes in place of a message; None: nothing."""
        return message

    def hand(self, topic: str, message: Mapping[str, Any], take: Take) -> None:
        key = self.arm(topic)
        self._count[key] = self._count.get(key, 0) + 1
        changed = self.changed(key, dict(message))
        if changed is not None:
            take(changed)


class NoFrame(FaultyClient):
    """measured_cp names no frame."""

    found_by = ("poses name their frame",)

    def changed(self, key, message):
        if key in ("measured_cp", "setpoint_cp"):
            message["header"] = {**message["header"], "frame_id": ""}
        return message


class SlowStream(FaultyClient):
    """measured_js comes at a tenth of the rate."""

    found_by = ("rate",)

    def changed(self, key, message):
        return message if key != "measured_js" or self._count[key] % 10 == 0 else None


class OldStamps(FaultyClient):
    """Stamps of measured_cp go back by 100 ms now and then."""

    found_by = ("stamps do not go back",)

    def changed(self, key, message):
        if key == "measured_cp" and self._count[key] % 50 == 0:
            seconds, rest = divmod(
                message["header"]["stamp"][0] * 10**9 + message["header"]["stamp"][1] - 100_000_000,
                10**9,
            )
            message["header"] = {**message["header"], "stamp": (seconds, rest)}
        return message


class TurnedQuaternion(FaultyClient):
    """The quaternion of measured_cp is in the order w, x, y, z."""

    found_by = ("forward_kinematics of measured_js is measured_cp",)

    def changed(self, key, message):
        if key == "measured_cp":
            q = message["pose"]["orientation"]
            turned = {"x": q["w"], "y": q["x"], "z": q["y"], "w": q["z"]}
            message["pose"] = {**message["pose"], "orientation": turned}
        return message


class NoJaw(FaultyClient):
    """The jaw's measured position is not published."""

    found_by = ("published topics are there",)

    def graph(self):
        whole = super().graph()
        left = {k: v for k, v in whole.published.items() if k != "PSM1/jaw/measured_js"}
        return Graph(left, whole.subscribed, whole.services)


class OtherType(FaultyClient):
    """state_command is a std_msgs/String."""

    found_by = ("commands have their types",)

    def graph(self):
        whole = super().graph()
        other = {**whole.subscribed, "PSM1/state_command": "std_msgs/String"}
        return Graph(whole.published, other, whole.services)


class Millimetres(FaultyClient):
    """The insertion of measured_js is in millimetres."""

    found_by = (
        "measured positions are at the set-points",
        "forward_kinematics of measured_js is measured_cp",
    )

    def changed(self, key, message):
        if key == "measured_js":
            message["position"] = message["position"] * [1.0, 1.0, 1e3, 1.0, 1.0, 1.0]
        return message


class VolatileRatio(FaultyClient):
    """Late subscribers do not get the ratio."""

    found_by = ("trajectory_j/ratio comes at once",)

    def changed(self, key, message):
        return message if key != "trajectory_j/ratio" or self._count[key] > 1 else None


class TwistedVelocity(FaultyClient):
    """measured_cv has the opposite sign."""

    found_by = ("measured_cv adds up to the way of measured_cp, in axes of its frame",)
    moves = True

    def changed(self, key, message):
        if key == "measured_cv":
            message["twist"] = {
                part: {axis: -value for axis, value in vector.items()}
                for part, vector in message["twist"].items()
            }
        return message


class DeafRatio(FaultyClient):
    """set_ratio is published back, and does nothing."""

    found_by = (
        "move_jp: peak speeds at a ratio of 0.2, of the profile's",
        "a quarter of the ratio (0.05) makes moves half as fast, or slower",
    )
    moves = True

    def publish(self, topic, kind, fields):
        if self.arm(topic) != "trajectory_j/set_ratio":
            super().publish(topic, kind, fields)
            return
        for part in ("", "_v", "_a"):
            for take in tuple(self.takes.get(f"PSM1/trajectory_j/ratio{part}", ())):
                take({"data": fields["data"]})


class DeafHold(FaultyClient):
    """hold does nothing."""

    found_by = ("hold ends a move: set-points stay, goal_reached is false",)
    moves = True

    def publish(self, topic, kind, fields):
        if self.arm(topic) != "hold":
            super().publish(topic, kind, fields)


class BusyNever(FaultyClient):
    """is_busy stays false during moves."""

    found_by = (
        "move_jp: is_busy while it lasts, not after",
        "move_jr: is_busy while it lasts, not after",
        "jaw/move_jp: is_busy while it lasts, not after",
    )
    moves = True

    def changed(self, key, message):
        if key == "operating_state":
            message["is_busy"] = False
        return message


class Fault(FaultyClient):
    """A tracking error in the middle of the moves."""

    moves = True

    def publish(self, topic, kind, fields):
        if self.arm(topic) == "move_jr":
            jump = {"position": [0.0, 0.0, 0.0, 0.0, 0.0, 1.3]}
            super().publish("PSM1/servo_jp", JOINTS, {**blank(JOINTS), **jump})
            return
        super().publish(topic, kind, fields)


class Runaway(FaultyClient):
    """A joint that leaves without a command."""

    moves = True
    began: float | None = None

    def publish(self, topic, kind, fields):
        if self.arm(topic) == "hold" and self.began is None:
            self.began = self.now()
        super().publish(topic, kind, fields)

    def changed(self, key, message):
        if key == "measured_js" and self.began is not None:
            q = message["position"].copy()
            q[1] += 0.2 * (self.now() - self.began)
            message["position"] = q
        return message


READING = (
    NoFrame, SlowStream, OldStamps, TurnedQuaternion, NoJaw, OtherType, Millimetres, VolatileRatio,
)  # fmt: skip
MOVING = (TwistedVelocity, DeafRatio, DeafHold, BusyNever)
