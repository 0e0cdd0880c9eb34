"""Topics of an arm's joint states in bags and on robots, by the names of all versions."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions import ArmDescription
from trocar.errors import InputError, LogError
from trocar.recording.bags import JOINT_STATE, Bag
from trocar.robot.recordings.arm_motion import ArmMotion
from trocar.robot.recordings.columns import choose_arm
from trocar.robot.recordings.motor_side import recorded_joints

Array = NDArray[np.float64]

#: Names of an arm's joint states, and of those of its last joint, newest first. Source: dVRK 2
#: (CRTK), dVRK 1.4 to 1.7, dVRK 1.2.
ARM_STATES = ("measured_js", "state_joint_current", "position_joint_current")
END_STATES = {
    "jaw": ("jaw/measured_js", "state_jaw_current", "position_jaw_current"),
    "gripper": ("gripper/measured_js", "state_gripper_current"),
}
ENDS = tuple(name for names in END_STATES.values() for name in names)


def find_topic(topics: Iterable[str], arm: str, names: Collection[str], where: str) -> str | None:
    """Return the topic of an arm among those of joint states, in whatever namespace and case.

    /SUJ/PSM1/measured_js does not belong to PSM1.

    Args:
        topics: without leading slashes
        arm: prefix of the arm, "PSM1"
        names: the allowed ones, the preferred first
        where: for errors

    Raises:
        InputError: several namespaces have it
    """
    known = list(topics)
    for name in names:
        exact = f"{arm}/{name}"
        if exact in known:
            return exact
        ending = f"/{exact}".lower()
        fitting = [
            topic for topic in known
            if f"/{topic}".lower().endswith(ending)
            and f"/{topic}"[: -len(ending)].rpartition("/")[2].upper() != "SUJ"
        ]  # fmt: skip
        if len(fitting) > 1:
            raise InputError(
                f"{where}: {exact} exists in several namespaces:"
                f" {', '.join(sorted(fitting))}; select one with --topic"
            )
        if fitting:
            return fitting[0]
    return None


def live_names(arm: str, names: Sequence[str]) -> tuple[str, ...]:
    """Return the topics that a robot of any version may have for an arm."""
    return (
        f"{arm}/{names[0]}",
        f"{arm.lower()}/{names[0]}",
        *(f"dvrk/{arm}/{name}" for name in names if name.startswith("state_")),
    )


def arm_of(topic: str) -> str:
    """Return the arm that a topic of joint states names, "" without one: the last but its name."""
    for name in (*ENDS, *ARM_STATES):
        if f"/{topic}".endswith(f"/{name}"):
            return topic[: -len(name)].rstrip("/").rpartition("/")[2]
    return topic.rpartition("/")[0].rpartition("/")[2]


def read_bag_motion(
    bag: Bag, arm: ArmDescription, topic: str | None, jaw: str | None, of: str | None
) -> ArmMotion:
    """Read the motion of an arm from a bag.

    The jaw has a topic of its own on the dVRK; without it, it stays closed.

    Args:
        bag: the bag
        arm: the recorded arm, with the tool that was mounted
        topic: of the joint states; found by its name when omitted
        jaw: of the jaw; that beside `topic` when omitted
        of: name of the arm in the bag

    Raises:
        LogError: no such topic, or joint states that this arm does not have
    """
    joints = recorded_joints(arm)
    chosen = _topic(bag, arm, topic, of)
    own_joints = joints[: len(joints) - arm.has_jaw]
    times, names, table, given = _samples(bag, chosen)
    columns = _order(bag.file, chosen, names, joints, own_joints)
    rows = np.zeros((len(times), 3, len(joints)))
    rows[:, :, : len(columns)] = table[:, :, columns]
    known = [set[str](), set[str](), set[str]()]
    for quantity, has in enumerate(given):
        known[quantity].update(joints[: len(columns)] if has else ())
    if arm.has_jaw and len(columns) < len(joints):
        beside = _jaw_topic(bag, chosen, jaw)
        if beside is not None:
            jaw_times, _, jaw_table, given = _samples(bag, beside)
            order = np.argsort(jaw_times, kind="stable")
            jaw_times, jaw_table = jaw_times[order], jaw_table[order]
            for quantity, has in enumerate(given):
                rows[:, quantity, -1] = np.interp(times, jaw_times, jaw_table[:, quantity, 0])
                known[quantity].update(joints[-1:] if has else ())
    recorded = frozenset(known[0]), frozenset(known[1]), frozenset(known[2])
    numbers = np.arange(1, len(times) + 1)
    return ArmMotion(bag.file, arm_of(chosen), joints, times, rows, recorded, numbers)


def _jaw_topic(bag: Bag, chosen: str, jaw: str | None) -> str | None:
    """Return the jaw's topic: the given one, or that beside the arm's."""
    if jaw is not None:
        if jaw.lstrip("/") not in bag.topics:
            known = ", ".join(f"/{t}" for t, kind in bag.topics.items() if kind == JOINT_STATE)
            raise LogError(bag.file, f"has no topic {jaw!r}; joint states are in: {known}")
        return jaw.lstrip("/")
    before = next(
        (chosen[: -len(name)] for name in ARM_STATES if f"/{chosen}".endswith(f"/{name}")), None
    )
    if before is None:
        return None
    return next((before + name for name in END_STATES["jaw"] if before + name in bag.topics), None)


def state_topics(bag: Bag) -> list[str]:
    """List the topics of arms' joint states in a bag, without leading slashes."""
    return sorted(
        name
        for name, kind in bag.topics.items()
        if kind == JOINT_STATE
        and any(f"/{name}".endswith(f"/{state}") for state in ARM_STATES)
        and not any(f"/{name}".endswith(f"/{end}") for end in ENDS)
    )


