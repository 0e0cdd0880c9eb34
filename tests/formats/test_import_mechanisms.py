"""Foreign robots stand where MuJoCo, which reads the same files by itself, has them."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

pytest.importorskip("lxml", reason="lxml is not installed (extra export)")
pytest.importorskip("trimesh", reason="trimesh is not installed (extra convex)")

from tests.formats.texts import MJCF, SDF, URDF
from trocar.descriptions import load_arm
from trocar.descriptions.rigs import lone_arm_rig
from trocar.formats.importing import Imported, ImportOptions, import_file
from trocar.kinematics.forward import coordinates, poses
from trocar.simulation import World


def brought(text: str, suffix: str, folder: Path, order: ImportOptions | None = None) -> Imported:
    file = folder / f"robot{suffix}"
    file.write_text(text, encoding="utf-8")
    return import_file(file, folder / "out", order)


def mujoco_poses(model: mujoco.MjModel, values: dict[str, float]) -> dict[str, np.ndarray]:
    """Return the pose of each body in the world at joint values."""
    data = mujoco.MjData(model)
    for name, value in values.items():
        data.qpos[model.joint(name).qposadr[0]] = value
    mujoco.mj_kinematics(model, data)
    found = {}
    for k in range(model.nbody):
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = data.xmat[k].reshape(3, 3), data.xpos[k]
        found[model.body(k).name] = pose
    return found


def test_a_urdf_moves_as_mujoco_moves_it(tmp_path, rng, random_positions) -> None:
    found = brought(URDF, ".urdf", tmp_path)
    assert (found.kind, found.name) == ("arm", "three_joints")
    assert found.joints == ("shoulder", "elbow", "grip")
    arm = load_arm(found.file)
    witness = mujoco.MjModel.from_xml_string(URDF)
    for q in random_positions(arm, rng, 20):
        values = dict(zip(found.joints, q, strict=True))
        values["grip2"] = -values["grip"] - 0.002
        expected = mujoco_poses(witness, values)
        ours = poses(arm.mechanism, q, "base")
        for link in ("upper", "fore", "finger", "thumb"):
            assert np.abs(ours[link] - expected[link]).max() < 1e-9


def test_masses_limits_and_friction_come_along(tmp_path) -> None:
    arm = load_arm(brought(URDF, ".urdf", tmp_path).file)
    witness = mujoco.MjModel.from_xml_string(URDF)
    assert sum(b.mass for b in arm.bodies if b.mass > 1e-3) == pytest.approx(
        witness.body_mass.sum()
    )
    shoulder = arm.joint("shoulder")
    assert (shoulder.lower, shoulder.upper, shoulder.effort_max) == (-1.0, 2.0, 20.0)
    assert arm.friction["identified"]["shoulder"].viscous == 0.2
    assert arm.friction["identified"]["shoulder"].coulomb == 0.1
    fore = next(b for b in arm.bodies if b.frame.startswith("fore"))
    assert np.linalg.eigvalsh(fore.inertia) == pytest.approx(
        np.sort(witness.body("fore").inertia), rel=1e-9
    )


def test_an_imported_arm_moves_to_where_it_is_told(tmp_path) -> None:
    arm = load_arm(brought(URDF, ".urdf", tmp_path).file)
    world = World(lone_arm_rig(arm))
    (robot,) = world.arms.values()
    goal = np.array([0.3, -0.4, 0.02])
    robot.servo_jp(goal)
    world.step(2000)
    assert np.abs(robot.measured_js().position - goal).max() < 5e-3


@pytest.mark.parametrize("suffix", [".sdf", ".xml"])
def test_the_bar_of_a_parallelogram_does_not_turn(suffix: str, tmp_path) -> None:
    text = (SDF if suffix == ".sdf" else MJCF).format(block=0.0, rest=0.1)
    found = brought(text, suffix, tmp_path)
    assert found.joints == ("crank",)
    mechanism = load_arm(found.file).mechanism
    q = np.linspace(-0.4, 0.4, 9)[:, None]
    at = poses(mechanism, q, mechanism.reference)
    assert np.abs(at["bar"][:, :3, :3] - at["bar"][4, :3, :3]).max() < 1e-12
    top = at["bar"][:, :3, 3] - at["left"][:, :3, 3]
    assert np.abs(top - 0.1 * np.stack([np.sin(q), 0 * q, np.cos(q)], -1)[:, 0]).max() < 1e-12


@pytest.mark.parametrize("suffix", [".sdf", ".xml"])
def test_a_four_bar_with_unequal_sides_closes_everywhere(suffix: str, tmp_path) -> None:
    text = (SDF if suffix == ".sdf" else MJCF).format(block=0.03, rest=0.07)
    mechanism = load_arm(brought(text, suffix, tmp_path).file).mechanism
    q = np.linspace(-0.4, 0.4, 9)[:, None]
    at = poses(mechanism, q, mechanism.reference)
    end = np.array([0.2, 0.0, 0.1]) - np.array([0.0, 0.0, 0.1])  # of the bar, where q = 0
    in_bar = at["bar"][4, :3, :3].T @ end
    reached = at["bar"][:, :3, :3] @ in_bar + at["bar"][:, :3, 3]
    foot = at["right"][:, :3, 3]
    assert np.abs(np.linalg.norm(reached - foot, axis=-1) - 0.07).max() < 1e-9
    assert np.ptp(at["bar"][:, 0, 2]) > 0.01  # it does turn


def test_a_model_of_sdf_stands_in_its_own_frame(tmp_path) -> None:
    mechanism = load_arm(brought(SDF.format(block=0.0, rest=0.1), ".sdf", tmp_path).file).mechanism
    at = poses(mechanism, np.zeros(1), "base")
    assert np.allclose(at["right"][:3, 3], [0.2, 0.0, 0.0], atol=1e-15)
    turn = np.array([[np.cos(0.3), 0, np.sin(0.3)], [0, 1, 0], [-np.sin(0.3), 0, np.cos(0.3)]])
    assert np.allclose(at["bar"][:3, :3], turn, atol=1e-15)


def test_a_passive_joint_can_be_named(tmp_path) -> None:
    order = ImportOptions(passive=("crank", "top"))
    found = brought(SDF.format(block=0.0, rest=0.1), ".sdf", tmp_path, order)
    assert found.joints == ("rocker",)


def test_loops_have_the_coordinates_that_close_mujoco_s_own_constraint(tmp_path) -> None:
    text = MJCF.format(block=0.03, rest=0.07)
    arm = load_arm(brought(text, ".xml", tmp_path).file)
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    frames = [f.name for f in arm.mechanism.frames]
    for crank in (-0.3, 0.25):
        at = coordinates(arm.mechanism, np.array([crank]))
        for joint, frame in (("crank", "left"), ("top", "bar"), ("rocker", "right")):
            index = frames.index(f"{frame}_hinge")
            data.qpos[model.joint(joint).qposadr[0]] = at[index]
        mujoco.mj_forward(model, data)
        assert np.abs(data.efc_pos[:3]).max() < 1e-9
