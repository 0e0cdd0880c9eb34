"""Bags of a real arm replay like its rows of numbers: rosbag 1, rosbag 2, MCAP."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.robot.follow.motions import write
from trocar.descriptions import load_arm
from trocar.errors import LogError, MissingExtraError
from trocar.recording import record
from trocar.recording.bags import is_bag
from trocar.robot.follow import ReplaySettings, replay
from trocar.robot.recordings import ArmMotion, ReadSettings, read_arm_motion
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
            [(1.0, "/PSM1/setpoint_js", GOOD)],
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
            r"2 topics fit a PSM; select one with --topic: /PSM1/measured_js, /PSM2/measured_js",
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
