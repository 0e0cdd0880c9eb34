"""Visual servoing: it centres what both eyes see, and says what it cannot use."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.servoing import run
from trocar.cameras import StereoCalibration
from trocar.cameras.lens import project
from trocar.descriptions import load_arm
from trocar.descriptions.cameras import load_stereo_camera
from trocar.errors import InputError
from trocar.geometry import inverse
from trocar.geometry.rotations import matrix_from_rotation_vector, rotation_z
from trocar.geometry.se3 import transform
from trocar.tasks.scenes.vision import blue_box
from trocar.tasks.vision import ServoSettings, VisualServo

MOUNT = transform(rotation_z(np.pi), np.zeros(3))
Q = np.array([0.1, 0.2, 0.12, 0.3])


@pytest.fixture
def eyes() -> StereoCalibration:
    return load_stereo_camera("hd_1280x720")


def servo(eyes: StereoCalibration, **settings: float) -> VisualServo:
    return VisualServo(load_arm("ecm"), eyes, MOUNT, ServoSettings(**settings))


def seen(eyes: StereoCalibration, point: list[float]) -> list[np.ndarray]:
    return [
        project((inverse(T) @ [*point, 1.0])[:3], eye.K, eye.distortion)
        for T, eye in zip(eyes.mounts, eyes.eyes, strict=True)
    ]


def test_a_point_comes_back_from_the_pixels_of_both_eyes(eyes: StereoCalibration) -> None:
    point = [0.01, -0.004, 0.09]
    np.testing.assert_allclose(servo(eyes).see(0.0, Q, *seen(eyes, point)), point, atol=1e-12)


def test_an_object_that_is_centred_at_its_depth_moves_nothing(eyes: StereoCalibration) -> None:
    one = servo(eyes, depth=0.09)
    one.see(0.0, Q, *seen(eyes, [0.0, 0.0, 0.09]))
    one.velocity(0.0, Q)
    np.testing.assert_allclose(one.velocity(0.005, Q), 0.0, atol=1e-12)


def test_velocities_keep_the_limits_of_the_joints(eyes: StereoCalibration) -> None:
    one, joints = servo(eyes, gain=20.0), load_arm("ecm").joints
    one.see(0.0, Q, *seen(eyes, [0.03, 0.02, 0.2]))
    one.velocity(0.0, Q)
    first = one.velocity(0.01, Q)
    second = one.velocity(0.4, Q)
    for v, w, joint in zip(first, second, joints, strict=True):
        assert abs(v) <= 0.01 * joint.acceleration_max + 1e-12
        assert abs(w) <= joint.velocity_max + 1e-12
    lower = load_arm("ecm").mechanism.lower
    assert (one.velocity(0.41, lower) >= -1e-12).all()


def test_it_brakes_when_the_object_is_lost(eyes: StereoCalibration) -> None:
    one = servo(eyes, lost_after=0.1)
    one.see(0.0, Q, *seen(eyes, [0.02, 0.0, 0.1]))
    moving = [np.abs(one.velocity(0.01 * k, Q)).max() for k in range(60)]
    assert moving[10] > 0.01 and moving[-1] == 0.0


def test_an_object_200_px_off_is_centred_in_time_without_overshoot() -> None:
    found = run((120.0, -160.0), 0.0, 1.6)
    size = np.linalg.norm(found.offset, axis=1)
    # Source of the bounds: the project's goals.
    assert (size[found.times > 1.2] < 2.0).all()
    assert (found.offset @ [0.6, -0.8]).min() > -0.05 * 200.0
    assert found.rcm < 1e-6


def test_pictures_that_cannot_be_used_are_rejected(eyes: StereoCalibration) -> None:
    one, pixels = servo(eyes), seen(eyes, [0.0, 0.0, 0.1])
    with pytest.raises(InputError, match="are the eyes exchanged"):
        one.see(0.0, Q, *pixels[::-1])
    with pytest.raises(InputError, match="within 1280x720"):
        one.see(0.0, Q, [1500.0, 100.0], pixels[1])
    with pytest.raises(InputError, match="2 finite numbers"):
        one.see(0.0, Q, [np.nan, 100.0], pixels[1])
    one.see(0.1, Q, *pixels)
    with pytest.raises(InputError, match=r"got 0.05 s after 0.1 s; allowed: in order"):
        one.see(0.05, Q, *pixels)
    with pytest.raises(InputError, match="allowed: an ECM"):
        VisualServo(load_arm("psm"), eyes, MOUNT)
    with pytest.raises(InputError, match="gain: got -1"):
        ServoSettings(gain=-1.0)


def test_a_box_is_centred_though_a_jaw_hides_one_of_its_corners() -> None:
    cv2 = pytest.importorskip("cv2", reason="needs the extra vision")
    rng, eye = np.random.default_rng(0), load_stereo_camera("dvrk_sd_640x480").left
    half = 0.5 * np.array([0.007, 0.007, 0.008])
    corners = half * (np.mgrid[:2, :2, :2].reshape(3, -1).T * 2.0 - 1.0)
    off: list[np.ndarray] = []
    for _ in range(20):
        turn = matrix_from_rotation_vector(rng.uniform((0.0, -0.2, -0.6), (1.2, 1.0, 0.6)))
        middle = np.array([*rng.uniform(-0.008, 0.008, 2), 0.09])
        pixels = project(corners @ turn.T + middle, eye.K, eye.distortion)
        image = np.full((eye.height, eye.width, 3), (170, 80, 75), np.uint8)
        hull = cv2.convexHull(np.round(pixels).astype(np.int32))
        cv2.fillConvexPoly(image, hull, (30, 80, 150))
        corner = hull[rng.integers(len(hull)), 0]
        true = project(middle, eye.K, eye.distortion)
        jaw = [(true + by * (corner - true)).astype(int).tolist() for by in (0.2, 3.0)]
        cv2.line(image, *jaw, (200, 190, 190), 24)
        found = blue_box(image)
        assert found is not None
        blue = np.argwhere(image[..., 2] == 150)[:, ::-1].mean(axis=0)
        off.append(np.array([np.linalg.norm(found - true), np.linalg.norm(blue - true)]))
    outline, mean = np.median(off, axis=0)
    # Perspective and whole pixels alone are 0.5 px.
    assert outline < 1.5 and mean > 4.0, (outline, mean)
    assert blue_box(np.zeros((eye.height, eye.width, 3), np.uint8)) is None
