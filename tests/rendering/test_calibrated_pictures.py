"""Pictures are what a camera with that calibration takes: OpenCV finds the calibration in them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.rendering import checkerboard as board
from trocar.cameras import Intrinsics, StereoCalibration
from trocar.descriptions.cameras import load_stereo_camera
from trocar.geometry.rotations import matrix_from_rotation_vector
from trocar.geometry.se3 import inverse, transform
from trocar.rendering import Endoscope, Look, StereoFrame

cv2 = pytest.importorskip("cv2", reason="OpenCV is the judge here")
pytestmark = pytest.mark.usefixtures("opengl")

#: Where the board is seen from: distance [m], turn [rad], shift [m].
VIEWS = [
    (0.100, (0.0, 0.0, 0.0), (0.0, 0.0)),
    (0.110, (0.7, 0.0, 0.1), (0.004, 0.0)),
    (0.105, (-0.7, 0.1, -0.1), (-0.004, 0.002)),
    (0.105, (0.1, 0.7, 0.2), (0.0, -0.004)),
    (0.105, (0.0, -0.7, -0.2), (0.006, 0.002)),
    (0.115, (0.5, 0.5, 0.3), (-0.01, 0.0)),
    (0.110, (-0.5, 0.5, 0.0), (0.01, -0.004)),
    (0.120, (0.5, -0.5, -0.3), (0.012, 0.006)),
    (0.115, (-0.5, -0.5, 0.25), (-0.012, -0.006)),
    (0.100, (0.6, -0.2, 1.5), (0.0, 0.001)),
    (0.105, (-0.2, 0.65, 1.6), (0.01, 0.0)),
    (0.105, (0.2, -0.65, -1.5), (-0.01, 0.0)),
]
#: What real scopes have, and the other way round: k1, k2, p1, p2.
BARREL, CUSHION = (-0.33, 0.12, 0.002, -0.001), (0.2, -0.1, -0.001, 0.001)
#: No film of water, whose glint would hide squares.
DRY = Look(wet=0.0)
#: And edges without stairs, which OpenCV finds to a twentieth of a pixel.
SMOOTH = Look(wet=0.0, samples=4)


def crooked(*lenses: tuple[float, ...]) -> StereoCalibration:
    """Two eyes that differ in everything, as a real scope's do."""
    one, other = lenses or ((), ())
    left = np.array([[588.776, 0.0, 325.305], [0.0, 589.725, 251.666], [0.0, 0.0, 1.0]])
    right = np.array([[610.0, 0.0, 330.0], [0.0, 605.0, 245.0], [0.0, 0.0, 1.0]])
    turn = matrix_from_rotation_vector(np.array([0.01, -0.03, 0.02]))
    return StereoCalibration(
        Intrinsics(640, 480, left, np.array(one)),
        Intrinsics(640, 480, right, np.array(other)),
        transform(turn, [5.2e-3, 0.1e-3, -0.2e-3]),
    )


def frames(
    folder: Path, calibration: StereoCalibration | None, views: list, look: Look, **more
) -> list[StereoFrame]:
    """Look at the board from each view."""
    world = board.world_with_board(folder, more.pop("dark", "joint"))
    scope = Endoscope(world, calibration=calibration, look=look, **more)
    snapshot, camera = world.snapshot(), world.camera("endoscope")
    placed = [board.before(camera, board.looking(*view)) for view in views]
    found = [scope.render(snapshot, {"endoscope": place}) for place in placed]
    scope.close()
    return found


def T_eye_board(frame: StereoFrame, eye: int) -> np.ndarray:
    T_world_board = transform(np.eye(3), board.PLACE)
    return inverse(frame.T_world_camera[eye]) @ T_world_board


def judged(points: np.ndarray, frame: StereoFrame, eye: int) -> np.ndarray:
    """Project points of the board with OpenCV, (n, 2) [px]."""
    T, seen = T_eye_board(frame, eye), frame.calibration.eyes[eye]
    turn, _ = cv2.Rodrigues(T[:3, :3])
    found, _ = cv2.projectPoints(points, turn, T[:3, 3], seen.K, seen.distortion)
    return found[:, 0]


