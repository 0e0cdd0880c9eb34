"""Pictures of simulated views show the board where the views say it is."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from trocar.descriptions import load_rig
from trocar.robot.boards import Board
from trocar.robot.calibration.camera_views import read_views
from trocar.robot.mocap.view_files import write_views
from trocar.robot.mocap.views import ViewSettings, simulate_views


@pytest.mark.parametrize(
    "board", [Board("chessboard", 8, 5, 0.005, 0.0), Board()], ids=lambda board: board.kind
)
def test_corners_found_in_pictures_are_those_of_the_view(board: Board, tmp_path: Path) -> None:
    pytest.importorskip("cv2")
    pytest.importorskip("moderngl")
    rig, settings = load_rig("two_psm_ecm"), ViewSettings("PSM1", board, 1, 0.0, seed=3)
    made = simulate_views(rig, settings)
    write_views(tmp_path / "views", rig, settings, pictures=True)
    off = np.abs(read_views(tmp_path / "views" / "views.toml").pixels - made.pixels)
    assert np.isfinite(off).sum() > 0.8 * np.isfinite(made.pixels).sum()
    # Detectors are good to 0.1 px (chessboard) and 0.3 px (ChArUco) here.
    assert np.nanmax(off) < 0.6 and np.nanmedian(off) < 0.1
