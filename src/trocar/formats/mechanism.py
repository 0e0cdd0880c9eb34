"""A model that was read, as a mechanism: frames, couplings and closures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import zip_longest

import numpy as np
from numpy.typing import NDArray

from trocar.formats.links import (
    ImportFileError,
    LinkLoop,
    SourceJoint,
    SourceModel,
    joints_above,
)
from trocar.geometry.se3 import inverse, transform
from trocar.kinematics.loops import residual_jacobian, residuals
from trocar.kinematics.mechanism import Closure, Frame, Joint, Mechanism

Array = NDArray[np.float64]

#: Limit, both ways, of a revolute [rad] or prismatic joint [m] without limits. Source: our own
#: choice.
ENDLESS = {"revolute": 2.0 * np.pi, "prismatic": 10.0}
#: Largest loop error where the file's coordinates are 0 [m]. Source: our own choice, for files with
#: six decimals.
GAP_M = 1e-5
#: Largest deviation of a ratio from a whole number to which it is rounded. Source: our own choice.
WHOLE = 1e-6


@dataclass(frozen=True, eq=False)
class MechanismLayout:
    """The mechanism of a model.

    Attributes:
        mechanism: joints, frames and closures
        carrier: {link: (frame that its bodies move with, T_frame_link (4, 4))}
        sources: {public joint: the file's}
        warnings: parts of the file that were changed
    """

    mechanism: Mechanism
    carrier: Mapping[str, tuple[str, Array]]
    sources: Mapping[str, SourceJoint]
    warnings: tuple[str, ...]


def lay_out(model: SourceModel, passive: Sequence[str] = ()) -> MechanismLayout:
    """Return the mechanism of a model.

    Args:
        model: links, joints and loops
        passive: joints that loops determine; (): chosen

    Raises:
        ImportFileError: an open loop, a loop without two passive joints, or no independent joint
    """
    warnings: list[str] = []
    joints = [_limited(joint, warnings) for joint in model.joints]
    in_loops = _passive(model, joints, passive)
    held = {name for pair in in_loops.values() for name in pair}
    moving = [j for j in joints if j.kind != "fixed"]
    free = [j for j in moving if j.name not in held and j.follows is None]
    if not free:
        raise ImportFileError(model.file, "no independent joint; import it as a prop (--as prop)")
    by_name = {joint.name: joint for joint in moving}
    frames: list[Frame] = [Frame(model.links[0].name, None, "fixed", np.eye(4), np.eye(4))]
    carrier = {model.links[0].name: (model.links[0].name, np.eye(4))}
    hinge: dict[str, str] = {}
    for joint in joints:
        couplings, offset = _coupling(joint, by_name, held)
        made, at = _frames(joint, couplings, offset)
        frames += made
        carrier[joint.child] = (made[0].name, at)
        hinge[joint.name] = made[0].name
    public = [
        Joint(j.name, j.kind, j.lower, j.upper, ((hinge[j.name], 1.0),))  # type: ignore[arg-type]
        for j in free
    ]
    closures = [
        _closure(loop, carrier, tuple(hinge[name] for name in in_loops[loop.name]))
        for loop in model.loops
    ]
    root = model.links[0].name
    tip = _tip(frames)
    mechanism = Mechanism(model.name, tuple(public), tuple(frames), tuple(closures), root, tip)
    mechanism = _with_loop_ratios(model.file, mechanism)
    sources = {joint.name: joint for joint in free}
    return MechanismLayout(mechanism, carrier, sources, tuple(warnings))


def _limited(joint: SourceJoint, warnings: list[str]) -> SourceJoint:
    """Return a joint with finite limits, or a fixed one where they leave no room."""
    if joint.kind == "fixed":
        return joint
    end = ENDLESS[joint.kind]
    lower = joint.lower if np.isfinite(joint.lower) else -end
    upper = joint.upper if np.isfinite(joint.upper) else end
    if lower < upper:
        return replace(joint, lower=lower, upper=upper)
    warnings.append(
        f"joint {joint.name}: limits {lower:g} to {upper:g} leave no range; joint fixed"
    )
    still = joint.pose @ joint.motion(lower)
    return replace(joint, kind="fixed", pose=still, follows=None)


def _frames(
    joint: SourceJoint, couplings: tuple[tuple[str, float], ...], offset: float
) -> tuple[list[Frame], Array]:
    """Return the frames of a joint's child, the moving one first, and T_moving_child."""
    if joint.kind == "fixed":
        made = Frame(joint.child, joint.parent, "fixed", joint.pose, np.eye(4))
        return [made], np.eye(4)
    pose = joint.pose @ joint.motion(offset) if offset else joint.pose
    aligned = np.array_equal(joint.axis, [0.0, 0.0, 1.0])
    at_origin = joint.kind == "prismatic" or not joint.point.any()
    if aligned and at_origin:
        return [Frame(joint.child, joint.parent, joint.kind, pose, np.eye(4), couplings)], np.eye(4)
    axis = transform(_rotation_to(joint.axis), joint.point)
    name = f"{joint.child}_hinge"
    back = inverse(axis)
    return [
        Frame(name, joint.parent, joint.kind, pose @ axis, np.eye(4), couplings),
        Frame(joint.child, name, "fixed", back, np.eye(4)),
    ], back


def _coupling(
    joint: SourceJoint, by_name: Mapping[str, SourceJoint], held: set[str]
) -> tuple[tuple[tuple[str, float], ...], float]:
    """Return a joint's couplings and offset; those of passive joints follow from the loops."""
    if joint.kind == "fixed" or joint.name in held:
        return (), 0.0
    ratio, offset, name = 1.0, 0.0, joint.name
    while (lead := by_name[name].follows) is not None and lead[0] in by_name:
        offset += ratio * lead[2]
        ratio *= lead[1]
        name = lead[0]
    return ((name, ratio),), offset


def _passive(
    model: SourceModel, joints: Sequence[SourceJoint], named: Sequence[str]
) -> dict[str, tuple[str, str]]:
    """Return two passive joints per loop, those nearest to its closure without a motor."""
    known = [joint.name for joint in joints if joint.kind != "fixed"]
    for name in named:
        if name not in known:
            raise ImportFileError(
                model.file, f"got the passive joint {name!r}; known: {', '.join(known)}"
            )
    found: dict[str, tuple[str, str]] = {}
    taken: set[str] = set()
    for loop in model.loops:
        sides = [joints_above(joints, link) for link in (loop.link_a, loop.link_b)]
        shared = {joint.name for joint in sides[0]} & {joint.name for joint in sides[1]}
        ring = [j for pair in zip_longest(*sides) for j in pair if j and j.name not in shared]
        free = [j for j in ring if j.kind != "fixed" and j.name not in taken]
        undriven = [j for j in free if not j.driven or j.follows]
        chosen = [j for j in free if j.name in named] or (undriven if len(undriven) >= 2 else free)
        if len(chosen) < 2:
            raise ImportFileError(
                model.file,
                f"loop {loop.name!r} has {len(chosen)} passive joints; allowed: two"
                " (--passive names them)",
            )
        found[loop.name] = (chosen[0].name, chosen[1].name)
        taken |= set(found[loop.name])
    return found


def _closure(
    loop: LinkLoop, carrier: Mapping[str, tuple[str, Array]], passive: tuple[str, ...]
) -> Closure:
    (frame_a, at_a), (frame_b, at_b) = carrier[loop.link_a], carrier[loop.link_b]
    return Closure(
        loop.name,
        frame_a,
        at_a[:3, :3] @ loop.point_a + at_a[:3, 3],
        frame_b,
        at_b[:3, :3] @ loop.point_b + at_b[:3, 3],
        passive,
    )


def _with_loop_ratios(file: str, mechanism: Mechanism) -> Mechanism:
    """Return the mechanism whose passive frames follow the joints as the loops make them, at 0."""
    if not mechanism.closures:
        return mechanism
    still = np.zeros(len(mechanism.frames))
    gap = np.linalg.norm(residuals(mechanism, still), axis=-1)
    for closure, open_by in zip(mechanism.closures, gap, strict=True):
        if open_by > GAP_M:
            raise ImportFileError(
                file,
                f"loop {closure.name!r} has a loop error of {open_by:.3g} m at zero coordinates;"
                f" allowed: {GAP_M:g} m",
            )
    slope = residual_jacobian(mechanism, still).reshape(-1, len(mechanism.frames))
    index = mechanism.frame_index
    passive = [index[name] for c in mechanism.closures for name in c.passive]
    given = slope @ mechanism.ratios
    ratios = -np.linalg.pinv(slope[:, passive], rcond=1e-9) @ given
    ratios = np.where(np.abs(ratios - np.round(ratios)) < WHOLE, np.round(ratios), ratios)
    names = mechanism.joint_names
    found = {
        mechanism.frames[k].name: tuple((n, float(r)) for n, r in zip(names, row, strict=True) if r)
        for k, row in zip(passive, ratios, strict=True)
    }
    frames = tuple(
        replace(f, couplings=found[f.name]) if f.name in found else f for f in mechanism.frames
    )
    for frame in frames:
        if frame.motion != "fixed" and not frame.couplings:
            raise ImportFileError(
                file,
                f"{frame.name!r} follows no joint at zero coordinates (dead point)",
            )
    return replace(mechanism, frames=frames)


def _tip(frames: Sequence[Frame]) -> str:
    """Return the frame with most moving frames between it and the root, the first of them."""
    depth: dict[str, int] = {}
    for frame in frames:
        before = depth[frame.parent] if frame.parent else 0
        depth[frame.name] = before + (frame.motion != "fixed")
    deepest = max(depth.values())
    return [name for name, d in depth.items() if d == deepest][-1]


def _rotation_to(direction: Array) -> Array:
    """Return a rotation whose z axis points along `direction`, (3, 3); exact along the axes."""
    z = direction / np.linalg.norm(direction)
    x = np.cross(np.eye(3)[int(np.argmin(np.abs(z)))], z)
    x /= np.linalg.norm(x)
    return np.column_stack([x, np.cross(z, x), z])
