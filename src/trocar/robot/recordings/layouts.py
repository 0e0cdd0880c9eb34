"""Public layouts of tables without a header."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from trocar.robot.recordings.columns import AXES, ArmPlaces, ScaledColumn

Array = NDArray[np.float64]

#: The public layout of JIGSAWS: 19 columns each of the left and right master, the left and right
#: slave: position of the tip [m], its rotation matrix row by row, linear and angular velocity, and
#: angle of the gripper [rad]. Source: Gao et al., JIGSAWS, M2CAI 2014, and its readme; 30 Hz.
JIGSAWS, JIGSAWS_HZ = 76, 30.0
JIGSAWS_ARMS = ("master_left", "master_right", "slave_left", "slave_right")
#: Playfiles of two PSMs: seven joints each (.jsp), or position of the tip [m], its x and z axes and
#: the jaw [rad] of each (.csp, .psp); then the time [s]. Source: readme of
#: cwru-robotics/cwru_davinci_playfile, and of wsnewman/davinci_wsn, playfile_reader.
JOINT_PLAYFILE, TIP_PLAYFILE = 15, 21
PLAYFILE_ARMS = ("PSM1", "PSM2")
#: Largest difference of the norm of a tip's axis from 1, and cosine between its axes. Source: our
#: own choice; published files have three digits.
AXIS_ERROR = 0.02
#: Least ratio of times that do not go back. Source: our own choice; a published file has one of 19.
MOSTLY = 0.9


@dataclass(frozen=True)
class TableLayout:
    """Columns of a table without a header.

    Attributes:
        arms: columns of each arm
        time: column of times
        rate_hz: of layouts without times [Hz]
    """

    arms: tuple[ArmPlaces, ...]
    time: ScaledColumn | None = None
    rate_hz: float | None = None


def public_layout(values: Array, joints: Sequence[str], has_jaw: bool) -> TableLayout | None:
    """Recognise the layout of a table without a header.

    Args:
        values: the table, (k, c)
        joints: of the arm that is looked for, the jaw last where `has_jaw`
        has_jaw: whether it has one

    Returns:
        the columns; None for other layouts
    """
    count, width = values.shape
    if width == JIGSAWS:
        arms = [_jigsaws(k, label, joints, has_jaw) for k, label in enumerate(JIGSAWS_ARMS)]
        return TableLayout(tuple(arms), rate_hz=JIGSAWS_HZ)
    if width not in (JOINT_PLAYFILE, TIP_PLAYFILE) or not has_jaw or count < 2:
        return None
    steps = np.diff(values[:, -1])
    if np.median(steps) <= 0.0 or np.mean(steps >= 0.0) < MOSTLY:
        return None
    each = (width - 1) // len(PLAYFILE_ARMS)
    if width == JOINT_PLAYFILE and (each != len(joints) or (np.diff(values[:, 0]) > 0.0).all()):
        return None
    if width == TIP_PLAYFILE and not (_are_axes(values[:, 3:9]) and _are_axes(values[:, 13:19])):
        return None
    read = _joints_of_playfile if width == JOINT_PLAYFILE else _tip_of_playfile
    arms = [read(k * each, label, joints) for k, label in enumerate(PLAYFILE_ARMS)]
    return TableLayout(tuple(arms), ScaledColumn(width - 1, 1.0))


def _jigsaws(k: int, label: str, joints: Sequence[str], has_jaw: bool) -> ArmPlaces:
    first = 19 * k
    tip = {part: ScaledColumn(first + i) for i, part in enumerate("xyz")}
    tip |= {f"r{i}": ScaledColumn(first + 3 + i) for i in range(9)}
    jaw = {joints[-1]: ScaledColumn(first + 18)} if has_jaw else {}
    return ArmPlaces(label, jaw, {}, {}, tip)


def _joints_of_playfile(first: int, label: str, joints: Sequence[str]) -> ArmPlaces:
    position = {joint: ScaledColumn(first + i) for i, joint in enumerate(joints)}
    return ArmPlaces(label, position, {}, {}, {})


def _tip_of_playfile(first: int, label: str, joints: Sequence[str]) -> ArmPlaces:
    parts = enumerate(("x", "y", "z", *AXES))
    tip = {part: ScaledColumn(first + i) for i, part in parts}
    return ArmPlaces(label, {joints[-1]: ScaledColumn(first + 9)}, {}, {}, tip)


def _are_axes(columns: Array) -> bool:
    """Return whether every row, (k, 6), holds two axes of length 1 at a right angle."""
    x, z = columns[:, :3], columns[:, 3:]
    norms = np.concatenate([np.linalg.norm(x, axis=1), np.linalg.norm(z, axis=1)])
    cosines = (x * z).sum(axis=1)
    return bool((np.abs(norms - 1.0) < AXIS_ERROR).all() and (np.abs(cosines) < AXIS_ERROR).all())
