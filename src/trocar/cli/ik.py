"""Compute all joint positions within limits that reach a tip pose.

The pose is expressed in the arm's reference frame (relative_to in the output): position in metres
and unit quaternion, scalar first. Exit status 1: the pose is out of reach.
"""

from __future__ import annotations

import math
import sys
from argparse import ArgumentParser, Namespace
from collections.abc import Sequence
from typing import TYPE_CHECKING

from trocar.cli.arguments import add_arm, add_calibration, add_json, number, options
from trocar.cli.output import fixed, print_json, print_result, table, title
from trocar.errors import InputError, SingularError, UnreachableError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from trocar.descriptions import ArmDescription

    Array = NDArray[np.float64]

SUMMARY = "inverse kinematics: all joint positions for a pose"
ORDER = 130

# Source: our choice. A quaternion typed with four digits has a norm within this of 1.
NORM_TOLERANCE = 1e-3


def add_arguments(parser: ArgumentParser) -> None:
    """Describe the arguments."""
    add_arm(parser)
    add_calibration(parser)
    for name in ("X", "Y", "Z"):
        parser.add_argument(name, type=number, help="tip position [m]")
    for name in ("QW", "QX", "QY", "QZ"):
        parser.add_argument(name, type=number, help="tip orientation, unit quaternion")
    parser.add_argument(
        "--seed",
        metavar="Q",
        nargs="+",
        type=number,
        help="sort solutions by distance from these joint positions (default: centre of the"
        " limits)",
    )
    options(parser, """
        --platform RAD:number  wrist platform angle of an MTM [rad] (default: the one with wrist yaw
                               0, if within limits)
    """)  # fmt: skip
    add_json(parser)


def run(args: Namespace) -> int:
    """Print every solution."""
    from trocar.descriptions import load_arm
    from trocar.kinematics.inverse import inverse_kinematics

    arm = load_arm(args.arm, args.tool, args.calibration)
    T = _pose([args.X, args.Y, args.Z], [args.QW, args.QX, args.QY, args.QZ])
    answer = {"arm": arm.name, "tool": arm.tool or None, "relative_to": arm.mechanism.reference}
    try:
        solutions = inverse_kinematics(
            arm.mechanism, arm.inverse_kinematics, T, args.seed, platform_angle=args.platform
        )
    except (UnreachableError, SingularError) as error:
        if args.json:
            print_json({**answer, "solutions": [], "reason": str(error)})
        print(f"trocar: error: {error}", file=sys.stderr)
        return 1
    names = arm.mechanism.joint_names[: solutions.shape[-1]]
    first = "the seed" if args.seed else "the centre of the limits"
    document = {**answer, "joints": names, "solutions": solutions}
    print_result(args, document, lambda: _report(arm, solutions, first))
    return 0


def _pose(position: Sequence[float], quaternion: Sequence[float]) -> Array:
    from trocar.geometry import matrix_from_quaternion, transform

    if not all(map(math.isfinite, position)):
        raise InputError(f"X Y Z: got {', '.join(map(str, position))}; allowed: finite numbers")
    norm = math.hypot(*quaternion)
    if not abs(norm - 1.0) <= NORM_TOLERANCE:
        raise InputError(
            f"QW QX QY QZ: got a quaternion of norm {norm:.6g}; allowed: 1 to within "
            f"{NORM_TOLERANCE:g}"
        )
    return transform(matrix_from_quaternion(quaternion), position)


def _report(arm: ArmDescription, solutions: Array, first: str) -> str:
    joints = arm.joints[: solutions.shape[-1]]
    head = [f"{j.name} [{'m' if j.kind == 'prismatic' else 'rad'}]" for j in joints]
    count = f"{len(solutions)} solution{'s' if len(solutions) > 1 else ''}"
    order = f", nearest to {first} first" if len(solutions) > 1 else ""
    rows = [[fixed(value) for value in q] for q in solutions]
    return f"{title(arm)}: {count}{order}\n\n{table(head, rows)}"
