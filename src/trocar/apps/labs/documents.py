"""TOML documents: trocar's own arms and tools, changed where a lab's file differs."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trocar.apps.labs.records import Gains, Row
from trocar.descriptions import ArmDescription, load_arm
from trocar.descriptions.catalogue import DATA, document

Array = NDArray[np.float64]
Document = dict[str, Any]

#: Limits and gains that differ by less are the same: 1.5708 for 90 degrees makes 4e-6.
SAME = 1e-5


def own_arm(name: str) -> Document:
    """Return the document of one of trocar's arms."""
    return document("arms", name)


def own_rig(name: str) -> Document:
    """Return the document of one of trocar's rigs."""
    return tomllib.loads((DATA / "rigs" / f"{name}.toml").read_text(encoding="utf-8"))


def own_tool(name: str) -> Document:
    """Return the document of one of trocar's tools."""
    return document("tools", name)


@lru_cache(maxsize=64)
def known(name: str, tool: str | None = None) -> ArmDescription:
    """Return one of trocar's arms, read once."""
    return load_arm(name, tool)


def without(row: Document, name: str) -> None:
    """Take a quantity out of a table, whatever unit its key carries."""
    for key in [k for k in row if k == name or k.startswith(f"{name}_")]:
        del row[key]


def set_limits(document: Document, rows: tuple[Row, ...], source: str) -> bool:
    """Give joints the limits of a file, and say whether any of them changed.

    Poses of the document move inside them. Efforts of 0 are those that nobody gave.
    """
    changed = False
    for joint, row in zip(document["joint"], rows, strict=False):
        turns = row.kind == "revolute"
        unit, force = ("rad", "nm") if turns else ("m", "n")
        wanted = {
            f"lower_{unit}": row.lower,
            f"upper_{unit}": row.upper,
            f"effort_max_{force}": row.effort or None,
        }
        for key, value in wanted.items():
            name = key.rpartition("_")[0]
            if value is None or abs(limit(joint, name) - value) <= SAME * max(1.0, abs(value)):
                continue
            without(joint, name)
            joint[key], joint["source"], changed = value, source, True
    if changed:
        _clip_poses(document)
    return changed


def limit(joint: Document, name: str) -> float:
    """Return a limit of a document's joint in SI, infinity where it has none."""
    for key, value in joint.items():
        head, _, unit = key.rpartition("_")
        if head == name:
            return float(value) * {"deg": math.pi / 180.0, "mm": 1e-3}.get(unit, 1.0)
    return math.inf


def _clip_poses(document: Document) -> None:
    lower = np.array([limit(joint, "lower") for joint in document["joint"]])
    upper = np.array([limit(joint, "upper") for joint in document["joint"]])
    for pose in document.get("pose", []):
        pose["q_rad_m"] = np.clip(np.array(pose["q_rad_m"]), lower, upper).tolist()


def set_gains(document: Document, gains: Mapping[str, Gains], source: str) -> bool:
    """Give joints the gains of a file, as far as the document has these joints."""
    control = document["control"]["dvrk"]
    pid, changed = control["pid"], False
    for joint, wanted in gains.items():
        if joint in pid and not np.allclose(pid[joint], wanted, rtol=SAME, atol=0.0):
            pid[joint], changed = list(wanted), True
    if changed:
        control["source"] = source
    return changed


def set_row(frame: Document, row: Row, extra_turn: float = 0.0) -> None:
    """Give a frame a row's constants; angles that are whole degrees are written as such."""
    for name in ("a", "alpha", "d", "theta", "xyz", "rotation", "rpy"):
        without(frame, name)
    for name, value in (("a_m", row.a), ("d_m", row.d)):
        if value:
            frame[name] = value
    for name, value in (("alpha", row.alpha), ("theta", row.theta + extra_turn)):
        degrees = round(math.degrees(value))
        if abs(math.radians(degrees) - value) < 1e-12:
            frame |= {f"{name}_deg": float(degrees)} if degrees else {}
        else:
            frame[f"{name}_rad"] = value


def pose_entries(T: Array) -> Document:
    """Return xyz and rotation of a pose, each where it is not nothing."""
    found: Document = {}
    if T[:3, 3].any():
        found["xyz_m"] = (T[:3, 3] + 0.0).tolist()
    if not np.array_equal(T[:3, :3], np.eye(3)):
        found["rotation"] = (T[:3, :3] + 0.0).tolist()
    return found
