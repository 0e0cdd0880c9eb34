"""Files of simulated views, as `trocar calibrate-camera` reads them: corners or drawn pictures."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from trocar.descriptions import RigDescription
from trocar.descriptions.calibrated import calibrated_rig
from trocar.descriptions.meshes import Mesh
from trocar.descriptions.overlay_records import CameraPatch, FramePatch, Overlay
from trocar.descriptions.records import Movable, Prop, Shape
from trocar.descriptions.table import toml_text
from trocar.errors import InputError
from trocar.geometry import inverse, rpy_from_matrix, transform
from trocar.geometry.se3 import translation
from trocar.outputs import check_folder, whole_folder, write_text
from trocar.rendering import Endoscope, Look
from trocar.robot.boards import Board
from trocar.robot.mocap.views import SimulatedViews, ViewSettings, simulate_views
from trocar.simulation import World

Array = NDArray[np.float64]
Picture = NDArray[np.uint8]

EYES = ("left", "right")
#: The black of a board lies this far above its white; with its surface at z = 0. Source: our own
#: choice: nothing that a picture shows. [m]
PRINT_M = 1e-5
#: White margin around the squares, in squares, and thickness of the plate [m]. Source: our own
#: choice; detectors need about half a square.
MARGIN, PLATE_M = 0.5, 0.001
#: Radius of the handle behind the board. Source: our own choice. [m]
HANDLE_M = 0.0012
#: The sensor's noise, as a share of white. Source: our own choice.
NOISE = 0.01
NAME = "board"


def write_views(
    folder: str | Path,
    rig: RigDescription,
    settings: ViewSettings,
    overwrite: bool = False,
    pictures: bool = False,
    watch: Callable[[int, int], None] | None = None,
) -> dict[str, Any]:
    """Write FOLDER/views.toml, corners or pictures beside it, and the truth in truth.json.

    Args:
        folder: a new or an empty folder
        rig, settings: as for `simulate_views`
        overwrite: replace files that exist
        pictures: draw what the eyes see, in place of corners in corners.csv
        watch: called with the number of views that are drawn, and of all

    Returns:
        the truth

    Raises:
        InputError: as for `simulate_views`; a file that cannot be written
        MissingExtraError: pictures, without the extras `scope` and `vision`
    """
    place = check_folder(folder, overwrite)
    made = simulate_views(rig, settings)
    names = [f"{i:03d}" for i in range(settings.count)]
    arms = {name: rig.arm(name).arm for name in made.q}
    document = {
        "schema": 1,
        "corners": None if pictures else "corners.csv",
        "board": settings.board.document(),
        "camera": {"size_px": list(made.calibration.left.size)},
        "arms": {
            name: {"description": arm.name, "tool": arm.tool or None} for name, arm in arms.items()
        },
        "view": [
            {
                "name": name,
                "images": [f"{eye}_{name}.png" for eye in EYES] if pictures else None,
                "q_rad_m": {
                    arm: made.read[arm][i][: arms[arm].own_joints].tolist() for arm in made.read
                },
            }
            for i, name in enumerate(names)
        ],
    }
    truth = _truth(rig, made)
    with whole_folder(place, overwrite) as built:
        write_text(built / "views.toml", toml_text(document))
        if pictures:
            drawn = draw_views(rig, settings.board, made)
            for i, (name, both) in enumerate(zip(names, drawn, strict=True), 1):
                for eye, picture in zip(EYES, both, strict=True):
                    Image.fromarray(picture).save(built / f"{eye}_{name}.png")
                if watch is not None:
                    watch(i, len(names))
        else:
            write_text(built / "corners.csv", _corners(names, made.pixels))
        write_text(built / "truth.json", json.dumps(truth, indent=2) + "\n")
    return truth


def _truth(rig: RigDescription, made: SimulatedViews) -> dict[str, Any]:
    ecm, psm = made.q
    return {
        f"T_{ecm}_left": made.left.tolist(),
        f"T_{ecm}_{psm}": made.base.tolist(),
        "for_readings": {
            f"T_{ecm}_left": made.left_read.tolist(),
            f"T_{ecm}_{psm}": made.base_read.tolist(),
        },
        f"T_{psm}_board": made.board.tolist(),
        "T_left_right": made.calibration.T_left_right.tolist(),
        "eyes": {
            side: {"K": eye.K.tolist(), "distortion": eye.distortion.tolist()}
            for side, eye in zip(("left", "right"), made.calibration.eyes, strict=True)
        },
        "offsets": {
            arm: {
                joint.name: float(value)
                for joint, value in zip(rig.arm(arm).arm.joints, values, strict=True)
            }
            for arm, values in made.offsets.items()
        },
    }


def _corners(names: list[str], pixels: Array) -> str:
    lines = ["view,eye,corner,u_px,v_px"]
    for name, both in zip(names, pixels, strict=True):
        for eye, corners in zip(EYES, both, strict=True):
            lines += [
                f"{name},{eye},{i},{u:.9g},{v:.9g}"
                for i, (u, v) in enumerate(corners)
                if np.isfinite(u)
            ]
    return "\n".join([*lines, ""])


def draw_views(
    rig: RigDescription, board: Board, made: SimulatedViews
) -> Iterator[tuple[Picture, Picture]]:
    """Yield the pictures of both eyes of each view.

    Args:
        rig: the nominal rig that the views were simulated with
        board: what the PSM holds
        made: the views

    Raises:
        InputError: the rig has a prop called "board"
        MissingExtraError: the extra `scope`, or of markers `vision`, is not installed
    """
    ecm, psm = made.q
    camera = made.left @ inverse(made.calibration.mounts[0])
    robot = calibrated_rig(
        rig,
        {
            ecm: Overlay(
                rig.arm(ecm).arm.name,
                camera=CameraPatch(_patch(camera), made.calibration),
                bases={psm: _patch(made.base)},
            )
        },
    )
    if NAME in [prop.name for prop in robot.props]:
        raise InputError(f"rig {rig.name}: has a prop {NAME!r}; allowed: a rig without one")
    endoscope = next(c for c in robot.cameras if c.kind == "endoscope" and c.arm == ecm)
    held = board_prop(board, inverse(made.board)[:3, 3])
    world = World(replace(robot, props=(*robot.props, held)), collisions=False)
    for other in robot.arms:  # out of the way: tools drawn back
        if other.arm.type == "PSM" and other.name != psm:
            q = robot.poses["start"][other.name].copy()
            q[2] = other.arm.joints[2].lower
            world.set_state(other.name, q)
    look = Look(wet=0.0, noise=NOISE, distortion=True, samples=4)
    scope = Endoscope(world, endoscope.name, look=look)
    for i, seen in enumerate(made.seen):
        for arm in (ecm, psm):
            world.set_state(arm, made.q[arm][i])
        left = world.reference_pose(ecm) @ world.arm(ecm).forward_kinematics(made.q[ecm][i]).matrix
        world.object(NAME).set_cp(left @ made.left @ seen)
        frame = scope.capture()
        if frame.right is not None:
            yield frame.left, frame.right


def board_prop(board: Board, tip: Array) -> Prop:
    """Return a board with a handle as a thing that can be placed anywhere.

    Args:
        board: its frame is the thing's
        tip: where its handle is held, in this frame, (3,) [m]
    """
    width, height = board.columns * board.square, board.rows * board.square
    margin = MARGIN * board.square
    plate = Shape(
        "box",
        translation([0.5 * width, 0.5 * height, PRINT_M + 0.5 * PLATE_M]),
        np.array([0.5 * width + margin, 0.5 * height + margin, 0.5 * PLATE_M]),
        "floor",
        collide=False,
    )
    mesh = _slabs(board.dark_cells(), PRINT_M)
    size = np.abs(mesh.vertices).max(axis=0)
    print_ = Shape("mesh", np.eye(4), size, "black", collide=False, weigh=False, mesh=mesh)
    end = np.array([0.5 * width, 0.5 * height, PLATE_M + HANDLE_M])
    along = end - tip
    length = float(np.linalg.norm(along))
    z = along / length
    x = np.cross(z, [0.0, 0.0, 1.0])
    x = x / np.linalg.norm(x)
    handle = Shape(
        "capsule",
        transform(np.stack([x, np.cross(z, x), z], axis=1), 0.5 * (tip + end)),
        np.array([HANDLE_M, 0.5 * length, 0.0]),
        "steel",
        collide=False,
    )
    movable = Movable(0.01, np.array([0.5 * width, 0.5 * height, 0.0]), 1e-6 * np.eye(3), "source")
    return Prop(NAME, np.eye(4), (plate, print_, handle), movable)


def _slabs(cells: Array, thickness: float) -> Mesh:
    """Return flat boxes over rectangles (n, 4), from z = 0 down into the board."""
    corners = np.array([[x, y, z] for z in (0, 1) for y in (0, 1) for x in (0, 1)])
    # x right, y down, z away: faces anticlockwise as seen from outside
    quads = np.array(
        [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]]
    )
    triangles = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    low = np.concatenate([cells[:, :2], np.zeros((len(cells), 1))], axis=1)
    high = np.concatenate([cells[:, 2:], np.full((len(cells), 1), thickness)], axis=1)
    vertices = (low[:, None] + corners * (high - low)[:, None]).reshape(-1, 3)
    faces = (triangles + 8 * np.arange(len(cells))[:, None, None]).reshape(-1, 3)
    return Mesh(vertices, faces.astype(np.int64), "board")


def _patch(T: Array) -> FramePatch:
    return FramePatch(T[:3, 3], rpy_from_matrix(T[:3, :3]))
