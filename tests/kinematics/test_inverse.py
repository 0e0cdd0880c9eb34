"""Inverse kinematics of whole mechanisms, judged by their own forward kinematics."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from trocar.descriptions import ArmDescription, load_arm, names
from trocar.errors import InputError, SingularError, UnreachableError
from trocar.geometry import exp_twist, pose_difference, transform, translation
from trocar.kinematics import forward
from trocar.kinematics.closed_form import fit_chain
from trocar.kinematics.inverse import inverse_kinematics
from trocar.kinematics.mechanism import Mechanism

Array = NDArray[np.float64]

SOLVED = [name for name in names("arms") if load_arm(name).inverse_kinematics]
TOO_DEEP = r"insertion .* m is beyond its upper limit 0\.24 by"
COUNTS = {"rcm_arm": 6, "rcm_scope": 4, "gimbal_arm": 7}


def draw(arm: ArmDescription, rng: np.random.Generator, count: int) -> Array:
    """Return joint positions where the inverse is defined: decisions, "Inverse kinematics"."""
    mechanism = arm.mechanism
    q = rng.uniform(mechanism.lower, mechanism.upper, (3 * count, len(mechanism.joints)))
    frame = {"rcm_arm": "wrist_pitch", "rcm_scope": "tip"}.get(arm.inverse_kinematics)
    if frame:
        q = q[np.linalg.norm(forward.pose(mechanism, q, frame)[:, :3, 3], axis=-1) > 1e-3]
    return q[:count]


def platform(arm: ArmDescription, q: Array) -> float | None:
    return float(q[3]) if arm.inverse_kinematics == "gimbal_arm" else None


def full(mechanism: Mechanism, solutions: Array) -> Array:
    """Return solutions with the jaw, where there is one, at 0."""
    more = len(mechanism.joints) - solutions.shape[-1]
    return np.pad(solutions, [(0, 0), (0, more)])


def compare(arm: ArmDescription, mechanism: Mechanism, q: Array) -> None:
    """Check that every solution makes its pose, and that the generating one is among them."""
    n = COUNTS[arm.inverse_kinematics]
    poses = forward.pose(mechanism, q)
    found = [
        inverse_kinematics(mechanism, arm.inverse_kinematics, T, platform_angle=platform(arm, own))
        for T, own in zip(poses, q, strict=True)
    ]
    every, which = np.concatenate(found), np.repeat(np.arange(len(q)), [len(s) for s in found])
    metres, radians = pose_difference(forward.pose(mechanism, full(mechanism, every)), poses[which])
    # the goal of 1e-9 for both
    assert max(metres.max(), radians.max()) < 1e-9
    assert ((every >= mechanism.lower[:n]) & (every <= mechanism.upper[:n])).all()
    own = [np.abs(s - made[:n]).max(axis=-1).min() for s, made in zip(found, q, strict=True)]
    assert max(own) < 1e-9


@pytest.mark.parametrize("name", SOLVED)
def test_poses_come_back_with_the_joints_that_made_them(
    name: str, rng: np.random.Generator
) -> None:
    arm = load_arm(name)
    # `trocar bench fidelity` measures 10,000.
    compare(arm, arm.mechanism, draw(arm, rng, 500))


@pytest.mark.parametrize("name", SOLVED)
def test_an_arm_as_described_is_exactly_its_chain(name: str) -> None:
    arm = load_arm(name)
    # Rounding over some twenty products of matrices.
    assert fit_chain(arm.mechanism, arm.inverse_kinematics).deviation < 1e-14


def test_the_jaw_is_no_part_of_a_solution() -> None:
    arm = load_arm("psm")
    q = [0.2, -0.3, 0.12, 0.4, 0.5, -0.6, 0.7]
    found = inverse_kinematics(arm.mechanism, "rcm_arm", forward.pose(arm.mechanism, q))
    assert found.shape == (1, 6)


def test_a_seed_brings_its_own_solution_first() -> None:
    arm = load_arm("psm")
    q = np.array([0.2, -0.3, 0.12, 2.5, 0.5, -0.6])
    T = forward.pose(arm.mechanism, [*q, 0.0])
    for seed in (q, q - [0.0, 0.0, 0.0, 2.0 * np.pi, 0.0, 0.0]):
        found = inverse_kinematics(arm.mechanism, "rcm_arm", T, seed)
        assert np.abs(found[0] - seed).max() < 1e-9


def test_an_instrument_whose_tip_lies_ahead_of_the_wrist_is_solved_too(
    rng: np.random.Generator,
) -> None:
    arm = load_arm("psm")
    ahead = [
        replace(f, before=f.before @ translation([0.0, 0.0, 0.0102])) if f.name == "tip" else f
        for f in arm.mechanism.frames
    ]
    compare(arm, replace(arm.mechanism, frames=tuple(ahead)), draw(arm, rng, 100))


def calibrated(mechanism: Mechanism, moved: set[str], rng: np.random.Generator) -> Mechanism:
    """Return a mechanism with some frames up to 1 mm and 2 mrad from where they were."""
    limit = np.array([1e-3] * 3 + [2e-3] * 3)
    frames = [
        replace(f, before=f.before @ exp_twist(rng.uniform(-limit, limit)))
        if f.name in moved
        else f
        for f in mechanism.frames
    ]
    return replace(mechanism, frames=tuple(frames))


# Frames that lie outside the loops, or carry all of them: moving these leaves the loops closed.
OUTSIDE_LOOPS = {
    "rcm_arm": {"rcm", "yaw", "insertion", "roll", "wrist_pitch", "wrist_yaw", "tip"},
    "rcm_scope": {"rcm", "yaw", "insertion", "roll", "tip"},
    "gimbal_arm": {"wrist_platform", "wrist_pitch", "wrist_yaw", "wrist_roll", "tip"},
}


@pytest.mark.parametrize("name", SOLVED)
def test_a_calibrated_arm_is_solved_though_its_axes_miss_each_other(
    name: str, rng: np.random.Generator
) -> None:
    arm = load_arm(name)
    mechanism = calibrated(arm.mechanism, OUTSIDE_LOOPS[arm.inverse_kinematics], rng)
    q = draw(arm, rng, 60)
    if arm.inverse_kinematics != "gimbal_arm":
        q = q[q[:, 2] > 0.03]  # farther from the remote centre than the axes miss each other
    assert fit_chain(mechanism, arm.inverse_kinematics).deviation > 1e-4
    compare(arm, mechanism, q)


def test_a_calibrated_scope_takes_no_pose_that_looks_elsewhere(rng: np.random.Generator) -> None:
    arm = load_arm("ecm")
    mechanism = calibrated(arm.mechanism, OUTSIDE_LOOPS["rcm_scope"], rng)
    tilted = forward.pose(mechanism, [0.1, 0.2, 0.1, 0.3]) @ exp_twist([0, 0, 0, 1e-3, 0, 0])
    with pytest.raises(UnreachableError, match="the nearest that ecm comes misses it by") as caught:
        inverse_kinematics(mechanism, "rcm_scope", tilted)
    assert max(caught.value.excess.values()) > 1e-5


def test_a_calibrated_arm_says_which_limit_is_in_the_way(rng: np.random.Generator) -> None:
    mechanism = calibrated(load_arm("psm").mechanism, OUTSIDE_LOOPS["rcm_arm"], rng)
    for depth, by in ((0.2402, 2e-4), (0.9, 0.66)):  # within Newton's reach, and far beyond it
        T = forward.pose(mechanism, [0.2, -0.3, depth, 0.4, 0.5, -0.6, 0.0])
        with pytest.raises(UnreachableError, match=TOO_DEEP) as caught:
            inverse_kinematics(mechanism, "rcm_arm", T)
        assert caught.value.excess["insertion"] == pytest.approx(by, abs=1e-3)


def test_a_pose_out_of_reach_is_said_to_be() -> None:
    with pytest.raises(UnreachableError, match=TOO_DEEP):
        inverse_kinematics(load_arm("psm").mechanism, "rcm_arm", translation([0.0, 0.0, -0.9]))


def test_the_wrist_at_the_remote_centre_is_said_to_be_singular() -> None:
    mechanism = load_arm("psm").mechanism
    T = forward.pose(mechanism, [0.2, 0.1, 0.016, 0.3, 0.2, 0.1, 0.0])
    with pytest.raises(SingularError, match="within 1 mm of the remote centre"):
        inverse_kinematics(mechanism, "rcm_arm", T)


def test_an_arm_without_a_closed_form_says_so() -> None:
    expected = "suj_psm1: no inverse kinematics: .* names no structure; .* are rcm_arm, rcm_scope"
    arm = load_arm("suj_psm1")
    with pytest.raises(InputError, match=expected):
        inverse_kinematics(arm.mechanism, arm.inverse_kinematics, np.eye(4))
    with pytest.raises(InputError, match="got structure 'scara'"):
        inverse_kinematics(load_arm("psm").mechanism, "scara", np.eye(4))


def test_an_arm_without_its_tool_asks_for_it() -> None:
    with pytest.raises(InputError, match=r"got RRS \(yaw, pitch, insertion\); is its tool mounted"):
        inverse_kinematics(load_arm("psm", tool="none").mechanism, "rcm_arm", np.eye(4))


def test_another_structure_is_rejected() -> None:
    with pytest.raises(InputError, match="not built as 'gimbal_arm', whose joints are RRRRRRR"):
        inverse_kinematics(load_arm("psm").mechanism, "gimbal_arm", np.eye(4))
    mirrored = load_arm("psm").mechanism
    turned = transform(np.diag([1.0, -1.0, -1.0]), np.zeros(3))
    frames = [
        replace(f, before=f.before @ turned, after=turned @ f.after) if f.name == "roll" else f
        for f in mirrored.frames
    ]  # its roll turns the other way
    with pytest.raises(InputError, match=r"not built as 'rcm_arm': .* \(m or rad\) off"):
        inverse_kinematics(replace(mirrored, frames=tuple(frames)), "rcm_arm", np.eye(4))


def test_only_an_arm_with_a_platform_takes_its_angle() -> None:
    with pytest.raises(InputError, match="platform_angle: only an arm with a wrist platform"):
        inverse_kinematics(load_arm("ecm").mechanism, "rcm_scope", np.eye(4), platform_angle=0.1)


@pytest.mark.parametrize("bad", [np.full((4, 4), np.nan), np.eye(3), np.zeros((2, 4, 4))])
def test_a_pose_that_is_none_is_rejected(bad: Array) -> None:
    with pytest.raises(InputError):
        inverse_kinematics(load_arm("psm").mechanism, "rcm_arm", bad)


@pytest.mark.parametrize("seed", [[0.0] * 5, [np.nan] * 6])
def test_a_seed_that_is_none_is_rejected(seed: list[float]) -> None:
    mechanism = load_arm("psm").mechanism
    T = forward.pose(mechanism, [0.2, -0.3, 0.12, 0.4, 0.5, -0.6, 0.0])
    with pytest.raises(InputError, match="seed: expected 6 finite numbers"):
        inverse_kinematics(mechanism, "rcm_arm", T, seed)
