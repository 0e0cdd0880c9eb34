"""Overlays: a calibrated robot's own geometry, laid over the description of its kind."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trocar.cameras.records import Intrinsics, StereoCalibration
from trocar.descriptions.calibration_plan import hinge_side
from trocar.descriptions.cameras import read_eye
from trocar.descriptions.dynamics import apply_dynamics, dynamics_document, read_dynamics
from trocar.descriptions.frames import (
    PIN_ROTOR_KG,
    pin_body,
    pin_frame,
    pin_name,
    pinned,
    read_pose,
)
from trocar.descriptions.overlay_records import (
    CameraPatch,
    ClosurePatch,
    FramePatch,
    Overlay,
)
from trocar.descriptions.records import ArmDescription, Body, Shape
from trocar.descriptions.solids import read_solid, seen_and_touched
from trocar.descriptions.table import SCHEMA, Table, parse_table, read_table, toml_text
from trocar.errors import DescriptionError, InputError, LoopError, UnknownNameError
from trocar.geometry.rotations import matrix_from_rpy, rpy_from_matrix
from trocar.geometry.se3 import inverse, transform
from trocar.kinematics.forward import coordinates
from trocar.kinematics.loops import (
    PARALLELOGRAM_TOLERANCE_M,
    coupled_coordinates,
    gaps,
    loops_are_parallelograms,
)
from trocar.kinematics.mechanism import Closure, Frame, Mechanism
from trocar.outputs import whole_file

__all__ = [
    "CameraPatch",
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
    if overlay.camera is not None and arm.type != "ECM":
        raise InputError(f"{where}: camera: {arm.name} is of type {arm.type}; allowed: an ECM")
    if overlay.frames or overlay.closures:
        arm = _moved(arm, overlay, where)
    if overlay.dynamics is not None:
        arm = apply_dynamics(arm, overlay.dynamics, where)
    return replace(arm, overlay=overlay)


def _moved(arm: ArmDescription, overlay: Overlay, where: str) -> ArmDescription:
    """Return an arm with frames and closing hinges where an overlay has them."""
    mechanism = arm.mechanism
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
    )


def _check_frames(arm: ArmDescription, overlay: Overlay, where: str) -> None:
    """Reject frames that the arm does not have by itself: tools are exchanged, and not measured."""
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
    """Reject what did not come from a file, where it would have been looked at."""
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
    """Reject loops that do not close as the overlay says they do, over the joints' range."""
    share = np.linspace(0.0, 1.0, SAMPLES)[:, None]
    q = mechanism.lower + share * (mechanism.upper - mechanism.lower)
    if overlay.closure == "parallelogram" and not loops_are_parallelograms(mechanism):
        error = gaps(mechanism, coupled_coordinates(mechanism, q)).max(axis=0)
        worst = int(np.argmax(error))
        raise DescriptionError(
            where,
            f"closures.{mechanism.closures[worst].name}",
            f"the loop is no parallelogram: its error is {error[worst]:.3g} m over the joints'"
            f' range; allowed: {PARALLELOGRAM_TOLERANCE_M:.0e} m, or closure = "general"',
        )
    try:
        coordinates(mechanism, q)
    except LoopError as problem:
        raise DescriptionError(where, "closures", str(problem)) from problem


HEADER = """\
# A calibrated robot's own geometry, laid over the description of its kind:
#   trocar sim --calibration THIS_FILE (geometry), trocar sim --dynamics THIS_FILE (dynamics)
# Lengths in metres, angles in radians; *_sigma_* are standard deviations. xyz and rpy place a
# frame (of a hinge: its axis) in its parent at coordinate 0; rpy turns about the parent's fixed
# axes x, y, z, rpy_sigma is of small turns about its own. point_a and point_b are a closing hinge
# on its two frames. bodies: mass distributions; inertia_* is xx, yy, zz, xy, xz, yz about the
# centre of mass. drivetrains: forces along combinations of joints (docs/dynamics.md). camera: the
# middle of both eyes in the ECM's tip frame (x right, y down, z ahead). bases: where other arms'
# remote centres stand in this arm's frame.
"""


def read_overlay(path: str | Path) -> Overlay:
    """Read an overlay.

    Raises:
        DescriptionError: naming file, key, what was got and what is allowed
    """
    return _read(read_table(Path(path).expanduser()))


def parse_overlay(text: str, file: str) -> Overlay:
    """Read an overlay from its text; `file` is what messages call it.

    Raises:
        DescriptionError: as for `read_overlay`
    """
    return _read(parse_table(text, file))


def write_overlay(path: str | Path, overlay: Overlay, *, overwrite: bool = False) -> None:
    """Write an overlay, whole or not at all.

    Args:
        path: a new file
        overlay: what to write
        overwrite: replace a file that exists

    Raises:
        InputError: numbers that are not finite, or a file that exists or cannot be written
        TrocarError: the disk is full
    """
    text = overlay_text(overlay)
    with whole_file(path, overwrite) as part:
        part.write_text(text, encoding="utf-8", newline="\n")


