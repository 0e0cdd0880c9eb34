"""The URDF that viewers get, and the hinges that are published for it."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from urllib.parse import unquote, urlparse

import numpy as np
import pytest

from trocar.descriptions import load_rig, names
from trocar.formats.links import joint_values, link_poses, rig_links
from trocar.formats.urdf import urdf_tree
from trocar.kinematics.forward import poses
from trocar.ros.robot_model import KEPT, fixed_frames, frames, hinge_states, robot_model
from trocar.simulation import World

RIGS = ("psm", "ecm", "mtm", "full_cart_mtm")


def random_joints(rig, rng):
    found = {}
    for arm in rig.arms:
        ends = arm.arm.mechanism.lower, arm.arm.mechanism.upper
        lower, upper = (np.nan_to_num(e, posinf=1.0, neginf=-1.0) for e in ends)
        found[arm.name] = rng.uniform(lower, upper)
    return found


def test_only_the_newest_folders_of_meshes_are_kept() -> None:
    pytest.importorskip("lxml", reason="URDF needs the extra 'export'")
    rigs = [replace(load_rig("psm")) for _ in range(KEPT + 1)]
    first = [robot_model(rig).folder for rig in rigs[:KEPT]]
    assert robot_model(rigs[0]).folder == first[0]  # asked for again, so it is the newest
    robot_model(rigs[KEPT])
    assert [folder.is_dir() for folder in first] == [True, False, True, True]
    assert robot_model(rigs[1]).folder.is_dir()  # written anew


def test_the_folders_of_a_process_go_with_it(tmp_path: Path) -> None:
    pytest.importorskip("lxml", reason="URDF needs the extra 'export'")
    text = """
from trocar.descriptions import load_rig
from trocar.ros.robot_model import robot_model
assert robot_model(load_rig("psm")).folder.is_dir()
"""
    environment = {**os.environ, "TMPDIR": str(tmp_path)}
    subprocess.run([sys.executable, "-c", text], env=environment, check=True)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", RIGS)
def test_the_hinges_put_every_link_where_the_kinematics_have_it(name: str) -> None:
    rig = load_rig(name)
    q = random_joints(rig, np.random.default_rng(7))
    model = urdf_tree(rig_links(rig))
    found, positions, _ = hinge_states(rig, q, q)
    own = [j.name for j in model.joints if j.kind != "fixed" and not j.follows]
    assert sorted(found) == sorted(own)
    at = link_poses(model, joint_values(model, dict(zip(found, positions, strict=True))))
    for arm in rig.arms:
        mechanism = arm.arm.mechanism
        root = np.linalg.inv(at[f"{arm.name}_{arm.arm.root}"])
        for frame, expected in poses(mechanism, q[arm.name], arm.arm.root).items():
            link = f"{arm.name}_{frame}"
            if link in at:
                np.testing.assert_allclose(root @ at[link], expected, atol=1e-9, err_msg=link)


def test_velocities_are_the_positions_differences() -> None:
    rig = load_rig("psm")
    rng = np.random.default_rng(8)
    q, v = random_joints(rig, rng), {"PSM1": rng.normal(size=7)}
    step = 1e-6
    _, a, velocity = hinge_states(rig, q, v)
    _, b, _ = hinge_states(rig, {"PSM1": q["PSM1"] + step * v["PSM1"]}, v)
    np.testing.assert_allclose((b - a) / step, velocity, atol=1e-6)


@pytest.mark.parametrize("name", RIGS)
def test_no_link_has_the_name_of_a_frame_of_crtk_and_every_mesh_is_there(name: str) -> None:
    pytest.importorskip("lxml", reason="URDF needs the extra 'export'")
    rig = load_rig(name)
    model = robot_model(rig)
    links = set(re.findall(r'<link name="(\w+)"', model.urdf))
    assert not links & set(frames(rig))
    assert "world" in links
    files = set(re.findall(r'filename="([^"]+)"', model.urdf))
    assert files
    for file in files:
        assert Path(unquote(urlparse(file).path)).is_file(), file
    assert robot_model(rig) is model


@pytest.mark.parametrize("name", names("rigs"))
def test_fixed_frames_stand_where_the_world_has_them(name: str) -> None:
    world = World(name)
    fixed = fixed_frames(world.rig)
    assert fixed
    for arm in world.arms.values():
        frame = arm.local.measured_cp().frame_id
        if frame in fixed:
            np.testing.assert_allclose(fixed[frame], world.reference_pose(arm.name), atol=1e-12)


def test_what_cannot_be_written_leaves_no_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fails(*_: object) -> bytes:
        raise OSError("the disk is full")

    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    monkeypatch.setattr("trocar.ros.robot_model.urdf", fails)
    with pytest.raises(OSError, match="full"):
        robot_model(replace(load_rig("psm")))
    assert not list(tmp_path.iterdir())
