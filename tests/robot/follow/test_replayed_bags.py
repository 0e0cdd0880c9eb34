"""Bags of a real arm replay like its rows of numbers: rosbag 1, rosbag 2, MCAP."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.robot.follow.motions import write, write_poses
from trocar.descriptions import load_arm
from trocar.errors import LogError, MissingExtraError
from trocar.geometry import quaternion_from_matrix, transform
from trocar.kinematics.chain_pose import chain_pose
from trocar.recording import record
from trocar.recording.bags import is_bag
from trocar.robot.follow import ReplaySettings, replay
from trocar.robot.recordings import ArmMotion, ReadSettings, read_arm_motion
from trocar.robot.recordings.tips import tip_motions
from trocar.simulation import World

PSM = load_arm("psm")
NAMES = PSM.mechanism.joint_names
KINDS = ("ros1", "sqlite", "mcap", "mcap file")
RATE_HZ = 100.0
PSM1 = {"/PSM1/measured_js": NAMES[:6], "/PSM1/jaw/measured_js": ["jaw"]}


AT_200 = ReplaySettings(reading=ReadSettings(rate_hz=200.0))


def read(bag: Path, **settings: Any) -> ArmMotion:
    return read_arm_motion(bag, PSM, ReadSettings(**settings))


def motion(rate_hz: float = RATE_HZ, seconds: float = 0.5) -> tuple[Any, Any, Any]:
    """A small swing: times (k,), positions and velocities (k, 7)."""
    time = np.arange(0.0, seconds, 1.0 / rate_hz)
    shape = np.array([0.2, 0.2, 0.02, 0.3, 0.2, 0.2, 0.3])
    middle = np.array([0.0, 0.0, 0.12, 0.0, 0.0, 0.0, 0.4])
    swing = np.sin(3.0 * time)[:, None]
    return time, middle + shape * swing, 3.0 * shape * np.cos(3.0 * time)[:, None]


def psm_bag(path: Path, kind: str, efforts: bool = True) -> Path:
    parts = [("/PSM1/measured_js", slice(0, 6)), ("/PSM1/jaw/measured_js", slice(6, 7))]
    rows = [
        (t, topic, q[part], v[part], np.full(len(q[part]), 0.01) if efforts else [])
        for t, q, v in zip(*motion(), strict=True)
        for topic, part in (*parts, ("/MTMR/measured_js", slice(0, 7)))
    ]
    return write(path, kind, rows, {**PSM1, "/MTMR/measured_js": list("abcdefg")})


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_of_bag_holds_the_same_motion(tmp_path: Path, kind: str) -> None:
    bag = psm_bag(tmp_path / "bag", kind)
    assert is_bag(bag)
    found = read_arm_motion(bag, PSM)
    rows, (_, q, v) = found.rows, motion()
    assert found.has_efforts and len(rows) == len(q)
    assert found.rate_hz == pytest.approx(RATE_HZ, rel=1e-4)
    # the times of the bag are rounded to nanoseconds, and float64 knows today to 0.2 us
    np.testing.assert_allclose(rows[:, 0], q, atol=2e-6)
    np.testing.assert_allclose(rows[:, 1], v, atol=2e-5)
    np.testing.assert_allclose(rows[:, 2], 0.01, atol=1e-12)


@pytest.mark.parametrize("kind", ["ros1", "mcap file"])
def test_a_bag_is_replayed_with_the_report_of_a_log(tmp_path: Path, kind: str) -> None:
    report = replay(psm_bag(tmp_path / "bag", kind), "psm", AT_200)
    assert report.samples == 99  # 0.49 s at 200 Hz
    assert set(report.tracking_rms) == set(NAMES)
    assert all(rms < 0.02 for rms in report.tracking_rms.values())
    assert all(share is not None for share in report.effort_relative_rms.values())


def test_without_efforts_positions_are_compared_alone(tmp_path: Path) -> None:
    bag = psm_bag(tmp_path / "bag", "mcap file", efforts=False)
    report = replay(bag, "psm")
    assert set(report.effort_relative_rms.values()) == {None}
    with pytest.raises(LogError, match="contains no efforts; allowed: mode position"):
        replay(bag, "psm", ReplaySettings(mode="effort"))


def test_a_recording_of_our_own_is_a_bag_that_a_lone_arm_follows(tmp_path: Path) -> None:
    pytest.importorskip("mcap")
    file, world = tmp_path / "run.mcap", World("psm")
    with record(world, file):
        world.arm("PSM1").move_jp([0.3, 0.2, 0.15, 0.4, 0.2, -0.3])
        world.step(500)
    found = read_arm_motion(file, PSM)
    rows = found.rows
    assert found.has_efforts
    np.testing.assert_allclose(rows[-1, 0, :6], world.arm("PSM1").measured_js().position, atol=1e-6)


def test_names_in_another_order_are_sorted_out(tmp_path: Path) -> None:
    time, q, _ = motion()
    order = [5, 3, 1, 0, 2, 4]
    told = [(t, "/PSM2/measured_js", a[order]) for t, a in zip(time, q, strict=True)]
    bag = write(tmp_path / "bag", "sqlite", told, [NAMES[k] for k in order])
    found = read_arm_motion(bag, PSM)
    np.testing.assert_allclose(found.rows[:, 0, :6], q[:, :6], atol=2e-6)
    assert not found.rows[:, :, 6].any()
    assert found.recorded[0] == set(NAMES[:6])
    assert "no jaw, velocities by differences, no efforts" in found.understood()


def test_velocities_that_were_not_recorded_are_differences(tmp_path: Path) -> None:
    time, q, v = motion()
    told = [(t, "/PSM1/measured_js", a[:6]) for t, a in zip(time, q, strict=True)]
    found = read_arm_motion(write(tmp_path / "bag", "sqlite", told, NAMES[:6]), PSM).rows
    # differences of positions that float64 rounds to 0.2 us
    np.testing.assert_allclose(found[2:-2, 1, :6], v[2:-2, :6], atol=1e-3)


def told(*rows: tuple[float, Any], arm: str = "PSM1") -> list[tuple[float, str, Any]]:
    return [(t, f"/{arm}/measured_js", q) for t, q in rows]


GOOD = np.zeros(6)
TWO = told((0.0, GOOD), (0.1, GOOD)) + told((0.0, GOOD), (0.1, GOOD), arm="PSM2")


@pytest.mark.parametrize(
    ("rows", "names", "complaint"),
    [
        (
            [(1.0, "/PSM1/status_js", GOOD)],
            NAMES[:6],
            "contains no joint states of a PSM; allowed",
        ),
        (told((1.0, GOOD)), NAMES[:6], "got 1 samples; allowed: 2 or more"),
        (told((1.0, GOOD), (4.0, GOOD)), NAMES[:6], "no two samples follow each other"),
        (told((1.0, GOOD[:3]), (1.1, GOOD[:3])), list("abc"), "got 3 joints"),
        (told((1.0, GOOD), (1.01, GOOD + np.nan)), NAMES[:6], r"row 2.*must be finite"),
        (told((1.0, GOOD), (1.1, GOOD + 9.0)), NAMES[:6], "is this a recording of a psm"),
        (
            TWO,
            (),
            r"2 topics fit a PSM; select one with --of \(PSM1, PSM2\) or --topic: /PSM1/measured",
        ),
    ],
)
def test_bags_that_cannot_be_replayed_are_refused(
    tmp_path: Path, rows: Any, names: Sequence[str], complaint: str
) -> None:
    with pytest.raises(LogError, match=complaint):
        replay(write(tmp_path / "bag", "sqlite", rows, names), "psm")


def test_a_topic_can_be_named(tmp_path: Path) -> None:
    bag = write(tmp_path / "bag", "sqlite", TWO)
    assert read(bag, topic="/PSM2/measured_js").label == "PSM2"
    with pytest.raises(LogError, match=r"has no topic '/PSM3/measured_js'; joint states are in"):
        read(bag, topic="/PSM3/measured_js")


def test_an_arm_finds_its_own_topic_among_those_of_its_type(tmp_path: Path) -> None:
    rows = told((0.0, [0.1] * 7), (0.1, [0.1] * 7), arm="MTMR")
    rows += told((0.0, [0.2] * 7), (0.1, [0.2] * 7), arm="MTML")
    found = read_arm_motion(write(tmp_path / "bag", "sqlite", rows), load_arm("mtml")).rows
    assert found.shape == (2, 3, 7)
    np.testing.assert_allclose(found[:, 0], 0.2)


def test_a_damaged_bag_and_a_missing_library_are_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bag = psm_bag(tmp_path / "bag", "mcap file")
    bag.write_bytes(bag.read_bytes()[:500])
    with pytest.raises(LogError, match="contains no joint states"):
        replay(bag, "psm")
    broken = tmp_path / "x.bag"
    broken.write_bytes(b"#ROSBAG V2.0\n" + bytes(20))
    with pytest.raises(LogError, match=r"was not closed properly|cannot be read as a bag"):
        replay(broken, "psm")
    monkeypatch.setitem(sys.modules, "rosbags.rosbag1", None)
    with pytest.raises(MissingExtraError, match=r"pip install 'trocar\[bags\]'"):
        replay(bag, "psm")


def tip_poses(q: Any) -> list[Any]:
    """Position and quaternion xyzw of the tip at joints (k, 7)."""
    turned = [(T[:3, 3], quaternion_from_matrix(T[:3, :3])) for T in chain_pose(PSM.mechanism)(q)]
    return [np.array([*p, *w[1:], w[0]]) for p, w in turned]


@pytest.mark.parametrize(
    ("topic", "kind"),
    [
        ("/PSM1/local/measured_cp", "PoseStamped"),
        ("/PSM1/measured_cp", "TransformStamped"),
        ("/dvrk/PSM1/position_cartesian_current", "PoseStamped"),
        ("/dvrk/PSM1/position_cartesian_current", "Pose"),
    ],
)
def test_a_bag_of_poses_alone_becomes_the_joints_that_bring_the_tip_there(
    tmp_path: Path, topic: str, kind: str
) -> None:
    time, q, _ = motion()
    bag = write_poses(tmp_path / "bag", topic, kind, zip(time.tolist(), tip_poses(q), strict=True))
    found = read(bag)
    assert found.label == "PSM1"
    # the times of the bag are known to 0.2 us
    np.testing.assert_allclose(found.rows[:, 0, :6], q[:, :6], atol=2e-6)
    assert "joints from poses of the tip, base in the frame of the poses" in found.understood()
    assert "no jaw" in found.understood()
    (scored,) = tip_motions(bag)
    np.testing.assert_allclose(
        scored.positions[0], chain_pose(PSM.mechanism)(q[:1])[0, :3, 3], atol=1e-9
    )


def test_poses_in_another_frame_have_the_base_that_is_given(tmp_path: Path) -> None:
    time, q, _ = motion()
    base = transform(np.diag([-1.0, -1.0, 1.0]), [0.3, 0.1, 0.2])
    away = [base @ T for T in chain_pose(PSM.mechanism)(q)]
    seen = [
        np.array([*T[:3, 3], *w[1:], w[0]])
        for T, w in ((T, quaternion_from_matrix(T[:3, :3])) for T in away)
    ]
    told = zip(time.tolist(), seen, strict=True)
    bag = write_poses(tmp_path / "bag", "/PSM1/measured_cp", "PoseStamped", told)
    with pytest.raises(LogError, match=r"poses are out of reach, the first in row 1: .*--base"):
        read(bag)
    np.testing.assert_allclose(read(bag, base=base).rows[:, 0, :6], q[:, :6], atol=2e-6)


def test_set_points_stand_for_measured_joints_that_were_not_recorded(tmp_path: Path) -> None:
    time, q, _ = motion()
    topics = (("/PSM1/setpoint_js", slice(0, 6)), ("/PSM1/jaw/setpoint_js", slice(6, 7)))
    told = [(t, topic, a[s]) for t, a in zip(time, q, strict=True) for topic, s in topics]
    bag = write(tmp_path / "bag", "sqlite", told, {t: list(NAMES[s]) for t, s in topics})
    found = read(bag)
    np.testing.assert_allclose(found.rows[:, 0], q, atol=2e-6)
    assert "set-points, no measured positions" in found.understood()
    told += [(t, "/PSM1/measured_js", a[:6] + 0.01) for t, a in zip(time, q, strict=True)]
    both = write(tmp_path / "both", "sqlite", told, {t: list(NAMES[s]) for t, s in topics})
    np.testing.assert_allclose(read(both).rows[:, 0, :6], q[:, :6] + 0.01, atol=2e-6)
    assert "set-points" not in read(both).understood()


def test_joints_of_other_names_are_taken_in_their_order_and_named(tmp_path: Path) -> None:
    names = ["waist", "shoulder", "elbow", "yaw", "pitch", "roll"]
    told = [(t, "/PSM1/measured_js", a[:6]) for t, a in zip(*motion()[:2], strict=True)]
    found = read(write(tmp_path / "bag", "sqlite", told, names))
    assert "joints waist, shoulder, elbow, yaw, pitch, roll taken in" in found.understood()
    own = [f"outer_{name}" for name in NAMES[:6]]
    assert "in their order" not in read(write(tmp_path / "own", "sqlite", told, own)).understood()


def test_noise_of_joints_at_rest_raises_no_doubt_about_the_rate(tmp_path: Path) -> None:
    q = np.array([0.1, 0.2, 0.12, 0.0, 0.0, 0.0])
    told = [
        (0.01 * k, "/PSM1/measured_js", q + 1e-9 * k, np.full(6, 1e-3), np.zeros(6))
        for k in range(100)
    ]
    assert "rate" not in read(write(tmp_path / "bag", "sqlite", told, NAMES[:6])).understood()