def on_the_board(pixels: np.ndarray, frame: StereoFrame, eye: int) -> tuple[np.ndarray, np.ndarray]:
    """Intersect the rays of pixels with the board: points in its frame (n, 3), depths (n,) [m]."""
    T, seen = T_eye_board(frame, eye), frame.calibration.eyes[eye]
    rays = np.ones((len(pixels), 3))
    rays[:, :2] = cv2.undistortPoints(pixels[:, None], seen.K, seen.distortion)[:, 0]
    depth = (T[:3, 2] @ T[:3, 3]) / (rays @ T[:3, 2])
    return (rays * depth[:, None] - T[:3, 3]) @ T[:3, :3], depth


def pixels_of(frame: StereoFrame) -> np.ndarray:
    height, width = frame.left.shape[:2]
    u, v = np.meshgrid(np.arange(width), np.arange(height))
    return np.stack([u, v], axis=-1).reshape(-1, 2).astype(np.float64)


def found_corners(picture: np.ndarray, expected: np.ndarray) -> np.ndarray:
    """Let OpenCV look for the corners, and number them as the board does, (n, 2) [px]."""
    grey = cv2.cvtColor(np.ascontiguousarray(picture), cv2.COLOR_RGB2GRAY)
    seen, corners = cv2.findChessboardCornersSB(
        grey, board.CORNERS, flags=cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_ACCURACY
    )
    assert seen
    grid = corners.reshape(*board.CORNERS[::-1], 2)
    ways = [grid[::a, ::b].reshape(-1, 2) for a in (1, -1) for b in (1, -1)]
    return min(ways, key=lambda way: float(np.abs(way - expected).max())).astype(np.float32)


def calibrated(
    shot: list[StereoFrame], flags: int
) -> tuple[list[np.ndarray], list[np.ndarray], float, np.ndarray]:
    """Let OpenCV calibrate: each eye's K and distortion, the baseline [m], and R_right_left."""
    things = [board.corners().astype(np.float32)] * len(shot)
    seen = [
        [found_corners(frame.eyes[k], judged(board.corners(), frame, k)) for frame in shot]
        for k in (0, 1)
    ]
    size = shot[0].calibration.eyes[0].size
    alone = [cv2.calibrateCamera(things, s, size, None, None, flags=flags)[1:3] for s in seen]
    _, K1, D1, K2, D2, R, T, _, _ = cv2.stereoCalibrate(
        things, *seen, *alone[0], *alone[1], size, flags=flags | cv2.CALIB_USE_INTRINSIC_GUESS
    )
    return [K1, K2], [D1.ravel(), D2.ravel()], float(np.linalg.norm(T)), R


