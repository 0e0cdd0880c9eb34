"""Plot position, set-point, tracking error and effort of every joint of a recording.

FILE is a recording of a simulation (trocar sim --record, World.record). PNG output is one file per
arm, named after the arm if there are several. HTML output is one self-contained page with all
arms, a table of maximum errors and efforts, and the list of commands.
"""

from __future__ import annotations

import sys
from argparse import ArgumentParser, Namespace

from trocar.cli.arguments import add_overwrite, options
from trocar.cli.output import progress_steps

SUMMARY = "plot a recording: joints, errors, efforts"
ORDER = 100


def add_arguments(parser: ArgumentParser) -> None:
    """Describe the arguments."""
    options(parser, """
        file FILE     recording, MCAP file
        -o,--out OUT  output file, .png or .html (default: FILE as .png)
    """)  # fmt: skip
    add_overwrite(parser, "existing output files")
    options(parser, """
        --arm ARM      plot this arm only (default: every arm that moved)
        --joint JOINT  plot this joint only
    """)  # fmt: skip


def run(args: Namespace) -> int:
    """Plot, and print the files written."""
    from trocar.plotting import plot

    with progress_steps() as watch:
        watch(f"plotting {args.file}")
        report = plot(args.file, args.out, args.arm, args.joint, overwrite=args.overwrite)
    if report.problem:
        print(f"trocar: warning: {args.file}: {report.problem}", file=sys.stderr)
    for file in report.files:
        print(file)
    return 0
