"""Simulate arms that touch a block of known points, and write their joint readings.

Poses of the bases and offsets of the joint readings are random. With --boards each arm holds a
board in front of a camera instead. trocar calibrate-bases reads the files; the ground truth is
written to FILE.truth.json.
"""

from __future__ import annotations

import math
from argparse import ArgumentParser, Namespace

from trocar.cli.arguments import add_json, add_overwrite, allow, options
from trocar.cli.output import print_result
from trocar.errors import InputError

SUMMARY = "simulate arms touching known points"
ORDER = 85


def add_arguments(parser: ArgumentParser) -> None:
    """Describe the arguments."""
    options(parser, """
        --arm NAME=ARM ... required    name of an arm in the files, and its description: built-in or
                                       TOML file (repeatable), e.g. PSM1=psm
        -o,--output FILE required      TOML file to write, with a CSV file
        --boards                       simulate views of a board on the tip, not touches
        --count N:int = 30             readings of each arm
        --noise-mm MM:number = 0.2     position noise per axis, 1 sigma
        --noise-deg DEG:number = 0.05  rotation noise of a board per axis, 1 sigma
        --offset-deg DEG:number = 1    largest offset of joint readings, of prismatic joints in mm
        --seed N:int = 0               random seed
    """)  # fmt: skip
    add_overwrite(parser, "existing output files")
    add_json(parser)


def run(args: Namespace) -> int:
    """Simulate, write, and print what was written."""
    from trocar.descriptions import ArmDescription, load_arm
    from trocar.robot.mocap.touches import TouchSettings, write_touches

    if not args.boards:
        allow(args, "with --boards", "noise_deg")
    arms: dict[str, tuple[str, ArmDescription]] = {}
    for text in args.arm:
        name, given, description = text.partition("=")
        if not (name and given and description) or name in arms:
            raise InputError(f"--arm: got {text!r}; allowed: NAME=ARM, each name once")
        arms[name] = (description, load_arm(description))
    settings = TouchSettings(
        count=args.count,
        noise_m=1e-3 * args.noise_mm,
        noise_rad=math.radians(args.noise_deg),
        offset_rad=math.radians(args.offset_deg),
        offset_m=1e-3 * args.offset_deg,
        boards=args.boards,
        seed=args.seed,
    )
    truth = write_touches(args.output, arms, settings, args.overwrite)
    what = "views of a board" if args.boards else "touches"
    print_result(
        args,
        {"file": args.output, "truth": truth},
        lambda: f"{args.output}: {args.count} {what} of {', '.join(arms)}",
    )
    return 0
