"""Overlays: a calibrated robot's own geometry, laid over the description of its kind."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.calibration_plan import hinge_side
from trocar.descriptions.overlay_file import (
    overlay_text,
    parse_overlay,
    read_overlay,
    write_overlay,
)
from trocar.descriptions.overlay_records import ClosurePatch, FramePatch, Overlay
from trocar.descriptions.pins import PIN_ROTOR_KG, pin_body, pin_frame, pin_name, pinned
from trocar.descriptions.records import ArmDescription
from trocar.descriptions.warp import calibrated_bodies
from trocar.errors import DescriptionError, InputError, LoopError, UnknownNameError
from trocar.geometry.rotations import matrix_from_rpy, rpy_from_matrix
from trocar.geometry.se3 import transform
from trocar.kinematics.forward import coordinates
from trocar.kinematics.loops import (
    PARALLELOGRAM_TOLERANCE_M,
    coupled_coordinates,
    gaps,
    loops_are_parallelograms,
)
from trocar.kinematics.mechanism import Closure, Frame, Mechanism

__all__ = [
    "ClosurePatch",
    "FramePatch",
    "Overlay",
    "apply_overlay",
    "closure_patch",
    "frame_patch",
    "overlay_between",
    "overlay_text",
    "parse_overlay",
    "patched_frame",
    "read_overlay",
    "write_overlay",
]

Array = NDArray[np.float64]

#: Joint positions at which the loops must close, spread over the range of each joint.
SAMPLES = 33


def frame_patch(frame: Frame) -> FramePatch:
    """Return the patch that leaves a frame where it is, to rounding."""
    return FramePatch(frame.before[:3, 3].copy(), rpy_from_matrix(frame.before[:3, :3]))


def closure_patch(
    closure: Closure, slides: bool = False, mechanism: Mechanism | None = None
) -> ClosurePatch:
    """Return the patch that leaves a closing hinge where it is.

    Args:
        closure: the hinge
        slides: whether its pin shall slide
        mechanism: what it is of; needed where its pin slides already, as of a calibrated arm

    Raises:
        InputError: its pin slides already, and the mechanism is not given
    """
    if mechanism is None:
        if closure.frame_b == pin_name(closure.name):
            raise InputError(f"{closure.name}: its pin slides already; give its mechanism as well")
        return ClosurePatch(closure.point_a.copy(), closure.point_b.copy(), slides=slides)
    _, pin = hinge_side(mechanism, closure)
    point_b = mechanism.frame(pin).before[:3, 3] if pin else closure.point_b
    return ClosurePatch(closure.point_a.copy(), point_b.copy(), slides=slides or bool(pin))


def patched_frame(frame: Frame, patch: FramePatch) -> Frame:
    """Return a frame that stands where a patch has it."""
    return replace(frame, before=transform(matrix_from_rpy(*patch.rpy), patch.xyz))


def overlay_between(nominal: ArmDescription, robot: ArmDescription) -> Overlay:
    """Return the overlay that makes a robot of its nominal description, to rounding.

    Args:
        nominal: the description
        robot: the same with frames and closing hinges elsewhere, such as one changed in Python
    """
    pins = {hinge_side(robot.mechanism, closure)[1] for closure in robot.mechanism.closures}
    frames = {
        frame.name: frame_patch(frame)
        for frame in robot.mechanism.frames
        if frame.name not in pins
        and not np.array_equal(frame.before, nominal.mechanism.frame(frame.name).before)
    }
    before = {
        c.name: closure_patch(c, False, nominal.mechanism) for c in nominal.mechanism.closures
    }
    after = {c.name: closure_patch(c, False, robot.mechanism) for c in robot.mechanism.closures}
    closures = {name: patch for name, patch in after.items() if _differ(patch, before[name])}
    kind = "parallelogram" if loops_are_parallelograms(robot.mechanism) else "general"
    return Overlay(nominal.name, kind, frames, closures)


def _differ(one: ClosurePatch, other: ClosurePatch) -> bool:
    return one.slides != other.slides or not (
        np.array_equal(one.point_a, other.point_a) and np.array_equal(one.point_b, other.point_b)
    )


def apply_overlay(arm: ArmDescription, overlay: Overlay) -> ArmDescription:
    """Return the calibrated robot; the description that it is laid over stays as it is.

    Raises:
        InputError: the overlay is for another arm, names what the arm does not have or a frame of
            its tool, or holds numbers that are not finite
        DescriptionError: its loops do not close over the joints' range
    """
    where = overlay.file or "overlay"
    if overlay.arm != arm.name:
        raise InputError(
            f"{where}: is a calibration of {overlay.arm!r}; it cannot be laid over {arm.name!r}"
        )
    if arm.overlay is not None:
        raise InputError(f"{where}: {arm.name} carries the calibration {arm.overlay.file} already")
    _check_numbers(overlay, where)
    mechanism = arm.mechanism
    _check_frames(arm, overlay, where)
    _check_known("closure", overlay.closures, [c.name for c in mechanism.closures], where)
    if not overlay.frames and not overlay.closures:
        return replace(arm, overlay=overlay)
    frames = {
        f.name: patched_frame(f, overlay.frames[f.name]) if f.name in overlay.frames else f
        for f in mechanism.frames
    }
    closures: list[Closure] = []
    pins: list[str] = []
    for closure in mechanism.closures:
        patch = overlay.closures.get(closure.name)
        if patch is None:
            closures.append(closure)
            continue
        side, pin = hinge_side(mechanism, closure)
        moved = replace(closure, frame_b=side, point_a=patch.point_a, point_b=patch.point_b)
        if patch.slides or pin:
            new = pin_frame(moved, frames)
            frames[new.name] = new
            pins += [] if pin else [closure.name]
            moved = pinned(moved)
        closures.append(moved)
    changed = replace(mechanism, frames=tuple(frames.values()), closures=tuple(closures))
    _check_closed(changed, overlay, where)
    return replace(
        arm,
        mechanism=changed,
        bodies=(
            *calibrated_bodies(arm, changed, overlay.file),
            *(pin_body(name, arm.name) for name in pins),
        ),
        rotor={**arm.rotor, **{pin_name(name): PIN_ROTOR_KG for name in pins}},
        overlay=overlay,
    )


def _check_frames(arm: ArmDescription, overlay: Overlay, where: str) -> None:
    """Refuse frames that the arm does not have by itself: tools are exchanged, and not measured."""
    mechanism = arm.mechanism
    tools: set[str] = set()
    if arm.tool:
        base = mechanism.frame_index[arm.tool_frame]
        tools = {f.name for f in mechanism.frames if base in mechanism.chain(f.name)[:-1]}
    own = [name for name in mechanism.frame_names if name not in tools]
    for name in overlay.frames:
        if name in tools:
            raise InputError(
                f"{where}: frames.{name}: is a frame of the tool {arm.tool}, which may be"
                f" exchanged; allowed: the arm's own, {', '.join(own)}"
            )
    _check_known("frame", overlay.frames, own, where)


def _check_known(kind: str, got: Iterable[str], known: Iterable[str], where: str) -> None:
    names = tuple(known)
    for name in got:
        if name not in names:
            raise UnknownNameError(kind, name, names, where)


def _check_numbers(overlay: Overlay, where: str) -> None:
    """Refuse what did not come from a file, where it would have been looked at."""
    for name, patch in (*overlay.frames.items(), *overlay.closures.items()):
        for key, value in vars(patch).items():
            if value is None or isinstance(value, bool):
                continue
            if np.shape(value) != (3,) or not np.isfinite(value).all():
                raise InputError(
                    f"{where}: {name}.{key}: got {np.asarray(value).tolist()}; allowed: 3 finite"
                    " numbers"
                )


def _check_closed(mechanism: Mechanism, overlay: Overlay, where: str) -> None:
    """Refuse loops that do not close as the overlay says they do, over the joints' range."""
    share = np.linspace(0.0, 1.0, SAMPLES)[:, None]
    q = mechanism.lower + share * (mechanism.upper - mechanism.lower)
    if overlay.closure == "parallelogram" and not loops_are_parallelograms(mechanism):
        gape = gaps(mechanism, coupled_coordinates(mechanism, q)).max(axis=0)
        worst = int(np.argmax(gape))
        raise DescriptionError(
            where,
            f"closures.{mechanism.closures[worst].name}",
            f"the loop is no parallelogram: it gapes by {gape[worst]:.3g} m over the joints' range;"
            f' allowed: {PARALLELOGRAM_TOLERANCE_M:.0e} m, or closure = "general"',
        )
    try:
        coordinates(mechanism, q)
    except LoopError as problem:
        raise DescriptionError(where, "closures", str(problem)) from problem
