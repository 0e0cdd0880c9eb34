"""A plain four-bar, as of a gripper: no parallelogram, no remote centre, a user's own file."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from trocar.descriptions import ArmDescription, load_arm
from trocar.descriptions.overlay import apply_overlay, overlay_text, parse_overlay
from trocar.errors import InputError
from trocar.geometry import matrix_from_rotation_vector, transform
from trocar.robot.calibration import Tracks, calibrate
from trocar.robot.calibration.linkage import linkage
from trocar.robot.calibration.robot import Robot, marker_poses, mechanism_of

GRIPPER = """
schema = 1
name = "gripper"
type = "PSM"
title = "A finger on a four-bar"
source = "our own choice"
root = "base"
relative_to = "base"
tip = "finger"

[[joint]]
name = "drive"
kind = "revolute"
lower_deg = -40.0
upper_deg = 40.0
drive = { crank = 1.0 }

[[frame]]
name = "base"

[[frame]]
name = "crank"
parent = "base"
motion = "revolute"
q = { drive = 1.0 }

[[frame]]
name = "finger"
parent = "base"
xyz_mm = [60.0, 10.0, 0.0]
motion = "revolute"
q = { drive = 0.8 }

[[frame]]
name = "coupler"
parent = "crank"
xyz_mm = [0.0, 40.0, 0.0]
motion = "revolute"
q = { drive = -1.0 }

[[closure]]
name = "pin"
frame_a = "finger"
point_a_mm = [5.0, 50.0, 0.0]
frame_b = "coupler"
point_b_mm = [65.0, 20.0, 0.0]
passive = ["finger", "coupler"]
"""


@pytest.fixture
def gripper(tmp_path: Path) -> ArmDescription:
    path = tmp_path / "gripper.toml"
    path.write_text(GRIPPER, encoding="utf-8")
    return load_arm(path)


def swept(arm: ArmDescription, moved: np.ndarray) -> Tracks:
    rng, loops = np.random.default_rng(0), linkage(arm)
    markers = {
        body: transform(matrix_from_rotation_vector(rng.normal(size=3)), 0.02 * rng.normal(size=3))
        for body in loops.bodies
    }
    robot = Robot(loops, moved, {}, markers)
    times = np.arange(360) / 60.0
    q = np.where(times < 1.0, 0.0, 0.5 * np.sin(2.0 * np.pi * (times - 1.0) / 5.0))[:, None]
    seen = marker_poses(robot, mechanism_of(robot), q)
    poses = {body: seen[:, i] for i, body in enumerate(loops.bodies)}
    return Tracks("gripper.csv", "", times, poses, 60.0)


def test_a_four_bar_of_a_users_own_is_calibrated(gripper: ArmDescription) -> None:
    loops = linkage(gripper)
    assert list(loops.bodies) == [f"gripper_{n}" for n in ("base", "crank", "finger", "coupler")]
    off = np.zeros((5, 2))
    off[2], off[3] = (1e-3, 5e-4), (4e-4, -7e-4)  # the coupler's hinge, and one side of the pin
    off[4] = off[3] - off[2] + off[1]  # the pin's other side, so that home closes
    found = calibrate(swept(gripper, off), gripper)
    assert found.closure == "general" and found.centre is None and not found.betas
    want = float(np.linalg.norm(np.array([0.0, 0.04]) + off[2] @ _axes(gripper)))
    assert found.axis_distances["crank-coupler"].value == pytest.approx(want, abs=1e-8)
    assert found.axis_distances["crank-finger"].value == pytest.approx(0.0608276253, abs=1e-8)
    assert np.abs(found.refined.robot.moved - off).max() < 1e-8
    apply_overlay(gripper, parse_overlay(overlay_text(found.overlay), "overlay.toml"))


def _axes(arm: ArmDescription) -> np.ndarray:
    """Return the plane's two axes in the base, as rows of x and y."""
    return linkage(arm).plane[:2, :2].T


def test_a_four_bar_is_no_parallelogram(gripper: ArmDescription) -> None:
    with pytest.raises(InputError, match="not parallelograms; allowed: closure 'general'"):
        calibrate(swept(gripper, np.zeros((5, 2))), gripper, closure="parallelogram")


def test_an_arm_without_loops_has_nothing_to_calibrate() -> None:
    suj = load_arm("suj_psm1")
    tracks = Tracks("x.csv", "", np.arange(3.0), {}, 1.0)
    with pytest.raises(InputError, match="has no closed loop"):
        calibrate(tracks, suj)


def test_a_calibrated_arm_is_not_calibrated_again(gripper: ArmDescription) -> None:
    found = calibrate(swept(gripper, np.zeros((5, 2))), gripper)
    again = replace(gripper, overlay=found.overlay)
    with pytest.raises(InputError, match="already calibrated"):
        calibrate(swept(gripper, np.zeros((5, 2))), again)
