"""Models in which joints follow one other at most, and are sorted behind it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from trocar.descriptions import load_arm, load_rig
from trocar.descriptions.rigs import lone_arm_rig
from trocar.formats.links import LinkModel, joint_values, link_poses, rig_links
from trocar.formats.urdf import late_leaders, leaders_first, single_leaders


@pytest.fixture(scope="module")
def master() -> LinkModel:
    return rig_links(lone_arm_rig(load_arm("mtml")))


def own_values(model: LinkModel, rng: np.random.Generator) -> dict[str, float]:
    return {
        joint.name: rng.uniform(joint.lower, joint.upper)
        for joint in model.joints
        if joint.kind != "fixed" and not joint.follows
    }


def test_a_joint_that_follows_two_becomes_two_and_every_link_stays(master, rng) -> None:
    assert max(len(joint.follows) for joint in master.joints) == 2
    split = single_leaders(master)
    assert max(len(joint.follows) for joint in split.joints) == 1
    assert len(split.links) == len(master.links) + 1
    for _ in range(10):
        own = own_values(master, rng)
        before = link_poses(master, joint_values(master, own))
        after = link_poses(split, joint_values(split, own))
        assert all(np.abs(after[name] - pose).max() < 1e-12 for name, pose in before.items())
        values = joint_values(split, own)
        for joint in split.joints:
            if joint.follows:
                assert joint.lower <= values[joint.name] <= joint.upper


def test_splitting_keeps_all_mass_and_gives_the_new_link_a_little(master) -> None:
    split = single_leaders(master)
    (new,) = {link.name for link in split.links} - {link.name for link in master.links}
    assert sum(x.mass for x in split.links) == pytest.approx(sum(x.mass for x in master.links))
    link = next(link for link in split.links if link.name == new)
    assert 0.0 < link.mass < 1e-5 and np.linalg.eigvalsh(link.inertia).min() > 0.0


def test_the_pose_start_is_that_of_the_same_links(master) -> None:
    tree = leaders_first(single_leaders(master))
    before, after = link_poses(master, master.start), link_poses(tree, tree.start)
    assert set(tree.start) == {joint.name for joint in tree.joints if joint.kind != "fixed"}
    assert all(np.abs(after[name] - pose).max() < 1e-12 for name, pose in before.items())


@pytest.mark.parametrize("rig", ["psm", "mtm", "full_cart_mtm"])
def test_sorting_by_name_then_brings_leaders_first(rig) -> None:
    model = single_leaders(rig_links(load_rig(rig)))
    assert late_leaders(model)
    tree = leaders_first(model)
    assert late_leaders(tree) == ()
    moved = [(a, b) for a, b in zip(model.joints, tree.joints, strict=True) if a.name != b.name]
    assert all(a.follows or a.kind == "fixed" for a, _ in moved)
    assert all(b.name.endswith(f"_and_{a.name}") for a, b in moved)
    assert len({joint.name for joint in tree.joints}) == len(tree.joints)


def test_joints_that_wait_for_one_another_keep_their_names(master) -> None:
    joints = {joint.name: joint for joint in master.joints}
    bar, elbow = joints["MTML_elbow_bar"], joints["MTML_elbow_pitch"]
    knot = {
        bar.name: replace(bar, follows=(("MTML_wrist_roll", 1.0),)),
        elbow.name: replace(elbow, follows=(("MTML_elbow_rod", 1.0),)),
        "MTML_elbow_rod": replace(joints["MTML_elbow_rod"], follows=()),
    }
    tangled = replace(master, joints=tuple(knot.get(j.name, j) for j in master.joints))
    assert late_leaders(leaders_first(tangled))