def assert_recovered(
    shot: list[StereoFrame], flags: int, expected: StereoCalibration
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Hold what OpenCV finds against what was asked for: K to 0.1 %, the baseline to 0.05 mm.

    Returns:
        K and distortion of each eye, as OpenCV found them
    """
    found, lenses, baseline, R = calibrated(shot, flags)
    for K, eye in zip(found, expected.eyes, strict=True):
        entries = ([0, 1, 0, 1], [0, 1, 2, 2])
        np.testing.assert_allclose(K[entries], eye.K[entries], rtol=1e-3)
    assert baseline == pytest.approx(expected.baseline, abs=0.05e-3)
    np.testing.assert_allclose(R, expected.T_left_right[:3, :3].T, atol=1e-3)
    return list(zip(found, lenses, strict=True))


NO_DISTORTION = cv2.CALIB_ZERO_TANGENT_DIST | cv2.CALIB_FIX_K1 | cv2.CALIB_FIX_K2
NO_DISTORTION |= cv2.CALIB_FIX_K3


@pytest.mark.slow
def test_opencv_recovers_the_calibration_of_a_preset(tmp_path: Path) -> None:
    shot = frames(tmp_path, None, VIEWS, SMOOTH)
    assert shot[0].left.shape == (720, 1280, 3)
    assert_recovered(shot, NO_DISTORTION, load_stereo_camera("hd_1280x720"))


@pytest.mark.parametrize("view", [VIEWS[0], VIEWS[5]], ids=["facing", "turned"])
def test_squares_end_where_opencv_projects_their_edges(view: tuple, tmp_path: Path) -> None:
    """Each pixel whose middle is 0.05 px or farther from an edge has its square's colour."""
    (shot,) = frames(tmp_path, crooked(), [view], Look(wet=0.0, shadows=False), dark="drape")
    pixels = pixels_of(shot)
    for eye, picture in enumerate(shot.eyes):
        points, _ = on_the_board(pixels, shot, eye)
        np.testing.assert_allclose(judged(points, shot, eye), pixels, atol=1e-6)
        square = board.square_of(points)
        sure = board.within(points)
        for step in ([0.05, 0.0], [-0.05, 0.0], [0.0, 0.05], [0.0, -0.05]):
            beside, _ = on_the_board(pixels + step, shot, eye)
            sure &= (board.square_of(beside) == square).all(axis=1)
        assert sure.sum() > 30_000
        red, _, blue = picture.reshape(-1, 3).astype(np.float64).T
        # A drape's red is 0.56 of its blue, a floor's 0.96: whatever the light, halfway is safe.
        dark = red < 0.76 * blue
        assert not (dark != (square.sum(axis=1) % 2 == 1))[sure].any()


@pytest.mark.slow
def test_opencv_recovers_two_eyes_that_differ_in_everything_and_distort(tmp_path: Path) -> None:
    # Without p1 and p2: a dozen views tell these from the principal point to a pixel only.
    expected = crooked((*BARREL[:2], 0.0, 0.0), (*CUSHION[:2], 0.0, 0.0)).resized(1280, 960)
    shot = frames(tmp_path, expected, VIEWS, replace(SMOOTH, distortion=True))
    flags = cv2.CALIB_FIX_K3 | cv2.CALIB_ZERO_TANGENT_DIST
    found = assert_recovered(shot, flags, expected)
    for (_, lens), eye in zip(found, expected.eyes, strict=True):
        # k2 is what a dozen views tell least of: they see little of the corners.
        np.testing.assert_allclose(lens[0], eye.distortion[0], atol=0.005)
        np.testing.assert_allclose(lens[1], eye.distortion[1], atol=0.03)


@pytest.mark.parametrize("view", [VIEWS[0], VIEWS[2]], ids=["facing", "turned"])
def test_corners_lie_where_opencv_projects_them_distortion_included(
    view: tuple, tmp_path: Path
) -> None:
    calibration = crooked(BARREL, CUSHION).resized(1280, 960)
    (shot,) = frames(tmp_path, calibration, [view], replace(SMOOTH, distortion=True))
    for eye, picture in enumerate(shot.eyes):
        np.testing.assert_array_equal(
            shot.calibration.eyes[eye].distortion, calibration.eyes[eye].distortion
        )
        expected = judged(board.corners(), shot, eye)
        off = found_corners(picture, expected) - expected
        # OpenCV finds single corners to 0.03 px in pictures without distortion, and these are mixed
        # from neighbouring pixels; the mean of all is what is asked for.
        assert np.abs(off.mean(axis=0)).max() < 0.05
        assert np.median(np.linalg.norm(off, axis=1)) < 0.1


@pytest.mark.parametrize("view", [VIEWS[0], VIEWS[5]], ids=["facing", "turned"])
def test_the_depth_of_a_plane_is_that_of_the_rays_that_meet_it(view: tuple, tmp_path: Path) -> None:
    (shot,) = frames(tmp_path, None, [view], DRY, depth=True)
    assert shot.depth is not None
    pixels = pixels_of(shot)
    for eye in (0, 1):
        points, expected = on_the_board(pixels, shot, eye)
        inside = board.within(points)
        assert inside.sum() > 100_000
        error = np.abs(shot.depth[eye].ravel() - expected)[inside]
        # 0.1 mm at 100 mm is what is asked for; 32 bits of depth leave a few um.
        assert error.max() < 0.01e-3
    if view is VIEWS[0]:
        assert np.median(shot.depth[0][300:420, 600:680]) == pytest.approx(0.1, abs=1e-5)