def overlay_text(overlay: Overlay) -> str:
    """Return an overlay as the text of its file; numbers come back to the last bit.

    Raises:
        InputError: numbers that are not finite
    """
    frames = {name: _placed(patch) for name, patch in overlay.frames.items()}
    closures = {
        name: {
            "point_a_m": hinge.point_a,
            "point_a_sigma_m": hinge.point_a_sigma,
            "point_b_m": hinge.point_b,
            "point_b_sigma_m": hinge.point_b_sigma,
            "slides": hinge.slides,
        }
        for name, hinge in overlay.closures.items()
    }
    document = {
        "schema": SCHEMA,
        "arm": overlay.arm,
        "closure": overlay.closure,
        "warnings": overlay.warnings or None,
        "source": overlay.source or None,
        "frames": frames or None,
        "closures": closures or None,
        "camera": None if overlay.camera is None else _camera(overlay.camera),
        "bases": {name: _placed(patch) for name, patch in overlay.bases.items()} or None,
        "measured": overlay.measured or None,
        **({} if overlay.dynamics is None else dynamics_document(overlay.dynamics)),
    }
    return f"{HEADER}\n{toml_text(document)}"


def _placed(patch: FramePatch) -> dict[str, Any]:
    return {
        "xyz_m": patch.xyz,
        "xyz_sigma_m": patch.xyz_sigma,
        "rpy_rad": patch.rpy,
        "rpy_sigma_rad": patch.rpy_sigma,
    }


def _camera(camera: CameraPatch) -> dict[str, Any]:
    left, right = (_eye(eye) for eye in camera.calibration.eyes)
    T = camera.calibration.T_left_right
    return {
        **_placed(camera.place),
        "left": left,
        "right": {**right, "xyz_m": T[:3, 3], "rotation": T[:3, :3].tolist()},
    }


def _eye(eye: Intrinsics) -> dict[str, Any]:
    return {
        "size_px": list(eye.size),
        "focal_px": [eye.K[0, 0], eye.K[1, 1]],
        "principal_px": eye.K[:2, 2],
        "distortion": eye.distortion,
    }


def _read(table: Table) -> Overlay:
    table.check_schema(", of a calibration's overlay")
    head = table.record(Overlay, file=table.file)
    source = table.optional_table("source")
    about = {key: source.text(key) for key in source.entries()}
    frames = table.named("frames", _read_frame)
    closures = table.named("closures", _read_closure)
    measured = table.raw("measured", {})
    if not isinstance(measured, dict):
        raise table.fail("measured", f"got {measured!r}; allowed: a table")
    found = replace(
        head,
        frames=frames,
        closures=closures,
        measured=measured,
        source=about,
        dynamics=read_dynamics(table),
        camera=_read_camera(table.table("camera")) if "camera" in table else None,
        bases=table.named("bases", _read_frame),
    )
    table.done()
    return found


def _read_camera(table: Table) -> CameraPatch:
    left, right = table.table("left"), table.table("right")
    eyes = read_eye(left), read_eye(right)
    T = read_pose(right)
    left.done()
    right.done()
    try:
        calibration = StereoCalibration(*eyes, T, "calibrated", table.file)
    except InputError as problem:
        raise table.fail("right", str(problem)) from problem
    place = _read_frame(table)
    table.done()
    return CameraPatch(place, calibration)


def _read_frame(row: Table) -> FramePatch:
    return row.record(FramePatch)


def _read_closure(row: Table) -> ClosurePatch:
    return row.record(ClosurePatch)


#: Weight of an axis is its distance to the power of minus this. Source: our own choice: the bosses
#: around an axis move with it as one piece, and the middle of a rod shares its ends' ways.
POWER = 3.0
#: Corners of a box of half edges 1.
CORNERS = np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])
#: Nearer than this a point lies on the axis; axes that moved less have not moved. [m]
NEAR = 1e-9


@dataclass(frozen=True, eq=False)
class CarriedAxis:
    """An axis of a link, as drawn and as calibrated: points (3,) [m] and directions (3,)."""

    point: Array
    along: Array
    point_now: Array
    along_now: Array

    @property
    def moved(self) -> bool:
        """Whether it stands elsewhere now."""
        away = np.abs(self.point_now - self.point).max()
        return bool(max(away, np.abs(self.along_now - self.along).max()) > NEAR)


def calibrated_bodies(arm: ArmDescription, now: Mechanism, overlay: str) -> tuple[Body, ...]:
    """Return an arm's bodies with the shapes of the calibrated robot.

    Args:
        arm: the nominal arm
        now: its mechanism as calibrated
        overlay: the overlay's file; a folder `NAME.solids` beside `NAME.toml` holds what `trocar
            cad --calibration` has drawn for this robot
    """
    folder = Path(overlay).with_suffix(".solids") if overlay else None
    axes = carried_axes(arm.mechanism, now, {body.frame for body in arm.bodies})
    return tuple(_calibrated(body, axes.get(body.frame, ()), folder) for body in arm.bodies)


