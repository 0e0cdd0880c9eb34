"""Joints and tips of datasets: found by their names, chosen, converted, solved."""

from pathlib import Path

import numpy as np
import pytest

from trocar.descriptions import load_arm
from trocar.errors import InputError, LogError, UnknownNameError
from trocar.geometry import matrix_from_rotation_vector, transform
from trocar.geometry.rotations import quaternion_from_matrix
from trocar.kinematics.forward import pose
from trocar.learning.importing import import_dataset
from trocar.learning.lerobot import DatasetWriter, Feature
from trocar.recording.bags import open_bag

pytest.importorskip("pyarrow", reason="the extra `learn` is not there")
pytest.importorskip("mcap.reader", reason="the extra `record` is not there")
pytest.importorskip("rosbags.typesys", reason="the extra `bags` is not there")

JOINTS = load_arm("psm").mechanism.joint_names


def dataset(root: Path, **columns: tuple[str, ...]) -> np.ndarray:
    """Write a dataset of three frames whose columns have these names, and return its numbers."""
    root.mkdir()
    features = {f"observation.{name}": Feature(names) for name, names in columns.items()}
    values = 0.01 * np.arange(3)[:, None] + 0.1 * np.arange(len(next(iter(columns.values()))))
    with DatasetWriter(root, 50, features, "dvrk") as writer:
        writer.add({n: values + k for k, n in enumerate(features)}, "x")
    return values


def imported(root: Path, topic: str, columns: tuple[str, ...] = ()) -> np.ndarray:
    (path,) = import_dataset(root, root / "out", columns=columns)
    return np.array([m.fields["position"] for m in open_bag(path).messages([topic])])


@pytest.mark.parametrize(
    "names",
    [
        tuple(f"PSM1.{name}_{'m' if name == 'insertion' else 'rad'}" for name in JOINTS),
        tuple(f"psm1_{name}" for name in JOINTS),
        tuple(f"psm1_joint_{k + 1}.pos" for k in range(7)),
        (*(f"PSM1/{k}" for k in range(6)), "PSM1/jaw"),
        (*(f"psm1.outer_{name}" for name in JOINTS[:6]), "psm1.jaw.position"),
    ],
)
def test_joints_are_found_by_their_names(tmp_path: Path, names: tuple[str, ...]) -> None:
    values = dataset(tmp_path / "data", state=names)
    assert imported(tmp_path / "data", "PSM1/measured_js") == pytest.approx(values[:, :6], abs=1e-6)
    jaw = import_dataset(tmp_path / "data", tmp_path / "jaw.mcap", episode=0)
    messages = open_bag(jaw[0]).messages(["PSM1/jaw/measured_js"])
    assert [m.fields["position"][0] for m in messages] == pytest.approx(values[:, 6], abs=1e-6)


def test_units_of_names_are_converted(tmp_path: Path) -> None:
    names = tuple(f"PSM1.{name}_{'mm' if name == 'insertion' else 'deg'}" for name in JOINTS[:6])
    values = np.radians(dataset(tmp_path / "data", state=names))
    values[:, 2] *= 1e-3 / np.radians(1.0)
    assert imported(tmp_path / "data", "PSM1/measured_js") == pytest.approx(values, abs=1e-6)


def test_scaled_numbers_without_units_come_after_those_with_units(tmp_path: Path) -> None:
    scaled = tuple(f"PSM1.{name}" for name in JOINTS[:6])
    values = dataset(tmp_path / "data", state=scaled, joints=tuple(f"{n}_rad" for n in scaled))
    found = imported(tmp_path / "data", "PSM1/measured_js")
    assert found == pytest.approx(values + 1.0, abs=1e-6)


def test_joints_are_chosen_by_columns(tmp_path: Path) -> None:
    values = dataset(tmp_path / "data", state=tuple(f"n{k}" for k in range(9)))
    chosen = ("PSM2=observation.state[1:8]",)
    found = imported(tmp_path / "data", "PSM2/measured_js", chosen)
    assert found == pytest.approx(values[:, 1:7], abs=1e-6)


