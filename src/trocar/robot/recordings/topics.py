"""Topics of an arm's joint states and poses in bags and on robots, by the names of all versions."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions import ArmDescription
from trocar.errors import InputError, LogError
from trocar.recording.bags import JOINT_STATE, POSES, Bag
from trocar.robot.recordings.arm_motion import ArmMotion
from trocar.robot.recordings.columns import choose_arm
from trocar.robot.recordings.motor_side import recorded_joints
from trocar.robot.recordings.tip_poses import joints_along, pose_from_numbers

Array = NDArray[np.float64]

#: Names of an arm's joint states, and of those of its last joint, newest first. Source: dVRK 2
#: (CRTK), dVRK 1.4 to 1.7, dVRK 1.2.
ARM_STATES = ("measured_js", "state_joint_current", "position_joint_current")
END_STATES = {
    "jaw": ("jaw/measured_js", "state_jaw_current", "position_jaw_current"),
    "gripper": ("gripper/measured_js", "state_gripper_current"),
}
#: Names of commanded positions, which stand for measured ones that were not recorded. Source: dVRK
#: 2 (CRTK), dVRK 1.4 to 1.7, dVRK 1.2.
ARM_SETPOINTS = ("setpoint_js", "state_joint_desired", "position_joint_desired")
END_SETPOINTS = {"jaw": ("jaw/setpoint_js", "state_jaw_desired", "position_jaw_desired")}
#: Names of poses of the tip, in the arm's own base frame and in that of `measured_cp`. Source: as
#: above.
LOCAL_POSES = ("local/measured_cp", "position_cartesian_local_current")
TIP_POSES = ("measured_cp", "position_cartesian_current")
ENDS = tuple(name for names in (*END_STATES.values(), *END_SETPOINTS.values()) for name in names)
KNOWN = (*ARM_STATES, *ARM_SETPOINTS, *LOCAL_POSES, *TIP_POSES)


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


def fits_names(names: Sequence[str], joints: Sequence[str]) -> bool:
    """Return whether the names of a message are those of an arm's joints, numbers, or none."""
    return all(
        name.isdigit() or name in joints or name.removeprefix("outer_") in joints for name in names
    )


def live_names(arm: str, names: Sequence[str]) -> tuple[str, ...]:
    """Return the topics that a robot of any version may have for an arm."""
    return (
        f"{arm}/{names[0]}",
        f"{arm.lower()}/{names[0]}",
        *(f"dvrk/{arm}/{name}" for name in names if name.startswith("state_")),
    )


def arm_of(topic: str) -> str:
    """Return the arm that a topic names, "" without one: the last but its name."""
    for name in (*ENDS, *KNOWN):
        if f"/{topic}".endswith(f"/{name}"):
            return topic[: -len(name)].rstrip("/").rpartition("/")[2]
    return topic.rpartition("/")[0].rpartition("/")[2]


def arm_topics(bag: Bag) -> dict[str, list[str]]:
    """Find the arms of a bag, {name: topics without leading slashes}.

    The topics are those of measured joints, else of commanded joints, else of poses of the tip.
    """
    found: dict[str, list[str]] = {}
    for names, kinds in (
        (ARM_STATES, (JOINT_STATE,)),
        (ARM_SETPOINTS, (JOINT_STATE,)),
        ((*LOCAL_POSES, *TIP_POSES), POSES),
    ):
        before = set(found)
        for topic, kind in sorted(bag.topics.items()):
            if kind not in kinds or not _ends(topic, names) or _ends(topic, ENDS):
                continue
            if (label := arm_of(topic)) not in before:
                found.setdefault(label, []).append(topic)
    return found


def read_bag_motion(
    bag: Bag,
    arm: ArmDescription,
    topic: str | None,
    jaw: str | None,
    of: str | None,
    base: Array | Literal["centred"] | None,
) -> ArmMotion:
    """Read the motion of an arm from a bag.

    The jaw has a topic of its own on the dVRK; without it, it stays closed.

    Args:
        bag: the bag
        arm: the recorded arm, with the tool that was mounted
        topic: of the joint states or poses of the tip; found by its name when omitted
        jaw: of the jaw; that beside `topic` when omitted
        of: name of the arm in the bag
        base: of poses, as for `joints_along`

    Raises:
        LogError: no such topic, or joint states that this arm does not have
    """
    joints = recorded_joints(arm)
    chosen = _topic(bag, arm, topic, of, base)
    own_joints = joints[: len(joints) - arm.has_jaw]
    notes: list[str] = []
    if bag.topics[chosen] in POSES:
        times, tips = _tips(bag, chosen)
        numbers = np.arange(1, len(times) + 1)
        q, note = joints_along(arm, tips, base, bag.file, numbers)
        table, given = np.zeros((len(times), 3, len(own_joints))), (True, False, False)
        table[:, 0] = q
        columns = list(range(len(own_joints)))
        notes.append(note)
    else:
        times, names, table, given = _samples(bag, chosen)
        columns = _order(bag.file, chosen, names, joints, own_joints)
        if not fits_names(names, joints):
            notes.append(f"joints {', '.join(names)} taken in their order")
    if _ends(chosen, ARM_SETPOINTS):
        notes.append("set-points, no measured positions")
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
    reached = np.asarray(np.isfinite(rows[:, 0]).all(axis=1))
    if not reached.all():
        notes.append(f"{int((~reached).sum())} of {len(rows)} poses out of reach left out")
    numbers = np.flatnonzero(reached) + 1
    return ArmMotion(
        bag.file, arm_of(chosen), joints, times[reached], rows[reached], recorded, numbers,
        notes=tuple(notes),
    )  # fmt: skip


