"""A recording drives a lone arm; what comes out is compared with what was recorded."""

from __future__ import annotations

import importlib
import os
from collections.abc import Callable
from dataclasses import replace as changed
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from trocar.errors import InputError, LogError, UnknownNameError
from trocar.robot.follow import ReplaySettings, replay
from trocar.robot.follow.follow_log import between, pieces
from trocar.robot.recordings import ReadSettings
from trocar.simulation import World

Array = NDArray[np.float64]
module = importlib.import_module("trocar.robot.follow.follow_log")
JOINTS = ("yaw", "pitch", "insertion", "roll", "wrist_pitch", "wrist_yaw", "jaw")
PERIODS = 5
AMPLITUDES = np.array([0.3, 0.2, 0.05, 0.4, 0.2, 0.2, 0.3])
MIDDLES = np.array([0.1, 0.1, 0.14, 0.0, 0.0, 0.1, 0.5])


def smooth(count: int, period_s: float) -> tuple[Array, Array]:
    """A motion of every joint that starts and is everywhere smooth, (count, 7) each."""
    turn = 2.0 * np.pi * np.array([0.5, 0.4, 0.3, 0.6, 0.5, 0.4, 0.3])
    phase = np.outer(period_s * np.arange(count), turn)
    return MIDDLES + AMPLITUDES * np.sin(phase), AMPLITUDES * turn * np.cos(phase)


def swung(world: World) -> tuple[Array, Array, Array]:
    """What a simulated arm did in two seconds, at 200 Hz: positions, velocities, efforts."""
    q, v = smooth(2001, world.timestep)
    world.set_state("PSM1", q[0], v[0])
    played = world.play({"PSM1": q[1:]}, {"PSM1": v[1:]}, every=1)
    tables = (played.positions["PSM1"], played.velocities["PSM1"], played.efforts["PSM1"])
    rows = [table[PERIODS - 1 :: PERIODS] for table in tables]
    return rows[0], rows[1], rows[2]


@pytest.fixture(scope="module")
def recorded() -> tuple[Array, Array, Array]:
    return swung(World("psm"))


@pytest.fixture
def log(
    recorded: tuple[Array, Array, Array], write_psm_log: Callable[..., Path], tmp_path: Path
) -> Path:
    return write_psm_log(tmp_path / "log.csv.gz", *recorded)


def test_an_arm_that_follows_its_own_recording_does_the_same(log: Path) -> None:
    report = replay(log)
    assert (report.log, report.arm, report.mode) == (str(log), "psm", "position")
    assert (report.samples, report.clipped) == (400, 0)
    assert tuple(report.tracking_rms) == JOINTS
    for joint in JOINTS:  # the servos' own error: friction and inertia over the gain
        assert report.tracking_rms[joint] < (0.5e-3 if joint == "insertion" else 8e-3)
    for joint in JOINTS:  # the servos need some 30 ms to build up what the recording begins with
        assert (report.effort_relative_rms[joint] or 0.0) < 0.2


def test_recorded_efforts_open_loop_repeat_the_recorded_motion(
    write_psm_log: Callable[..., Path], tmp_path: Path
) -> None:
    """Without stop elements, which each window begins with unloaded."""
    log = write_psm_log(tmp_path / "log.csv.gz", *swung(World("psm", dynamics="cad")))
    settings = ReplaySettings(mode="effort", window_s=0.1, calibration="cad")
    report = replay(log, settings=settings)
    for joint in JOINTS:  # 200 Hz samples of the effort leave this much out
        assert report.tracking_rms[joint] < (0.1e-3 if joint == "insertion" else 2e-3)
    assert max(report.effort_rms.values()) < 1e-12


def test_without_restarts_the_open_loop_drifts_further(log: Path) -> None:
    short, long = (
        replay(log, settings=ReplaySettings(mode="effort", window_s=s)) for s in (0.1, 2.0)
    )
    assert long.tracking_rms["yaw"] > 3.0 * short.tracking_rms["yaw"]


def test_a_wrist_taken_for_the_wrong_side_is_seen_in_the_figures(log: Path) -> None:
    right = replay(log)
    wrong = replay(log, settings=ReplaySettings(reading=ReadSettings(wrist="joint")))
    assert wrong.tracking_rms["yaw"] == pytest.approx(right.tracking_rms["yaw"], rel=0.01)
    assert (right.effort_relative_rms["wrist_yaw"] or 0.0) < 0.2
    assert (wrong.effort_relative_rms["wrist_yaw"] or 0.0) > 0.5