@pytest.mark.parametrize(
    ("columns", "message"),
    [
        ((), "no column names all joints of an arm; got observation.state: n0, .*--columns PSM1="),
        (("PSM1=observation.state",), r"got 'PSM1=observation.state'; allowed: ARM=COLUMN\[FIRST"),
        (("PSM1=observation.stat[0:7]",), r"unknown column .*did you mean 'observation.state'"),
        (("PSM1=observation.state[0:5]",), r"5 of 9 numbers; allowed: 7 or 6 \(yaw, pitch"),
        (("PSM1=observation.state[3:10]",), "7 of 9 numbers"),
        (("KUKA=observation.state[0:7]",), "unknown arm 'KUKA'; known: PSM1"),
    ],
)
def test_columns_without_joints_are_rejected(
    tmp_path: Path, columns: tuple[str, ...], message: str
) -> None:
    dataset(tmp_path / "data", state=tuple(f"n{k}" for k in range(9)))
    with pytest.raises(InputError, match=message):
        import_dataset(tmp_path / "data", tmp_path / "out", columns=columns)
    assert not (tmp_path / "out").exists()


# ------------------------------------------------------------------ poses of tips

#: As Open-H has them: quaternions xyzw.
TIP = (
    *(f"psm1_pose.position.{axis}" for axis in "xyz"),
    *(f"psm1_pose.orientation.{axis}" for axis in "xyzw"),
    "psm1_jaw",
)
BASE = transform(matrix_from_rotation_vector([0.4, -0.9, 1.1]), [0.1, 0.2, -0.3])


def tips(root: Path, count: int = 30) -> np.ndarray:
    """Write a dataset of a PSM's tip on its way, in another frame, and return the joints."""
    root.mkdir()
    psm, t = load_arm("psm").mechanism, np.linspace(0.0, 1.0, count)[:, None]
    middle = np.array([0.1, -0.2, 0.15, 0.5, 0.3, -0.4, 0.3])
    q = middle + np.array([0.4, 0.3, 0.05, 1.5, 0.6, 0.5, 0.2]) * np.sin(4.0 * t + np.arange(7))
    rows: list[np.ndarray] = []
    for joints in q:
        T = BASE @ pose(psm, joints, "tip")
        quaternion = np.roll(quaternion_from_matrix(T[:3, :3]), -1)
        rows.append(np.concatenate([T[:3, 3], quaternion, joints[6:]]))
    with DatasetWriter(root, 30, {"observation.state": Feature(TIP)}, "dvrk") as writer:
        writer.add({"observation.state": np.array(rows)}, "x")
    return q


def test_poses_of_a_tip_are_solved_for_the_joints(tmp_path: Path) -> None:
    q = tips(tmp_path / "data")
    (path,) = import_dataset(tmp_path / "data", tmp_path / "out", bases={"PSM1": BASE})
    topics = {topic: [] for topic in ("PSM1/measured_js", "PSM1/jaw/measured_js")}
    for message in open_bag(path).messages(topics):
        topics[message.topic].append(message.fields["position"])
    # float32 keeps 3e-8 m of the tip; 0.09 m from the remote centre and 9 mm at the wrist
    assert np.array(topics["PSM1/measured_js"]) == pytest.approx(q[:, :6], abs=2e-5)
    assert np.array(topics["PSM1/jaw/measured_js"]) == pytest.approx(q[:, 6:], abs=1e-6)


def test_poses_need_the_base_of_their_arm(tmp_path: Path) -> None:
    tips(tmp_path / "data", 2)
    with pytest.raises(InputError, match="or the base of PSM1 in the frame of its poses, --base"):
        import_dataset(tmp_path / "data", tmp_path / "out")
    with pytest.raises(UnknownNameError, match=r"unknown pose of the tip 'PSM2' \(did you mean"):
        import_dataset(tmp_path / "data", tmp_path / "out", bases={"PSM2": BASE})
    with pytest.raises(LogError, match=r"episode 0, frame 0: PSM1: .*; is its base \(--base\)"):
        import_dataset(tmp_path / "data", tmp_path / "out", bases={"PSM1": np.eye(4)})
    assert not (tmp_path / "out").exists()
