"""Simulate views of a board on a tool, seen by an endoscope, with the arms' joint readings.

trocar calibrate-camera reads the files. The simulated robot's lenses, scope and bases are a few
millimetres and degrees off the rig's; the ground truth is written to truth.json.
"""

from __future__ import annotations

import math
from argparse import ArgumentParser, Namespace

from trocar.cli.arguments import add_calibrations, add_json, add_overwrite, add_rig, number
from trocar.cli.output import print_result, progress_bar
from trocar.errors import InputError

SUMMARY = "simulate views of a calibration board by the endoscope"
ORDER = 86


def add_arguments(parser: ArgumentParser) -> None:
    """Describe the arguments."""
    parser.add_argument(
        "-o", "--output", required=True, metavar="DIR", help="directory to write to"
    )
    add_rig(parser, "two_psm_ecm")
    add_calibrations(parser)
    parser.add_argument(
        "--psm", default="PSM1", metavar="ARM", help="arm that holds the board (default: PSM1)"
    )
    parser.add_argument(
        "--count", type=int, default=20, metavar="N", help="number of views (default: 20)"
    )
    parser.add_argument(
        "--board",
        choices=("charuco", "chessboard"),
        default="charuco",
        help="what the tool holds (default: charuco, 8 x 6 squares of 5 mm; chessboard: 8 x 5)",
    )
    parser.add_argument(
        "--pictures",
        action="store_true",
        help="draw what both eyes see, instead of a file of corners (extras scope and vision)",
    )
    parser.add_argument(
        "--corner-noise-px",
        type=number,
        metavar="PX",
        help="noise of a corner per axis, 1 sigma, without --pictures (default: 0.2)",
    )
    parser.add_argument(
        "--joint-noise-deg",
        type=number,
        default=0.02,
        metavar="DEG",
        help="noise of joint readings, 1 sigma; of joints that slide, what this turn moves at 0.1 m"
        " (default: 0.02, and 0.035 mm)",
    )
    parser.add_argument(
        "--offset-deg",
        type=number,
        default=0.0,
        metavar="DEG",
        help="largest constant offset of joint readings; of joints that slide, what this turn moves"
        " at 0.1 m (default: 0)",
    )
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="random seed (default: 0)")
    add_overwrite(parser, "existing output files")
    add_json(parser)


def run(args: Namespace) -> int:
    """Simulate, write, and print what was written."""
    from trocar.apps.boards import Board
    from trocar.apps.mocap.view_files import write_views
    from trocar.apps.mocap.views import ViewSettings
    from trocar.descriptions import load_rig

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
    with progress_bar("views", args.pictures and not args.json) as watch:
        truth = write_views(args.output, rig, settings, args.overwrite, args.pictures, watch)
    print_result(
        args,
        {"folder": args.output, "truth": truth},
        lambda: f"{args.output}: {args.count} views of a board on {args.psm}",
    )
    return 0
