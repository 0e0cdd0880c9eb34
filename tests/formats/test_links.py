"""Links and joints, from which files for other simulators are written, stand where frames do."""

from __future__ import annotations

import numpy as np
import pytest

from trocar.descriptions import load_arm, load_rig
from trocar.descriptions.calibrated import apply_overlay
from trocar.descriptions.catalogue import names
from trocar.descriptions.records import ArmDescription, RigDescription
from trocar.descriptions.rigs import lone_arm_rig
from trocar.errors import InputError
from trocar.formats.links import LinkModel, rig_links
from trocar.geometry.rotations import matrix_from_rpy
from trocar.geometry.se3 import inverse, transform
from trocar.kinematics.forward import coordinates, poses
from trocar.robot.dvrk_config.arms import SERIAL

ARMS = ("psm", "ecm", "mtml", "mtmr", "suj_psm1", "suj_ecm")


def joint_values(model: LinkModel, arm: ArmDescription, q: np.ndarray) -> dict[str, float]:
    """Every joint of a lone arm from those that move on their own, as a reader of a file would."""
    own = coordinates(arm.mechanism, q)
    at = {f.name: own[k] for k, f in enumerate(arm.mechanism.frames)}
    values = {j.name: at[j.frame] for j in model.joints if j.hinge and not j.follows}
    for joint in model.joints:
        if joint.follows:
            values[joint.name] = joint.offset + sum(r * values[n] for n, r in joint.follows)
    return values


def stand(model: LinkModel, values: dict[str, float]) -> dict[str, np.ndarray]:
    """Return the pose of each link in the world."""
    found = {model.links[0].name: np.eye(4)}
    for joint in model.joints:
        moved = joint.pose
        if joint.kind != "fixed":
            at, slides = values[joint.name], joint.kind == "prismatic"
            turn = np.eye(3) if slides else matrix_from_rpy(0.0, 0.0, at)
            moved = moved @ transform(turn, np.array([0.0, 0.0, at if slides else 0.0]))
        found[joint.child] = found[joint.parent] @ moved
    return found


@pytest.mark.parametrize("name", ARMS)
def test_every_frame_is_a_link_of_its_name_and_stands_where_the_kinematics_say(
    name: str, rng: np.random.Generator, random_positions
) -> None:
    arm = load_arm(name)
    rig = lone_arm_rig(arm)
    model = rig_links(rig)
    for q in random_positions(arm, rng, 20):
        at = stand(model, joint_values(model, arm, q))
        root = at[f"{rig.arms[0].name}_{arm.root}"]
        for frame, expected in poses(arm.mechanism, q, arm.root).items():
            if frame in arm.mechanism.frame_index:
                pose = inverse(root) @ at[f"{rig.arms[0].name}_{frame}"]
                assert np.abs(pose - expected).max() < 1e-12


def test_loops_close_in_the_links_that_they_name(rng, random_positions) -> None:
    for name in ("psm", "ecm", "mtml"):
        arm = load_arm(name)
        model = rig_links(lone_arm_rig(arm))
        assert len(model.loops) == len(arm.mechanism.closures)
        for q in random_positions(arm, rng, 10):
            at = stand(model, joint_values(model, arm, q))
            for loop in model.loops:
                a = at[loop.link_a] @ np.append(loop.point_a, 1.0)
                b = at[loop.link_b] @ np.append(loop.point_b, 1.0)
                assert np.abs(a - b).max() < 1e-12


def test_at_its_zero_every_joint_that_moves_on_its_own_is_at_0_and_loops_are_closed(
    skew_overlay, rng
) -> None:
    for overlay in (None, skew_overlay("psm", rng)):
        model = rig_links(lone_arm_rig(load_arm("psm", calibration=overlay)))
        zero = model.zero
        assert set(zero) == {joint.name for joint in model.joints if joint.hinge}
        assert all(zero[j.name] == 0.0 for j in model.joints if j.hinge and not j.in_loop)
        assert any(zero.values()) == (overlay is not None)
        at = stand(model, dict(zero))
        for loop in model.loops:
            a = at[loop.link_a] @ np.append(loop.point_a, 1.0)
            b = at[loop.link_b] @ np.append(loop.point_b, 1.0)
            assert np.abs(a - b).max() < 1e-12


def all_rigs() -> list[RigDescription]:
    return [load_rig(name) for name in names("rigs")]


def test_rigs_lose_no_mass_and_no_shape() -> None:
    for rig in all_rigs():
        model = rig_links(rig)
        bodies = [body for place in rig.arms for body in place.arm.bodies]
        still = [p for p in rig.props if p.movable is None]
        shapes = [s for b in bodies for s in b.shapes] + [s for p in still for s in p.shapes]
        assert sum(link.mass for link in model.links) == pytest.approx(sum(b.mass for b in bodies))
        assert sum(len(link.shapes) for link in model.links) == len(shapes)
        assert len({link.name for link in model.links}) == len(model.links)
        assert len({joint.name for joint in model.joints}) == len(model.joints)
        assert [joint.child for joint in model.joints] == [link.name for link in model.links[1:]]


def test_passive_joints_stay_inside_their_limits_over_the_whole_range(
    rng, random_positions
) -> None:
    for name in ARMS:
        arm = load_arm(name)
        model = rig_links(lone_arm_rig(arm))
        for q in random_positions(arm, rng, 20):
            for joint, value in joint_values(model, arm, q).items():
                found = model.joint(joint)
                assert found.lower - 1e-12 <= value <= found.upper + 1e-12


def test_straight_lines_that_stand_for_a_general_loop_say_how_wrong_they_are(
    skew_overlay, rng, random_positions
) -> None:
    arm = apply_overlay(load_arm("psm"), skew_overlay("psm", rng))
    model = rig_links(lone_arm_rig(arm))
    reported = model.line_errors["PSM1"].worst
    assert 1e-6 < reported < 5e-3
    worst = 0.0
    for q in random_positions(arm, rng, 50):
        at = stand(model, joint_values(model, arm, q))
        root = inverse(at["PSM1_base"])
        for frame, expected in poses(arm.mechanism, q, arm.root).items():
            if frame in arm.mechanism.frame_index:
                off = (root @ at[f"PSM1_{frame}"] - expected)[:3, 3]
                worst = max(worst, float(np.linalg.norm(off)))
    assert 0.5 * reported < worst < 1.5 * reported


def test_a_general_loop_follows_the_joints_that_move_it_and_no_other(skew_overlay, rng) -> None:
    for name in ("psm", "ecm"):
        rig = lone_arm_rig(apply_overlay(load_arm(name), skew_overlay(name, rng)))
        loops = [joint for joint in rig_links(rig).joints if joint.in_loop]
        assert len(loops) == 6
        leaders = {leader for joint in loops for leader, _ in joint.follows}
        assert leaders == {f"{rig.arms[0].name}_pitch"}


def test_an_arm_without_masses_is_rejected_with_what_is_missing() -> None:
    with pytest.raises(InputError, match="has no mass for yaw"):
        rig_links(lone_arm_rig(load_arm(SERIAL["PSM"])))
