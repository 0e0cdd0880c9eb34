"""Foreign robots stand where MuJoCo, which reads the same files by itself, has them."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

pytest.importorskip("lxml", reason="lxml is not installed (extra export)")
pytest.importorskip("trimesh", reason="trimesh is not installed (extra convex)")

from trocar.apps.foreign import Imported, Order, bring_in
from trocar.descriptions import load_arm
from trocar.descriptions.lone_arm import lone_arm_rig
from trocar.kinematics.forward import coordinates, poses
from trocar.simulation import World

URDF = """<robot name="three joints">
 <material name="red"><color rgba="0.8 0.1 0.1 1"/></material>
 <link name="base"><visual><geometry><box size="0.2 0.2 0.1"/></geometry>
  <material name="red"/></visual></link>
 <link name="upper"><inertial><origin xyz="0 0 0.15"/><mass value="1.2"/>
  <inertia ixx="0.01" iyy="0.01" izz="0.001" ixy="0" ixz="0" iyz="0"/></inertial>
  <visual><origin xyz="0 0 0.15"/><geometry><cylinder radius="0.03" length="0.3"/></geometry>
  </visual><collision><origin xyz="0 0 0.15" rpy="0.1 0.2 0.3"/>
  <geometry><cylinder radius="0.03" length="0.3"/></geometry></collision></link>
 <link name="fore"><inertial><origin xyz="0 0 0.1" rpy="0.3 0 0"/><mass value="0.6"/>
  <inertia ixx="0.004" iyy="0.005" izz="0.002" ixy="0.0001" ixz="0" iyz="0"/></inertial></link>
 <link name="finger"><inertial><mass value="0.1"/>
  <inertia ixx="1e-4" iyy="1e-4" izz="1e-5" ixy="0" ixz="0" iyz="0"/></inertial></link>
 <link name="thumb"><inertial><mass value="0.1"/>
  <inertia ixx="1e-4" iyy="1e-4" izz="1e-5" ixy="0" ixz="0" iyz="0"/></inertial></link>
 <joint name="shoulder" type="revolute"><origin xyz="0 0 0.05" rpy="0.2 -0.4 1.1"/>
  <parent link="base"/><child link="upper"/><axis xyz="1 2 -1"/>
  <limit lower="-1" upper="2" effort="20" velocity="3"/><dynamics damping="0.2" friction="0.1"/>
 </joint>
 <joint name="elbow" type="continuous"><origin xyz="0 0 0.3"/><parent link="upper"/>
  <child link="fore"/><axis xyz="0 1 0"/></joint>
 <joint name="grip" type="prismatic"><origin xyz="0.01 0 0.2"/><parent link="fore"/>
  <child link="finger"/><axis xyz="1 0 0"/>
  <limit lower="0" upper="0.04" effort="30" velocity="0.1"/></joint>
 <joint name="grip2" type="prismatic"><origin xyz="-0.01 0 0.2"/><parent link="fore"/>
  <child link="thumb"/><axis xyz="1 0 0"/>
  <limit lower="-0.1" upper="0.1" effort="30" velocity="0.1"/>
  <mimic joint="grip" multiplier="-1" offset="-0.002"/></joint>
</robot>"""

#: Two uprights on a base and a bar between their tops, which are 0.1 m above the base; the right
#: upright stands on a block of {block} m, so that it is shorter.
SDF = """<sdf version="1.7"><model name="bars"><pose>1 2 3 0 0 0.5</pose>
 <link name="base"/>
 <link name="left"><pose>0 0 0 0 0 0</pose><inertial><mass>0.1</mass><inertia><ixx>1e-4</ixx>
  <iyy>1e-4</iyy><izz>1e-4</izz></inertia></inertial></link>
 <link name="right"><pose>0.2 0 {block} 0 0 0</pose><inertial><mass>0.1</mass><inertia>
  <ixx>1e-4</ixx><iyy>1e-4</iyy><izz>1e-4</izz></inertia></inertial></link>
 <link name="bar"><pose relative_to="left">0 0 0.1 0 0.3 0</pose><inertial><mass>0.1</mass>
  <inertia><ixx>1e-4</ixx><iyy>1e-4</iyy><izz>1e-4</izz></inertia></inertial></link>
 <joint name="crank" type="revolute"><parent>base</parent><child>left</child>
  <axis><xyz>0 1 0</xyz><limit><lower>-0.4</lower><upper>0.4</upper><effort>5</effort></limit>
  </axis></joint>
 <joint name="rocker" type="revolute"><parent>base</parent><child>right</child>
  <axis><xyz>0 1 0</xyz></axis></joint>
 <joint name="top" type="revolute"><parent>left</parent><child>bar</child>
  <axis><xyz expressed_in="__model__">0 2 0</xyz></axis></joint>
 <joint name="closing" type="revolute"><pose relative_to="right">0 0 {rest} 0 0 0</pose>
  <parent>right</parent><child>bar</child><axis><xyz>0 1 0</xyz></axis></joint>
</model></sdf>"""
#: The same as MJCF.
MJCF = """<mujoco model="bars"><compiler angle="radian"/><worldbody>
 <body name="left"><joint name="crank" axis="0 1 0" range="-0.4 0.4"/>
  <geom type="capsule" fromto="0 0 0 0 0 0.1" size="0.004" mass="0.1"/>
  <body name="bar" pos="0 0 0.1" euler="0 0.3 0"><joint name="top" axis="0 1 0"/>
   <geom type="box" size="0.02 0.004 0.004" mass="0.1"/>
   <site name="end" pos="0.19106729782512123 0 0.059104041332267915"/></body></body>
 <body name="right" pos="0.2 0 {block}"><joint name="rocker" axis="0 1 0"/>
  <geom type="capsule" fromto="0 0 0 0 0 {rest}" size="0.004" mass="0.1"/>
  <site name="peak" pos="0 0 {rest}"/></body></worldbody>
 <equality><connect name="closing" site1="peak" site2="end"/></equality>
 <actuator><motor joint="crank" forcerange="-2 2" forcelimited="true"/></actuator></mujoco>"""


def brought(text: str, suffix: str, folder: Path, order: Order | None = None) -> Imported:
    file = folder / f"robot{suffix}"
    file.write_text(text, encoding="utf-8")
    return bring_in(file, folder / "out", order)


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
    order = Order(passive=("crank", "top"))
    found = brought(SDF.format(block=0.0, rest=0.1), ".sdf", tmp_path, order)
    assert found.joints == ("rocker",)


def test_loops_have_the_coordinates_that_mujoco_settles_in(tmp_path) -> None:
    text = MJCF.format(block=0.03, rest=0.07)
    arm = load_arm(brought(text, ".xml", tmp_path).file)
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    data.qpos[model.joint("crank").qposadr[0]] = 0.25
    for _ in range(20000):  # the closed loop by relaxation, the crank held
        mujoco.mj_step(model, data)
        data.qvel[:] *= 0.9
        data.qpos[model.joint("crank").qposadr[0]] = 0.25
        data.qvel[model.joint("crank").dofadr[0]] = 0.0
    at = coordinates(arm.mechanism, np.array([0.25]))
    frames = [f.name for f in arm.mechanism.frames]
    for joint, frame in (("top", "bar_hinge"), ("rocker", "right_hinge")):
        settled = data.qpos[model.joint(joint).qposadr[0]]
        assert at[frames.index(frame)] == pytest.approx(settled, abs=2e-3)
