"""Calibrate an endoscope from views of a board on a tool, and write a calibration overlay.

VIEWS is a TOML file with the board, the arms' joint positions at each view, and pictures of both
eyes or the corners found in them (trocar views simulates one). One adjustment finds both lenses,
the pose between the eyes, the camera's place on the ECM's scope and the bases of the PSMs in the
ECM's, with standard deviations. See docs/vision.md. Also: trocar calibrate camera VIEWS.
"""

from __future__ import annotations

import math
from argparse import ArgumentParser, Namespace
from typing import TYPE_CHECKING

from trocar.cli.arguments import add_json, add_overwrite, allow_overwrite, options
from trocar.cli.output import print_result, progress_steps, table, warn

if TYPE_CHECKING:
    from trocar.robot.calibration.hand_eye import HandEye

SUMMARY = "calibrate an endoscope from views of a board on a tool"
ORDER = 111


def add_arguments(parser: ArgumentParser) -> None:
    """Describe the arguments."""
    options(parser, """
        views VIEWS                         TOML file of views
        --offsets                           find constant offsets of joint readings as well
        --joint-noise-deg DEG:number = 0.02  noise of joint readings, 1 sigma; of joints that slide,
                                            what this turn moves at 0.1 m (default: 0.02, and 0.035
                                            mm)
        -o,--output OVERLAY                 overlay file to write, for --calibration
    """)  # fmt: skip
    parser.add_argument(
        "--ros",
        nargs=2,
        metavar=("LEFT", "RIGHT"),
        help="camera_info files of ROS to write, .yaml",
    )
    add_overwrite(parser, "existing output files")
    add_json(parser)


def run(args: Namespace) -> int:
    """Calibrate, write, print."""
    from trocar.cameras import write_camera
    from trocar.descriptions.overlay import write_overlay
    from trocar.outputs import check_file
    from trocar.robot.calibration.camera_views import read_views
    from trocar.robot.calibration.hand_eye import calibrate_camera

    allow_overwrite(args, "output", "ros")
    written: list[str] = [*([args.output] if args.output else []), *(args.ros or [])]
    for file in written:
        check_file(file, args.overwrite)
    with progress_steps() as watch:
        watch(f"reading {args.views}")
        views = read_views(args.views, watch)
        found = calibrate_camera(views, math.radians(args.joint_noise_deg), args.offsets, watch)
    if args.output:
        write_overlay(args.output, found.overlay, overwrite=args.overwrite)
    if args.ros:
        write_camera(found.calibration, args.ros, overwrite=args.overwrite)
    for text in found.warnings:
        warn(text)
    print_result(
        args,
        found.as_dict(),
        lambda: "\n\n".join([_report(found), *(f"written to {file}" for file in written)]),
    )
    return 0


def _report(found: HandEye) -> str:
    eyes = [
        [side, *(f"{v:.2f}" for v in (eye.K[0, 0], eye.K[1, 1], *eye.K[:2, 2])),
         *(f"{v:.4f}" for v in eye.distortion[:4])]
        for side, eye in zip(("left", "right"), found.calibration.eyes, strict=True)
    ]  # fmt: skip
    for place, sigma in enumerate(found.eye_sigma):
        row = ["sigma", *(f"{v:.2f}" for v in sigma[:4]), *(f"{v:.4f}" for v in sigma[4:])]
        eyes.insert(2 * place + 1, row)
    placed = {
        "left eye to right": found.stereo,
        f"{found.ecm} tip to left eye": found.left,
        f"{found.ecm} tip to camera": found.camera,
        **{f"{found.ecm} base to {name} base": one for name, one in found.bases.items()},
        **{f"{name} tip to board": one for name, one in found.boards.items()},
    }
    rows: list[list[str]] = []
    for what, one in placed.items():
        fields = one.as_dict()
        rows.append(
            [what, *(f"{1e3 * v:.3f}" for v in fields["xyz_m"]),
             *(f"{1e3 * v:.3f}" for v in fields["xyz_sigma_m"]),
             *(f"{math.degrees(v):.3f}" for v in fields["rpy_rad"]),
             *(f"{math.degrees(v):.3f}" for v in fields["rpy_sigma_rad"])]
        )  # fmt: skip
    head = ["pose", "x [mm]", "y", "z", "sigma x", "y", "z", "roll [deg]", "pitch", "yaw",
            "sigma about x", "y", "z"]  # fmt: skip
    offsets = [
        [arm, joint, f"{1e3 * v.value:.3f}", f"{1e3 * v.sigma:.3f}"]
        for arm, row in found.offsets.items()
        for joint, v in row.items()
    ]
    parts = [
        f"{len(found.view_rms)} views, {found.corners} corners; {found.corner_rms:.3f} px RMS"
        f" residual per axis; joint readings off by {found.joint_ratio:.2f} of their noise",
        table(["eye", "fx [px]", "fy", "cx", "cy", "k1", "k2", "p1", "p2"], eyes),
        table(head, rows),
    ]
    if offsets:
        parts.append(table(["arm", "joint", "offset [mrad; mm]", "sigma"], offsets))
    return "\n\n".join(parts)
