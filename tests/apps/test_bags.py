"""Bags of a real arm replay like its rows of numbers: rosbag 1, rosbag 2, MCAP."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from trocar.apps.replay import ReplaySettings, replay
from trocar.apps.replay.bags import is_bag, read_bag
from trocar.descriptions import load_arm
from trocar.errors import LogError, MissingExtraError
from trocar.recording import record
from trocar.simulation import World

rosbag1 = pytest.importorskip("rosbags.rosbag1")
rosbag2 = pytest.importorskip("rosbags.rosbag2")
typesys = pytest.importorskip("rosbags.typesys")
PSM = load_arm("psm")
NAMES = PSM.mechanism.joint_names
KINDS = ("rosbag1", "sqlite3", "mcap folder", "mcap file")
RATE_HZ = 100.0


def motion(rate_hz: float = RATE_HZ, seconds: float = 0.5) -> tuple[Any, Any, Any]:
    """A small swing: times (k,), positions and velocities (k, 7)."""
    time = np.arange(0.0, seconds, 1.0 / rate_hz)
    shape = np.array([0.2, 0.2, 0.02, 0.3, 0.2, 0.2, 0.3])
    middle = np.array([0.0, 0.0, 0.12, 0.0, 0.0, 0.0, 0.4])
    swing = np.sin(3.0 * time)[:, None]
    return time, middle + shape * swing, 3.0 * shape * np.cos(3.0 * time)[:, None]


def joint_state(store: Any, names: Sequence[str], at: float, values: Sequence[Any]) -> Any:
    stamp = store.types["builtin_interfaces/msg/Time"](int(at), round((at % 1.0) * 1e9))
    header_type = store.types["std_msgs/msg/Header"]
    header = (
        header_type(seq=0, stamp=stamp, frame_id="")
        if "seq" in header_type.__dataclass_fields__
        else header_type(stamp=stamp, frame_id="")
    )
    arrays = [np.array(v, np.float64) for v in values]
    return store.types["sensor_msgs/msg/JointState"](header, list(names), *arrays)


def write(
    path: Path, kind: str, topics: Mapping[str, tuple[Sequence[str], list[tuple[Any, Any]]]]
) -> Path:
    """Write a bag: {topic: (joint names, [(time, (positions, velocities, efforts))])}."""
    one = kind == "rosbag1"
    store = typesys.get_typestore(typesys.Stores.ROS1_NOETIC if one else typesys.Stores.ROS2_HUMBLE)
    if one:
        path = path.with_suffix(".bag")
        bag = rosbag1.Writer(path)
        pack: Callable[..., Any] = store.serialize_ros1
    else:
        plugin = rosbag2.StoragePlugin.SQLITE3 if kind == "sqlite3" else rosbag2.StoragePlugin.MCAP
        bag = rosbag2.Writer(path, version=9, storage_plugin=plugin)
        pack = store.serialize_cdr
    kind_name = "sensor_msgs/msg/JointState"
    with bag:
        for topic, (names, rows) in topics.items():
            connection = bag.add_connection(topic, kind_name, typestore=store)
            for at, values in rows:
                data = pack(joint_state(store, names, at, values), kind_name)
                bag.write(connection, round(at * 1e9), data)
    return next(path.glob("*.mcap")) if kind == "mcap file" else path


def psm_bag(path: Path, kind: str, efforts: bool = True) -> Path:
    time, q, v = motion()
    tau = 0.01 * np.ones_like(q)
    start = 1_700_000_000.0

    def rows(columns: slice) -> list[tuple[float, Any]]:
        return [
            (start + t, (a[columns], b[columns], c[columns] if efforts else []))
            for t, a, b, c in zip(time, q, v, tau, strict=True)
        ]

    return write(
        path,
        kind,
        {
            "/PSM1/measured_js": (NAMES[:6], rows(slice(0, 6))),
            "/PSM1/jaw/measured_js": (["jaw"], rows(slice(6, 7))),
            "/MTMR/measured_js": (list("abcdefg"), rows(slice(0, 7))),
        },
    )


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_of_bag_holds_the_same_motion(tmp_path: Path, kind: str) -> None:
    bag = psm_bag(tmp_path / "bag", kind)
    assert is_bag(bag)
    rows, has_efforts = read_bag(bag, PSM, RATE_HZ)
    _, q, v = motion()
    assert has_efforts and len(rows) == len(q)
    # the times of the bag are rounded to nanoseconds, and float64 knows today to 0.2 us
    np.testing.assert_allclose(rows[:, 0], q, atol=2e-6)
    np.testing.assert_allclose(rows[:, 1], v, atol=2e-5)
    np.testing.assert_allclose(rows[:, 2], 0.01, atol=1e-12)


@pytest.mark.parametrize("kind", ["rosbag1", "mcap file"])
def test_a_bag_is_replayed_with_the_report_of_a_log(tmp_path: Path, kind: str) -> None:
    report = replay(psm_bag(tmp_path / "bag", kind), "psm", ReplaySettings(rate_hz=200.0))
    assert report.samples == 99  # 0.49 s at 200 Hz
    assert set(report.tracking_rms) == set(NAMES)
    assert all(rms < 0.02 for rms in report.tracking_rms.values())
    assert all(share is not None for share in report.effort_relative_rms.values())


def test_without_efforts_positions_are_compared_alone(tmp_path: Path) -> None:
    bag = psm_bag(tmp_path / "bag", "mcap file", efforts=False)
    report = replay(bag, "psm")
    assert set(report.effort_relative_rms.values()) == {None}
    with pytest.raises(LogError, match="holds no efforts; allowed: mode position"):
        replay(bag, "psm", ReplaySettings(mode="effort"))


def test_a_recording_of_our_own_is_a_bag_that_a_lone_arm_follows(tmp_path: Path) -> None:
    pytest.importorskip("mcap")
    file, world = tmp_path / "run.mcap", World("psm")
    with record(world, file):
        world.arm("PSM1").move_jp([0.3, 0.2, 0.15, 0.4, 0.2, -0.3])
        world.step(500)
    rows, has_efforts = read_bag(file, PSM, 50.0)
    assert has_efforts
    np.testing.assert_allclose(rows[-1, 0, :6], world.arm("PSM1").measured_js().position, atol=1e-6)


def test_names_in_another_order_are_sorted_out(tmp_path: Path) -> None:
    time, q, v = motion()
    order = [5, 3, 1, 0, 2, 4]
    rows = [(1.0 + t, (a[order], b[order], [])) for t, a, b in zip(time, q, v, strict=True)]
    topics = {"/PSM2/measured_js": ([NAMES[k] for k in order], rows)}
    found, _ = read_bag(write(tmp_path / "bag", "sqlite3", topics), PSM, RATE_HZ)
    np.testing.assert_allclose(found[:, 0, :6], q[:, :6], atol=2e-6)
    assert not found[:, :, 6].any()


def test_velocities_that_were_not_recorded_are_differences(tmp_path: Path) -> None:
    time, q, v = motion()
    rows = [(1.0 + t, (a[:6], [], [])) for t, a in zip(time, q, strict=True)]
    topics = {"/PSM1/measured_js": (NAMES[:6], rows)}
    found, _ = read_bag(write(tmp_path / "bag", "sqlite3", topics), PSM, RATE_HZ)
    # second-order differences: h^2 w^3 / 6, at the ends of first order
    np.testing.assert_allclose(found[2:-2, 1, :6], v[2:-2, :6], atol=1e-3)


def one(rows: list[tuple[float, Any]], names: Sequence[str] = NAMES[:6]) -> dict[str, Any]:
    return {"/PSM1/measured_js": (names, rows)}


GOOD = (np.zeros(6), [], [])


@pytest.mark.parametrize(
    ("topics", "complaint"),
    [
        ({"/PSM1/setpoint_js": (NAMES[:6], [(1.0, GOOD)])}, "holds no joint states; allowed"),
        (one([(1.0, GOOD)]), "got 1 samples; allowed: 2 or more"),
        (one([(1.0, GOOD), (4.0, GOOD)]), r"row 2: /PSM1/measured_js: a gap of 3 s"),
        (one([(t, (np.zeros(3), [], [])) for t in (1.0, 1.1)], list("abc")), "got 3 joints"),
        (one([(1.0, GOOD), (1.01, (np.full(6, np.nan), [], []))]), "row 2.*must be finite"),
        (one([(1.0, GOOD), (1.1, (np.full(6, 9.0), [], []))]), "is this a recording of a psm"),
        (
            {f"/PSM{k}/measured_js": (NAMES[:6], [(1.0, GOOD), (1.1, GOOD)]) for k in (1, 2)},
            r"2 topics fit a PSM; name one \(--topic\): /PSM1/measured_js, /PSM2/measured_js",
        ),
    ],
)
def test_bags_that_cannot_be_replayed_are_refused(
    tmp_path: Path, topics: Any, complaint: str
) -> None:
    with pytest.raises(LogError, match=complaint):
        replay(write(tmp_path / "bag", "sqlite3", topics), "psm")


def test_a_topic_can_be_named(tmp_path: Path) -> None:
    topics = {f"/PSM{k}/measured_js": (NAMES[:6], [(1.0, GOOD), (1.1, GOOD)]) for k in (1, 2)}
    bag = write(tmp_path / "bag", "sqlite3", topics)
    assert len(read_bag(bag, PSM, 100.0, "/PSM2/measured_js")[0]) == 11
    with pytest.raises(LogError, match=r"has no topic '/PSM3/measured_js'; joint states are in"):
        read_bag(bag, PSM, 100.0, "/PSM3/measured_js")


def test_a_damaged_bag_and_a_missing_library_are_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bag = psm_bag(tmp_path / "bag", "mcap file")
    bag.write_bytes(bag.read_bytes()[:500])
    with pytest.raises(LogError, match="holds no joint states"):
        replay(bag, "psm")
    broken = tmp_path / "x.bag"
    broken.write_bytes(b"#ROSBAG V2.0\n" + bytes(20))
    with pytest.raises(LogError, match="cannot be read as a bag"):
        replay(broken, "psm")
    monkeypatch.setitem(sys.modules, "rosbags.highlevel", None)
    with pytest.raises(MissingExtraError, match=r"pip install 'trocar\[bags\]'"):
        replay(bag, "psm")