def read_bag_tip(
    bag: Bag, arm: ArmDescription, topic: str | None, of: str | None
) -> tuple[str, Array, Array] | None:
    """Read the positions of an arm's tip from a bag that has poses in place of its joints.

    Args:
        bag, arm, topic, of: as for `read_bag_motion`

    Returns:
        name of the arm, times (k,) [s], positions (k, 3) [m]; None of an arm with joints

    Raises:
        LogError: as for `read_bag_motion`
    """
    chosen = _topic(bag, arm, topic, of, None)
    if bag.topics[chosen] not in POSES:
        return None
    times, tips = _tips(bag, chosen)
    return arm_of(chosen), times, tips[:, :3, 3]


def _ends(topic: str, names: Iterable[str]) -> bool:
    return any(f"/{topic}".endswith(f"/{name}") for name in names)


def _jaw_topic(bag: Bag, chosen: str, jaw: str | None) -> str | None:
    """Return the jaw's topic: the given one, or that beside the arm's."""
    if jaw is not None:
        if jaw.lstrip("/") not in bag.topics:
            known = ", ".join(f"/{t}" for t, kind in bag.topics.items() if kind == JOINT_STATE)
            raise LogError(bag.file, f"has no topic {jaw!r}; joint states are in: {known}")
        return jaw.lstrip("/")
    before = next((chosen[: -len(name)] for name in KNOWN if _ends(chosen, [name])), None)
    if before is None:
        return None
    names = (*END_STATES["jaw"], *END_SETPOINTS["jaw"])
    return next((before + name for name in names if before + name in bag.topics), None)


def _topic(
    bag: Bag,
    arm: ArmDescription,
    topic: str | None,
    of: str | None,
    base: Array | Literal["centred"] | None,
) -> str:
    """Return the topic to read, without a leading slash."""
    found = [name for names in arm_topics(bag).values() for name in names]
    known = ", ".join(f"/{name}" for name in found) or "none"
    if topic is not None:
        if topic.lstrip("/") not in bag.topics:
            raise LogError(bag.file, f"has no topic {topic!r}; joint states are in: {known}")
        return topic.lstrip("/")
    if not found:
        others = [f"/{t}" for t, kind in bag.topics.items() if kind in (JOINT_STATE, *POSES)]
        raise LogError(
            bag.file,
            f"contains no joint states of a {arm.type}; allowed: a topic /{arm.type}.../measured_js"
            f" or /{arm.type}.../measured_cp"
            + (f", or one of {', '.join(others)} with --topic" if others else ""),
        )
    suj = [name for name in found if name.upper().split("/")[-3:-2] == ["SUJ"]]
    found = [name for name in found if name not in suj] or found
    if of is not None:
        label = choose_arm(bag.file, map(arm_of, found), arm.name, arm.type, of)
        found = [name for name in found if arm_of(name) == label]
    fitting = [name for name in found if arm_of(name).upper().startswith(arm.type)]
    named = [name for name in fitting if arm_of(name).lower() == arm.name]
    # a given base is in the frame of `measured_cp`
    order = (*TIP_POSES, *LOCAL_POSES) if isinstance(base, np.ndarray) else KNOWN
    order = (*ARM_STATES, *ARM_SETPOINTS, *order)
    for names in (named, fitting, found if of is not None else []):
        if len({arm_of(name).lower() for name in names}) == 1:
            # one arm under names of several versions: the newest
            ranks = [next(k for k, name in enumerate(order) if _ends(n, [name])) for n in names]
            newest = [n for n, rank in zip(names, ranks, strict=True) if rank == min(ranks)]
            if len(newest) == 1:
                return newest[0]
    labels = ", ".join(dict.fromkeys(map(arm_of, fitting)))
    choice = f"--of ({labels}) or --topic" if labels else "--topic"
    listed = ", ".join(f"/{name}" for name in fitting) or known
    raise LogError(
        bag.file, f"{len(fitting)} topics fit a {arm.type}; select one with {choice}: {listed}"
    )  # fmt: skip


def _tips(bag: Bag, topic: str) -> tuple[Array, Array]:
    """Read a topic of poses to its end: times (k,) [s], poses (k, 4, 4)."""
    times: list[float] = []
    poses: list[Array] = []
    for message in bag.poses([topic]):
        times.append(message.stamp)
        place = f"/{topic}, message {len(times)}"
        poses.append(pose_from_numbers(bag.file, place, message.pose[:3], message.pose[3:]))
    if len(times) < 2:
        raise LogError(bag.file, f"/{topic}: got {len(times)} samples; allowed: 2 or more")
    return np.array(times), np.array(poses)


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
