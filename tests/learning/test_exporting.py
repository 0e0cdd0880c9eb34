"""Datasets from recordings and recordings from datasets: the same joints either way."""

from pathlib import Path

import numpy as np
import pytest

from trocar.descriptions import load_arm
from trocar.errors import InputError, LogError, UnknownNameError
from trocar.learning.collecting import Collection, collect
from trocar.learning.episodes import EpisodeLog, record_episode
from trocar.learning.exporting import export
from trocar.learning.importing import import_dataset
from trocar.learning.lerobot import open_dataset
from trocar.recording import record
from trocar.recording.bags import JointSamples, open_bag, write_joint_states
from trocar.robot.follow import ReplaySettings, replay
from trocar.robot.recordings import ReadSettings, read_arm_motion
from trocar.simulation import World
from trocar.tasks import make_task

pytest.importorskip("pyarrow", reason="the extra `learn` is not there")
pytest.importorskip("mcap.reader", reason="the extra `record` is not there")
pytest.importorskip("rosbags.typesys", reason="the extra `bags` is not there")

#: Half of the last digit of float32, as a ratio: datasets keep these.
SINGLE = 1e-7


@pytest.fixture(scope="module")
def log() -> EpisodeLog:
    return record_episode(make_task("needle-pick"), 2, mcap=True)


@pytest.fixture
def recording(log: EpisodeLog, tmp_path: Path) -> Path:
    (tmp_path / "pick.mcap").write_bytes(log.recording)
    return tmp_path / "pick.mcap"


def test_an_exported_recording_has_the_joints_tips_and_objects_of_the_episode(
    log: EpisodeLog, recording: Path, tmp_path: Path
) -> None:
    found = export([recording], tmp_path / "data", arms=["PSM1"], task="pick")
    data = open_dataset(tmp_path / "data")
    assert (found.episodes, found.arms) == (1, ("PSM1",))
    rows, seen = data.rows(0), log.readings
    assert len(rows["action"]) == len(log)
    assert data.episodes[0]["tasks"] == ["pick"]
    assert rows["observation.state"] == pytest.approx(seen.q["PSM1"][:-1], rel=SINGLE, abs=1e-9)
    assert rows["observation.objects"] == pytest.approx(seen.objects["needle"][:-1], abs=1e-7)
    names = data.features["action"].names
    assert names == data.features["observation.state"].names
    assert (names[2], names[6]) == ("PSM1.insertion_m", "PSM1.jaw_rad")
    # set-points lie between those of the controller's rows, two a period, and end on them
    assert rows["action"] == pytest.approx(seen.setpoints["PSM1"][1:], abs=1e-6)


def test_what_is_collected_imported_and_replayed_moves_the_arm_to_the_same_joints(
    tmp_path: Path,
) -> None:
    collect(Collection("needle-pick"), range(2), tmp_path / "data")
    files = import_dataset(tmp_path / "data", tmp_path / "out")
    assert [path.name for path in files] == ["episode_000000.mcap", "episode_000001.mcap"]
    data = open_dataset(tmp_path / "data")
    for k, path in enumerate(files):
        recorded = read_arm_motion(path, load_arm("psm")).rows
        q = data.rows(k)["observation.joints"]
        assert recorded[:, 0] == pytest.approx(q.astype(float), abs=1e-9)
        report = replay(path, "psm", ReplaySettings(reading=ReadSettings(of="PSM1")))
        assert (report.clipped, report.samples, report.rate_hz) == (0, len(q), 50.0)
        # servos lag by some milliseconds: 5 mrad at 0.5 rad/s, 1 mm at 0.1 m/s
        assert all(error < 0.01 for error in report.tracking_rms.values())
        assert report.tracking_rms["insertion"] < 1e-3


def test_a_recording_of_all_arms_comes_back_as_it_was(recording: Path, tmp_path: Path) -> None:
    export([recording], tmp_path / "data")
    (path,) = import_dataset(tmp_path / "data", tmp_path / "out.mcap", episode=0)
    export([path], tmp_path / "again")
    one, two = (open_dataset(tmp_path / name).rows(0) for name in ("data", "again"))
    assert set(open_dataset(tmp_path / "data").features) > {"observation.tips"}
    assert np.array_equal(two["observation.state"], one["observation.state"][:-1])
    with pytest.raises(InputError, match="exists already"):
        import_dataset(tmp_path / "data", tmp_path / "out.mcap", episode=0)


