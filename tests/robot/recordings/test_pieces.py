"""Logs of real sessions: pauses, lost rows, clocks that jump or are set."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from trocar.descriptions import load_arm
from trocar.errors import LogError
from trocar.robot.follow import ReplaySettings, replay
from trocar.robot.identification import filtered, read_motion
from trocar.robot.identification.logs import default_filters
from trocar.robot.recordings import ReadSettings, read_arm_motion

Array = NDArray[np.float64]
ECM = load_arm("ecm")
NAMES = ECM.mechanism.joint_names
HEADER = ",".join(
    ["time", *(f"{j}_{w}" for w in ("position", "velocity", "effort") for j in NAMES)]
)


def session(count: int = 800, rate_hz: float = 100.0) -> tuple[Array, Array]:
    """Times and rows of positions, velocities, efforts."""
    time = np.arange(count) / rate_hz
    phase = 1.3 * time[:, None] + np.arange(4)
    middle, size = np.array([0.0, 0.1, 0.12, 0.0]), np.array([0.2, 0.2, 0.03, 0.2])
    v = 1.3 * size * np.cos(phase)
    return time, np.hstack([middle + size * np.sin(phase), v, v + 0.1])


def write(path: Path, time: Array, rows: Array) -> Path:
    table = np.column_stack([time, rows])
    text = "\n".join(",".join("" if np.isnan(v) else f"{v:.12g}" for v in row) for row in table)
    path.write_text(f"{HEADER}\n{text}\n")
    return path


def test_a_pause_ends_a_piece_and_is_left_out_of_the_figures(tmp_path: Path) -> None:
    time, rows = session(400)
    keep = np.r_[0:150, 250:400]
    whole = replay(write(tmp_path / "whole.csv", time, rows), "ecm")
    time = np.where(np.arange(400) >= 250, time + 30.0, time)
    report = replay(write(tmp_path / "paused.csv", time[keep], rows[keep]), "ecm")
    assert (report.pieces, report.samples) == (2, 300)
    assert "pauses of up to 31 s, 2 pieces" in report.understood
    for joint, error in report.tracking_rms.items():
        assert error < 2.0 * whole.tracking_rms[joint]


def test_a_clock_that_is_set_makes_two_pieces(tmp_path: Path) -> None:
    time, rows = session(400)
    time[200:] -= 3600.0
    found = read_arm_motion(write(tmp_path / "log.csv", time, rows), ECM)
    assert found.starts == (0, 200)
    assert "the clock goes back 1 times" in found.understood()
    assert found.rate_hz == pytest.approx(100.0)


def test_a_stamp_astray_is_left_out(tmp_path: Path) -> None:
    time, rows = session(400)
    time[123] += 5000.0
    found = read_arm_motion(write(tmp_path / "log.csv", time, rows), ECM)
    assert found.starts == (0,) and len(found.times) == 399
    assert "1 samples of times apart from all others were left out" in found.understood()


def test_samples_that_came_a_few_late_are_put_in_their_order(tmp_path: Path) -> None:
    time, rows = session(400)
    order = np.arange(400)
    order[[50, 51, 52]], order[[300, 301]] = [51, 52, 50], [301, 300]
    time[350:] -= 100.0  # a clock that is set stays a piece of its own
    found = read_arm_motion(write(tmp_path / "log.csv", time[order], rows[order]), ECM)
    assert found.starts == (0, 350)
    assert (np.diff(found.times[:350]) > 0.0).all()
    np.testing.assert_allclose(found.rows[:, 0], rows[:, :4], atol=1e-11)
    assert "2 samples that came late put in their order" in found.understood()


def test_repeated_stamps_and_rows_without_numbers_are_left_out(tmp_path: Path) -> None:
    time, rows = session(400)
    time[50] = time[49]
    rows[100:102, 1] = np.nan
    rows[200, 6] = np.nan  # a velocity: filled in
    found = read_arm_motion(write(tmp_path / "log.csv", time, rows), ECM)
    assert len(found.times) == 397
    assert "2 of 400 rows without positions left out" in found.understood()
    assert "1 samples repeat a time and were left out" in found.understood()
    row = int(np.flatnonzero(np.isclose(found.times, 2.0))[0])
    assert found.rows[row, 1, 2] == pytest.approx(session()[1][200, 6], abs=1e-3)


def test_rows_that_were_cut_out_without_times_are_seen_by_a_jump(tmp_path: Path) -> None:
    """Recorders that write only while a pedal is down leave no pause in rows without times."""
    _, rows = session(400)
    rows[200:, :4] += 0.2, 0.1, 0.02, 0.0
    path = tmp_path / "rows.csv"
    np.savetxt(path, rows, delimiter=",")
    found = read_arm_motion(path, ECM, ReadSettings(rate_hz=100.0))
    assert found.starts == (0, 200)
    astray = session(400)[1]
    astray[200, 0] += 0.3
    np.savetxt(path, astray, delimiter=",")
    assert read_arm_motion(path, ECM, ReadSettings(rate_hz=100.0)).starts == (0,)


def test_rows_that_were_cut_out_leave_a_jump_that_ends_a_piece_with_times_too(
    tmp_path: Path,
) -> None:
    time, rows = session(400)
    rows[200:, :4] += 0.5, 0.3, 0.06, 0.0
    found = read_arm_motion(write(tmp_path / "log.csv", time, rows), ECM)
    assert found.starts == (0, 200)
    assert "1 jumps of the joints, 2 pieces" in found.understood()
    time, rows = session(400)
    time[200:240] = 2.395 + 1e-5 * np.arange(40)  # stamped in a burst, after a delay
    found = read_arm_motion(write(tmp_path / "burst.csv", time, rows), ECM)
    assert found.starts == (0,)


def test_an_arm_that_cannot_follow_names_row_time_joint_and_distance(tmp_path: Path) -> None:
    time, rows = session(400)
    q = np.zeros((400, 6))
    q[:, 2] = 0.12
    q[200:, 3] = 3.0  # slower than what ends a piece
    path = tmp_path / "roll.csv"
    header = "time,q1,q2,q3,q4,q5,q6"
    np.savetxt(path, np.column_stack([time, q]), delimiter=",", header=header, comments="")
    fault = r"row 202: roll moves by 3 rad in 0\.01 s, at t = 2\.000 s, and the arm cannot follow"
    with pytest.raises(LogError, match=fault + ": FAULT: tracking error of roll"):
        replay(path, "psm")
    rows[200:, 2] += 0.01
    rows[200, 6] = 9.0
    speed = (
        r"row 202: insertion moves by 0\.0\d+ m in 0\.01 s, at t = 2\.000 s, .*: at 9 m/s; allowed"
    )
    with pytest.raises(LogError, match=speed):
        replay(write(tmp_path / "log.csv", time, rows), "ecm")


def test_waypoints_seconds_apart_are_one_motion(tmp_path: Path) -> None:
    time, rows = session(12, 0.5)
    path = write(tmp_path / "log.csv", time, 0.0 * rows)
    how = ReadSettings(columns=("time=0[s]", "position=1:5"))
    report = replay(path, "ecm", ReplaySettings(reading=how))
    assert (report.pieces, report.rate_hz, report.samples) == (1, 1.0, 23)


def test_each_piece_of_a_log_is_filtered_by_itself(tmp_path: Path) -> None:
    time, rows = session(1600)
    keep = np.r_[0:500, 510:1100, 1130:1600]
    read = read_motion(write(tmp_path / "log.csv", time[keep], rows[keep]), ECM)
    assert read.starts == (0, 500, 1090)
    assert "used 15.6 of 16.0 s in 3 of 3 pieces" in read.understood
    settings = default_filters(ECM)
    found = filtered(read, ECM, settings)
    alone = read_motion(write(tmp_path / "alone.csv", time[510:1100], rows[510:1100]), ECM)
    other = filtered(alone, ECM, settings)
    np.testing.assert_allclose(found.motion.qdd[500:1090], other.motion.qdd, atol=1e-9)
    np.testing.assert_allclose(found.cut(found.effort)[300:690], other.cut(other.effort), atol=1e-9)
    assert len(found.cut(found.effort)) == 1560 - 3 * 200


def test_single_lost_rows_are_filled_in_and_short_pieces_left_out(tmp_path: Path) -> None:
    time, rows = session(1000)
    rng = np.random.default_rng(1)
    keep = np.setdiff1d(np.arange(1000), rng.choice(np.arange(5, 600), 12, replace=False))
    keep = keep[(keep < 620) | (keep > 640) & (keep < 700) | (keep > 760) & (keep < 800)]
    read = read_motion(write(tmp_path / "log.csv", time[keep], rows[keep]), ECM)
    assert read.starts == (0,) and len(read.q) == 620
    assert "used 6.2 of" in read.understood
    # a lost row is filled in along a chord: (2 h)^2 w^2 / 8
    np.testing.assert_allclose(read.q, rows[:620, :4], atol=2e-4)


@pytest.mark.parametrize("rate_hz", [24.0, 30.0, 60.0, 333.0, 1000.0, 2400.0])
def test_any_rate_is_played_in_its_own_time(tmp_path: Path, rate_hz: float) -> None:
    time, rows = session(round(2.0 * rate_hz), rate_hz)
    report = replay(write(tmp_path / "log.csv", time, rows), "ecm")
    assert report.samples / report.rate_hz == pytest.approx(2.0, abs=2.0 / rate_hz + 2e-3)
    slow = replay(
        write(tmp_path / "log.csv", time, rows), "ecm",
        ReplaySettings(reading=ReadSettings(rate_hz=50.0)),
    )  # fmt: skip
    assert slow.rate_hz == 50.0
    assert report.tracking_rms["yaw"] == pytest.approx(slow.tracking_rms["yaw"], rel=0.2)