def _calibrated(body: Body, axes: tuple[CarriedAxis, ...], folder: Path | None) -> Body:
    if folder is not None and body.solid and folder.is_dir():
        try:
            solid = read_solid(body.solid, folder)
        except KeyError:
            pass  # of another arm or of a tool
        else:
            nominal = len(seen_and_touched(read_solid(body.solid), body.touches))
            drawn = seen_and_touched(solid, body.touches)
            return replace(body, shapes=(*drawn, *body.shapes[nominal:]))
    if not any(axis.moved for axis in axes):
        return body
    return replace(body, shapes=tuple(_warped(shape, axes) for shape in body.shapes))


def _warped(shape: Shape, axes: tuple[CarriedAxis, ...]) -> Shape:
    """Return a shape whose mesh, or box that is only touched, has moved with the axes."""
    turn, at = shape.pose[:3, :3], shape.pose[:3, 3]
    if shape.kind == "box" and not shape.visible:
        corners = shape.size * CORNERS
        moved = (warp(corners @ turn.T + at, axes) - at) @ turn
        lower, upper = moved.min(axis=0), moved.max(axis=0)
        place = shape.pose @ transform(np.eye(3), 0.5 * (lower + upper))
        return replace(shape, pose=place, size=0.5 * (upper - lower))
    if shape.mesh is None:
        return shape
    moved = warp(shape.mesh.vertices @ turn.T + at, axes)
    vertices = (moved - at) @ turn
    mark = hashlib.sha256(np.round(vertices, 9).tobytes()).hexdigest()[:8]
    mesh = replace(shape.mesh, vertices=vertices, name=f"{shape.mesh.name}_{mark}")
    return replace(shape, mesh=mesh, size=np.abs(vertices).max(axis=0))


def warp(points: Array, axes: tuple[CarriedAxis, ...]) -> Array:
    """Return the positions of points of a link after its axes have moved, (n, 3) [m]."""
    ways, weights = np.zeros((len(axes), *points.shape)), np.zeros((len(axes), len(points)))
    for k, axis in enumerate(axes):
        height = (points - axis.point) @ axis.along
        foot = axis.point + height[:, None] * axis.along
        ways[k] = axis.point_now + height[:, None] * axis.along_now - foot
        away = np.linalg.norm(points - foot, axis=1)
        weights[k] = np.maximum(away, NEAR) ** -POWER
    share = weights / weights.sum(axis=0)
    return points + np.einsum("kn,kni->ni", share, ways)


def carried_axes(
    before: Mechanism, now: Mechanism, bodied: set[str]
) -> Mapping[str, tuple[CarriedAxis, ...]]:
    """Return the axes that each link carries, in the link's frame, {frame: axes}.

    Args:
        before: the nominal mechanism
        now: as calibrated; frames that are new in it, such as pins, are left out
        bodied: frames with a body, which are links though they may stand still
    """
    first, then = _in_links(before, bodied), _in_links(now, bodied)
    found: dict[str, list[CarriedAxis]] = {}
    for frame in before.frames:
        if frame.motion == "fixed" or frame.name not in then:
            continue
        link, pose = first[frame.name]
        found.setdefault(link, []).append(_axis(pose, then[frame.name][1]))
        own = inverse(frame.after)
        found.setdefault(frame.name, []).append(_axis(own, own))
    after = {closure.name: closure for closure in now.closures}
    for closure in before.closures:
        other = after[closure.name]
        side = hinge_side(before, closure)[0]
        # The far side of a pin that slides is where the pin stands, which is the pin's own frame.
        point_b = other.point_b
        if hinge_side(now, other)[1] and not hinge_side(before, closure)[1]:
            point_b = now.frame(other.frame_b).before[:3, 3]
        for link, point, moved in (
            (closure.frame_a, closure.point_a, other.point_a),
            (side, closure.point_b, point_b),
        ):
            upright = np.array([0.0, 0.0, 1.0])
            found.setdefault(link, []).append(CarriedAxis(point, upright, moved, upright))
    return {link: tuple(axes) for link, axes in found.items()}


def _axis(pose: Array, now: Array) -> CarriedAxis:
    return CarriedAxis(pose[:3, 3], pose[:3, 2], now[:3, 3], now[:3, 2])


def _in_links(mechanism: Mechanism, bodied: set[str]) -> dict[str, tuple[str, Array]]:
    """Return the link that carries each frame's axis, and the axis' pose in it: {frame: ...}."""
    at: dict[str, tuple[str, Array]] = {}
    stands: dict[str, tuple[str, Array]] = {}
    for frame in mechanism.frames:
        link, pose = (frame.name, np.eye(4)) if frame.parent is None else stands[frame.parent]
        at[frame.name] = link, pose @ frame.before
        still = frame.parent is not None and frame.motion == "fixed" and frame.name not in bodied
        placed = pose @ frame.before @ frame.after
        stands[frame.name] = (link, placed) if still else (frame.name, np.eye(4))
    return at
