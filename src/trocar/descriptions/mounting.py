"""Tools on the arms of a rig, and their exchange for others."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.catalogue import load_arm, load_tool, names
from trocar.descriptions.records import ArmDescription, RigDescription
from trocar.errors import InputError

Array = NDArray[np.float64]


def fitting_tools(arm: ArmDescription) -> tuple[str, ...]:
    """Return the built-in tools that an arm takes, none for an arm without a tool frame."""
    return _tools_of(arm.generation) if arm.tool_frame else ()


def with_tool(arm: ArmDescription, tool: str | Path) -> ArmDescription:
    """Return an arm, read again from its file, with another tool.

    Args:
        arm: an arm that takes tools
        tool: a built-in tool, the path of a TOML file, or "none" for a bare arm

    Raises:
        InputError: the arm takes no tools, the tool is made for another generation, or the arm
            is not what stands in its file
        UnknownNameError, DescriptionError: the tool
    """
    if not arm.tool_frame:
        raise InputError(
            f"{arm.name}: takes no tool; only arms with a tool_frame do (a PSM, not an {arm.type})"
        )
    if not Path(arm.file).is_file():
        raise InputError(
            f"{arm.name}: its file {arm.file!r} is gone; a tool is mounted on what stands there"
        )
    _check_as_in_file(arm)
    return load_arm(Path(arm.file), tool, arm.overlay)


def _check_as_in_file(arm: ArmDescription) -> None:
    """Reject an arm that was changed in Python: reading it again would take the change back."""
    bare = load_arm(Path(arm.file), "none", arm.overlay)
    changed = [
        frame.name
        for frame in bare.mechanism.frames
        if frame.name not in arm.mechanism.frame_index
        or not _same(frame, arm.mechanism.frame(frame.name))
    ]
    closures = {closure.name: closure for closure in arm.mechanism.closures}
    changed += [c.name for c in bare.mechanism.closures if not _same(c, closures.get(c.name))]
    changed += [j.name for j in bare.joints if j not in arm.joints]
    if changed:
        raise InputError(
            f"{arm.name}: {', '.join(dict.fromkeys(changed))} differs from {arm.file}; a tool is"
            " mounted on what stands there, so write the change into a file of your own first"
        )


def _same(one: object, other: object) -> bool:
    """Return whether two frozen records of numbers and arrays are equal."""
    if type(one) is not type(other):
        return False
    pairs = [(value, vars(other)[key]) for key, value in vars(one).items()]
    return all(np.array_equal(np.asarray(a, object), np.asarray(b, object)) for a, b in pairs)


def rig_with_tool(rig: RigDescription, name: str, tool: str | Path) -> RigDescription:
    """Return a rig whose arm `name` has another tool; its named poses stay inside the limits.

    Raises:
        UnknownNameError: no such arm or tool
        InputError, DescriptionError: as for `with_tool`; a sensor that would stand on nothing
    """
    old = rig.arm(name)
    try:
        new = replace(old, arm=with_tool(old.arm, tool))
    except InputError as problem:
        if type(problem) is InputError:
            raise InputError(f"{name}: {problem}") from problem
        raise
    _check_sensors(rig, name, new.arm)
    poses = {
        pose: {
            arm: carried_over(q, old.arm, new.arm) if arm == name else q
            for arm, q in by_arm.items()
        }
        for pose, by_arm in rig.poses.items()
    }
    arms = tuple(new if arm.name == name else arm for arm in rig.arms)
    return replace(rig, arms=arms, poses=poses)


def _check_sensors(rig: RigDescription, name: str, arm: ArmDescription) -> None:
    """Reject a tool that lacks what a sensor of the rig stands on."""
    for sensor in rig.sensors:
        lacking = set(sensor.frames) - set(arm.mechanism.frame_index)
        lacking |= set(sensor.joints) - set(arm.mechanism.joint_names)
        if sensor.arm == name and lacking:
            raise InputError(
                f"{name}: sensor {sensor.name!r} needs {', '.join(sorted(lacking))}, which"
                f" {arm.tool or 'the bare arm'} does not have"
            )


def carried_over(q: Array, old: ArmDescription, new: ArmDescription) -> Array:
    """Return joint positions of an arm with another tool: by name, clipped, 0 for new joints.

    Args:
        q: positions of the joints of `old`, (n_old,) [rad or m]

    Returns:
        (n_new,) [rad or m]
    """
    known: Mapping[str, float] = dict(zip(old.mechanism.joint_names, q.tolist(), strict=True))
    positions = np.array([known.get(joint, 0.0) for joint in new.mechanism.joint_names])
    return np.clip(positions, new.mechanism.lower, new.mechanism.upper)


def joints_without_tool(arm: ArmDescription) -> tuple[str, ...]:
    """Return the joints that an arm has without its tool."""
    mechanism = arm.mechanism
    if not arm.tool_frame:
        return mechanism.joint_names
    base = mechanism.frame_index[arm.tool_frame]
    return tuple(
        joint.name
        for joint in arm.joints
        if joint.drive[0][0] == arm.tool_frame or base not in mechanism.chain(joint.drive[0][0])
    )


@lru_cache
def _tools_of(generation: str) -> tuple[str, ...]:
    fits = {name: load_tool(name).fits for name in names("tools")}
    return tuple(name for name, those in fits.items() if not those or generation in those)
