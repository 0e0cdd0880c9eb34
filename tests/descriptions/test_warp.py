"""Meshes of a calibrated robot follow its axes, and those of a nominal one stay as they are."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from trocar.descriptions import load_arm
from trocar.descriptions.overlay import (
    ClosurePatch,
    Overlay,
    apply_overlay,
    carried_axes,
    closure_patch,
    frame_patch,
    warp,
)
from trocar.descriptions.records import ArmDescription, Shape
from trocar.descriptions.solids import DATA
from trocar.kinematics.forward import pose

ARMS = ["psm", "ecm"]


def longer(name: str) -> tuple[ArmDescription, ArmDescription]:
    """An arm, and one whose lower and upper bars are 4 mm longer: still parallelograms."""
    arm = load_arm(name, "none")
    more = np.array([0.004, 0.0, 0.0])
    end = frame_patch(arm.mechanism.frame("pitch_end"))
    c2 = next(c for c in arm.mechanism.closures if c.name == "c2")
    overlay = Overlay(
        name,
        frames={"pitch_end": replace(end, xyz=end.xyz + more)},
        closures={"c2": ClosurePatch(c2.point_a + more, c2.point_b)},
    )
    return arm, apply_overlay(arm, overlay)


@pytest.mark.parametrize("name", ARMS)
def test_points_on_an_axis_lie_on_the_calibrated_axis(name: str) -> None:
    arm, robot = longer(name)
    found = carried_axes(arm.mechanism, robot.mechanism, {b.frame for b in arm.bodies})
    moved = 0
    for axes in found.values():
        for axis in axes:
            height = np.array([[-0.03], [0.0], [0.05]])
            points = warp(axis.point + height * axis.along, axes)
            away = points - axis.point_now
            across = away - np.outer(away @ axis.along_now, axis.along_now)
            assert np.abs(across).max() < 1e-7
            moved += axis.moved
    assert moved == 2


@pytest.mark.parametrize("name", ARMS)
def test_bars_reach_the_hinges_of_the_longer_robot(name: str) -> None:
    arm, robot = longer(name)
    for frame in ("pitch_bottom", "pitch_top"):
        before, now = (
            max(
                float(s.mesh.vertices[:, 0].max())
                for body in one.bodies
                if body.frame == frame
                for s in body.shapes
                if s.mesh is not None and s.visible
            )
            for one in (arm, robot)
        )
        assert now - before == pytest.approx(0.004, abs=2e-4)
    q = np.zeros(len(arm.joints))
    reach = pose(robot.mechanism, q, "pitch_end") - pose(arm.mechanism, q, "pitch_end")
    assert np.linalg.norm(reach[:3, 3]) == pytest.approx(0.004)


@pytest.mark.parametrize("name", ARMS)
def test_other_links_keep_their_meshes(name: str) -> None:
    arm, robot = longer(name)
    same = [a.frame for a, b in zip(arm.bodies, robot.bodies, strict=False) if a is b]
    assert {"base", "yaw", "pitch_front", "pitch_back", "insertion"} <= set(same)
    assert not {"pitch_bottom", "pitch_top"} & set(same)


@pytest.mark.parametrize("name", ARMS)
def test_an_overlay_that_says_the_same_changes_nothing(name: str) -> None:
    arm = load_arm(name, "none")
    frames = {f.name: frame_patch(f) for f in arm.mechanism.frames if f.motion != "fixed"}
    closures = {c.name: closure_patch(c) for c in arm.mechanism.closures}
    robot = apply_overlay(arm, Overlay(name, frames=frames, closures=closures))
    for before, now in zip(arm.bodies, robot.bodies, strict=True):
        assert before is now


def test_warped_meshes_are_told_from_the_nominal_ones() -> None:
    arm, robot = longer("psm")
    names = [
        {s.mesh.name for b in one.bodies for s in b.shapes if s.mesh is not None}
        for one in (arm, robot)
    ]
    assert len(names[1]) == len(names[0]) and names[0] != names[1]


def test_shapes_drawn_for_a_robot_are_taken_from_beside_its_overlay(tmp_path: Path) -> None:
    arm, robot = longer("psm")
    assert robot.overlay is not None
    shutil.copytree(DATA / "psm", tmp_path / "robot.solids" / "psm")
    drawn = apply_overlay(arm, replace(robot.overlay, file=str(tmp_path / "robot.toml")))
    bar = next(body for body in drawn.bodies if body.frame == "pitch_bottom")
    nominal = next(body for body in arm.bodies if body.frame == "pitch_bottom")
    own, old = bar.shapes[0].mesh, nominal.shapes[0].mesh
    assert own is not None and old is not None and own is not old
    np.testing.assert_array_equal(own.vertices, old.vertices)
    assert [s.collide for s in bar.shapes] == [s.collide for s in nominal.shapes]


@pytest.mark.parametrize("name", ARMS)
def test_what_touches_of_a_longer_bar_is_as_long_as_the_bar(name: str) -> None:
    arm, robot = longer(name)
    before, after = (touched(one, "pitch_bottom") for one in (arm, robot))
    assert before.kind == after.kind == "box" and before.hull == after.hull == "capsule"
    ends = [shape.pose[0, 3] + np.array([-1.0, 1.0]) * shape.size[0] for shape in (before, after)]
    np.testing.assert_allclose(ends[1] - ends[0], [0.0, 0.004], atol=2e-4)
    np.testing.assert_allclose(before.size[1:], after.size[1:], atol=1e-4)


def test_a_box_that_touches_is_about_all_convex_pieces() -> None:
    arm = load_arm("psm", "none")
    (body,) = (body for body in arm.bodies if body.frame == "pitch_end")
    pieces = [s for s in body.shapes if s.mesh is not None and not s.visible]
    corners = np.concatenate([s.mesh.vertices for s in pieces if s.mesh is not None])
    box = touched(arm, "pitch_end")
    middle = box.pose[:3, 3]
    assert len(pieces) > 1 and not any(s.collide for s in pieces)
    np.testing.assert_allclose(middle - box.size, corners.min(axis=0), atol=1e-12)
    np.testing.assert_allclose(middle + box.size, corners.max(axis=0), atol=1e-12)


def touched(arm: ArmDescription, frame: str) -> Shape:
    """The one shape of a link that collides."""
    (body,) = (body for body in arm.bodies if body.frame == frame)
    (shape,) = (shape for shape in body.shapes if shape.collide)
    return shape
