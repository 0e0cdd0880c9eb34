"""What has been heard of each arm, and where that puts its twin."""

from __future__ import annotations

import threading
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal, cast

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions import ArmDescription, RigDescription
from trocar.errors import InputError
from trocar.interfaces.crtk.topics import prefix

if TYPE_CHECKING:
    from trocar.simulation import World

Array = NDArray[np.float64]
By = Literal["set", "servo"]
#: Which of a message's positions is which joint, by its names and their number.
Orders = dict[tuple[tuple[str, ...], int], list[int]]

MEASURED = "measured_js"
#: Joints that have a topic of their own, by the last joint's name. Source: the dVRK's topics.
PARTS = {"jaw": "jaw/measured_js", "gripper": "gripper/measured_js"}
JOINT_STATE = "sensor_msgs/JointState"


@dataclass(frozen=True)
class Follow:
    """Bring an arm to joint positions and velocities, with its jaw or gripper.

    Attributes:
        arm: its name
        position, velocity: (n,) [rad or m, per s]
        by: "set": it is put there; "servo": its servos follow
    """

    arm: str
    position: tuple[float, ...]
    velocity: tuple[float, ...]
    by: By

    @property
    def stream(self) -> tuple[str, str]:
        """Of several that wait only the newest counts."""
        return self.arm, "mirror"

    def apply(self, world: World) -> None:
        """Put the arm there, or let its servos follow."""
        arm, q = world.arm(self.arm), np.array(self.position)
        own = arm.description.own_joints
        if self.by == "set":
            world.set_state(self.arm, q)
        else:
            arm.servo_jp(q[:own], np.array(self.velocity[:own]))
            if arm.jaw is not None:
                arm.jaw.servo_jp(q[own:])
        if arm.gripper is not None:
            arm.gripper.squeeze_to(float(q[-1]))


@dataclass(frozen=True)
class Prepare:
    """Let an arm be moved by what is heard: brakes off, and in the mode "set" held there."""

    arm: str
    by: By

    def apply(self, world: World) -> None:
        """Switch its mode."""
        arm = world.arm(self.arm)
        if arm.type == "SUJ":
            arm.release_brakes()
        if self.by == "set":
            arm.set_mode("set")


@dataclass
class Twin:
    """One arm and what was heard of it.

    Attributes:
        name, arm: of the rig
        q, qd: where it is to be, and how fast it moves there, (n,) [rad or m, per s]
        heard: how many messages
        last: when the newest one was heard, None before the first [s]
        silent: whether it has been silent for too long
        gaps: how often it has been
        clipped: how many messages asked for more than the joints' limits
        refused: how many could not be used
    """

    name: str
    arm: ArmDescription
    q: Array
    qd: Array
    heard: int = 0
    last: float | None = None
    first: float | None = None
    silent: bool = False
    gaps: int = 0
    clipped: int = 0
    refused: int = 0
    orders: Orders = field(default_factory=dict[tuple[tuple[str, ...], int], list[int]])

    @property
    def rate(self) -> float:
        """Messages a second since the first [Hz]."""
        if self.first is None or self.last is None or self.last <= self.first:
            return 0.0
        return (self.heard - 1) / (self.last - self.first)

    def take(self, joints: slice, names: Sequence[str], position: Array, velocity: Array) -> str:
        """Take a message's positions; return why they cannot be used, "" where they can.

        Velocities that are not told are 0, and so are those of joints at their limits.
        """
        known = self.arm.mechanism.joint_names[joints]
        if len(position) != len(known):
            if joints.start == 0 and len(position) == len(self.q):
                joints, known = slice(0, len(self.q)), self.arm.mechanism.joint_names
            else:
                return f"got {len(position)} joints; allowed: {len(known)} ({', '.join(known)})"
        if not np.isfinite(position).all():
            return f"got {position.tolist()}; allowed: finite numbers"
        order = self._order(tuple(names), known)
        wanted = position[order]
        lower, upper = self.arm.mechanism.lower[joints], self.arm.mechanism.upper[joints]
        inside = np.clip(wanted, lower, upper)
        self.clipped += bool((inside != wanted).any())
        self.q[joints] = inside
        told = len(velocity) == len(position) and bool(np.isfinite(velocity).all())
        self.qd[joints] = np.where(inside == wanted, velocity[order], 0.0) if told else 0.0
        return ""

    def _order(self, names: tuple[str, ...], known: Sequence[str]) -> list[int]:
        """Return which position is which joint; other names are taken in their order."""
        key = names, len(known)
        if key not in self.orders:
            same = set(names) == set(known) and len(names) == len(known)
            count = range(len(known))
            self.orders[key] = [names.index(j) for j in known] if same else list(count)
        return self.orders[key]


