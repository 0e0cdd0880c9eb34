"""Draw a recording: of every joint its position and set-point, their difference, and the effort.

FILE is one of trocar's own (trocar sim --record, World.record). A PNG shows one arm; of several
arms each has its own, named after it. An HTML page shows them all, with the largest errors and
efforts in numbers and the list of commands, and needs no network.
"""

from __future__ import annotations

import sys
from argparse import ArgumentParser, Namespace


def add_arguments(parser: ArgumentParser) -> None:
    """Describe the arguments."""
    parser.add_argument("file", metavar="FILE", help="the recording")
    parser.add_argument(
        "-o", "--out", metavar="OUT", help="a .png or .html file; default: FILE's name with .png"
    )
    parser.add_argument("--arm", help="this arm alone; default: every arm that moved")
    parser.add_argument("--joint", help="this joint alone")


def run(args: Namespace) -> int:
    """Draw, and print what was written."""
    from trocar.apps.plotting import plot

    report = plot(args.file, args.out, args.arm, args.joint)
    if report.problem:
        print(f"trocar: warning: {args.file}: {report.problem}", file=sys.stderr)
    for file in report.files:
        print(file)
    return 0
