"""What is known of an arm: joints and limits, frames, loops, masses, gains, and the sources."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace

from trocar.cli.arguments import add_arm, add_json
from trocar.cli.output import print_json


def add_arguments(parser: ArgumentParser) -> None:
    """Describe the arguments."""
    add_arm(parser)
    add_json(parser)


def run(args: Namespace) -> int:
    """Print all that the arm's description says."""
    from trocar.cli.show_document import document
    from trocar.cli.show_tables import report
    from trocar.descriptions import load_arm

    found = document(load_arm(args.arm, args.tool))
    if args.json:
        print_json(found)
    else:
        print(report(found))
    return 0
