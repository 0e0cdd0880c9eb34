"""Tips of instruments, registered to images that the endoscope renders elsewhere."""

from __future__ import annotations

from contextlib import closing
from typing import Literal

import numpy as np
import pytest

from trocar.cameras import StereoCalibration
from trocar.descriptions import load_rig
from trocar.errors import InputError
from trocar.geometry import inverse, matrix_from_rotation_vector, transform, transform_points
from trocar.rendering import Endoscope, Look
from trocar.simulation import World
from trocar.simulation.records import DrawnCurve
from trocar.tasks.vision import find_marker, find_tip
from trocar.tasks.vision.instruments import instrument_masks

pytest.importorskip("cv2", reason="needs the extra vision")
pytest.importorskip("moderngl", reason="needs the extra scope")


def test_a_tip_3_mm_beside_its_prediction_is_found_within_2_pixels() -> None:
    world = World(load_rig("training"))
    scope = Endoscope(world, preset="dvrk_sd_640x480", ids=True, look=Look(noise=0.03))
    camera = world.camera("endoscope").T_world_camera
    frame = scope.capture()
    eyes, right = frame.calibration, frame.right
    assert isinstance(eyes, StereoCalibration) and right is not None
    tip = world.arms["PSM1"].measured_cp("world").matrix
    truth = inverse(frame.T_world_camera[0]) @ tip @ [0.0, 0.0, 0.005, 1.0]
    # The hand-eye error turns and moves what is seen about the tip.
    error = transform(matrix_from_rotation_vector([0.01, -0.015, 0.01]), [2e-3, -1.5e-3, 1.5e-3])
    about = transform(np.eye(3), truth[:3])
    believed = about @ error @ inverse(about)  # believed = error of true, in the left eye
    mount = frame.calibration.mounts[0]
    there = scope.render(
        world.snapshot(), world.cameras(),
        T_world_camera=camera @ mount @ inverse(believed) @ inverse(mount),
    )  # fmt: skip
    guess = (believed @ truth)[:3]
    fix = find_tip(
        eyes,
        frame.left,
        right,
        there.eyes,
        instrument_masks(there, "PSM1"),
        guess,
    )
    scope.close()
    for eye in range(2):
        true = frame.project((frame.T_world_camera[0] @ truth)[:3], eye)
        # Source of the bounds: the project's goals.
        assert np.linalg.norm(fix.pixels[eye] - true) < 2.0
    assert np.linalg.norm(guess - truth[:3]) > 2.5e-3
    assert np.linalg.norm(fix.point - truth[:3]) < 1.5e-3
    blank = np.full_like(frame.left, 90)
    masks = instrument_masks(there, "PSM1")
    with pytest.raises(InputError, match=r"of the instrument's edges .* Is it in view\?"):
        find_tip(eyes, blank, blank, there.eyes, masks, guess)
    with pytest.raises(InputError, match="a point ahead of the eyes"):
        find_tip(eyes, blank, blank, there.eyes, masks, -guess)
    with pytest.raises(InputError, match=r"tip: at .* px, out of the \(640, 480\) images"):
        find_tip(eyes, blank, blank, there.eyes, masks, np.array([0.3, 0.0, guess[2]]))
    with pytest.raises(InputError, match=r"predicted image: got 640x240; allowed: 640x480"):
        find_tip(eyes, blank, blank, [one[::2] for one in there.eyes], masks, guess)


@pytest.mark.parametrize("style", ["plain", "surgical"])
def test_a_green_dot_on_an_instrument_is_found_in_both_eyes(style: Literal["plain"]) -> None:
    world = World(load_rig("training"))
    tip = world.arms["PSM1"].measured_cp("world").matrix
    sight = world.camera("endoscope").T_world_camera[:3, 2]
    dot = tip[:3, 3] - 0.012 * sight  # in front of the jaws
    across = np.cross(sight, [1.0, 0.0, 0.0])
    line = dot + np.outer([-1e-3, 1e-3], across / np.linalg.norm(across))
    stop = world.draw("dot", lambda: DrawnCurve("dot", line, 0.001, (0.1, 0.7, 0.2, 1.0)))
    with closing(Endoscope(world, preset="dvrk_sd_640x480", look=Look(style, noise=0.03))) as scope:
        frame = scope.capture()
        stop()
        bare = scope.capture()
    eyes = frame.calibration
    assert isinstance(eyes, StereoCalibration) and frame.right is not None
    assert bare.right is not None
    fix = find_marker(eyes, frame.left, frame.right, (40, 180, 60))
    for eye in range(2):
        assert np.linalg.norm(fix.pixels[eye] - frame.project(dot, eye)) < 0.5
    true = transform_points(inverse(frame.T_world_camera[0]), dot)
    depth_per_px = true[2] ** 2 / (frame.K[0, 0, 0] * frame.baseline)
    assert np.linalg.norm(fix.point - true) < 0.75 * depth_per_px
    with pytest.raises(InputError, match=r"the left image has nothing of its colour"):
        find_marker(eyes, bare.left, bare.right, (40, 180, 60))
    with pytest.raises(InputError, match="allowed: one that is not grey"):
        find_marker(eyes, frame.left, frame.right, (90, 90, 90))
