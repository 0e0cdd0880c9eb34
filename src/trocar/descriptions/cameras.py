"""Cameras from TOML: presets and one's own files of the same kind, and where rigs place them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import get_args

import numpy as np
from numpy.typing import NDArray

from trocar.cameras.calibration_files import read_calibration
from trocar.cameras.records import (
    Calibration,
    CameraDescription,
    CameraKind,
    Intrinsics,
    MonoCalibration,
    StereoCalibration,
    check_bend,
)
from trocar.descriptions.frames import read_pose
from trocar.descriptions.keys import key
from trocar.descriptions.records import RigArm
from trocar.descriptions.table import Table, read_table
from trocar.errors import DescriptionError, InputError, UnknownNameError
from trocar.geometry.rotations import rotation_z
from trocar.geometry.se3 import transform, translation
from trocar.kinematics.forward import pose

Array = NDArray[np.float64]

PRESETS = Path(__file__).parent / "data" / "cameras"
#: Source of a camera: a preset or file, or the files of the left and the right eye.
Source = str | Path | Sequence[str | Path]
KINDS: tuple[str, ...] = get_args(CameraKind)
#: A view looks this way up: away from the patient's floor. Source: our own choice.
UP = np.array([0.0, 0.0, 1.0])
#: The image of a scope (x right, y down, z ahead) against its last DH row: the row's y is to the
#: right of the picture, and its -x down. Source: SAW mtsIntuitiveResearchKitECM.cpp,
#: ToolOffsetTransformation, the rotation of an ECM's tip: x left, y up and z ahead.
R_ROW_IMAGE = rotation_z(np.pi / 2.0)


def presets() -> tuple[str, ...]:
    """Return the names of the built-in cameras, sorted."""
    return tuple(sorted(path.stem for path in PRESETS.glob("*.toml")))


def load_camera(source: Source) -> Calibration:
    """Load a camera.

    Args:
        source: a preset ("hd_1280x720"); a TOML file of the same kind; a YAML or XML file of
            OpenCV's, or YAML or INI of ROS's camera_info; or two files, ROS's of the left and of
            the right eye, or OpenCV's intrinsics and extrinsics

    Raises:
        UnknownNameError: no such preset; the known ones are listed
        DescriptionError: a file that cannot be read, or a calibration that no camera has; file,
            entry, what was got and what is allowed are named
    """
    given = [source] if isinstance(source, str | Path) else list(source)
    if len(given) == 2:
        return read_calibration([Path(path).expanduser() for path in given])
    if len(given) != 1:
        raise InputError(f"calibration: got {len(given)} files; allowed: one, or left and right")
    name = str(given[0])
    if isinstance(given[0], str) and not Path(name).suffix and "/" not in name:
        if name not in presets():
            raise UnknownNameError("camera preset", name, presets())
        return _read_preset(PRESETS / f"{name}.toml")
    path = Path(name).expanduser().resolve()
    return _read_preset(path) if path.suffix == ".toml" else read_calibration([path])


def load_stereo_camera(source: Source) -> StereoCalibration:
    """Load a camera that has two eyes, as an endoscope needs.

    Raises:
        DescriptionError, UnknownNameError: as for `load_camera`; a camera with one eye
    """
    found = load_camera(source)
    if isinstance(found, StereoCalibration):
        return found
    name = source if isinstance(source, str | Path) else ", ".join(str(s) for s in source)
    raise DescriptionError(
        str(name),
        "",
        "is the calibration of one eye; an endoscope has two: give the files of the left and of the"
        " right eye, or OpenCV's with both",
    )


def _read_preset(path: Path) -> Calibration:
    """Read a camera: two eyes alike and side by side where it has a baseline, else one.

    Raises:
        DescriptionError: naming file, key, what was got and what is allowed
    """
    table = read_table(path)
    table.check_schema()
    keys, eye = table.record(CameraFileKeys), read_eye(table)
    table.done()
    if keys.baseline is None:
        return MonoCalibration(eye, keys.name, keys.source, keys.title)
    try:
        T = translation([keys.baseline, 0.0, 0.0])
        return StereoCalibration(eye, eye, T, keys.name, keys.source, None, keys.title)
    except InputError as problem:
        raise DescriptionError(str(path), "", str(problem)) from problem


@dataclass(frozen=True)
class CameraFileKeys:
    """Keys of a camera's file beside those of its eyes.

    Attributes:
        name, title, source: of the camera
        baseline: distance of the eyes; default: one eye [m]
    """

    name: str = field(metadata=key())
    source: str = field(metadata=key())
    title: str = field(default="", metadata=key())
    baseline: float | None = field(default=None, metadata=key("length"))


@dataclass(frozen=True, eq=False)
class EyeKeys:
    """Keys of an eye.

    Attributes:
        size_px: width and height of the picture
        fov: horizontal field of view, with square pixels [rad]
        focal_px: instead of `fov`: fx and fy
        principal_px: cx and cy; default: the centre of the picture
        distortion: k1, k2, p1, p2 and optionally k3, or k3 to k6; default: no distortion
    """

    size_px: Array = field(metadata=key(size=2))
    fov: float | None = field(default=None, metadata=key("angle"))
    focal_px: Array | None = field(default=None, metadata=key(size=2))
    principal_px: Array | None = field(default=None, metadata=key(size=2))
    distortion: Array = field(default_factory=lambda: np.zeros(0), metadata=key())


@dataclass(frozen=True, eq=False)
class CameraKeys:
    """Keys of a camera that a rig places, beside its placement and its eye.

    Attributes:
        name: of the camera
        kind: `endoscope`: two eyes at the end of an ECM's scope; `view`: in the room or on a link
        arm: carrier; default: of an `endoscope` the rig's ECM, of a `view` the world
        frame: of the carrier; default: its tip
        look_at: target, image upright, instead of `rpy` or `rotation`, (3,) [m]
        angle: lens angle: 0, 30 deg down or -30 deg up [rad]
        preset: a built-in camera
        calibration: instead of `preset`: a calibration's file, or `["left.yaml", "right.yaml"]`,
            relative to the rig's folder
        source: of the numbers
    """

    name: str = field(metadata=key(form="name"))
    kind: CameraKind = field(metadata=key())
    source: str = field(metadata=key(default=""))
    arm: str | None = field(default=None, metadata=key())
    frame: str | None = field(default=None, metadata=key(of=("view",)))
    look_at: Array | None = field(default=None, metadata=key("length", size=3, of=("view",)))
    angle: float = field(default=0.0, metadata=key("angle", of=("endoscope",)))
    preset: str | None = field(default=None, metadata=key(see="#cameras"))
    calibration: object = field(default=None, metadata=key(form="any", see="#your-own-scope"))


def read_eye(table: Table) -> Intrinsics:
    """Read picture size, lens and distortion.

    Raises:
        DescriptionError: naming file, key, what was got and what is allowed
    """
    keys = table.record(EyeKeys)
    size = keys.size_px
    if (size < 1).any() or (size != np.round(size)).any():
        raise table.fail("size_px", f"got {size.tolist()}; allowed: two whole numbers above 0")
    width, height = (int(v) for v in size)
    focal = _focal_lengths(table, keys, width)
    middle = keys.principal_px
    if middle is None:
        middle = 0.5 * (size - 1.0)
    K = np.array([[focal[0], 0.0, middle[0]], [0.0, focal[1], middle[1]], [0.0, 0.0, 1.0]])
    try:
        return Intrinsics(width, height, K, keys.distortion)
    except InputError as problem:
        raise DescriptionError(table.file, table.path, str(problem)) from problem


def _focal_lengths(table: Table, keys: EyeKeys, width: int) -> Array:
    """Return fx and fy [px], given as such or by the horizontal field of view."""
    if keys.focal_px is not None:
        if keys.fov is not None:
            raise table.fail("focal_px", "contradicts fov; give one of them")
        return keys.focal_px
    fov = table.quantity("fov", "angle") if keys.fov is None else keys.fov
    if not 0.0 < fov < np.pi:
        raise table.fail(
            "fov", f"got {np.degrees(fov):g} deg; allowed: above 0 to below 180 deg, or focal_px"
        )
    f = 0.5 * width / np.tan(0.5 * fov)
    return np.array([f, f])


def read_camera(row: Table, arms: Sequence[RigArm]) -> CameraDescription:
    """Return a camera of a rig.

    Raises:
        DescriptionError: an unknown kind, arm, frame or preset, a broken calibration, or a
            viewing direction of zero length
    """
    keys = row.record(CameraKeys, row.text("kind", allowed=KINDS))
    angle = 0.0
    if keys.kind == "endoscope":
        arm, frame, at = _on_scope(row, keys, arms)
        try:
            angle = check_bend(keys.angle)
        except InputError as problem:
            raise row.fail("angle", str(problem).partition(": ")[2]) from problem
    else:
        arm, frame, at = _view(row, keys, arms)
    calibration = _calibration(row, keys)
    return CameraDescription(keys.name, keys.kind, arm, frame, at, angle, calibration, keys.source)


def _on_scope(row: Table, keys: CameraKeys, arms: Sequence[RigArm]) -> tuple[str, str, Array]:
    """Return arm, frame and T_frame_camera of a camera at the end of an arm's scope."""
    scopes = {a.name: a for a in arms if a.arm.type == "ECM"}
    name = keys.arm
    if name is None:
        name = next(iter(scopes)) if len(scopes) == 1 else row.text("arm")
    if name not in scopes:
        raise row.fail(
            "arm",
            f"got {name!r}; allowed: an ECM of this rig: {', '.join(scopes) or 'it has none'}",
        )
    mechanism = scopes[name].arm.mechanism
    turned = mechanism.joints[-1].drive[0][0]
    end = pose(mechanism, np.zeros(len(mechanism.joints)), mechanism.tip, turned)
    return name, turned, transform(R_ROW_IMAGE, end[:3, 3])


