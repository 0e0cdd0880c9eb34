"""Joints that bring an arm's tip to recorded poses."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from trocar.descriptions import ArmDescription
from trocar.errors import LogError, SingularError, UnreachableError
from trocar.geometry import matrix_from_quaternion
from trocar.geometry.se3 import inverse, transform
from trocar.kinematics.chain_pose import chain_pose
from trocar.kinematics.inverse import inverse_kinematics, nearest_solution

Array = NDArray[np.float64]

#: Norms of recorded quaternions, and largest difference of a recorded rotation matrix from its
#: nearest rotation. Source: our own choice; those of float32 are within 1e-6.
NORMS = 0.9, 1.1
MOST_SKEW = 0.1
#: Largest ratio of poses out of an arm's reach, which are left out. Source: our own choice.
MOST_MISSED = 0.1


def pose_from_numbers(file: str, where: str, position: Array, turn: Array) -> Array:
    """Return a pose (4, 4) from a position (3,) [m] and a rotation.

    Args:
        file, where: for errors
        position: (3,) [m]
        turn: quaternion wxyz (4,), or rotation matrix row by row (9,)

    Raises:
        LogError: no rotation
    """
    if len(turn) == 4:
        norm = float(np.linalg.norm(turn))
        if not NORMS[0] < norm < NORMS[1]:
            raise LogError(file, f"{where}: got a quaternion of norm {norm:.6g}; allowed: 1")
        return transform(matrix_from_quaternion(turn / norm), position)
    matrix = turn.reshape(3, 3)
    left, _, right = np.linalg.svd(matrix)
    nearest = left @ np.diag([1.0, 1.0, np.linalg.det(left @ right)]) @ right
    skew = float(np.abs(matrix - nearest).max())
    if skew > MOST_SKEW:
        raise LogError(file, f"{where}: got a matrix {skew:.3g} from the nearest rotation")
    return transform(nearest, position)


def solved_tips(arm: ArmDescription, tips: Array, base: Array) -> tuple[Array, dict[int, str]]:
    """Return the joints that bring an arm's tip to poses, without the jaw.

    Args:
        arm: with the tool that was mounted
        tips: poses in some frame, (k, 4, 4)
        base: the arm's own base in that frame, (4, 4)

    Returns:
        (k, n), NaN where the arm does not reach a pose, and {row: why}
    """
    own, structure = inverse(base), arm.inverse_kinematics
    found = np.full((len(tips), arm.own_joints), np.nan)
    missed: dict[int, str] = {}
    near: int | None = None
    for row, tip in enumerate(tips):
        T = own @ tip
        try:
            if near is None:
                found[row] = inverse_kinematics(arm.mechanism, structure, T)[0]
            else:
                found[row] = nearest_solution(arm.mechanism, structure, T, found[near])
            near = row
        except (UnreachableError, SingularError) as problem:
            missed[row] = str(problem)
    return found, missed


def joints_along(
    arm: ArmDescription,
    tips: Array,
    base: Array | Literal["centred"] | None,
    file: str,
    numbers: NDArray[np.int64],
) -> tuple[Array, str]:
    """Return the joints that bring an arm's tip along recorded poses, and a note on its base.

    Args:
        arm: with the tool that was mounted
        tips: poses in some frame, (k, 4, 4)
        base: the arm's own base in that frame, (4, 4); "centred": where the mean pose is that of
            its home; None: the same
        file, numbers: for errors; (k,) of the rows

    Returns:
        (k, n) without the jaw, NaN where a pose is out of reach

    Raises:
        LogError: more than a tenth of the poses are out of reach
    """
    of = "as given"
    if base is None:
        base, of = np.eye(4), "in the frame of the poses"
    elif isinstance(base, str):
        base, of = centred_base(arm, tips), "placed so that the mean pose is home"
    q, missed = solved_tips(arm, tips, base)
    if len(missed) > MOST_MISSED * len(q):
        row, problem = next(iter(missed.items()))
        first = f"the first in row {numbers[row]}"
        raise out_of_reach(
            file, f"{len(missed)} of {len(q)} poses are out of reach, {first}", problem
        )
    return q, f"joints from poses of the tip, base {of}"


def joints_of_tips(
    arm: ArmDescription, tips: Array, base: Array, file: str, where: Callable[[int], str]
) -> Array:
    """Return the joints that bring an arm's tip to poses, all of them, (k, n).

    Args:
        arm, tips, base: as for `solved_tips`
        file: for errors
        where: names a row, for errors

    Raises:
        LogError: the arm does not reach a pose
    """
    q, missed = solved_tips(arm, tips, base)
    for row, problem in missed.items():
        raise out_of_reach(file, where(row), problem)
    return q


def out_of_reach(file: str, where: str, problem: str) -> LogError:
    """Return the error of a pose that an arm does not reach."""
    return LogError(
        file, f"{where}: {problem}; is its base (--base) in the frame of the poses right?"
    )


def centred_base(arm: ArmDescription, tips: Array) -> Array:
    """Place an arm's base so that the mean pose of its tip is that of its home, (4, 4).

    Args:
        arm: with the tool that was mounted
        tips: poses in some frame, (k, 4, 4)
    """
    mean = tips.mean(axis=0)
    left, _, right = np.linalg.svd(mean[:3, :3])
    mean[:3, :3] = left @ np.diag([1.0, 1.0, np.linalg.det(left @ right)]) @ right
    home = chain_pose(arm.mechanism)(arm.poses["home"][None])[0]
    return mean @ inverse(home)
