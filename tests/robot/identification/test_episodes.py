"""Episodes of SurgSync and of its part of Open-H, of which these are made, are logs."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from trocar.cli import main
from trocar.descriptions import load_arm
from trocar.errors import LogError
from trocar.robot.identification import JointMotion, predicted_efforts, read_motion
from trocar.robot.identification.drivetrains import described_trains
from trocar.robot.identification.episodes import episode_arms
from trocar.robot.standing import standing_arm

pyarrow: Any = pytest.importorskip("pyarrow", reason="pyarrow is not installed (extra learn)")
from pyarrow import parquet  # noqa: E402

Array = NDArray[np.float64]
RATE_HZ, SECONDS = 10.0, 40.0
ARMS = {"ECM": "ecm_si", "PSM1": "psm_si", "PSM2": "psm_si"}


def moved(name: str, drop: slice = slice(0, 0)) -> tuple[Array, Array, Array, Array]:
    """Return times [s], positions, velocities and efforts of a slow motion of an arm."""
    stand = standing_arm(name, rig="full_cart_si")
    arm = stand.arm
    time = np.delete(np.arange(round(SECONDS * RATE_HZ)) / RATE_HZ, drop)
    span = arm.mechanism.upper - arm.mechanism.lower
    middle = 0.5 * (arm.mechanism.lower + arm.mechanism.upper)
    speed = 0.25 + 0.1 * np.arange(len(middle))
    phase = np.outer(time, speed)
    q = middle + 0.2 * span * np.sin(phase)
    qd, qdd = 0.2 * span * speed * np.cos(phase), -0.2 * span * speed**2 * np.sin(phase)
    motion = JointMotion(q, qd, qdd, up=stand.up)
    return time, q, qd, predicted_efforts(arm, described_trains(arm), motion)


def surgsync(folder: Path, drop: slice = slice(0, 0)) -> Path:
    """Write an episode in the layout of SurgSync."""
    folder.mkdir()
    for name in ARMS:
        time, q, qd, effort = moved(name, drop)
        own = q.shape[1] - (name != "ECM")
        columns: dict[str, Any] = {
            "frame_index": np.arange(len(time), dtype=np.int32),
            "master_timestamp_ns": (1e9 * time).astype(np.int64),
        }
        for what, table in (("position", q), ("velocity", qd), ("effort", effort)):
            columns[f"measured_js.{what}"] = list(table[:, :own].astype(np.float32))
        if name != "ECM":
            columns["jaw.measured_position"] = q[:, -1].astype(np.float32)
        parquet.write_table(pyarrow.table(columns), folder / f"{name}.parquet")
    parquet.write_table(
        pyarrow.table({"frame_index": [0], "phase": ["none"]}), folder / "annotation.parquet"
    )
    return folder


def open_h(path: Path) -> Path:
    """Write an episode in the layout of Open-H: all arms in one file."""
    columns: dict[str, Any] = {"episode_index": None}
    for name in ARMS:
        time, q, qd, effort = moved(name)
        own = q.shape[1] - (name != "ECM")
        prefix = f"observation.state.{name.lower()}"
        for what, table in (("position", q), ("velocity", qd), ("effort", effort)):
            columns[f"{prefix}.joint_{what}"] = list(table[:, :own].astype(np.float32))
        if name != "ECM":
            columns[f"{prefix}.gripper"] = list(q[:, -1:].astype(np.float32))
        columns |= {"timestamp": time.astype(np.float32), "episode_index": np.zeros(len(time), int)}
    parquet.write_table(pyarrow.table(columns), path)
    return path


@pytest.mark.parametrize("layout", ["surgsync", "open_h"])
def test_every_arm_of_an_episode_is_predicted(
    layout: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    place = tmp_path / "episode"
    episode = surgsync(place) if layout == "surgsync" else open_h(place)
    assert episode_arms(episode) == tuple(ARMS)
    assert main(["predict", str(episode), "--rig", "full_cart_si", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)["predictions"]
    assert [one["arm"] for one in found] == list(ARMS.values())
    for one in found:
        errors = one["relative_rms_percent"]
        # a sample is 0.1 s: friction changes its sign between two
        assert max(errors[joint] for joint in ("yaw", "pitch", "insertion")) < 12.0
        assert errors.get("jaw") is None
        assert one["filters"]["cutoff_hz"] == pytest.approx(2.0, rel=1e-4)
    # each arm leans by its own pitch: upright ones are far off
    words = ["predict", str(episode), "--rig", "full_cart_si", "--arm", "PSM1"]
    assert main([*words, "--json"]) == 0
    assert (
        json.loads(capsys.readouterr().out)["relative_rms_percent"]
        == found[1]["relative_rms_percent"]
    )
    assert main(words) == 0
    text = capsys.readouterr().out
    assert (
        "samples at 10 Hz, cut-off 2 Hz, gravity along (0.000, 0.707, -0.707) of its base" in text
    )
    if layout == "surgsync":
        assert main(["predict", str(episode / "PSM1.parquet"), "--arm", "psm_si", "--json"]) == 0
        assert json.loads(capsys.readouterr().out)["relative_rms_percent"]["pitch"] > 50.0


def test_an_episode_keeps_its_longest_stretch(tmp_path: Path) -> None:
    arm = load_arm("ecm_si")
    whole = read_motion(surgsync(tmp_path / "whole"), arm, name="ECM")
    cut = read_motion(surgsync(tmp_path / "cut", slice(100, 115)), arm, name="ECM")
    assert (len(whole.q), len(cut.q)) == (400, 285)
    np.testing.assert_allclose(cut.q, whole.q[115:], atol=1e-6)
    short = read_motion(surgsync(tmp_path / "lost", slice(100, 103)), arm, name="ECM")
    assert len(short.q) == 400  # filled in


def test_the_arm_of_an_episode_is_named(tmp_path: Path) -> None:
    episode = surgsync(tmp_path / "episode")
    with pytest.raises(
        LogError, match=r"joint states of ECM, PSM1, PSM2; .*name a rig and the arm"
    ):
        read_motion(episode, load_arm("psm_si"))
    with pytest.raises(LogError, match="got 4 numbers; allowed: 6"):
        read_motion(episode, load_arm("psm_si"), name="ECM")
    (episode / "PSM1.parquet").write_bytes(b"PAR1 and nothing else")
    with pytest.raises(LogError, match=r"PSM1\.parquet: cannot be read"):
        read_motion(episode, load_arm("psm_si"), name="PSM1")


def test_a_file_of_other_columns_is_named(tmp_path: Path) -> None:
    path = tmp_path / "a.parquet"
    parquet.write_table(pyarrow.table({"timestamp": [0.0], "action": [[1.0]]}), path)
    with pytest.raises(LogError, match="has no columns of the joints of psm_si: timestamp, action"):
        read_motion(path, load_arm("psm_si"))
