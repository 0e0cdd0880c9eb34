"""Flat boards with corners at known places, which cameras are calibrated with."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, cast, get_args

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from trocar.descriptions.table import Table
from trocar.errors import InputError, MissingExtraError

Array = NDArray[np.float64]
BoardKind = Literal["chessboard", "charuco"]
KINDS: tuple[str, ...] = get_args(BoardKind)


@dataclass(frozen=True)
class Board:
    """A chessboard, or one with ArUco markers in its white squares (ChArUco).

    Its frame: x along a row of squares, y down, z into the board; (0, 0) is the outer corner of the
    first square. Corner i is the inner corner in column i % (columns - 1), row i // (columns - 1).
    Source: OpenCV's CharucoBoard.

    Attributes:
        kind: "chessboard" or "charuco"
        columns, rows: squares
        square: edge of a square [m]
        marker: edge of a marker [m]; 0 of a chessboard
        dictionary: of the markers, as OpenCV calls it

    Raises:
        InputError: a board that cannot be
    """

    kind: BoardKind = "charuco"
    columns: int = 8
    rows: int = 6
    square: float = 0.005
    marker: float = 0.0037
    dictionary: str = "DICT_4X4_50"

    def __post_init__(self) -> None:
        if not (3 <= self.columns <= 50 and 3 <= self.rows <= 50):
            raise InputError(
                f"board: got {self.columns} x {self.rows} squares; allowed: 3 to 50 each way"
            )
        if not 1e-4 <= self.square <= 1.0:
            raise InputError(
                f"board: got squares of {1e3 * self.square:g} mm; allowed: 0.1 to 1000"
            )
        if self.kind == "charuco" and not 0.0 < self.marker < self.square:
            raise InputError(
                f"board: got markers of {1e3 * self.marker:g} mm in squares of"
                f" {1e3 * self.square:g} mm; allowed: smaller ones"
            )
        if self.kind == "chessboard" and (self.columns + self.rows) % 2 == 0:
            raise InputError(
                f"board: got a chessboard of {self.columns} x {self.rows} squares, which looks the"
                " same from both ends; allowed: one count even, the other odd"
            )

    @property
    def corners(self) -> Array:
        """The inner corners in the board's frame, (n, 3) [m]."""
        down, across = np.mgrid[1 : self.rows, 1 : self.columns]
        flat = np.stack([across.ravel(), down.ravel(), np.zeros(down.size)], axis=1)
        return self.square * flat

    def dark_cells(self) -> Array:
        """Return the rectangles that are black, (n, 4): from x, y to x, y [m].

        Raises:
            InputError: no such dictionary of markers
            MissingExtraError: markers, without the extra `vision`
        """
        down, across = np.mgrid[: self.rows, : self.columns]
        black = (down + across) % 2 == 0
        first = np.stack([across[black], down[black]], axis=1) * self.square
        cells = [np.concatenate([first, first + self.square], axis=1)]
        if self.kind == "charuco":
            cv2 = _opencv()
            markers = _charuco(cv2, self).getDictionary()
            bits = markers.markerSize + 2
            edge = self.marker / bits
            inset = 0.5 * (self.square - self.marker)
            for number, (row, column) in enumerate(np.argwhere(~black)):
                drawn = markers.generateImageMarker(number, bits)
                at = np.argwhere(np.reshape(drawn, (bits, bits)) < 128)[:, ::-1] * edge
                at = at + np.array([column, row]) * self.square + inset
                cells.append(np.concatenate([at, at + edge], axis=1))
        return np.concatenate(cells)

    def document(self) -> dict[str, Any]:
        """Convert to its table in a file of views."""
        marked = self.kind == "charuco"
        return {
            "kind": self.kind,
            "columns": self.columns,
            "rows": self.rows,
            "square_mm": 1e3 * self.square,
            "marker_mm": 1e3 * self.marker if marked else None,
            "dictionary": self.dictionary if marked else None,
        }


