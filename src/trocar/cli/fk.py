"""Compute the pose of an arm's tip, or of another frame, from joint positions.

Joint positions are in radians, prismatic joints (insertion, setup-joint slide) in metres, in the
order and with the signs of the dVRK. A PSM takes six values, or seven with the jaw angle last; an
MTM takes seven, or eight with the gripper angle last.
"""

from __future__ import annotations

import math
from argparse import ArgumentParser, Namespace
from collections.abc import Mapping
from typing import TYPE_CHECKING

from trocar.cli.arguments import add_arm, add_calibration, add_json, options
from trocar.cli.output import fixed, print_result, short, table, title, warn
from trocar.errors import InputError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from trocar.descriptions import ArmDescription

    Array = NDArray[np.float64]

SUMMARY = "forward kinematics: poses from joint positions"
ORDER = 120


def add_arguments(parser: ArgumentParser) -> None:
    """Describe the arguments."""
    add_arm(parser)
    add_calibration(parser)
    options(parser, """
        q Q:number ...  joint positions [rad, m if prismatic]
        --frame NAME    frame name, or "all" (default: the tip)
    """)  # fmt: skip
    add_json(parser)


def run(args: Namespace) -> int:
    """Print the pose of one frame, or of all frames."""
    from trocar.descriptions import load_arm
    from trocar.kinematics import forward

    arm = load_arm(args.arm, args.tool, args.calibration)
    q = _positions(arm, args.q)
    head = {"arm": arm.name, "tool": arm.tool or None, "relative_to": arm.mechanism.reference}
    if args.frame == "all":
        frames = forward.poses(arm.mechanism, q)
        print_result(args, {**head, "frames": frames}, lambda: _all_frames(arm, frames))
        return 0
    name = args.frame or arm.mechanism.tip
    pose = forward.pose(arm.mechanism, q, name)
    document = {**head, "frame": name, "pose": pose}
    print_result(args, document, lambda: _one_frame(arm, name, pose))
    return 0


def _positions(arm: ArmDescription, values: list[float]) -> list[float]:
    """Return one position per joint (jaw or gripper 0 if not given); warn if beyond a limit."""
    joints = [joint.name for joint in arm.joints]
    own = joints[: arm.own_joints]
    if len(values) not in (len(joints), len(own)):
        more = f", or {len(joints)} with the {joints[-1]}" if joints != own else ""
        raise InputError(
            f"{arm.name}: got {len(values)} joint positions; allowed: {len(own)} "
            f"({', '.join(own)}){more}"
        )
    for joint, value in zip(arm.joints, values, strict=False):
        if not joint.lower <= value <= joint.upper and math.isfinite(value):
            unit = "m" if joint.kind == "prismatic" else "rad"
            warn(
                f"{joint.name} {short(value)} {unit} is beyond its limits "
                f"{short(joint.lower)} to {short(joint.upper)} {unit}"
            )
    return values + [0.0] * (len(joints) - len(values))


def _one_frame(arm: ArmDescription, name: str, pose: Array) -> str:
    from trocar.geometry import quaternion_from_matrix

    position = table(["x [m]", "y [m]", "z [m]"], [[fixed(v) for v in pose[:3, 3]]])
    quaternion = [fixed(v) for v in quaternion_from_matrix(pose[:3, :3])]
    return "\n".join(
        [
            f"{title(arm)}: {name} in {arm.mechanism.reference}\n",
            position + "\n",
            table(["qw", "qx", "qy", "qz"], [quaternion]) + "\n",
            *("  " + "".join(f"{fixed(v):>14}" for v in row) for row in pose),
        ]
    )


def _all_frames(arm: ArmDescription, frames: Mapping[str, Array]) -> str:
    from trocar.geometry import quaternion_from_matrix

    rows = [
        [
            name,
            *(fixed(v) for v in pose[:3, 3]),
            *(fixed(v) for v in quaternion_from_matrix(pose[:3, :3])),
        ]
        for name, pose in frames.items()
    ]
    head = ["frame", "x [m]", "y [m]", "z [m]", "qw", "qx", "qy", "qz"]
    return f"{title(arm)}: every frame in {arm.mechanism.reference}\n\n{table(head, rows)}"