class Twins:
    """Every arm that is mirrored; heard from any thread.

    Args:
        rig: whose arms
        topics: those that there are, None where nobody knows (live)
        arms: names of arms that are to be mirrored; None: all that have topics
        by: how they are brought to where they are

    Attributes:
        missing: arms of the rig that have no topic

    Raises:
        InputError: an arm without a topic that was asked for, or no arm at all; tells what there is
    """

    def __init__(
        self,
        rig: RigDescription,
        topics: Mapping[str, str] | None,
        arms: Sequence[str] | None,
        by: By,
        where: str,
    ) -> None:
        self.by: By = by
        self._lock = threading.Lock()
        self._parts: dict[str, tuple[Twin, slice]] = {}
        self.twins: dict[str, Twin] = {}
        self.missing: list[str] = []
        wanted = [rig.arm(name).name for name in arms] if arms else [a.name for a in rig.arms]
        for name in wanted:
            arm = rig.arm(name).arm
            own = _found(topics, f"{prefix(name, arm)}/{MEASURED}", where)
            if own is None:
                self.missing.append(name)
                continue
            start = rig.poses["start"][name]
            twin = Twin(name, arm, start.copy(), np.zeros(len(start)))
            self.twins[name] = twin
            self._parts[own] = twin, slice(0, arm.own_joints)
            part = PARTS.get(arm.mechanism.joint_names[-1])
            if part is not None:
                other = _found(topics, f"{prefix(name, arm)}/{part}", where)
                if other is not None:
                    self._parts[other] = twin, slice(arm.own_joints, len(arm.joints))
        if not self.twins or (arms and self.missing):
            raise InputError(_nothing(self.missing, rig, topics or {}, where))

    @property
    def topics(self) -> tuple[str, ...]:
        """The topics that are listened to, without a leading slash."""
        return tuple(self._parts)

    def prepare(self) -> list[Prepare]:
        """Return what lets the arms be moved."""
        return [Prepare(name, self.by) for name in self.twins]

    def hear(self, topic: str, message: Mapping[str, Any], now: float) -> tuple[Follow | None, str]:
        """Take a message; return where its arm is to be, and what is to be said.

        Args:
            topic: without a leading slash
            message: fields of a JointState
            now: when it came [s]
        """
        twin, joints = self._parts[topic]
        with self._lock:
            try:
                position = np.asarray(message["position"], np.float64)
                velocity = np.asarray(message.get("velocity", ()), np.float64)
                names = [str(name) for name in cast(Iterable[object], message.get("name", ()))]
            except (TypeError, ValueError, KeyError):
                position, velocity, names = np.zeros(0), np.zeros(0), []
            wrong = twin.take(joints, names, position, velocity)
            if wrong:
                twin.refused += 1
                return None, f"{twin.name}: {topic}: {wrong}" if twin.refused == 1 else ""
            back, by = "", self.by
            if joints.start == 0:
                if not twin.heard or twin.silent:  # it may be far from where the twin stands
                    by = "set"
                back = self._own_heard(twin, now)
            return Follow(twin.name, tuple(twin.q.tolist()), tuple(twin.qd.tolist()), by), back

    def _own_heard(self, twin: Twin, now: float) -> str:
        back = ""
        if twin.silent and twin.last is not None:
            back = f"{twin.name}: heard again after {now - twin.last:.2f} s"
        twin.silent, twin.last = False, now
        twin.first = now if twin.first is None else twin.first
        twin.heard += 1
        return back

    def silence(self, now: float, longest_s: float) -> list[str]:
        """Return what is to be said of arms that have been silent for too long."""
        found: list[str] = []
        with self._lock:
            for twin in self.twins.values():
                if twin.last is None or twin.silent or now - twin.last <= longest_s:
                    continue
                twin.silent, twin.gaps = True, twin.gaps + 1
                found.append(
                    f"{twin.name}: silent for {1e3 * longest_s:.0f} ms; it holds where it is"
                )
        return found


def _found(topics: Mapping[str, str] | None, name: str, where: str) -> str | None:
    """Return the topic of that name, whatever namespace it is in, None where there is none."""
    if topics is None:
        return name
    fitting = [
        topic
        for topic, kind in topics.items()
        if kind == JOINT_STATE and (topic == name or _namespaced(topic, name))
    ]
    if len(fitting) > 1 and name not in fitting:
        raise InputError(f"{where}: {name} is in several namespaces: {', '.join(sorted(fitting))}")
    return None if not fitting else name if name in fitting else fitting[0]


def _namespaced(topic: str, name: str) -> bool:
    """Tell whether a topic is that one in a namespace; /SUJ/PSM1/... is no PSM1's."""
    before, found, after = topic.rpartition(f"/{name}")
    return bool(found) and not after and before.rpartition("/")[2] != "SUJ"


def _nothing(
    missing: Sequence[str], rig: RigDescription, topics: Mapping[str, str], where: str
) -> str:
    wanted = ", ".join(f"/{prefix(n, rig.arm(n).arm)}/{MEASURED}" for n in missing)
    states = [topic for topic, kind in sorted(topics.items()) if kind == JOINT_STATE]
    found = ", ".join(f"/{topic}" for topic in (states or sorted(topics))) or "none"
    kind = "joint states" if states or not topics else "topics, none of them joint states"
    return f"{where}: has no {wanted}; its {kind}: {found}"
