"""Motions of tips in a recording, from joints or from poses."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions import ArmDescription, load_arm
from trocar.errors import LogError, UnknownNameError
from trocar.kinematics.chain_pose import chain_pose
from trocar.robot.recordings.arm_motion import LONGEST_GAP_S
from trocar.robot.recordings.read import (
    ReadSettings,
    arms_in,
    read_arm_motion,
    read_tip_positions,
)

Array = NDArray[np.float64]

#: Descriptions of the arms that are looked for. Source: the arms of a da Vinci.
DESCRIBED = ("psm", "ecm", "mtml", "mtmr")


@dataclass(frozen=True, eq=False)
class TipMotion:
    """The motion of an arm's tip at even times: its longest piece without a pause.

    Attributes:
        label: name of the arm in the file
        times: since the first sample of all arms, (k,) [s]
        positions: in the arm's reference frame, or the frame of recorded poses, (k, 3) [m]
        understood: what was read, in words
    """

    label: str
    times: Array
    positions: Array
    understood: str

    @property
    def extent_m(self) -> float:
        """Largest extent of the path along an axis [m]."""
        return float(np.ptp(self.positions, axis=0).max())


def tip_motions(
    path: str | Path,
    only: str | None = None,
    how: ReadSettings | None = None,
    tool: str | None = None,
) -> list[TipMotion]:
    """Read the motions of all tips in a recording.

    Args:
        path: as for `read_arm_motion`
        only: name of the one arm to read
        how: how to read it
        tool: of PSMs; that of the description when omitted

    Raises:
        UnknownNameError: no such arm
        LogError, InputError: as for `read_arm_motion`
    """
    found: dict[str, TipMotion] = {}
    known: list[str] = []
    for name in DESCRIBED:
        if only is not None and found:
            break
        arm = load_arm(name, tool if name == "psm" else None)
        for label in arms_in(path, arm, how):
            known.append(label)
            wanted = only is None or label.upper() == only.upper()
            if label not in found and wanted and _fits(label, name):
                found[label] = _tip(path, arm, replace(how or ReadSettings(), of=label or None))
    if not found:
        if only is not None:
            raise UnknownNameError("arm", only, list(dict.fromkeys(known)), str(path))
        raise LogError(str(path), "holds neither joints nor tips of an arm")
    begin = min(float(motion.times[0]) for motion in found.values())
    return [replace(motion, times=motion.times - begin) for motion in found.values()]


def _fits(label: str, name: str) -> bool:
    """Return whether a description is that of an arm by its name; a PSM without a name."""
    lower = label.lower()
    if lower.startswith("mtm"):
        return lower.startswith(name) or (lower == "mtm" and name == "mtmr")
    return lower.startswith(name) or (name == "psm" and not lower.startswith("ecm"))


def _tip(path: str | Path, arm: ArmDescription, how: ReadSettings) -> TipMotion:
    """Return the longest piece of a tip's motion."""
    positions = read_tip_positions(path, arm, how)
    if positions is not None:
        label, times, p = positions
        words = f"{label or path}: poses of the tip"
    else:
        motion = read_arm_motion(path, arm, how)
        lacking = [joint for joint in motion.joints[:-1] if joint not in motion.recorded[0]]
        if lacking:
            raise LogError(str(path), f"holds no {', '.join(lacking)}: the tip is not known")
        q = np.tile(arm.poses["home"], (len(motion.times), 1))
        q[:, : motion.rows.shape[2]] = motion.rows[:, 0]
        label, times, p = motion.label, motion.times, chain_pose(arm.mechanism)(q)[:, :3, 3]
        words = motion.understood()
    steps = np.diff(times)
    ends = [0, *(np.flatnonzero((steps <= 0.0) | (steps > LONGEST_GAP_S)) + 1), len(times)]
    pieces = [slice(a, b) for a, b in pairwise(ends)]
    longest = max(pieces, key=lambda piece: piece.stop - piece.start)
    times, p = times[longest], p[longest]
    if len(times) < 2:
        raise LogError(str(path), "no two samples follow each other within a second")
    if len(pieces) > 1:
        words += f"; scored the longest of {len(pieces)} pieces, {times[-1] - times[0]:.1f} s"
    count = round((times[-1] - times[0]) / float(np.median(np.diff(times)))) + 1
    even = np.zeros((count, 4))
    even[:, 3] = np.linspace(times[0], times[-1], count)
    for k in range(3):
        even[:, k] = np.interp(even[:, 3], times, p[:, k])
    return TipMotion(label, even[:, 3], even[:, :3], words)
