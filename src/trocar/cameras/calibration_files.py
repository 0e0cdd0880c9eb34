"""Calibration files of ROS and OpenCV: YAML, INI, XML or JSON, of one eye or of two.

ROS has a file of camera_info for each eye. Where two come together, the pose between the eyes is in
their R and P: both pictures are turned into the same axes by R, and in these the right eye stands
at -P[0, 3] / P[0, 0] along x.

OpenCV's names are those of its samples `calibration` and `stereo_calib` (the latter writes
intrinsics and extrinsics into two files; they may be given together). R and T lead from the left
eye to the right one: p_right = R p_left + T.

Keys are found whatever their case. A key that neither ROS nor OpenCV writes is ignored with a
warning.

Source: ROS, camera_calibration_parsers and sensor_msgs/CameraInfo; OpenCV 4,
samples/cpp/calibration.cpp, samples/cpp/stereo_calib.cpp and the tutorial camera_calibration.cpp.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Iterable, Sequence
from difflib import get_close_matches
from pathlib import Path
from typing import Any, Literal, cast

import numpy as np
from numpy.typing import NDArray

from trocar.cameras.calibration_layouts import with_common_keys
from trocar.cameras.calibration_text import (
    NUMBERS,
    Keys,
    numbers_of,
    parse_ini,
    parse_json,
    parse_xml,
    parse_yaml,
)
from trocar.cameras.records import (
    Calibration,
    Intrinsics,
    MonoCalibration,
    Rectification,
    StereoCalibration,
)
from trocar.cameras.rectification import CameraInfo, camera_infos, rectified
from trocar.errors import DescriptionError, InputError
from trocar.geometry.se3 import inverse, transform
from trocar.inputs import got, read_input
from trocar.outputs import check_file, whole_file

Array = NDArray[np.float64]

_log = logging.getLogger("trocar")

#: Source: our own choice, 50 times what a stereo camera takes; PyYAML reads 100 kB a second.
MOST_BYTES = 200_000
#: ROS's models that trocar has, and how many coefficients each may have.
MODELS = {"plumb_bob": (0, 4, 5), "rational_polynomial": (8,)}
#: Names of an entry in a file, and in a message printed by `rostopic echo` or `ros2 topic echo`.
ROS_SIZE = (("image_width", "width"), ("image_height", "height"))
ROS_MATRIX, ROS_COEFFICIENTS = ("camera_matrix", "K", "k"), ("distortion_coefficients", "D", "d")
ROS_TURN, ROS_PROJECTION = ("rectification_matrix", "R", "r"), ("projection_matrix", "P", "p")
ROS_MODEL = ("distortion_model", "camera_model")
#: Further keys that ROS writes, without a use here.
ROS_IDLE = ("camera_name", "header", "binning_x", "binning_y", "roi", "frame_id", "stamp")
#: R of a file has so many digits that it is a rotation to this. Source: six digits are printed.
ROUNDED = 1e-4
#: And one that is exact to this is kept to the last bit. Source: rounding of numbers of size 1.
EXACT = 1e-12
#: OpenCV's names of a matrix; the first is what is written.
OPENCV_ONE = (
    ("camera_matrix", "cameraMatrix", "K", "mtx", "intrinsic_matrix", "intrinsics"),
    ("distortion_coefficients", "distCoeffs", "D", "dist", "dist_coeffs", "distortion"),
)
OPENCV_LEFT = (
    ("M1", "K1", "cameraMatrix1", "camera_matrix_1", "camera_matrix_left", "K_left"),
    ("D1", "distCoeffs1", "distortion_coefficients_1", "dist_coeffs_left", "D_left"),
)
OPENCV_RIGHT = (
    ("M2", "K2", "cameraMatrix2", "camera_matrix_2", "camera_matrix_right", "K_right"),
    ("D2", "distCoeffs2", "distortion_coefficients_2", "dist_coeffs_right", "D_right"),
)
OPENCV_SIZES = ("imageSize", "image_size", "size", "imgsize", "imsize", "resolution")
#: Further keys that OpenCV writes, without a use here.
OPENCV_IDLE = (
    *("calibration_time", "nframes", "nrOfFrames", "nr_of_frames", "board_width", "board_height"),
    *("square_size", "marker_size", "flags", "flagValue", "aspectRatio", "fisheye_model"),
    *("avg_reprojection_error", "per_view_reprojection_errors", "extrinsic_parameters"),
    *("image_points", "grid_points", "rms", "E", "F", "Q", "R1", "R2", "P1", "P2", "version"),
    *("fix_aspect_ratio", "validRoi1", "validRoi2", "roi1", "roi2", "camera_name", "R", "T"),
)
#: Least similarity of a misspelled key, 0 to 1. Source: our own choice.
SIMILAR = 0.8
#: Endings of files.
SUFFIXES = (".yaml", ".yml", ".xml", ".json", ".ini", ".txt")


def read_calibration(paths: Sequence[Path]) -> Calibration:
    """Read a camera from a file of OpenCV or ROS, or from two of the same kind.

    Args:
        paths: one file (ROS's INI may hold both eyes); or ROS's of the left and of the right eye,
            or OpenCV's intrinsics and extrinsics

    Raises:
        DescriptionError: a file that cannot be read, or a calibration that no camera has; file,
            entry, what was got and what is allowed are named
    """
    first, *others = (entries for path in paths for entries in _read_entries(path))
    if len(others) > 1:
        files = ", ".join(str(path) for path in paths)
        raise DescriptionError(files, "", f"have {1 + len(others)} cameras; allowed: one or two")
    if not others:
        return _mono_from_ros(first) if _is_ros(first) else _calibration_from_opencv(first)
    (second,) = others
    if _is_ros(first) and _is_ros(second):
        return _stereo_from_ros(first, second)
    files = f"{first.file}, {second.file}"
    if _is_ros(first) or _is_ros(second):
        raise DescriptionError(files, "", "one is ROS's and one is OpenCV's; allowed: a pair")
    if first.has(*OPENCV_ONE[0]) and second.has(*OPENCV_ONE[0]):
        raise DescriptionError(
            files,
            "",
            f"have a {OPENCV_ONE[0][0]} each, and nothing of the pose between the eyes; allowed:"
            " one eye's file, ROS's of both, or one with M1, D1, M2, D2, R and T",
        )
    return _calibration_from_opencv(_Entries(second.data | first.data, files))


def write_camera(
    calibration: Calibration,
    paths: Iterable[str | Path],
    kind: Literal["ros", "opencv"] = "ros",
    *,
    overwrite: bool = False,
) -> tuple[Path, ...]:
    """Write a camera for ROS, one file for each eye, or for OpenCV, one file.

    Raises:
        InputError: another number of files than the kind needs, or one that exists (without
            `overwrite`) or cannot be written
        TrocarError: the disk is full
    """
    texts = _ros_texts(calibration) if kind == "ros" else (_opencv_text(calibration),)
    files = [Path(path) for path in paths]
    if len(files) != len(texts):
        raise InputError(f"calibration: got {len(files)} files; {kind} needs {len(texts)} here")
    for path in files:
        check_file(path, overwrite)
    for path, text in zip(files, texts, strict=True):
        with whole_file(path, overwrite) as part:
            part.write_text(text, encoding="utf-8")
    return tuple(files)


class _Entries:
    """The keys and values of a calibration file.

    Args:
        data: keys and values
        file: the file's name, for messages
    """

    def __init__(self, data: dict[str, Any], file: str) -> None:
        self.file = file
        self.data = data

    def __contains__(self, key: str) -> bool:
        return self.spelled(key) is not None

    def spelled(self, *keys: str) -> str | None:
        """Return the first of some names that the file has, in its own spelling."""
        for key in keys:
            if key in self.data:
                return key
        plain = {_plain(str(key)): str(key) for key in self.data}
        return next((plain[_plain(key)] for key in keys if _plain(key) in plain), None)

    def warn_of_others(self, *known: str) -> None:
        """Warn of unknown keys, once."""
        plain = {_plain(key): key for key in known}
        found: list[str] = []
        for key in self.data:
            if _plain(str(key)) not in plain:
                near = get_close_matches(_plain(str(key)), plain, n=1, cutoff=SIMILAR)
                found.append(f"{key} (did you mean {plain[near[0]]}?)" if near else str(key))
        if found:
            word = "key" if len(found) == 1 else "keys"
            _log.warning("%s: unknown %s, ignored: %s", self.file, word, ", ".join(found))

    def fail(self, key: str, problem: str) -> DescriptionError:
        """Return the error that names this file, the entry and what is wrong with it."""
        return DescriptionError(self.file, key, problem)

    def has(self, *keys: str) -> bool:
        """Return whether there is an entry by one of these names."""
        return self.spelled(*keys) is not None

    def text(self, default: str, *keys: str) -> str:
        """Return a text."""
        key = self.spelled(*keys)
        value = None if key is None else self.data[key]
        return default if value is None else str(value)

    def whole(self, *keys: str) -> int:
        """Return a whole number above 0."""
        key, value = self._one(keys)
        number = isinstance(value, int | float) and not isinstance(value, bool)
        if not number or not math.isfinite(value) or value != round(value):
            raise self.fail(key, got(value, "a whole number"))
        return int(value)

    def matrix(self, rows: int, columns: int, *keys: str) -> Array:
        """Return a matrix that is written as `rows, cols, data`, as rows, or as one list."""
        key, value = self._one(keys)
        found = self._numbers(key, value)
        if found.size != rows * columns:
            raise self.fail(key, f"got {found.size} numbers; allowed: {rows} x {columns}")
        return found.reshape(rows, columns)

    def numbers(self, *keys: str) -> Array:
        """Return a list or matrix of any size as (n,)."""
        key, value = self._one(keys)
        return self._numbers(key, value)

    def rotation(self, *keys: str) -> Array:
        """Return a rotation matrix, the nearest one where the file has rounded its numbers."""
        turn = self.matrix(3, 3, *keys)
        left, _, right = np.linalg.svd(turn)
        nearest = left @ right
        off = float(np.abs(nearest - turn).max())
        if np.linalg.det(turn) <= 0.0 or off > ROUNDED:
            raise self.fail(keys[0], got(turn.tolist(), "a rotation matrix"))
        return turn if off < EXACT else nearest

    def _one(self, keys: tuple[str, ...]) -> tuple[str, Any]:
        found = self.spelled(*keys)
        if found is not None:
            return found, self.data[found]
        first, *others = keys
        present = ", ".join(str(key) for key in self.data) or "nothing"
        other = f" (or {', '.join(others)})" if others else ""
        raise self.fail(first, f"is missing{other}; the file has {present}{self.like(*keys)}")

    def like(self, *keys: str) -> str:
        """Return a hint at the file's own key that resembles one of some, "" without any."""
        plain = {_plain(str(key)): str(key) for key in self.data}
        for key in keys:
            near = get_close_matches(_plain(key), plain, n=1, cutoff=SIMILAR)
            if near:
                return f"; is {plain[near[0]]!r} misspelled?"
        return ""

    def _numbers(self, key: str, value: Any) -> Array:
        if isinstance(value, dict):
            table = cast(dict[str, Any], value)
            found = self._numbers(key, table.get("data"))
            rows, columns = table.get("rows", found.size), table.get("cols", 1)
            if not all(isinstance(n, int) for n in (rows, columns)):
                raise self.fail(key, f"got {rows!r} x {columns!r}; allowed: whole numbers")
            if "cols" in table and (rows, columns) != (0, 0) and rows * columns != found.size:
                raise self.fail(key, f"has {found.size} numbers, but says {rows} x {columns}")
            return found
        if isinstance(value, str) and NUMBERS.fullmatch(value):  # an array as it is printed
            value = numbers_of(value)
        if not isinstance(value, list):
            raise self.fail(key, got(value, "a list or matrix of numbers"))
        flat: list[Any] = []
        for item in cast(list[Any], value):
            flat.extend(cast(list[Any], item) if isinstance(item, list) else [item])
        for item in flat:
            wrong = isinstance(item, bool) or not isinstance(item, int | float)
            if wrong or not math.isfinite(item):
                raise self.fail(key, got(item, "finite numbers"))
        return np.array(flat, dtype=np.float64)


def _plain(key: str) -> str:
    """Return a key without case, hyphens and underscores."""
    return key.lower().replace("_", "").replace("-", "").replace(" ", "")


def _is_ros(entries: _Entries) -> bool:
    """Return whether a file is ROS's."""
    return entries.has(ROS_PROJECTION[0], "camera_name", *ROS_MODEL)


def _mono_from_ros(entries: _Entries) -> MonoCalibration:
    """Return the calibration of one eye; its P and R say nothing that is needed.

    Raises:
        DescriptionError: naming file, entry, what was got and what is allowed
    """
    return MonoCalibration(_ros_eye(entries), entries.text("", "camera_name"), entries.file)


def _stereo_from_ros(left: _Entries, right: _Entries) -> StereoCalibration:
    """Return the calibration of two eyes.

    Raises:
        DescriptionError: naming file, entry, what was got and what is allowed
    """
    turns = tuple(_rectification(entries) for entries in (left, right))
    (f, x), (f_right, x_right) = ((t.P[0, 0], t.P[0, 3]) for t in turns)
    if abs(f - f_right) > ROUNDED * f:
        raise right.fail(
            ROS_PROJECTION[0], f"got fx = {f_right:g}, the left eye's is {f:g}; allowed: the same"
        )
    for entries, turn in zip((left, right), turns, strict=True):
        if turn.P[1, 3] != 0.0:
            raise entries.fail(
                ROS_PROJECTION[0],
                f"got P[1, 3] = {turn.P[1, 3]:g}: the eyes lie above each other; allowed: side by"
                " side",
            )
    if x_right == x:
        raise right.fail(
            ROS_PROJECTION[0],
            f"got P[0, 3] = {x_right:g}, which is a baseline of 0; allowed: -fx * baseline of the"
            " right eye",
        )
    # Of eyes that were calibrated under exchanged names, the first has the P[0, 3] that is not 0.
    turns = tuple(Rectification(t.R, _moved(t.P, -x)) for t in turns) if x else turns
    shift = turns[0].R.T @ np.array([(x - x_right) / f_right, 0.0, 0.0])
    T = transform(turns[0].R.T @ turns[1].R, shift)
    try:
        return StereoCalibration(
            _ros_eye(left),
            _ros_eye(right),
            T,
            left.text("", "camera_name"),
            f"{left.file}, {right.file}",
            (turns[0], turns[1]),
        )
    except DescriptionError:
        raise
    except InputError as problem:
        raise DescriptionError(f"{left.file}, {right.file}", "", str(problem)) from problem


def _moved(P: Array, by: float) -> Array:
    """Return a projection (3, 4) with a number added to P[0, 3]."""
    moved = P.copy()
    moved[0, 3] += by
    return moved


def _ros_texts(calibration: Calibration) -> tuple[str, ...]:
    """Return the text of each eye's file; numbers come back to the last bit."""
    infos = camera_infos(calibration)
    name = calibration.name.partition("/")[0] or "camera"
    sides = (f"{name}/left", f"{name}/right") if len(infos) == 2 else (name,)
    return tuple(_ros_text(info, side) for info, side in zip(infos, sides, strict=True))


def _ros_text(info: CameraInfo, name: str) -> str:
    lines = [
        f"image_width: {info.width}",
        f"image_height: {info.height}",
        f"camera_name: {name}",
        *_ros_matrix(ROS_MATRIX[0], info.K),
        f"distortion_model: {info.distortion_model}",
        *_ros_matrix(ROS_COEFFICIENTS[0], info.D[None]),
        *_ros_matrix(ROS_TURN[0], info.R),
        *_ros_matrix(ROS_PROJECTION[0], info.P),
    ]
    return "\n".join(lines) + "\n"


def _ros_matrix(key: str, matrix: Array) -> list[str]:
    rows, columns = matrix.shape
    data = ", ".join(repr(float(v)) for v in matrix.ravel())
    return [f"{key}:", f"  rows: {rows}", f"  cols: {columns}", f"  data: [{data}]"]


def _ros_eye(entries: _Entries) -> Intrinsics:
    width, height = (entries.whole(*names) for names in ROS_SIZE)
    K = entries.matrix(3, 3, *ROS_MATRIX)
    entries.warn_of_others(
        *(name for names in ROS_SIZE for name in names),
        *(*ROS_MATRIX, *ROS_COEFFICIENTS, *ROS_TURN, *ROS_PROJECTION, *ROS_MODEL, *ROS_IDLE),
    )
    coefficients = _coefficients(entries, ROS_COEFFICIENTS, ROS_MODEL)
    guess = "rational_polynomial" if coefficients.size == 8 else "plumb_bob"
    model = entries.text(guess, *ROS_MODEL) or guess
    if model not in MODELS:
        raise entries.fail(
            entries.spelled(*ROS_MODEL) or ROS_MODEL[0], got(model, ", ".join(MODELS))
        )
    if coefficients.size not in MODELS[model]:
        allowed = " or ".join(str(n) for n in MODELS[model] if n)
        raise entries.fail(
            ROS_COEFFICIENTS[0],
            f"got {coefficients.size} of them; allowed for {model}: {allowed}",
        )
    try:
        return Intrinsics(width, height, K, coefficients)
    except InputError as problem:
        raise DescriptionError(entries.file, "", str(problem)) from problem


def _coefficients(entries: _Entries, names: tuple[str, ...], models: tuple[str, ...] = ()) -> Array:
    """Return an eye's distortion coefficients, none with a warning where the file has no list.

    Raises:
        DescriptionError: the list is missing beside a distortion model, or seems misspelled
    """
    if entries.has(*names):
        return entries.numbers(*names)
    hint, model = entries.like(*names), entries.spelled(*models) if models else None
    if model is not None or hint:
        beside = f", which {model} {entries.data[model]!r} needs" if model is not None else ""
        other = f" (or {', '.join(names[1:])})"
        raise entries.fail(names[0], f"is missing{beside}{other}{hint}")
    _log.warning("%s: has no %s: taken as a lens without distortion", entries.file, names[0])
    return np.zeros(0)


def _rectification(entries: _Entries) -> Rectification:
    turn = entries.rotation(*ROS_TURN)
    P = entries.matrix(3, 4, *ROS_PROJECTION)
    if P[0, 0] <= 0.0 or P[1, 1] <= 0.0:
        raise entries.fail(ROS_PROJECTION[0], f"focal length {P[0, 0]:g}; allowed: above 0")
    return Rectification(turn, P)


def _calibration_from_opencv(entries: _Entries) -> Calibration:
    """Return the calibration of one eye or of two.

    Raises:
        DescriptionError: naming file, entry, what was got and what is allowed
    """
    single = not entries.has(*OPENCV_LEFT[0]) and not entries.has(*OPENCV_RIGHT[0])
    for names in (OPENCV_ONE,) if single else (OPENCV_LEFT, OPENCV_RIGHT):
        entries.matrix(3, 3, *names[0])  # a file of something else lacks it, with unknown keys only
    eyes = (*OPENCV_ONE, *OPENCV_LEFT, *OPENCV_RIGHT)
    known = (name for names in (*eyes, OPENCV_SIZES, OPENCV_IDLE) for name in names)
    entries.warn_of_others(*known, "image_width", "image_height")
    if single:
        return MonoCalibration(_opencv_eye(entries, OPENCV_ONE), "", entries.file)
    left, right = _opencv_eye(entries, OPENCV_LEFT), _opencv_eye(entries, OPENCV_RIGHT)
    T_right_left = transform(entries.rotation("R"), entries.matrix(3, 1, "T")[:, 0])
    try:
        return StereoCalibration(left, right, inverse(T_right_left), "", entries.file)
    except InputError as problem:
        raise DescriptionError(entries.file, "", str(problem)) from problem


def _opencv_text(calibration: Calibration) -> str:
    """Return the text of a file that OpenCV reads; numbers come back to the last bit."""
    eyes = calibration.eyes
    lines = ["%YAML:1.0", "---"]
    lines += [f"image_width: {eyes[0].width}", f"image_height: {eyes[0].height}"]
    if isinstance(calibration, MonoCalibration):
        eye = calibration.eye
        lines += _opencv_matrix(OPENCV_ONE[0][0], eye.K)
        lines += _opencv_matrix(OPENCV_ONE[1][0], eye.distortion[None])
        return "\n".join(lines) + "\n"
    for eye, (matrix, coefficients) in zip(eyes, (OPENCV_LEFT, OPENCV_RIGHT), strict=True):
        lines += _opencv_matrix(matrix[0], eye.K)
        lines += _opencv_matrix(coefficients[0], eye.distortion[None])
    T_right_left = inverse(calibration.T_left_right)
    lines += _opencv_matrix("R", T_right_left[:3, :3]) + _opencv_matrix("T", T_right_left[:3, 3:])
    for number, turn in enumerate(rectified(calibration), 1):
        lines += _opencv_matrix(f"R{number}", turn.R) + _opencv_matrix(f"P{number}", turn.P)
    return "\n".join(lines) + "\n"


def _opencv_matrix(key: str, matrix: Array) -> list[str]:
    rows, columns = matrix.shape
    data = ", ".join(repr(float(v)) for v in matrix.ravel())
    head = [f"{key}: !!opencv-matrix", f"  rows: {rows}", f"  cols: {columns}", "  dt: d"]
    return [*head, f"  data: [{data}]"]


def _opencv_eye(entries: _Entries, names: tuple[tuple[str, ...], tuple[str, ...]]) -> Intrinsics:
    width, height = _opencv_size(entries)
    K = entries.matrix(3, 3, *names[0])
    coefficients = _coefficients(entries, names[1])
    try:
        return Intrinsics(width, height, K, coefficients)
    except InputError as problem:
        raise DescriptionError(entries.file, names[0][0], str(problem)) from problem


def _opencv_size(entries: _Entries) -> tuple[int, int]:
    """Return the picture's size; the sample stereo_calib leaves it out."""
    for key in OPENCV_SIZES:
        if key in entries:
            width, height = entries.matrix(1, 2, key).ravel().tolist()
            if width != round(width) or height != round(height):
                raise entries.fail(key, got([width, height], "two whole numbers"))
            return int(width), int(height)
    if not entries.has("image_width"):
        raise entries.fail(
            "image_width",
            "is missing, as OpenCV's sample leaves it out; write image_width and image_height of"
            " the calibration's pictures into the file",
        )
    return entries.whole("image_width"), entries.whole("image_height")


def _read_entries(path: Path) -> list[_Entries]:
    """Return the keys of a file's cameras; two of ROS's INI and ORB-SLAM2, else one."""
    kind, file = path.suffix.lower(), str(path)
    if kind not in SUFFIXES:
        raise DescriptionError(
            file,
            "",
            f"is no calibration; allowed: {', '.join(('.toml', *SUFFIXES))} (or a preset's name)",
        )
    try:
        text = read_input(path, MOST_BYTES).decode("utf-8-sig")
    except (OSError, UnicodeDecodeError) as problem:
        raise DescriptionError(file, "", f"cannot be read: {problem}") from problem
    found: list[Keys]
    if kind in (".ini", ".txt"):
        found = parse_ini(text, file)
    elif kind == ".xml":
        found = [parse_xml(text, file)]
    elif kind == ".json":
        found = [parse_json(text, file)]
    else:
        found = [parse_yaml(text, file)]
    named = (one for keys in found for one in with_common_keys(keys, file))
    return [_Entries(keys, file) for keys in named]
