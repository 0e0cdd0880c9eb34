"""Find a camera by name or in files, and write one."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Literal

from trocar.descriptions.cameras.entries import Entries
from trocar.descriptions.cameras.opencv_file import calibration_from_opencv, opencv_text
from trocar.descriptions.cameras.presets import read_camera
from trocar.descriptions.cameras.records import Calibration, StereoCalibration
from trocar.descriptions.cameras.ros_file import (
    is_ros,
    mono_from_ros,
    ros_texts,
    stereo_from_ros,
)
from trocar.descriptions.cameras.yaml_text import parse_yaml
from trocar.errors import DescriptionError, InputError, UnknownNameError

PRESETS = Path(__file__).parents[1] / "data" / "cameras"
#: Where a camera comes from: a preset or file, or the files of the left and the right eye.
Source = str | Path | Sequence[str | Path]


def presets() -> tuple[str, ...]:
    """Return the names of the built-in cameras, sorted."""
    return tuple(sorted(path.stem for path in PRESETS.glob("*.toml")))


def load_camera(source: Source) -> Calibration:
    """Load a camera.

    Args:
        source: a preset ("hd_1280x720"); a TOML file of the same kind; a YAML file of OpenCV's, or
            of ROS's camera_info for one eye; or two files, ROS's of the left and of the right eye,
            or OpenCV's intrinsics and extrinsics

    Raises:
        UnknownNameError: no such preset; the known ones are listed
        DescriptionError: a file that cannot be read, or a calibration that no camera has; file,
            entry, what was got and what is allowed are named
    """
    given = [source] if isinstance(source, str | Path) else list(source)
    if len(given) == 2:
        return _load_pair(Path(given[0]), Path(given[1]))
    if len(given) != 1:
        raise InputError(f"calibration: got {len(given)} files; allowed: one, or left and right")
    name = str(given[0])
    if isinstance(given[0], str) and not Path(name).suffix and "/" not in name:
        if name not in presets():
            raise UnknownNameError("camera preset", name, presets())
        return read_camera(PRESETS / f"{name}.toml")
    path = Path(name).expanduser().resolve()
    if path.suffix == ".toml":
        return read_camera(path)
    entries = _entries(path)
    return mono_from_ros(entries) if is_ros(entries) else calibration_from_opencv(entries)


def load_stereo_camera(source: Source) -> StereoCalibration:
    """Load a camera that has two eyes, as an endoscope needs.

    Raises:
        DescriptionError, UnknownNameError: as for `load_camera`; a camera with one eye
    """
    found = load_camera(source)
    if isinstance(found, StereoCalibration):
        return found
    told = source if isinstance(source, str | Path) else ", ".join(str(s) for s in source)
    raise DescriptionError(
        str(told),
        "",
        "is the calibration of one eye; an endoscope has two: give the files of the left and of the"
        " right eye, or OpenCV's with both",
    )


def write_camera(
    calibration: Calibration, paths: Iterable[str | Path], kind: Literal["ros", "opencv"] = "ros"
) -> tuple[Path, ...]:
    """Write a camera for ROS, one file for each eye, or for OpenCV, one file.

    Raises:
        InputError: another number of files than the kind needs, or one that cannot be written
    """
    texts = ros_texts(calibration) if kind == "ros" else (opencv_text(calibration),)
    files = [Path(path) for path in paths]
    if len(files) != len(texts):
        raise InputError(f"calibration: got {len(files)} files; {kind} needs {len(texts)} here")
    for path, text in zip(files, texts, strict=True):
        try:
            path.write_text(text, encoding="utf-8")
        except OSError as problem:
            raise InputError(f"{path}: cannot be written: {problem.strerror}") from problem
    return tuple(files)


def _load_pair(first: Path, second: Path) -> Calibration:
    one, other = _entries(first.expanduser()), _entries(second.expanduser())
    if is_ros(one) and is_ros(other):
        return stereo_from_ros(one, other)
    if is_ros(one) or is_ros(other):
        raise DescriptionError(
            f"{one.file}, {other.file}", "", "one is ROS's and one is OpenCV's; allowed: a pair"
        )
    both = Entries(other.data | one.data, f"{one.file}, {other.file}")
    return calibration_from_opencv(both)


def _entries(path: Path) -> Entries:
    if path.suffix.lower() not in (".yaml", ".yml"):
        raise DescriptionError(
            str(path), "", "is no calibration; allowed: .toml, .yaml, .yml (or a preset's name)"
        )
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as problem:
        raise DescriptionError(str(path), "", f"cannot be read: {problem}") from problem
    return Entries(parse_yaml(text, str(path)), str(path))