def _view(row: Table, keys: CameraKeys, arms: Sequence[RigArm]) -> tuple[str, str, Array]:
    """Return arm, frame and T_frame_camera of a camera in the world or on an arm's link."""
    name, frame = keys.arm or "", ""
    if name:
        known = {a.name: a for a in arms}
        row.known("arm", name, known, "this rig has no such arm")
        mechanism = known[name].arm.mechanism
        frame = mechanism.tip if keys.frame is None else keys.frame
        row.known("frame", frame, mechanism.frame_index, f"{name} has no such frame")
    elif keys.frame is not None:
        raise row.fail("frame", "needs arm = NAME, whose frame it is")
    if keys.look_at is None:
        return name, frame, read_pose(row)
    if "rotation" in row or row.has("rpy", "angle"):
        raise row.fail("look_at", "contradicts rpy or rotation; give one of them")
    row.raw("rotation")
    at = row.vector("xyz", 3, "length", default=np.zeros(3))
    return name, frame, _looking(row, at, keys.look_at)


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


def _calibration(row: Table, keys: CameraKeys) -> Calibration:
    """Return the calibration of a camera: a preset, files, or size and angle of a view."""
    ways = ("preset", "calibration", "size_px")[: 2 if keys.kind == "endoscope" else 3]
    given = [way for way in ways if way in row]
    for way in ways:
        row.raw(way)
    if len(given) > 1:
        raise row.fail(given[1], f"contradicts {given[0]}; give one of them")
    if not given:
        raise row.fail(ways[0], f"is missing; allowed keys: {', '.join(ways)}")
    if given == ["size_px"]:
        return MonoCalibration(read_eye(row), "", keys.source)
    try:
        source = keys.preset or _files(row)
        return load_stereo_camera(source) if keys.kind == "endoscope" else load_camera(source)
    except InputError as problem:
        raise row.fail(given[0], str(problem)) from problem


def _files(row: Table) -> list[Path]:
    """Return the one or two files of a calibration, which are relative to the rig's folder."""
    one = isinstance(row.raw("calibration"), str)
    names = (row.text("calibration"),) if one else row.texts("calibration")
    return [Path(row.file).parent / name for name in names]
