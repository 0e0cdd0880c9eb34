"""Simulate views of a board on a tool, seen by an endoscope, with the arms' joint readings.

trocar calibrate-camera reads the files. The simulated robot's lenses, scope and bases are a few
millimetres and degrees off the rig's; the ground truth is written to truth.json.
"""

from __future__ import annotations

import math
from argparse import ArgumentParser, Namespace

from trocar.cli.arguments import add_calibrations, add_json, add_overwrite, add_rig, options
from trocar.cli.output import print_result, progress_bar
from trocar.errors import InputError

SUMMARY = "simulate views of a calibration board by the endoscope"
ORDER = 86


def add_arguments(parser: ArgumentParser) -> None:
    """Describe the arguments."""
    options(parser, """
        -o,--output DIR required  directory to write to
    """)  # fmt: skip
    add_rig(parser, "two_psm_ecm")
    add_calibrations(parser)
    options(parser, """
        --psm ARM = PSM1                    arm that holds the board
        --count N:int = 20                  number of views
        --board charuco|chessboard = charuco  what the tool holds (default: charuco, 8 x 6 squares
                                            of 5 mm; chessboard: 8 x 5)
        --pictures                          draw what both eyes see, instead of a file of corners
                                            (extras scope and vision)
        --corner-noise-px PX:number         noise of a corner per axis, 1 sigma, without --pictures
                                            (default: 0.2)
        --joint-noise-deg DEG:number = 0.02  noise of joint readings, 1 sigma; of joints that slide,
                                            what this turn moves at 0.1 m (default: 0.02, and 0.035
                                            mm)
        --offset-deg DEG:number = 0         largest constant offset of joint readings; of joints
                                            that slide, what this turn moves at 0.1 m
        --seed N:int = 0                    random seed
    """)  # fmt: skip
    add_overwrite(parser, "existing output files")
    add_json(parser)


def run(args: Namespace) -> int:
    """Simulate, write, and print what was written."""
    from trocar.descriptions import load_rig
    from trocar.robot.boards import Board
    from trocar.robot.mocap.view_files import write_views
    from trocar.robot.mocap.views import ViewSettings

    if args.pictures and args.corner_noise_px is not None:
        raise InputError("--corner-noise-px: allowed without --pictures only")
    settings = ViewSettings(
        psm=args.psm,
        board=Board("chessboard", 8, 5, 0.005, 0.0) if args.board == "chessboard" else Board(),
        count=args.count,
        corner_noise_px=0.2 if args.corner_noise_px is None else args.corner_noise_px,
        joint_noise=math.radians(args.joint_noise_deg),
        offset=math.radians(args.offset_deg),
        seed=args.seed,
    )
    rig = load_rig(args.rig, args.calibration)
    with progress_bar("views") as watch:
        truth = write_views(args.output, rig, settings, args.overwrite, args.pictures, watch)
    print_result(
        args,
        {"folder": args.output, "truth": truth},
        lambda: f"{args.output}: {args.count} views of a board on {args.psm}",
    )
    return 0