def read_board(table: Table) -> Board:
    """Read a board.

    Raises:
        DescriptionError: naming file, key, what was got and what is allowed
    """
    kind = cast(BoardKind, table.text("kind", allowed=KINDS))
    counts = [table.number(key) for key in ("columns", "rows")]
    square = table.quantity("square", "length")
    marked = kind == "charuco"
    marker = table.quantity("marker", "length") if marked else 0.0
    dictionary = table.text("dictionary", "DICT_4X4_50") if marked else ""
    table.done()
    if any(count != int(count) for count in counts):
        raise table.fail("columns", f"got {counts} with rows; allowed: whole numbers")
    try:
        return Board(kind, int(counts[0]), int(counts[1]), square, marker, dictionary)
    except InputError as problem:
        raise table.fail("kind", str(problem)) from problem


def find_corners(path: Path, board: Board, size: tuple[int, int]) -> Array:
    """Find a board's corners in a picture.

    Args:
        path: PNG or JPEG
        board: what to look for
        size: width and height that the picture must have [px]

    Returns:
        (corners, 2) [px], NaN where one was not found

    Raises:
        InputError: the picture cannot be read, or has another size
        MissingExtraError: the extra `vision` is not installed
    """
    grey = _grey(path)
    if grey.shape != size[::-1]:
        raise InputError(
            f"{path}: is {grey.shape[1]}x{grey.shape[0]}; allowed: {size[0]}x{size[1]}, as the"
            " camera's size_px"
        )
    return _found_chessboard(grey, board) if board.kind == "chessboard" else _found(grey, board)


def _grey(path: Path) -> NDArray[np.uint8]:
    try:
        with Image.open(path) as picture:
            return np.asarray(picture.convert("L"))
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError) as problem:
        raise InputError(f"{path}: cannot be read as a picture: {problem}") from problem


def _found(grey: NDArray[np.uint8], board: Board) -> Array:
    cv2 = _opencv()
    found = np.full((len(board.corners), 2), np.nan)
    detector = cv2.aruco.CharucoDetector(_charuco(cv2, board))
    corners, ids, _, _ = detector.detectBoard(grey)
    if ids is not None and len(ids):
        found[np.ravel(ids)] = np.reshape(corners, (-1, 2))
    return found


def _found_chessboard(grey: NDArray[np.uint8], board: Board) -> Array:
    cv2 = _opencv()
    shape = board.columns - 1, board.rows - 1
    flags = cv2.CALIB_CB_ACCURACY | cv2.CALIB_CB_EXHAUSTIVE
    seen, corners = cv2.findChessboardCornersSB(grey, shape, flags=flags)
    if not seen:
        return np.full((len(board.corners), 2), np.nan)
    found = np.reshape(corners, (-1, 2)).astype(np.float64)
    # Both ends look alike but for the colour: the square right below the first corner is black.
    grid = found.reshape(shape[1], shape[0], 2)
    inside = grid[:2, :2].mean(axis=(0, 1)).round().astype(int)
    beside = grid[:2, 1:3].mean(axis=(0, 1)).round().astype(int)
    black = grey[inside[1], inside[0]] < grey[beside[1], beside[0]]
    return found if black else found[::-1]


def _opencv() -> Any:
    try:
        import cv2 as library
    except ImportError as error:
        raise MissingExtraError("OpenCV", "vision", "finding corners in pictures") from error
    return library


def _charuco(cv2: Any, board: Board) -> Any:
    """Return OpenCV's board.

    Raises:
        InputError: no such dictionary, or one with too few markers
    """
    number = getattr(cv2.aruco, board.dictionary, None)
    if not board.dictionary.startswith("DICT_") or number is None:
        known = [name for name in dir(cv2.aruco) if name.startswith("DICT_")]
        raise InputError(
            f"board: dictionary: got {board.dictionary!r}; allowed: {', '.join(known)}"
        )
    markers = cv2.aruco.getPredefinedDictionary(number)
    needed = board.columns * board.rows // 2
    if len(markers.bytesList) < needed:
        raise InputError(
            f"board: dictionary {board.dictionary} has {len(markers.bytesList)} markers; allowed:"
            f" at least {needed}"
        )
    size = board.columns, board.rows
    return cv2.aruco.CharucoBoard(size, board.square, board.marker, markers)
