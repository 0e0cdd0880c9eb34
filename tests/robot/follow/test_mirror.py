"""The simulated arms are where the recorded ones were, and nowhere else."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from tests.robot.follow.motions import MIDDLE, Row, motion, rows, write
from trocar.descriptions import load_arm
from trocar.errors import InputError
from trocar.live import Loop
from trocar.live.loop import SERVER_TICK_S
from trocar.robot.follow import BagSource, Mirror, MirrorReport, open_bag
from trocar.robot.recordings import ReadSettings, read_arm_motion
from trocar.robot.recordings.table_bag import bag_of_table
from trocar.simulation import World


class Seen:
    """Notes where arms are after every tick."""

    def __init__(self, world: World, arms: Sequence[str]) -> None:
        self._world, self._arms = world, arms
        self.time: list[float] = []
        self.q: dict[str, list[np.ndarray]] = {arm: [] for arm in arms}

    def ticked(self, elapsed) -> None:
        self.time.append(elapsed.simulated_s)
        for arm in self._arms:
            self.q[arm].append(self._world.arm(arm).joints.readings()[0])

    def patience(self) -> int:
        return 1

    def refused(self, command, reason) -> None:
        raise AssertionError((command, reason))


def follow(
    bag: Path, rig: str = "two_psm_ecm", *, arms: Sequence[str] | None = None, by: str = "set"
) -> tuple[Seen, MirrorReport]:
    """Run a bag to its end, as fast as it goes."""
    world = World(rig)
    loop = Loop(world, speed="max", tick_s=SERVER_TICK_S)
    mirror = Mirror(loop, BagSource(open_bag(bag)), arms, by)  # type: ignore[arg-type]
    mirror.start()
    seen = Seen(world, list(mirror.twins))
    loop.watch(seen)
    for _ in range(200_000):
        loop.tick()
        if mirror.over.is_set():
            break
    mirror.close()
    return seen, mirror.report()


def lag_of(seen: Seen, arm: str, joint: int = 0) -> float:
    """Return by how much a joint is later than the recorded motion: the best shift [s]."""
    time = np.array(seen.time)
    q = np.array([row[joint] for row in seen.q[arm]])
    use = (time > 0.5) & (time < time[-1] - 0.1)
    shifts = np.arange(-0.005, 0.040, 0.0005)
    misses = [
        np.abs(q[use] - [motion(arm, t - shift)[joint] for t in time[use]]).mean()
        for shift in shifts
    ]
    return float(shifts[int(np.argmin(misses))])


@pytest.mark.slow
def test_arms_follow_a_bag_of_200_hz_within_ten_milliseconds(tmp_path: Path) -> None:
    path = write(tmp_path / "a.bag", "ros1", rows(["PSM1", "PSM2", "ECM"], 3.0))
    seen, report = follow(path)
    for arm in MIDDLE:
        assert 0.0 < lag_of(seen, arm) <= 0.010, arm
        told = report.arms[arm]
        assert told.heard == 600
        assert told.rate_hz == pytest.approx(200.0, abs=0.5)
        assert told.lag_ms_max <= 10.0
        last = seen.q[arm][-1][: len(MIDDLE[arm])]
        np.testing.assert_allclose(last, motion(arm, 2.995), atol=1e-6)
    jaw = seen.q["PSM1"][-1][6]
    assert jaw == pytest.approx(0.4 + 0.3 * np.sin(2.995), abs=1e-6)


def test_servos_follow_too(tmp_path: Path) -> None:
    path = write(tmp_path / "a.bag", "sqlite", rows(["PSM1"], 3.0))
    seen, report = follow(path, "psm", by="servo")
    assert report.arms["PSM1"].heard == 600
    assert (
        lag_of(seen, "PSM1") < 0.1
    )  # the dVRK's own gains lag by D / P = 50 ms without velocities
    assert np.abs(seen.q["PSM1"][-1][:6] - motion("PSM1", 2.995)).max() < 0.1


def test_the_same_bag_moves_the_arms_alike_each_time(tmp_path: Path) -> None:
    path = write(tmp_path / "a.bag", "mcap", rows(["PSM1"], 1.0))
    first, second = (follow(path, "psm")[0] for _ in range(2))
    assert np.array_equal(first.q["PSM1"], second.q["PSM1"])


def test_silence_holds_and_is_said_and_so_is_the_return(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    told = [(t if t < 1.0 else t + 1.2, topic, q) for t, topic, q in rows(["ECM", "PSM1"], 2.0)]
    kept = [row for row in told if row[1] != "/ECM/measured_js" or row[0] < 1.0 or row[0] > 2.5]
    path = write(tmp_path / "a.bag", "ros1", kept)
    with caplog.at_level(logging.WARNING, "trocar"):
        seen, report = follow(path)
    said = [r.getMessage() for r in caplog.records]
    assert "ECM: no message for 500 ms; holding position" in said
    assert "PSM1: no message for 500 ms; holding position" in said
    assert any(text.startswith("PSM1: messages received again after 1.2") for text in said)
    assert any(text.startswith("ECM: messages received again after 1.5") for text in said)
    assert any("ended after" in text and "hold" in text for text in said)
    assert (report.arms["ECM"].gaps, report.arms["PSM1"].gaps) == (1, 1)
    still = [q for t, q in zip(seen.time, seen.q["ECM"], strict=True) if 1.1 < t < 2.4]
    assert np.ptp(np.array(still), axis=0).max() < 1e-6


def test_a_bag_without_the_topics_lists_those_that_it_has(tmp_path: Path) -> None:
    path = write(tmp_path / "a.bag", "ros1", rows(["PSM2"], 0.1))
    with pytest.raises(InputError, match=r"has no /PSM1/measured_js; its joint states: .*/PSM2/"):
        follow(path, "psm")
    with pytest.raises(InputError, match=r"has no /ECM/measured_js; its joint states: /PSM2/jaw"):
        follow(path, arms=["PSM2", "ECM"])
    with pytest.raises(InputError, match="unknown arm 'PSM9'"):
        follow(path, arms=["PSM9"])


def test_arms_that_are_not_asked_for_or_not_told_of_stay(tmp_path: Path) -> None:
    path = write(tmp_path / "a.bag", "ros1", rows(["PSM1", "PSM2"], 0.5))
    world = World("two_psm_ecm")
    before = {name: arm.joints.readings()[0] for name, arm in world.arms.items()}
    loop = Loop(world, speed="max", tick_s=SERVER_TICK_S)
    mirror = Mirror(loop, BagSource(open_bag(path)), ["PSM1"])
    mirror.start()
    while not mirror.over.is_set():
        loop.tick()
    for name in ("PSM2", "ECM"):
        assert np.abs(world.arm(name).joints.readings()[0] - before[name]).max() < 1e-3
    assert np.abs(world.arm("PSM1").joints.readings()[0] - before["PSM1"]).max() > 0.1


def test_namespaces_names_and_limits(tmp_path: Path) -> None:
    q = motion("PSM1", 0.0)
    joints = ["yaw", "pitch", "insertion", "roll", "wrist_pitch", "wrist_yaw"]
    turned = [joints[k] for k in (5, 4, 3, 2, 1, 0)]
    far = q.copy()
    far[0] = 9.0
    told: list[Row] = [(0.01 * k, "/lab/PSM1/measured_js", far[::-1]) for k in range(20)]
    path = write(tmp_path / "a.bag", "ros1", told, turned)
    seen, report = follow(path, "psm")
    assert report.arms["PSM1"].clipped == 20
    last = seen.q["PSM1"][-1]
    assert last[0] == pytest.approx(1.588)  # its limit
    np.testing.assert_allclose(last[1:6], q[1:], atol=1e-6)


def test_messages_that_cannot_be_used_move_nothing(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    q = motion("PSM1", 0.0)
    told: list[Row] = [(0.005 * k, "/PSM1/measured_js", q) for k in range(20)]
    told += [(0.2, "/PSM1/measured_js", [1.0, 2.0]), (0.3, "/PSM1/measured_js", [np.nan] * 6)]
    with caplog.at_level(logging.WARNING, "trocar"):
        seen, report = follow(write(tmp_path / "a.bag", "sqlite", told), "psm")
    assert report.arms["PSM1"].refused == 2
    assert any("got 2 joints; allowed: 6 (yaw, pitch" in r.getMessage() for r in caplog.records)
    np.testing.assert_allclose(seen.q["PSM1"][-1][:6], q, atol=1e-6)


def test_setup_joints_and_masters_follow_with_brakes_and_springs(tmp_path: Path) -> None:
    suj = np.array([0.05, -0.5, -0.8, -0.6, -0.2, -0.4])
    mtm = np.array([0.2, 0.2, 0.1, 0.1, 0.5, 0.1, 0.2])
    told: list[Row] = []
    for k in range(200):
        told.append((0.005 * k, "/SUJ/PSM1/measured_js", suj))
        told.append((0.005 * k, "/MTMR/measured_js", mtm))
        told.append((0.005 * k, "/MTMR/gripper/measured_js", [0.3]))
    seen, report = follow(write(tmp_path / "a.bag", "ros1", told), "full_cart_mtm")
    assert set(report.arms) == {"SUJ_PSM1", "MTMR"}
    np.testing.assert_allclose(seen.q["SUJ_PSM1"][-1], suj, atol=1e-6)
    np.testing.assert_allclose(seen.q["MTMR"][-1][:7], mtm, atol=1e-6)
    assert seen.q["MTMR"][-1][7] == pytest.approx(0.3, abs=0.01)


def moved(seen: Seen, arm: str = "PSM1") -> np.ndarray:
    return seen.q[arm][-1]


OLD = [
    ("/dvrk/PSM1/state_joint_current", "/dvrk/PSM1/state_jaw_current"),
    ("/dvrk/PSM1/position_joint_current", "/dvrk/PSM1/state_jaw_current"),
    ("/psm1/measured_js", "/psm1/jaw/measured_js"),
    ("/lab/psm1/measured_js", "/lab/psm1/jaw/measured_js"),
]


@pytest.mark.parametrize(("topic", "jaw"), OLD)
def test_topics_of_older_versions_lower_case_and_prefixes_are_known(
    tmp_path: Path, topic: str, jaw: str
) -> None:
    q = motion("PSM1", 0.0)
    told: list[Row] = []
    for k in range(20):
        told += [(0.005 * k, topic, q), (0.005 * k, jaw, [0.6])]
    path = write(tmp_path / "a.bag", "ros1", told)
    seen, report = follow(path, "psm")
    assert report.arms["PSM1"].heard == 20
    np.testing.assert_allclose(moved(seen), [*q, 0.6], atol=1e-6)
    found = read_arm_motion(path, load_arm("psm"))
    np.testing.assert_allclose(found.rows[:, 0], np.tile([*q, 0.6], (20, 1)), atol=1e-9)
    assert found.label.upper() == "PSM1"


def test_topics_and_jaws_can_be_named(tmp_path: Path) -> None:
    q = motion("PSM1", 0.0)
    told: list[Row] = []
    for k in range(20):
        told += [(0.005 * k, "/left/state", q), (0.005 * k, "/left/grip", [0.6])]
    path = write(tmp_path / "a.bag", "ros1", told)
    with pytest.raises(
        InputError,
        match=r"has no /PSM1/measured_js; its joint states: /left/grip, .*--topic ARM=TOPIC",
    ):
        follow(path, "psm")
    loop = Loop(World("psm"), speed="max", tick_s=SERVER_TICK_S)
    source = BagSource(open_bag(path))
    with pytest.raises(InputError, match=r"has no joint states in /x; they are in: /left"):
        Mirror(loop, source, topics={"PSM1": "/x"})
    with pytest.raises(InputError, match="unknown arm 'PSM7'"):
        Mirror(loop, source, topics={"PSM7": "/left/state"})
    mirror = Mirror(loop, source, topics={"PSM1": "/left/state"}, jaws={"PSM1": "left/grip"})
    mirror.start()
    while not mirror.over.is_set():
        loop.tick()
    assert loop.world.arm("PSM1").jaw is not None
    np.testing.assert_allclose(loop.world.arm("PSM1").joints.readings()[0], [*q, 0.6], atol=1e-6)
    how = ReadSettings(topic="/left/state", jaw="/left/grip")
    found = read_arm_motion(path, load_arm("psm"), how)
    np.testing.assert_allclose(found.rows[:, 0], np.tile([*q, 0.6], (20, 1)), atol=1e-9)


def test_set_points_are_followed_where_nothing_was_measured(tmp_path: Path) -> None:
    told = [(t, topic.replace("measured", "setpoint"), q) for t, topic, q in rows(["PSM1"], 0.5)]
    seen, report = follow(write(tmp_path / "a.bag", "sqlite", told))
    assert report.arms["PSM1"].heard == 100
    np.testing.assert_allclose(seen.q["PSM1"][-1][:6], motion("PSM1", 0.495), atol=1e-6)
    assert seen.q["PSM1"][-1][6] > 0.3


def test_joints_of_other_names_are_followed_in_their_order_with_one_warning(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    told = [(t, "/PSM1/measured_js", motion("PSM1", t)) for t in (0.0, 0.1, 0.2)]
    follow(write(tmp_path / "a.bag", "sqlite", told, ["waist", *"bcde", "roll"]))
    assert caplog.text.count("PSM1: joints waist, b, c, d, e, roll taken in their order") == 1
    caplog.clear()
    outer = ["yaw", "pitch", "insertion", "roll", "wrist_pitch", "wrist_yaw"]
    follow(write(tmp_path / "b.bag", "sqlite", told, [f"outer_{name}" for name in outer]))
    assert "taken in their order" not in caplog.text


def test_a_table_is_mirrored_like_a_bag(tmp_path: Path) -> None:
    arms = ("PSM1", "PSM2")
    names = ["yaw", "pitch", "insertion", "roll", "wrist_pitch", "wrist_yaw"]
    lines = [",".join(["time", *(f"{arm}_{name}" for arm in arms for name in names)])]
    for k in range(60):
        values = [k / 30.0, *(v for arm in arms for v in motion(arm, k / 30.0))]
        lines.append(",".join(f"{value:.9g}" for value in values))
    path = tmp_path / "log.csv"
    path.write_text("\n".join(lines))
    world = World("two_psm_ecm")
    described = {arm.name: arm.arm for arm in world.rig.arms}
    loop = Loop(world, speed="max", tick_s=SERVER_TICK_S)
    understood: list[str] = []
    mirror = Mirror(loop, BagSource(bag_of_table(path, described, watch=understood.append)))
    said = "6 joints at 30.0 Hz, no jaw, velocities by differences, no efforts"
    assert understood == [f"{arm}: {said}" for arm in arms]
    mirror.start()
    while not mirror.over.is_set():
        loop.tick()
    loop.tick()
    assert set(mirror.report().arms) == set(arms)
    for arm in arms:
        found = world.arm(arm).joints.readings()[0][:6]
        np.testing.assert_allclose(found, motion(arm, 59 / 30.0), atol=1e-6)
