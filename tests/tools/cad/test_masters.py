"""The masters as solids: on their axes, left and right mirrored, neighbours clear of each other."""

from __future__ import annotations

import numpy as np
import pytest

from trocar.descriptions import load_arm
from trocar.kinematics.forward import poses

pytest.importorskip("build123d", reason="solids need the extra cad")

from build123d import Plane
from build123d.topology import Shape

from tests.tools.cad.solids import links_of, off_axis, shared
from tools.cad import kit
from tools.cad.links import drawn
from tools.cad.sets import solid_sets

# Whole arms are drawn.
pytestmark = pytest.mark.slow

ZERO = np.zeros(8)
#: Where each link's solid meets the axes that it turns about and carries.
AXES = {
    "base": ("outer_yaw",),
    "outer_yaw": ("outer_yaw", "shoulder_pitch"),
    "shoulder_pitch": ("shoulder_pitch", "elbow_pitch"),
    "elbow_pitch": ("elbow_pitch", "wrist_platform", "c1"),
    "elbow_bar": ("elbow_bar", "elbow_rod"),
    "elbow_rod": ("elbow_rod", "c1"),
    "wrist_platform": ("wrist_platform", "wrist_pitch"),
    "wrist_pitch": ("wrist_pitch", "wrist_yaw"),
    "wrist_yaw": ("wrist_yaw", "wrist_roll"),
    "wrist_roll": ("wrist_roll",),
    "gripper_left": ("gripper_left",),
    "gripper_right": ("gripper_right",),
}


def axis_at_zero(name: str, axis: str) -> tuple[np.ndarray, np.ndarray]:
    """A point [mm] and the direction of an axis in the base at zero, from the tables alone."""
    m = load_arm(name).mechanism
    at = poses(m, ZERO, relative_to="base")
    if axis == "c1":
        return 1e3 * at["c1"][:3, 3], at["elbow_rod"][:3, 2]
    frame = m.frame(axis)
    assert frame.parent is not None
    pose = at[frame.parent] @ frame.before
    return 1e3 * pose[:3, 3], pose[:3, 2]


def standing(name: str, q: np.ndarray, pins: bool = True) -> dict[str, list[Shape]]:
    at = poses(load_arm(name).mechanism, q, relative_to="base")
    return {
        link.frame: [
            part.solid.moved(kit.location(at[link.frame]))
            for part in link.parts
            if pins or part.material != "steel"
        ]
        for link in links_of(name)
    }


@pytest.mark.parametrize("name", ["mtml", "mtmr"])
def test_every_part_is_a_closed_solid_and_the_budget_is_kept(name):
    count = 0
    for link in links_of(name):
        assert all(part.solid.is_valid for part in link.parts)
        made = drawn(link, solid_sets()["mtm"].fineness)
        count += sum(len(piece.faces) for piece in made.visual)
        assert all(len(piece.faces) <= 64 for piece in made.convex)
    assert count <= 12000


@pytest.mark.parametrize("name", ["mtml", "mtmr"])
def test_bores_and_caps_lie_on_the_axes_of_the_description(name):
    at = standing(name, ZERO)
    for frame, axes in AXES.items():
        for axis in axes:
            assert off_axis(at[frame], *axis_at_zero(name, axis)) < 1e-6, (frame, axis)


def test_the_right_master_is_the_left_ones_mirror_image():
    left, right = standing("mtml", ZERO), standing("mtmr", ZERO)
    for frame in left:
        for a, b in zip(left[frame], right[frame], strict=True):
            image = a.mirror(Plane.YZ)
            for corner in ("min", "max"):
                one, two = (getattr(s.bounding_box(), corner) for s in (image, b))
                assert (one - two).length < 1e-6, frame
            volumes = [sum(s.volume for s in c.solids()) for c in (a, b)]
            assert volumes[0] == pytest.approx(volumes[1], rel=1e-5)  # integrated numerically


@pytest.mark.parametrize("elbow", [-0.87, 0.61])
def test_arm_and_parallelogram_are_clear_of_each_other_at_both_ends_of_the_elbow(elbow):
    """All but the steel pins, which go through."""
    at = standing("mtml", np.array([0.0, 0.2, elbow, 0.0, 0.0, 0.0, 0.0, 0.0]), pins=False)
    chain = ("outer_yaw", "shoulder_pitch", "elbow_pitch", "elbow_rod", "elbow_bar")
    for k, one in enumerate(chain):
        for other in chain[k + 1 :]:
            assert sum(shared(a, b) for a in at[one] for b in at[other]) < 1e-3, (one, other)


@pytest.mark.parametrize("angles", [(0.0, 0.0, 0.0), (1.5, 0.7, -0.7), (-1.6, 3.2, 0.78)])
def test_the_gimbals_angles_are_clear_of_each_other(angles):
    at = standing("mtml", np.array([0.0, 0.2, 0.0, *angles, 0.0, 0.0]), pins=False)
    chain = ("elbow_pitch", "wrist_platform", "wrist_pitch", "wrist_yaw", "wrist_roll")
    for k, one in enumerate(chain):
        for other in chain[k + 1 :]:
            assert sum(shared(a, b) for a in at[one] for b in at[other]) < 1e-3, (one, other)
