"""Views of a board on a tool: what both eyes of an endoscope show of it, and the arms' joints.

A TOML file names board, picture size and arms, and has a row for each view with the positions of
the arms' joints. Corners are in a CSV file beside it (view, eye, corner, u_px, v_px), or are found
in each view's pictures.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from trocar.cameras import Intrinsics
from trocar.descriptions import ArmDescription, load_arm
from trocar.descriptions.cameras import load_stereo_camera
from trocar.descriptions.table import Table, read_table
from trocar.errors import InputError
from trocar.robot.boards import Board, find_corners, read_board
from trocar.robot.calibration.touches import BEYOND
from trocar.robot.calibration.track_csv import csv_rows, read_text

Array = NDArray[np.float64]

EYES = ("left", "right")
COLUMNS = ("view", "eye", "corner", "u_px", "v_px")


@dataclass(frozen=True, eq=False)
class BoardViews:
    """Views of boards on the tools of PSMs, by the camera of an ECM.

    Attributes:
        file: the TOML file
        size: width and height of the pictures [px]
        start: both eyes as a first guess; None: none
        arms: {name: description}
        ecm: name of the arm with the camera
        psms: names of the arms that hold boards
        points: corners in the board's frame, (corners, 3) [m]
        names: of the views
        holders: index into `psms` of each view
        q: {arm: joint positions of each view, 0 for jaws, (n_views, n_joints) [rad or m]}; those of
            a PSM are 0 in other PSMs' views
        pixels: of the corners, NaN where one was not found, (n_views, 2, corners, 2) [px]
    """

    file: str
    size: tuple[int, int]
    start: tuple[Intrinsics, ...] | None
    arms: Mapping[str, ArmDescription]
    ecm: str
    psms: tuple[str, ...]
    points: Array
    names: tuple[str, ...]
    holders: tuple[int, ...]
    q: Mapping[str, Array]
    pixels: Array

    def chosen(self, index: Sequence[int]) -> BoardViews:
        """Return some of the views."""
        at = list(index)
        return replace(
            self,
            names=tuple(self.names[i] for i in at),
            holders=tuple(self.holders[i] for i in at),
            q={arm: q[at] for arm, q in self.q.items()},
            pixels=self.pixels[at],
        )


def read_views(path: str | Path, watch: Callable[[str], None] = lambda _: None) -> BoardViews:
    """Read views, and find the corners in their pictures where no file has them.

    Args:
        path: the TOML file
        watch: called with the name of each picture before corners are found in it

    Raises:
        DescriptionError: the TOML file is broken
        TracksError: the CSV file of corners is; line, what was got and what is allowed are named
        InputError: pictures that cannot be read, or of another size than the camera's
        MissingExtraError: pictures, without the extra `vision`
    """
    table = read_table(Path(path).expanduser())
    folder = Path(table.file).parent
    table.check_schema(", of views")
    board = read_board(table.table("board"))
    size, start = _camera(table.table("camera"), folder)
    arms = _arms(table.table("arms"), folder)
    ecms = [name for name, arm in arms.items() if arm.type == "ECM"]
    psms = tuple(name for name, arm in arms.items() if arm.type == "PSM")
    if len(ecms) != 1 or not psms or len(arms) != 1 + len(psms):
        kinds = ", ".join(f"{name}: {arm.type}" for name, arm in arms.items())
        raise table.fail("arms", f"got {kinds or 'none'}; allowed: one ECM, and PSMs")
    rows = table.tables("view")
    corners = table.text("corners", "")
    table.done()
    names: list[str] = []
    holders: list[int] = []
    q = {name: np.zeros((len(rows), len(arm.joints))) for name, arm in arms.items()}
    pictures: list[tuple[Table, tuple[str, ...]]] = []
    for i, row in enumerate(rows):
        name = row.text("name", f"{i:03d}")
        if name in names:
            raise row.fail("name", f"got {name!r} a second time")
        names.append(name)
        holders.append(_positions(row.table("q_rad_m"), arms, ecms[0], psms, q, i))
        pictures.append((row, row.texts("images")))
        row.done()
    if corners:
        pixels = _corners_of_file(folder / corners, names, size, board)
    else:
        pixels = np.full((len(rows), 2, len(board.corners), 2), np.nan)
        for i, (row, files) in enumerate(pictures):
            if len(files) != 2:
                raise row.fail(
                    "images", f"got {len(files)}; allowed: left and right, or corners = FILE above"
                )
            for eye, file in enumerate(files):
                watch(file)
                pixels[i, eye] = find_corners(folder / file, board, size)
    return BoardViews(table.file, size, start, arms, ecms[0], psms, board.corners, tuple(names),
                 tuple(holders), q, pixels)  # fmt: skip


def _camera(table: Table, folder: Path) -> tuple[tuple[int, int], tuple[Intrinsics, ...] | None]:
    """Return the pictures' size, and both eyes as a first guess."""
    wanted = table.numbers("size_px", 2)
    if (wanted < 16).any() or (wanted != np.round(wanted)).any():
        raise table.fail("size_px", f"got {wanted.tolist()}; allowed: two whole numbers from 16")
    size = int(wanted[0]), int(wanted[1])
    start: tuple[Intrinsics, ...] | None = None
    if "preset" in table or "calibration" in table:
        key = "preset" if "preset" in table else "calibration"
        names = table.texts(key) if isinstance(table.raw(key), list) else (table.text(key),)
        try:
            found = load_stereo_camera(
                names[0] if key == "preset" else [folder / name for name in names]
            )
        except InputError as problem:
            raise table.fail(key, str(problem)) from problem
        if found.left.size != size:
            across, down = found.left.size
            raise table.fail(
                key, f"is of pictures of {across}x{down}; these are of {size[0]}x{size[1]}"
            )
        start = found.eyes
    table.done()
    return size, start