def test_each_reset_begins_an_episode(tmp_path: Path) -> None:
    world = World("psm")
    with record(world, tmp_path / "a.mcap"):
        for q, steps in ((0.1, 200), (0.2, 300), (0.3, 10)):
            world.reset()
            world.arms["PSM1"].servo_jp([q, 0.0, 0.1, 0.0, 0.0, 0.0])
            world.step(steps)
    export([tmp_path / "a.mcap"], tmp_path / "data")
    data = open_dataset(tmp_path / "data")
    assert len(data) == 2  # the third is shorter than two rows
    for k, (goal, steps) in enumerate(((0.1, 200), (0.2, 300))):
        rows = data.rows(k)
        assert abs(len(rows["action"]) - steps // 20) <= 1
        assert rows["action"][-1, 0] == pytest.approx(goal)
        assert rows["next.done"].ravel().tolist() == [False] * (len(rows["action"]) - 1) + [True]


def test_recordings_of_other_arms_are_rejected_together(recording: Path, tmp_path: Path) -> None:
    world = World("psm")
    with record(world, tmp_path / "other.mcap"):
        world.step(200)
    with pytest.raises(LogError, match=r"other.mcap: has PSM1; .* has ECM, PSM1, needle; allowed"):
        export([recording, tmp_path / "other.mcap"], tmp_path / "data")
    with pytest.raises(UnknownNameError, match=r"unknown arm 'PSM2' \(did you mean 'PSM1'\?\)"):
        export([recording], tmp_path / "data", arms=["PSM2"])
    assert not (tmp_path / "data").exists()


def test_a_bag_of_another_robot_gets_velocities_and_actions_from_its_positions(
    tmp_path: Path,
) -> None:
    times = 100.0 + np.arange(0.0, 1.0, 0.01)
    q = np.stack([times - 100.0, 2.0 * (times - 100.0)], axis=1)
    write_joint_states(
        tmp_path / "a.mcap", {"/PSM3/measured_js": JointSamples(("0", "1"), times, q)}
    )
    export([tmp_path / "a.mcap"], tmp_path / "data", rate_hz=20)
    rows = open_dataset(tmp_path / "data").rows(0)
    t = np.arange(len(rows["action"])) / 20.0
    assert len(t) == 19
    assert rows["observation.state"] == pytest.approx(np.stack([t, 2.0 * t], axis=1), abs=1e-6)
    assert rows["observation.velocities"] == pytest.approx(np.tile([1.0, 2.0], (19, 1)), abs=1e-4)
    assert rows["action"] == pytest.approx(np.stack([t + 0.05, 2.0 * t + 0.1], axis=1), abs=1e-6)


def test_bags_without_joints_are_rejected(tmp_path: Path) -> None:
    samples = JointSamples(("a",), np.arange(2.0), np.zeros((2, 1)))
    write_joint_states(tmp_path / "a.mcap", {"/joint_states": samples})
    with pytest.raises(LogError, match="contains no joint states; allowed: a topic /ARM/measured"):
        export([tmp_path / "a.mcap"], tmp_path / "data")


def test_joint_states_are_read_as_they_were_written(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    streams = {
        f"/PSM{k}/measured_js": JointSamples(
            ("a", "b"), np.arange(5) / 7.0, rng.normal(size=(5, 2))
        )
        for k in (1, 2)
    }
    write_joint_states(tmp_path / "a.mcap", streams)
    bag = open_bag(tmp_path / "a.mcap")
    assert set(bag.topics) == {"PSM1/measured_js", "PSM2/measured_js"}
    for topic, samples in streams.items():
        messages = [*bag.messages([topic.lstrip("/")])]
        assert [m.time for m in messages] == pytest.approx(samples.times, abs=1e-9)
        assert np.array_equal([m.fields["position"] for m in messages], samples.positions)
        assert tuple(messages[0].fields["name"]) == samples.names
