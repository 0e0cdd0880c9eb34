"""A checkerboard to calibrate cameras with, and a world in which one hangs before an endoscope.

Its squares are boxes that lie side by side, so that their faces make one plane without steps.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from trocar.descriptions.catalogue import DATA
from trocar.geometry.rotations import matrix_from_rotation_vector
from trocar.geometry.se3 import inverse, transform
from trocar.simulation import World
from trocar.simulation.cameras import CameraRecord

#: Squares across and down, their edge and the white rim about them [mm].
ACROSS, DOWN, SQUARE, RIM = 10, 7, 6.0, 8.0
#: Where the board's middle hangs, in nothing's way [m]; its face looks along z.
PLACE = np.array([0.0, 0.0, 4.0])
#: Corners where four squares meet, across and down.
CORNERS = (ACROSS - 1, DOWN - 1)


def corners() -> np.ndarray:
    """Return those corners in the board's frame, row by row, (n, 3) [m]."""
    u, v = np.meshgrid(np.arange(CORNERS[0]), np.arange(CORNERS[1]))
    middle = 0.5 * (np.array(CORNERS) - 1.0)
    flat = 1e-3 * SQUARE * (np.stack([u, v], axis=-1).reshape(-1, 2) - middle)
    return np.concatenate([flat, np.zeros((len(flat), 1))], axis=1)


def world_with_board(folder: Path, dark: str = "joint") -> World:
    """Return a world of one ECM with the board high above it, its dark squares of this material."""
    boxes = [
        _box(
            (i - 0.5 * (ACROSS - 1)) * SQUARE,
            (j - 0.5 * (DOWN - 1)) * SQUARE,
            (SQUARE, SQUARE),
            dark if (i + j) % 2 else "floor",
        )
        for i in range(ACROSS)
        for j in range(DOWN)
    ]
    wide, high = ACROSS * SQUARE, DOWN * SQUARE
    for side in (-1.0, 1.0):
        boxes.append(_box(side * 0.5 * (wide + RIM), 0.0, (RIM, high + 2.0 * RIM), "floor"))
        boxes.append(_box(0.0, side * 0.5 * (high + RIM), (wide, RIM), "floor"))
    rig = (DATA / "rigs" / "ecm.toml").read_text(encoding="utf-8").partition("[[camera]]")[0]
    path = folder / "board.toml"
    path.write_text(
        f"{rig}\n[[prop]]\nname = 'board'\nxyz_m = {PLACE.tolist()}\nshape = [{','.join(boxes)}]\n"
        f"[[camera]]\nname = 'endoscope'\nkind = 'endoscope'\npreset = 'hd_1280x720'\n",
        encoding="utf-8",
    )
    return World(path)


def _box(x: float, y: float, size: tuple[float, float], material: str) -> str:
    return (
        f"{{ kind = 'box', center_mm = [{x}, {y}, -1.0], size_mm = [{size[0]}, {size[1]}, 2.0],"
        f" material = '{material}', collide = false }}"
    )


def square_of(points: np.ndarray) -> np.ndarray:
    """Return column and row of the square that points of the board lie in, (n, 2)."""
    half = 0.5e-3 * SQUARE * np.array([ACROSS, DOWN])
    return np.floor((points[:, :2] + half) / (1e-3 * SQUARE)).astype(np.int64)


def within(points: np.ndarray) -> np.ndarray:
    """Test which points of the board lie among its squares, half a millimetre from the rim (n,)."""
    half = 0.5e-3 * SQUARE * np.array([ACROSS, DOWN])
    return np.all(np.abs(points[:, :2]) < half - 0.5e-3, axis=1)


def before(record: CameraRecord, T_board_camera: np.ndarray) -> CameraRecord:
    """Return a camera that stands before the board instead of where its arm has it."""
    T_world_board = transform(np.eye(3), PLACE)
    return replace(record, body=0, T_body_mount=T_world_board @ T_board_camera, angle=0.0)


def looking(distance: float, turn: Sequence[float], shift: Sequence[float]) -> np.ndarray:
    """Return T_board_camera of a camera that faces the board.

    Args:
        distance: from its middle [m]
        turn: of the board against the camera, about the camera's axes (3,) [rad]
        shift: of the board's middle in the picture, right and down (2,) [m]
    """
    facing = np.diag([1.0, -1.0, -1.0])  # x of the board to the right, its face to the camera
    turned = matrix_from_rotation_vector(np.array(turn)) @ facing
    return inverse(transform(turned, [*shift, distance]))