def _arms(table: Table, folder: Path) -> dict[str, ArmDescription]:
    found: dict[str, ArmDescription] = {}
    for name in table.entries():
        row = table.table(name)
        described = row.text("description")
        overlay = row.text("calibration", "")
        found[name] = load_arm(
            folder / described if described.endswith(".toml") else described,
            row.text("tool") if "tool" in row else None,
            folder / overlay if overlay else None,
        )
        row.done()
    return found


def _positions(
    row: Table,
    arms: Mapping[str, ArmDescription],
    ecm: str,
    psms: tuple[str, ...],
    q: Mapping[str, Array],
    view: int,
) -> int:
    """Read a view's joint positions into `q`, and return the index of the PSM with the board."""
    present = row.entries()
    holders = [i for i, name in enumerate(psms) if name in present]
    if ecm not in present or len(holders) != 1:
        raise row.fail(
            "",
            f"got {', '.join(present) or 'nothing'}; allowed: {ecm} and one of {', '.join(psms)}",
        )
    for name in (ecm, psms[holders[0]]):
        arm = arms[name]
        values = row.numbers(name)
        if len(values) not in (arm.own_joints, len(arm.joints)):
            raise row.fail(
                name, f"got {len(values)} numbers; allowed: {arm.own_joints}, those of"
                f" {', '.join(joint.name for joint in arm.joints[: arm.own_joints])}"
            )  # fmt: skip
        for joint, value in zip(arm.joints[: arm.own_joints], values, strict=False):
            if not joint.lower - BEYOND <= value <= joint.upper + BEYOND:
                raise row.fail(
                    name,
                    f"{joint.name}: got {value:g}; allowed: {joint.lower:g} to {joint.upper:g}"
                    " (rad, or m of joints that slide)",
                )
        q[name][view, : arm.own_joints] = values[: arm.own_joints]
    row.done()
    return holders[0]


def _corners_of_file(path: Path, names: list[str], size: tuple[int, int], board: Board) -> Array:
    """Read corners, (n_views, 2, corners, 2) [px]."""
    rows = csv_rows(str(path), read_text(path)[0])
    if not rows.cells:
        raise rows.error("is empty", 0) if rows.lines else InputError(f"{path}: is empty")
    head = [cell.strip() for cell in rows.cells[0]]
    missing = [name for name in COLUMNS if name not in head]
    if missing:
        raise rows.error(f"columns missing: {', '.join(missing)}; needed: {', '.join(COLUMNS)}", 0)
    body = rows.part(1)
    at = [head.index(name) for name in COLUMNS]
    values = body.numbers(at[2:], COLUMNS[2:])
    count = len(board.corners)
    pixels = np.full((len(names), 2, count, 2), np.nan)
    known: Mapping[str, int] = {name: i for i, name in enumerate(names)}
    for i, cells in enumerate(body.cells):
        padded = [*cells, *[""] * len(head)]
        view, eye = padded[at[0]].strip(), padded[at[1]].strip()
        if view not in known:
            raise body.error(f"view: got {view!r}; allowed: those of [[view]]", i)
        if eye not in EYES:
            raise body.error(f"eye: got {eye!r}; allowed: left, right", i)
        corner, u, v = cast(list[Any], values[i].tolist())
        if np.isnan(values[i]).any() or corner != round(corner) or not 0 <= corner < count:
            raise body.error(
                f"corner: got {padded[at[2]]!r}; allowed: 0 to {count - 1}, with u_px and v_px", i
            )
        if not (-0.5 <= u <= size[0] - 0.5 and -0.5 <= v <= size[1] - 0.5):
            raise body.error(
                f"got a corner at ({u:g}, {v:g}) px; allowed: within {size[0]}x{size[1]}. Are the"
                " pictures of another size?",
                i,
            )
        pixels[known[view], EYES.index(eye), int(corner)] = u, v
    return pixels
