"""The endoscope of a world: what its frames say, and what asking for one changes."""

from __future__ import annotations

import numpy as np
import pytest

from trocar.errors import UnknownNameError
from trocar.rendering import Endoscope, Look
from trocar.simulation import World

pytestmark = pytest.mark.usefixtures("opengl")

SMALL = "dvrk_sd_640x480"


@pytest.fixture
def world() -> World:
    found = World("two_psm_ecm")
    found.reset(pose="work")
    return found


def test_both_eyes_see_the_instruments_at_the_pose_work(world: World) -> None:
    frame = Endoscope(world, preset=SMALL, depth=True, ids=True, normals=True).capture()
    assert frame.left.shape == (480, 640, 3) and frame.left.dtype == np.uint8
    assert frame.right is not None and (frame.left != frame.right).any()
    assert frame.ids is not None and frame.depth is not None and frame.normals is not None
    for ids in frame.ids:
        seen = {frame.names[int(k)] for k in np.unique(ids) if k}
        assert {"PSM1/finger_left", "PSM2/finger_left"} <= seen
    assert frame.depth.shape == (2, 480, 640) and frame.depth.dtype == np.float32
    drawn = frame.ids > 0
    assert (np.isinf(frame.depth) == ~drawn).all()
    assert np.abs(np.linalg.norm(frame.normals[drawn], axis=-1) - 1.0).max() < 1e-5
    assert frame.time == world.time


def test_a_frame_tells_calibration_and_poses_of_its_eyes(world: World) -> None:
    frame = Endoscope(world, preset=SMALL).capture()
    record = world.camera("endoscope")
    apart = np.linalg.norm(frame.T_world_camera[1, :3, 3] - frame.T_world_camera[0, :3, 3])
    assert frame.baseline == pytest.approx(apart, abs=1e-12)
    assert frame.K.shape == (2, 3, 3)
    middle = frame.T_world_camera[:, :3, 3].mean(axis=0)
    assert np.abs(middle - record.T_world_camera[:3, 3]).max() < 1e-12
    assert frame.depth is None and frame.ids is None and frame.normals is None


def test_frames_are_read_only(world: World) -> None:
    frame = Endoscope(world, preset=SMALL).capture()
    with pytest.raises(ValueError, match="read-only"):
        frame.left[0, 0, 0] = 1


def test_the_same_moment_twice_is_the_same_picture(world: World) -> None:
    scope = Endoscope(world, preset=SMALL, look=Look(exposure=1.0))
    assert (scope.capture().side_by_side == scope.capture().side_by_side).all()


def test_an_unknown_camera_is_named_beside_the_known_ones(world: World) -> None:
    with pytest.raises(UnknownNameError, match=r"unknown camera 'scope'.*endoscope"):
        Endoscope(world, "scope")
    with pytest.raises(UnknownNameError, match="hd_1280x720"):
        Endoscope(world, preset="hd")
