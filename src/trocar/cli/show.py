"""What is known of an arm: joints and limits, frames, loops, masses, gains, and the sources."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace

from trocar.cli.arguments import add_arm, add_calibration, add_json
from trocar.cli.output import print_json, short, warn


def add_arguments(parser: ArgumentParser) -> None:
    """Describe the arguments."""
    add_arm(parser)
    add_calibration(parser)
    add_json(parser)


def run(args: Namespace) -> int:
    """Print all that the arm's description says."""
    from trocar.cli.show_document import document
    from trocar.cli.show_tables import report
    from trocar.descriptions import load_arm
    from trocar.kinematics.loops import NEAR_FLAT_RAD

    found = document(load_arm(args.arm, args.tool, args.calibration))
    for flat in (flat for closure in found["closures"] for flat in closure["flattenings"]):
        if flat["margin"] is not None and flat["margin"] < NEAR_FLAT_RAD:
            warn(
                f"loop {flat['closure']} flattens {short(flat['margin'])} rad from the limits of "
                f"{flat['joint']}; allowed: {NEAR_FLAT_RAD} rad or more"
            )
    if args.json:
        print_json(found)
    else:
        print(report(found))
    return 0
