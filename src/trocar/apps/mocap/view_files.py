"""Files of simulated views: what `trocar calibrate-camera` reads, and the truth beside it."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from trocar.apps.mocap.view_pictures import draw_views
from trocar.apps.mocap.views import SimulatedViews, ViewSettings, simulate_views
from trocar.descriptions import RigDescription
from trocar.descriptions.table import toml_text
from trocar.outputs import check_folder, whole_folder, write_text

Array = NDArray[np.float64]

EYES = ("left", "right")


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
