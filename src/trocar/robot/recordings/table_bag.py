"""A table of numbers as a bag of joint states, which a mirror plays."""

from __future__ import annotations

import heapq
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import replace
from pathlib import Path

from trocar.descriptions import ArmDescription
from trocar.errors import LogError, TrocarError
from trocar.recording.bags import (
    JOINT_STATE,
    Bag,
    ImageMessage,
    JointMessage,
    Packed,
    PoseMessage,
)
from trocar.robot.recordings.arm_motion import ArmMotion
from trocar.robot.recordings.columns import choose_arm
from trocar.robot.recordings.read import ReadSettings, arms_in, read_arm_motion


def arm_motions(
    path: str | Path, arms: Mapping[str, ArmDescription], how: ReadSettings | None = None
) -> dict[str, ArmMotion]:
    """Read the motion of every arm of a file, {name: motion}, by the arms' names in it.

    Args:
        path: a bag, a text file or a dataset
        arms: {name: description} of the arms that may be in it
        how: how to read it; `of` is found by the names

    Raises:
        LogError, InputError: as for `read_arm_motion`, or none of the arms is in it
    """
    how = how or ReadSettings()
    found: dict[str, ArmMotion] = {}
    failure: TrocarError | None = None
    used: set[str | None] = set()
    for name, arm in arms.items():
        labels = arms_in(path, arm, how) or [""]
        named = [label for label in labels if label.upper() in {one.upper() for one in arms}]
        try:
            of = choose_arm(str(path), named or labels, name, arm.type, name if named else None)
            if of in used:
                continue
            found[name] = read_arm_motion(path, arm, replace(how, of=of or None))
            used.add(of)
        except TrocarError as problem:
            failure = failure or problem
    if not found:
        raise failure or LogError(str(path), f"holds none of the arms {', '.join(arms)}")
    return found


def bag_of_table(
    path: str | Path,
    arms: Mapping[str, ArmDescription],
    rate_hz: float | None = None,
    watch: Callable[[str], None] = lambda _: None,
) -> Bag:
    """Read a table's arms as joint states in topics /ARM/measured_js.

    Args:
        path: a text file or a Parquet file
        arms: {name: description} of the arms that may be in it
        rate_hz: of rows without times [Hz]
        watch: called with what was understood of each arm

    Raises:
        LogError, InputError: as for `arm_motions`
    """
    found = arm_motions(path, arms, ReadSettings(rate_hz=rate_hz))
    for motion in found.values():
        watch(motion.understood())

    def messages(wanted: Collection[str]) -> Iterator[JointMessage]:
        streams = (_messages(name, one) for name, one in found.items() if topic(name) in wanted)
        yield from heapq.merge(*streams, key=lambda message: message.time)

    def topic(name: str) -> str:
        return f"{name}/measured_js"

    def poses(_wanted: Collection[str]) -> Iterator[PoseMessage]:
        return iter(())

    def images(_wanted: Collection[str]) -> Iterator[ImageMessage]:
        return iter(())

    def raw(_wanted: Collection[str]) -> Iterator[Packed]:
        return iter(())

    topics = {topic(name): JOINT_STATE for name in found}
    return Bag(str(path), topics, messages, poses, images, raw)


def _messages(name: str, motion: ArmMotion) -> Iterator[JointMessage]:
    """Yield the samples of an arm; a jaw that was not recorded is left out."""
    kept = [k for k, joint in enumerate(motion.joints) if joint in motion.recorded[0]]
    names = [motion.joints[k] for k in kept]
    for time, rows in zip(motion.times.tolist(), motion.rows, strict=True):
        q, qd, effort = rows[:, kept]
        fields = {"stamp": time, "name": names, "position": q, "velocity": qd, "effort": effort}
        yield JointMessage(f"{name}/measured_js", time, fields)
