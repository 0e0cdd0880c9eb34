"""Eyes, scope and bases from views of a board: exact without noise, honest with it."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scipy.stats import chi2

from benchmarks.vision import as_views
from trocar.descriptions import load_rig
from trocar.errors import InputError, MissingExtraError, TrocarError
from trocar.geometry import inverse, log_transform
from trocar.kinematics import pose
from trocar.robot.boards import Board, find_corners
from trocar.robot.calibration.camera_views import read_views
from trocar.robot.calibration.hand_eye import calibrate_camera
from trocar.robot.mocap import views as mocap_views
from trocar.robot.mocap.view_files import write_views
from trocar.robot.mocap.views import SimulatedViews, ViewSettings, simulate_views

NOISE = np.radians(0.02)
EXACT = {"corner_noise_px": 0.0, "joint_noise": 0.0}


def made(**settings: float) -> SimulatedViews:
    return simulate_views(load_rig("two_psm_ecm"), ViewSettings("PSM1", **settings))  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def noisy() -> SimulatedViews:
    return made(seed=3)


def test_simulated_corners_lie_where_the_chain_of_arms_and_lenses_puts_them() -> None:
    one, arms = made(count=6, **EXACT), load_rig("two_psm_ecm")
    for i in range(6):
        scope, tool = (
            pose(arms.arm(name).arm.mechanism, one.q[name][i]) for name in ("ECM", "PSM1")
        )
        board = inverse(scope @ one.left) @ one.base @ tool @ one.board
        np.testing.assert_allclose(board, one.seen[i], atol=1e-12)


@pytest.mark.parametrize("offset", [0.0, 0.0035])
def test_views_without_noise_give_eyes_scope_and_base(offset: float) -> None:
    truth = made(offset=offset, seed=1, count=12, **EXACT)
    found = calibrate_camera(as_views(truth), NOISE, offsets=offset > 0.0)
    # Offsets and distortion are known beforehand to be near 0, which pulls by some nanometres.
    assert np.abs(log_transform(inverse(found.left.pose) @ truth.left_read)).max() < 2e-6
    assert np.abs(log_transform(inverse(found.bases["PSM1"].pose) @ truth.base_read)).max() < 2e-6
    for eye, true in zip(found.calibration.eyes, truth.calibration.eyes, strict=True):
        np.testing.assert_allclose(eye.K, true.K, atol=0.02)
        np.testing.assert_allclose(eye.distortion, true.distortion, atol=1e-3)
    assert found.calibration.baseline == pytest.approx(truth.calibration.baseline, abs=1e-6)
    for arm, row in found.offsets.items():
        joints = load_rig("two_psm_ecm").arm(arm).arm.mechanism.joint_names
        for joint, value in row.items():
            assert value.value == pytest.approx(truth.offsets[arm][joints.index(joint)], abs=1e-5)


def test_offsets_that_equal_a_shift_of_a_pose_count_for_it() -> None:
    found = calibrate_camera(as_views(made(seed=2, count=8)), NOISE, offsets=True)
    assert found.absorbed == {
        "ECM": ("yaw", "insertion", "roll"),
        "PSM1": ("yaw", "wrist_yaw"),
    }
    assert set(found.offsets["PSM1"]) == {"pitch", "insertion", "roll", "wrist_pitch"}
    assert set(found.offsets["ECM"]) == {"pitch"}


def test_errors_are_as_large_as_their_covariance_says() -> None:
    squares = []
    for seed in range(4):
        truth = made(seed=seed, count=8)
        found = calibrate_camera(as_views(truth), NOISE)
        error = log_transform(inverse(found.left.pose) @ truth.left)
        squares.append(error @ np.linalg.solve(found.left.covariance, error))
    # A sum of 24 squares lies between these in 99.9 % of cases.
    low, high = chi2.ppf([5e-4, 1.0 - 5e-4], 24)
    assert low < sum(squares) < high


def test_constant_offsets_are_named_where_they_are_not_looked_for() -> None:
    truth = made(offset=0.01, seed=1, count=12)
    (warning,) = calibrate_camera(as_views(truth), NOISE).warnings
    assert "constant offsets" in warning and "--offsets" in warning
    assert not calibrate_camera(as_views(truth), NOISE, offsets=True).warnings


def test_joint_noise_larger_than_said_is_warned_of() -> None:
    truth = made(joint_noise=2e-3, seed=1)
    warnings = calibrate_camera(as_views(truth), NOISE).warnings
    assert any("--joint-noise-deg" in text for text in warnings)


def test_views_without_corners_are_left_out_and_named(noisy: SimulatedViews) -> None:
    views = as_views(noisy)
    pixels = views.pixels.copy()
    pixels[[2, 5]] = np.nan
    found = calibrate_camera(replace(views, pixels=pixels), NOISE)
    assert found.warnings[0] == "no corners were found in the views 002, 005"
    assert len(found.view_rms) == 18


def test_exchanged_eyes_are_noticed_by_their_disparity(noisy: SimulatedViews) -> None:
    views = as_views(noisy)
    with pytest.raises(InputError, match=r"disparity -\d+ px.*Are the eyes exchanged"):
        calibrate_camera(replace(views, pixels=views.pixels[:, ::-1]), NOISE)


def test_a_view_with_misplaced_corners_is_named(noisy: SimulatedViews) -> None:
    views = as_views(noisy)
    pixels = views.pixels.copy()
    pixels[4] += np.random.default_rng(0).normal(scale=4.0, size=pixels[4].shape)
    warnings = calibrate_camera(replace(views, pixels=pixels), NOISE).warnings
    assert any("view 004" in text for text in warnings)


def test_a_view_off_by_less_than_corners_are_found_is_not_named() -> None:
    views = as_views(made(seed=1, count=8, **EXACT))
    pixels = views.pixels.copy()
    pixels[4] += np.random.default_rng(0).normal(scale=1e-5, size=pixels[4].shape)
    assert calibrate_camera(replace(views, pixels=pixels), NOISE).warnings == ()


def test_too_few_views_are_rejected(noisy: SimulatedViews) -> None:
    with pytest.raises(InputError, match="got 5 views of a board; allowed: at least 6"):
        calibrate_camera(as_views(noisy).chosen(range(5)), NOISE)
    blank = as_views(noisy)
    pixels = blank.pixels.copy()
    pixels[3:, 1] = np.nan
    pixels[9] = np.nan
    with pytest.raises(InputError, match="3 views show four corners or more to both eyes"):
        calibrate_camera(replace(blank, pixels=pixels), NOISE)


def test_views_by_a_scope_that_stands_still_do_not_determine_its_camera(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(mocap_views, "ECM_SPREAD", np.zeros(4))
    with pytest.raises(InputError, match=r"the views do not determine T_ECM_left.*required"):
        calibrate_camera(as_views(made(seed=1, count=6)), NOISE)


def test_corners_of_another_board_are_rejected(noisy: SimulatedViews) -> None:
    views = as_views(noisy).chosen(range(6))
    with pytest.raises(TrocarError):
        calibrate_camera(replace(views, points=views.points[::-1] * [1.0, 0.5, 1.0]), NOISE)


@pytest.mark.parametrize("noise", [0.0, -1.0, 1.0, np.nan])
def test_impossible_joint_noise_is_rejected(noisy: SimulatedViews, noise: float) -> None:
    with pytest.raises(InputError, match="joint noise"):
        calibrate_camera(as_views(noisy), noise)


@pytest.fixture
def written(tmp_path: Path) -> Path:
    rig = load_rig("two_psm_ecm")
    write_views(tmp_path / "views", rig, ViewSettings("PSM1", count=6))
    return tmp_path / "views" / "views.toml"


def test_views_come_back_as_they_were_written(written: Path) -> None:
    truth, read = made(count=6), read_views(written)
    np.testing.assert_allclose(read.pixels, truth.pixels, atol=1e-5)
    for arm in ("ECM", "PSM1"):
        np.testing.assert_array_equal(read.q[arm], truth.read[arm])
    np.testing.assert_array_equal(read.points, ViewSettings("PSM1").board.corners)


@pytest.mark.parametrize(
    ("old", "new", "problem"),
    [
        ("size_px = [1280, 720]", "size_px = [640, 480]", "pictures of another size"),
        ("size_px = [1280, 720]", 'size_px = [1280, 720]\npreset = "dvrk_sd_640x480"', "640x480"),
        ('description = "ecm"', 'description = "psm"', "one ECM, and PSMs"),
        ("schema = 1", "schema = 2", "allowed: 1"),
        ("columns = 8", "columns = 2", "3 to 50"),
        ("marker_mm = 3.7", "marker_mm = 7", "smaller ones"),
        ('kind = "charuco"', 'kind = "dots"', "chessboard, charuco"),
        ("ECM = [0.", "ECM = [30.", "rad, or m of joints that slide"),
        ('name = "001"', 'name = "000"', "second time"),
        ('corners = "corners.csv"', "", "allowed: left and right"),
        ('corners = "corners.csv"', 'corners = "none.csv"', "cannot be read"),
    ],
)
def test_broken_files_of_views_say_what_is_allowed(
    written: Path, old: str, new: str, problem: str
) -> None:
    text = written.read_text()
    assert old in text
    written.write_text(text.replace(old, new, 1))
    with pytest.raises(InputError, match=problem):
        read_views(written)


@pytest.mark.parametrize(
    ("old", "new", "problem"),
    [
        ("view,eye,corner", "view,side,corner", "columns missing: eye"),
        ("000,left,0,", "000,middle,0,", "allowed: left, right"),
        ("000,left,0,", "zzz,left,0,", "view: got 'zzz'"),
        ("000,left,0,", "000,left,35,", "allowed: 0 to 34"),
        ("000,left,0,", "000,left,x,", "finite number"),
        ("000,left,0,", "000,left,0,5", "within 1280x720"),
    ],
)
def test_broken_files_of_corners_name_the_line(
    written: Path, old: str, new: str, problem: str
) -> None:
    corners = written.parent / "corners.csv"
    text = corners.read_text()
    assert old in text
    corners.write_text(text.replace(old, new, 1))
    with pytest.raises(TrocarError, match=problem):
        read_views(written)


def flat_picture(board: Board, path: Path) -> np.ndarray:
    """Write a picture of a board seen straight, 30 px a square; return where its corners are."""
    cv2 = pytest.importorskip("cv2")
    if board.kind == "charuco":
        number = getattr(cv2.aruco, board.dictionary)
        drawn = cv2.aruco.CharucoBoard(
            (board.columns, board.rows), board.square, board.marker,
            cv2.aruco.getPredefinedDictionary(number),
        ).generateImage((60 * board.columns, 60 * board.rows))  # fmt: skip
    else:
        down, across = np.mgrid[: board.rows, : board.columns]
        drawn = np.kron(np.where((down + across) % 2, 255, 0), np.ones((60, 60))).astype(np.uint8)
    picture = np.full((480, 640), 255, dtype=np.uint8)
    picture[40 : 40 + drawn.shape[0], 60 : 60 + drawn.shape[1]] = drawn
    Image.fromarray(picture).save(path)
    return 60.0 * board.corners[:, :2] / board.square + [59.5, 39.5]


@pytest.mark.parametrize(
    "board", [Board(), Board("chessboard", 8, 5, 0.004, 0.0, ""), Board("charuco", 5, 7)]
)
@pytest.mark.parametrize("turned", [False, True])
def test_corners_are_found_and_numbered_in_a_picture(
    board: Board, turned: bool, tmp_path: Path
) -> None:
    path = tmp_path / "board.png"
    expected = flat_picture(board, path)
    if turned:
        Image.fromarray(np.asarray(Image.open(path))[::-1, ::-1].copy()).save(path)
        expected = [639.0, 479.0] - expected
    np.testing.assert_allclose(find_corners(path, board, (640, 480)), expected, atol=0.3)


def test_a_picture_without_a_board_has_no_corners(tmp_path: Path) -> None:
    pytest.importorskip("cv2")
    path = tmp_path / "grey.png"
    Image.fromarray(np.full((480, 640), 90, dtype=np.uint8)).save(path)
    for board in (Board(), Board("chessboard", 8, 5, 0.004)):
        assert np.isnan(find_corners(path, board, (640, 480))).all()


def test_pictures_of_another_size_or_kind_are_rejected(tmp_path: Path) -> None:
    path = tmp_path / "grey.png"
    Image.fromarray(np.full((480, 640), 90, dtype=np.uint8)).save(path)
    with pytest.raises(InputError, match="is 640x480; allowed: 1280x720"):
        find_corners(path, Board(), (1280, 720))
    path.write_bytes(b"no picture")
    with pytest.raises(InputError, match="cannot be read as a picture"):
        find_corners(path, Board(), (640, 480))


def test_pictures_need_the_extra_vision(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "cv2", None)
    path = tmp_path / "grey.png"
    Image.fromarray(np.full((480, 640), 90, dtype=np.uint8)).save(path)
    with pytest.raises(MissingExtraError, match=r"trocar\[vision\]"):
        find_corners(path, Board(), (640, 480))


def test_a_chessboard_that_looks_the_same_from_both_ends_is_rejected() -> None:
    with pytest.raises(InputError, match="one count even, the other odd"):
        Board("chessboard", 8, 6)
