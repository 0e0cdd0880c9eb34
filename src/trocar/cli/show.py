"""What is known of an arm: joints and limits, frames, loops, masses, gains, and the sources.

With --picture DIR, what it looks like: front.png, side.png and top.png without perspective, so that
lengths can be read from them, and three_quarter.png. ARM may then be a rig as well.
"""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from pathlib import Path
from typing import TYPE_CHECKING

from trocar.cli.arguments import add_arm, add_calibration, add_json
from trocar.cli.output import print_json, short, warn

if TYPE_CHECKING:
    from trocar.descriptions import RigDescription


def add_arguments(parser: ArgumentParser) -> None:
    """Describe the arguments."""
    add_arm(parser)
    add_calibration(parser)
    add_json(parser)
    parser.add_argument("--picture", metavar="DIR", help="draw it, from four sides, into DIR")


def run(args: Namespace) -> int:
    """Print all that the arm's description says, or draw it."""
    if args.picture is not None:
        from trocar.rendering import write_pictures

        for path in write_pictures(_rig(args), Path(args.picture)):
            print(path)
        return 0
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


def _rig(args: Namespace) -> RigDescription:
    """Return the rig that is asked for, or a rig of the one arm."""
    from trocar.descriptions import load_arm, load_rig, names
    from trocar.descriptions.lone_arm import lone_arm_rig

    if args.arm in names("rigs") and args.arm not in names("arms"):
        return load_rig(args.arm, args.calibration)
    return lone_arm_rig(load_arm(args.arm, args.tool, args.calibration))
