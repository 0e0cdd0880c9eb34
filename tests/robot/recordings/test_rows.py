"""Rows of numbers without a header, and files that hold none."""

from __future__ import annotations

import gzip
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from trocar.descriptions import ArmDescription, load_arm
from trocar.errors import InputError, LogError
from trocar.robot.recordings import ArmMotion, ReadSettings, Wrist, read_arm_motion
from trocar.robot.recordings.motor_side import actuators_of_recording

Array = NDArray[np.float64]
ROW = ",".join(["0.1"] * 21)


@pytest.fixture(scope="module")
def psm() -> ArmDescription:
    return load_arm("psm")


def read(path: Path, wrist: Wrist = "motor", arm: str = "psm") -> ArmMotion:
    return read_arm_motion(path, load_arm(arm), ReadSettings(wrist=wrist))


@pytest.fixture
def motion(rng: np.random.Generator) -> tuple[Array, Array, Array]:
    """A slow motion of every joint with its velocities, at 200 Hz."""
    phase = 0.01 * np.arange(37)[:, None] + rng.uniform(0.0, 6.0, 7)
    return 0.1 + 0.05 * np.sin(phase), 0.1 * np.cos(phase), rng.uniform(0.0, 0.2, (37, 7))


@pytest.mark.parametrize("name", ["log.csv", "log.csv.gz"])
def test_what_the_recorder_wrote_comes_back(
    motion: tuple[Array, Array, Array],
    write_psm_log: Callable[..., Path],
    tmp_path: Path,
    name: str,
) -> None:
    found = read(write_psm_log(tmp_path / name, *motion))
    np.testing.assert_allclose(found.rows, np.stack(motion, axis=1), atol=1e-12)
    assert (len(found.times), found.starts) == (37, (0,))


def test_the_tools_own_coupling_is_the_recorders(psm: ArmDescription) -> None:
    which, coupling = actuators_of_recording(psm)
    assert [psm.mechanism.joint_names[k] for k in which] == ["wrist_pitch", "wrist_yaw", "jaw"]
    # Source: Wang 2019, the recording script
    printed = [[1.0186, 0, 0], [-0.8306, 0.6089, 0.6089], [0, -1.2177, 1.2177]]
    np.testing.assert_array_equal(coupling.actuator_to_joint, printed)


def test_power_is_the_same_on_both_sides_of_the_wrist(
    motion: tuple[Array, Array, Array],
    write_psm_log: Callable[..., Path],
    tmp_path: Path,
) -> None:
    path = write_psm_log(tmp_path / "log.csv", *motion)
    joints, motors = (read(path, wrist).rows for wrist in ("motor", "joint"))
    power = [(rows[:, 1] * rows[:, 2]).sum(axis=1) for rows in (joints, motors)]
    np.testing.assert_allclose(power[0], power[1], atol=1e-12)
    assert np.abs(joints - motors).max() > 1e-3


def test_joint_side_recordings_are_taken_as_they_are(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text(f"{ROW}\n{ROW}\n")
    rows = read(path, "joint").rows
    np.testing.assert_array_equal(rows, np.full((2, 3, 7), 0.1))


def test_windows_line_ends_a_byte_order_mark_and_blank_rows_at_the_end_are_fine(
    tmp_path: Path,
) -> None:
    path = tmp_path / "log.csv"
    path.write_bytes(b"\xef\xbb\xbf" + f"{ROW}\r\n{ROW}\r\n\r\n  \r\n".encode())
    assert len(read(path).times) == 2


BAD_ROWS = {
    "a column short": (ROW[:-4], "got 20 columns; allowed: 21"),
    "cut off": (ROW[:30], "columns; allowed: 21"),
    "a header": ("time" + ROW[3:], "column 1: got 'time'; allowed: a number"),
    "not a number": (ROW[:-3] + "nan", "column 21: got 'nan'; allowed: a number"),
    "infinite": (ROW[:-3] + "-inf", "column 21: got '-inf'"),
    "a hole": (ROW.replace("0.1,0.1", "0.1,", 1), "column 2: got ''"),
    "blank": ("", "is blank"),
    "another arm": ("0.1,0.1,2.5" + ROW[11:], "insertion: got 2.5; allowed: -0.24 to 0.48"),
    "impossible velocity": (ROW[:28] + "1e9" + ROW[31:], "velocities: yaw: got 1e+09"),
    "impossible effort": (ROW[:-3] + "1e9", "efforts:"),
}


@pytest.mark.parametrize(("row", "problem"), BAD_ROWS.values(), ids=BAD_ROWS)
def test_a_bad_row_is_named(tmp_path: Path, row: str, problem: str) -> None:
    path = tmp_path / "log.csv"
    path.write_text("\n".join([ROW] * 600 + [row, ROW]) + "\n")
    with pytest.raises(LogError) as caught:
        read(path)
    assert problem in str(caught.value)
    assert str(path) in str(caught.value)
    assert caught.value.row == 601


def empty(path: Path) -> None:
    path.write_bytes(b"")


def one_row(path: Path) -> None:
    path.write_text(ROW)


def folder(path: Path) -> None:
    path.mkdir()


def absent(path: Path) -> None:
    del path


def picture(path: Path) -> None:
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + bytes(range(256)) * 20)


def endless(path: Path) -> None:
    path.write_text("1" * 200_000)


def cut_gzip(path: Path) -> None:
    packed = gzip.compress("\n".join(f"{ROW[:-1]}{k}" for k in range(5000)).encode())
    path.write_bytes(packed[: len(packed) // 2])


def false_gzip(path: Path) -> None:
    path.write_bytes(b"\x1f\x8b" + b"no gzip after all" * 20)


def damaged_gzip(path: Path) -> None:
    packed = bytearray(gzip.compress("\n".join([ROW] * 5000).encode()))
    packed[-6] ^= 0xFF  # in the check sum
    path.write_bytes(packed)


@pytest.mark.parametrize(
    ("make", "problem"),
    [
        (empty, "is empty; allowed: 2 rows or more"),
        (one_row, "got 1 row; allowed: 2 rows or more"),
        (folder, "contains no rosbag 2 file"),
        (
            absent,
            "no such file; allowed: a recording of trocar's own (MCAP), a text file of numbers"
            " (plain or gzip), an array (.npy), rosbag 1 (.bag), rosbag 2, MCAP, a dataset of"
            " LeRobot's",
        ),
        (picture, "is not text"),
        (endless, "row too long"),
        (cut_gzip, "gzip data is truncated or damaged"),
        (false_gzip, "gzip data is truncated or damaged"),
        (damaged_gzip, "gzip data is truncated or damaged"),
    ],
)
def test_what_is_no_recording_is_refused(
    tmp_path: Path, make: Callable[[Path], None], problem: str
) -> None:
    path = tmp_path / "log.csv.gz"
    make(path)
    with pytest.raises(LogError) as caught:
        read(path)
    assert problem in str(caught.value)
    assert str(path) in str(caught.value)


def test_a_truncated_gzip_file_names_the_row_where_it_ends(tmp_path: Path) -> None:
    path = tmp_path / "log.csv.gz"
    cut_gzip(path)
    with pytest.raises(LogError) as caught:
        read(path)
    assert caught.value.row is not None
    assert 1000 < caught.value.row < 5000


def test_wrist_is_motor_or_joint() -> None:
    wrong: Any = "finger"
    with pytest.raises(InputError, match="got 'finger'; allowed: motor, joint"):
        ReadSettings(wrist=wrong)
