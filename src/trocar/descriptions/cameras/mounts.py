"""Cameras of a rig from TOML: at the end of a scope, in the room, or on a link."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import cast, get_args

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions.cameras.files import Source, load_camera, load_stereo_camera
from trocar.descriptions.cameras.presets import read_eye
from trocar.descriptions.cameras.records import (
    Calibration,
    CameraDescription,
    CameraKind,
    MonoCalibration,
)
from trocar.descriptions.frames import read_pose
from trocar.descriptions.records import RigArm
from trocar.descriptions.table import Table
from trocar.errors import InputError
from trocar.geometry.rotations import rotation_x, rotation_z
from trocar.geometry.se3 import transform, translation
from trocar.kinematics.forward import pose

Array = NDArray[np.float64]

KINDS: tuple[str, ...] = get_args(CameraKind)
#: A view looks this way up: away from the patient's floor. Source: our own choice.
UP = np.array([0.0, 0.0, 1.0])
#: How far an endoscope may be bent. Source: the dVRK's are straight, or 30 deg up or down. [rad]
BENDS = (-np.pi / 6.0, 0.0, np.pi / 6.0)
#: The image of a scope (x right, y down, z ahead) against its last DH row: the row's y is to the
#: right of the picture, and its -x down. Source: SAW mtsIntuitiveResearchKitECM.cpp,
#: ToolOffsetTransformation, the rotation of an ECM's tip: x left, y up and z ahead.
R_ROW_IMAGE = rotation_z(np.pi / 2.0)


def read_cameras(rows: Iterable[Table], arms: Sequence[RigArm]) -> tuple[CameraDescription, ...]:
    """Return a rig's cameras.

    Raises:
        DescriptionError: an unknown kind, key, arm, frame or preset, a name used twice, a broken
            calibration, or a direction that is none
    """
    found: list[CameraDescription] = []
    for row in rows:
        camera = _read_camera(row, arms)
        if camera.name in [other.name for other in found]:
            raise row.fail("name", f"got {camera.name!r} a second time")
        found.append(camera)
    return tuple(found)


def bend(angle: float) -> Array:
    """Return T_straight_bent (4, 4) of a scope that is bent by an angle, above 0 down [rad]."""
    return transform(rotation_x(-angle), np.zeros(3))


def check_bend(angle: float) -> float:
    """Return how far a scope is bent, exactly [rad].

    Raises:
        InputError: no such scope
    """
    for known in BENDS:
        if abs(angle - known) < 1e-9:
            return known
    allowed = ", ".join(f"{np.degrees(known):.0f}" for known in BENDS)
    raise InputError(
        f"angle: got {np.degrees(angle):g} deg; allowed: {allowed} deg (down is above 0)"
    )


def _read_camera(row: Table, arms: Sequence[RigArm]) -> CameraDescription:
    name = row.text("name")
    if not name:
        raise row.fail("name", "got an empty text; allowed: a name")
    kind = row.text("kind", allowed=KINDS)
    source = row.text("source", "")
    angle = 0.0
    if kind == "endoscope":
        arm, frame, at = _read_scope(row, arms)
        try:
            angle = check_bend(row.quantity("angle", "angle", default=0.0))
        except InputError as problem:
            raise row.fail("angle", str(problem).partition(": ")[2]) from problem
        calibration = _read_calibration(row, stereo=True)
    else:
        arm, frame, at = _read_view(row, arms)
        calibration = _read_calibration(row, stereo=False)
    row.done()
    return CameraDescription(
        name, cast(CameraKind, kind), arm, frame, at, angle, calibration, source
    )


def _read_scope(row: Table, arms: Sequence[RigArm]) -> tuple[str, str, Array]:
    """Return arm, frame and T_frame_camera of a camera at the end of an arm's scope."""
    scopes = {a.name: a for a in arms if a.arm.type == "ECM"}
    name = row.text("arm", next(iter(scopes)) if len(scopes) == 1 else None)
    if name not in scopes:
        raise row.fail(
            "arm",
            f"got {name!r}; allowed: an ECM of this rig: {', '.join(scopes) or 'it has none'}",
        )
    mechanism = scopes[name].arm.mechanism
    turned = mechanism.joints[-1].drive[0][0]
    end = pose(mechanism, np.zeros(len(mechanism.joints)), mechanism.tip, turned)
    return name, turned, transform(R_ROW_IMAGE, end[:3, 3])


def _read_view(row: Table, arms: Sequence[RigArm]) -> tuple[str, str, Array]:
    """Return arm, frame and T_frame_camera of a camera in the world or on an arm's link."""
    name, frame = row.text("arm", ""), ""
    if name:
        known = {a.name: a for a in arms}
        if name not in known:
            raise row.fail(
                "arm", f"got {name!r}; this rig has no such arm; allowed: {', '.join(known)}"
            )
        mechanism = known[name].arm.mechanism
        frame = row.text("frame", mechanism.tip)
        if frame not in mechanism.frame_index:
            raise row.fail(
                "frame",
                f"got {frame!r}; {name} has no such frame; allowed:"
                f" {', '.join(mechanism.frame_index)}",
            )
    elif "frame" in row:
        raise row.fail("frame", "needs arm = NAME, whose frame it is")
    else:
        row.text("frame", "")
    if not row.has("look_at", "length"):
        return name, frame, read_pose(row)
    if "rotation" in row or row.has("rpy", "angle"):
        raise row.fail("look_at", "contradicts rpy or rotation; give one of them")
    row.raw("rotation")
    at = row.vector("xyz", 3, "length", default=np.zeros(3))
    return name, frame, _looking(row, at, row.vector("look_at", 3, "length"))


def _looking(row: Table, at: Array, target: Array) -> Array:
    """Return the pose of a camera that looks from one point at another, upright."""
    ahead = target - at
    distance = float(np.linalg.norm(ahead))
    if distance == 0.0:
        raise row.fail("look_at", "is where the camera stands; allowed: another point")
    ahead = ahead / distance
    right = np.cross(ahead, UP)
    if float(np.linalg.norm(right)) < 1e-9:  # straight up or down: y of the frame is up
        right = np.array([1.0, 0.0, 0.0])
    right = right / np.linalg.norm(right)
    return translation(at) @ transform(
        np.stack([right, np.cross(ahead, right), ahead], axis=1), np.zeros(3)
    )


def _read_calibration(row: Table, *, stereo: bool) -> Calibration:
    """Return what a camera sees: a preset, a calibration's files, or size and angle of a view."""
    ways = ("preset", "calibration") if stereo else ("preset", "calibration", "size_px")
    given = [key for key in ways if key in row]
    for key in ways:
        row.raw(key)
    if len(given) > 1:
        raise row.fail(given[1], f"contradicts {given[0]}; give one of them")
    if not given:
        raise row.fail(ways[0], f"is missing; allowed keys: {', '.join(ways)}")
    if given == ["size_px"]:
        return MonoCalibration(read_eye(row), "", row.text("source", ""))
    try:
        source = _source(row, given[0])
        return load_stereo_camera(source) if stereo else load_camera(source)
    except InputError as problem:
        raise row.fail(given[0], str(problem)) from problem


def _source(row: Table, key: str) -> Source:
    """Return a preset's name, or one or two paths, which are relative to the rig's folder."""
    if key == "preset":
        return row.text("preset")
    value = row.raw(key)
    names = (row.text(key),) if isinstance(value, str) else row.texts(key)
    folder = Path(row.file).parent
    return [folder / name for name in names]