def _topic(bag: Bag, arm: ArmDescription, topic: str | None, of: str | None) -> str:
    """Return the topic to read, without a leading slash."""
    found = state_topics(bag)
    known = ", ".join(f"/{name}" for name in found) or "none"
    if topic is not None:
        if topic.lstrip("/") not in bag.topics:
            raise LogError(bag.file, f"has no topic {topic!r}; joint states are in: {known}")
        return topic.lstrip("/")
    if not found:
        others = ", ".join(f"/{t}" for t, kind in bag.topics.items() if kind == JOINT_STATE)
        raise LogError(
            bag.file,
            f"contains no joint states of a {arm.type}; allowed: a topic /{arm.type}.../measured_js"
            + (f", or one of {others} with --topic" if others else ""),
        )
    suj = [name for name in found if name.upper().split("/")[-3:-2] == ["SUJ"]]
    found = [name for name in found if name not in suj] or found
    if of is not None:
        label = choose_arm(bag.file, map(arm_of, found), arm.name, arm.type, of)
        found = [name for name in found if arm_of(name) == label]
    fitting = [name for name in found if arm_of(name).upper().startswith(arm.type)]
    named = [name for name in fitting if arm_of(name).lower() == arm.name]
    for names in (named, fitting, found if of is not None else []):
        if len({arm_of(name).lower() for name in names}) == 1:
            # one arm under names of several versions: the newest
            ranks = [next(k for k, s in enumerate(ARM_STATES) if n.endswith(s)) for n in names]
            newest = [n for n, rank in zip(names, ranks, strict=True) if rank == min(ranks)]
            if len(newest) == 1:
                return newest[0]
    raise LogError(
        bag.file, f"{len(fitting)} topics fit a {arm.type}; select one with --topic: {known}"
    )  # fmt: skip


def _order(
    file: str, topic: str, names: Sequence[str], joints: Sequence[str], own: Sequence[str]
) -> list[int]:
    """Map the joints of the arm to columns of a topic."""
    for expected in (joints, own):
        if set(names) == set(expected):
            return [list(names).index(name) for name in expected]
    if len(names) in (len(joints), len(own)):  # other names for the same joints
        return list(range(len(names)))
    raise LogError(
        file,
        f"/{topic}: got {len(names)} joints ({', '.join(names)}); allowed: {len(own)}"
        f" ({', '.join(own)})",
    )


def _samples(bag: Bag, topic: str) -> tuple[Array, tuple[str, ...], Array, tuple[bool, bool, bool]]:
    """Read a topic to its end.

    Returns:
        times (k,) [s], names, table (k, 3, n), which of the three the topic has
    """
    times: list[float] = []
    values: list[tuple[Any, ...]] = []
    names: tuple[str, ...] = ()

    def reject(problem: str) -> LogError:
        return LogError(bag.file, f"/{topic}: {problem}", len(times) + 1)

    for message in bag.messages([topic]):
        fields: Mapping[str, Any] = message.fields
        position = fields["position"]
        names = names or tuple(fields["name"]) or tuple(map(str, range(len(position))))
        if len(position) != len(names):
            raise reject(f"got {len(position)} positions; allowed: {len(names)}")
        if not np.isfinite(position).all():
            raise reject("positions must be finite")
        times.append(fields["stamp"])
        values.append((position, fields["velocity"], fields["effort"]))
    if len(times) < 2:
        raise LogError(bag.file, f"/{topic}: got {len(times)} samples; allowed: 2 or more")
    velocities, efforts = (all(len(v[k]) == len(names) for v in values) for k in (1, 2))
    given = True, velocities, efforts
    table = np.zeros((len(times), 3, len(names)))
    for quantity, has in enumerate(given):
        if has:
            table[:, quantity] = np.array([v[quantity] for v in values])
    return np.array(times), names, table, given