def test_samples_beyond_a_limit_are_clipped_and_counted_in_silence(
    recorded: tuple[Array, Array, Array],
    write_psm_log: Callable[..., Path],
    tmp_path: Path,
    caplog: pytest.LogCaptureFixture,
) -> None:
    q, v, effort = (table.copy() for table in recorded)
    q[:, 6] = np.linspace(1.38, 1.4005, len(q))
    v[:, 6] = 0.0103
    q[7, 2] = -0.001
    report = replay(write_psm_log(tmp_path / "log.csv", q, v, effort))
    assert report.clipped == int((q[:, 6] > 1.39626).sum()) + 1
    assert not caplog.records
    assert report.tracking_rms["jaw"] > 1e-3  # measured against the recording, not its clipping


@pytest.mark.parametrize("periods", [5, 35, 500])
def test_how_a_recording_is_cut_makes_no_difference(
    log: Path, periods: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = replay(log)
    monkeypatch.setattr(module, "PIECE_PERIODS", periods)
    assert replay(log) == changed(
        whole,
        tracking_rms={k: pytest.approx(v, rel=1e-9) for k, v in whole.tracking_rms.items()},
        effort_rms={k: pytest.approx(v, rel=1e-9) for k, v in whole.effort_rms.items()},
        effort_relative_rms={
            k: pytest.approx(v, rel=1e-9) for k, v in whole.effort_relative_rms.items()
        },
    )


@pytest.mark.parametrize("chunk", [1, 2, 3, 5, 11, 40])
@pytest.mark.parametrize("restart", [1, 4, 10, 100])
def test_pieces_join_and_begin_afresh_when_they_are_due(chunk: int, restart: int) -> None:
    rows = np.arange(23.0)
    chunks = [rows[k : k + chunk] for k in range(0, len(rows), chunk)]
    cut = list(pieces(chunks, restart))
    assert [p[0] for p, fresh in cut if fresh] == list(range(0, 22, restart))
    np.testing.assert_array_equal(np.concatenate([rows[:1], *(p[1:] for p, _ in cut)]), rows)
    assert all(before[-1] == after[0] for (before, _), (after, _) in pairwise(cut))


def test_between_rows_the_targets_move_evenly_and_arrive() -> None:
    rows = np.array([[0.0, 1.0], [1.0, 1.0], [3.0, 0.0]])
    filled = between(rows, 4)
    np.testing.assert_allclose(filled[:, 0], [0.25, 0.5, 0.75, 1.0, 1.5, 2.0, 2.5, 3.0])
    np.testing.assert_allclose(filled[3::4], rows[1:])


def test_the_same_recording_gives_the_same_numbers(log: Path) -> None:
    assert replay(log) == replay(log)


def test_progress_reaches_the_last_row(log: Path) -> None:
    seen: list[tuple[int, int]] = []
    replay(log, progress=lambda done, total: seen.append((done, total)))
    assert seen[-1] == (400, 400)
    assert [done for done, _ in seen] == sorted(done for done, _ in seen)


@pytest.mark.parametrize("rate_hz", [0.0, float("nan"), -200.0, float("inf")])
def test_a_rate_is_above_zero(rate_hz: float) -> None:
    with pytest.raises(InputError, match=rf"rate: got {rate_hz!r} Hz; allowed: more than 0"):
        ReadSettings(rate_hz=rate_hz)


@pytest.mark.parametrize(
    ("settings", "problem"),
    [
        ({"mode": "effort", "window_s": 0.001}, "window: got 0.001 s; allowed: 0.005 s or more"),
        ({"mode": "effort", "window_s": float("nan")}, "window: got nan"),
        ({"mode": "fast"}, "mode: got 'fast'; allowed: position, effort"),
        ({"control": "best"}, "control: got 'best'"),
        ({"friction": "none"}, "friction: got 'none'"),
        ({"tool": "SPOON"}, "unknown tool 'SPOON'"),
    ],
)
def test_a_bad_setting_is_refused(log: Path, settings: dict[str, Any], problem: str) -> None:
    with pytest.raises(InputError) as caught:
        replay(log, settings=ReplaySettings(**settings))
    assert problem in str(caught.value)


def test_an_unknown_arm_is_answered_with_those_that_are_known(log: Path) -> None:
    with pytest.raises(UnknownNameError, match=r"known: .*psm"):
        replay(log, "pms")


def test_setup_joints_are_no_arm_to_replay_on(log: Path) -> None:
    with pytest.raises(InputError, match="allowed: PSM, ECM or MTM"):
        replay(log, "suj_psm1")


def test_a_recording_of_another_arm_is_refused(log: Path) -> None:
    with pytest.raises(LogError, match="row 1: got 21 columns; allowed: 12"):
        replay(log, "ecm")


def test_an_endoscope_arm_replays_its_own_recording(tmp_path: Path) -> None:
    phase = 0.01 * np.arange(200)[:, None]
    q = np.hstack([0.2 * np.sin(phase), 0.2 * np.sin(phase), 0.1 + 0.0 * phase, 0.0 * phase])
    rows = np.hstack([q, np.gradient(q, 0.005, axis=0), 0.0 * q])
    np.savetxt(tmp_path / "log.csv", rows, delimiter=",")
    report = replay(tmp_path / "log.csv", "ecm")
    assert report.tracking_rms["yaw"] < 0.02
    assert set(report.effort_relative_rms.values()) == {None}


def test_a_recording_that_breaks_off_is_refused_before_anything_moves(
    log: Path, tmp_path: Path
) -> None:
    cut = tmp_path / "cut.csv.gz"
    cut.write_bytes(log.read_bytes()[:-3000])
    seen: list[int] = []
    with pytest.raises(LogError, match="truncated"):
        replay(cut, progress=lambda done, _: seen.append(done))
    assert not seen


def test_a_master_replays_rows_and_bags_without_its_gripper(tmp_path: Path) -> None:
    """Columns 2 to 4 of rows are motor-side: the elbow is c3 - c2 (README of the recordings)."""
    phase = 0.01 * np.arange(200)
    q = np.zeros((200, 7))
    q[:, :3] = 0.3 * np.sin(phase)[:, None] * [0.5, 1.0, -0.5]
    v = np.array(np.gradient(q, 0.005, axis=0))
    motors = [np.array(q), np.array(v)]
    for side, joints in zip(motors, (q, v), strict=True):
        side[:, 2] = joints[:, 2] + joints[:, 1]  # c3
        side[:, 3] = joints[:, 3] - 0.6697 * (side[:, 1] - side[:, 2])  # c4
    np.savetxt(tmp_path / "motor.csv", np.hstack([*motors, 0.0 * q]), delimiter=",")
    np.savetxt(tmp_path / "joint.csv", np.hstack([q, v, 0.0 * q]), delimiter=",")
    motor = replay(tmp_path / "motor.csv", "mtmr")
    joint = replay(
        tmp_path / "joint.csv", "mtmr", ReplaySettings(reading=ReadSettings(wrist="joint"))
    )
    assert (motor.samples, motor.clipped, len(motor.tracking_rms)) == (200, 0, 7)
    assert all(rms < 0.02 for rms in motor.tracking_rms.values())
    for name, rms in joint.tracking_rms.items():
        assert motor.tracking_rms[name] == pytest.approx(rms, rel=1e-6, abs=1e-12)


HARDWARE = os.environ.get("TROCAR_HARDWARE_DATA", "")


@pytest.mark.skipif(
    not (Path(HARDWARE) / "psm_one_results.csv.gz").is_file(),
    reason="TROCAR_HARDWARE_DATA names no folder with psm_one_results.csv.gz, recorded on a PSM",
)
def test_a_real_arms_motion_is_followed_and_its_efforts_are_near() -> None:
    report = replay(Path(HARDWARE) / "psm_one_results.csv.gz")
    assert (report.samples, report.clipped) == (5999, 509)
    for joint, error in report.tracking_rms.items():
        assert error < (1e-3 if joint == "insertion" else 10e-3)
    assert report.effort_rms["yaw"] < 0.5
    assert report.effort_rms["pitch"] < 0.5


@pytest.mark.skipif(
    not (Path(HARDWARE) / "mtm_one_results.csv.gz").is_file(),
    reason="TROCAR_HARDWARE_DATA names no folder with mtm_one_results.csv.gz, recorded on an MTM",
)
def test_a_real_masters_motion_is_followed() -> None:
    report = replay(Path(HARDWARE) / "mtm_one_results.csv.gz", "mtmr")
    assert (report.samples, report.clipped) == (5999, 0)
    assert max(report.tracking_rms.values()) < 50e-3
    assert report.effort_rms["outer_yaw"] < 0.5
