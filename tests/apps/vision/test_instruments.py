"""Tips of instruments, registered to images that the endoscope renders elsewhere."""

from __future__ import annotations

import numpy as np
import pytest

from trocar.apps.vision import find_tip
from trocar.apps.vision.instruments import instrument_masks
from trocar.cameras import StereoCalibration
from trocar.descriptions import load_rig
from trocar.errors import InputError
from trocar.geometry import inverse, matrix_from_rotation_vector, transform
from trocar.rendering import Endoscope, Look
from trocar.simulation import World

pytest.importorskip("cv2", reason="needs the extra vision")
pytest.importorskip("moderngl", reason="needs the extra scope")


def test_a_tip_3_mm_beside_its_prediction_is_found_within_2_pixels() -> None:
    world = World(load_rig("training"))
    scope = Endoscope(world, preset="dvrk_sd_640x480", ids=True, look=Look(noise=0.03))
    camera = world.camera("endoscope").T_world_camera
    frame = scope.capture()
    eyes, right = frame.calibration, frame.right
    assert isinstance(eyes, StereoCalibration) and right is not None
    tip = world.arms["PSM1"].tip_in_world().T
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
