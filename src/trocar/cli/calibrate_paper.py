"""Fit a robot to the figures of the closed-loop paper: axis distances, place and spread of the RCM.

Tables 6 and 7 have them of one PSM and one ECM; of all geometries with these figures the nearest to
the description is taken. See docs/calibration.md.
"""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from typing import TYPE_CHECKING

from trocar.cli.arguments import add_json, add_overwrite, allow_overwrite, options
from trocar.cli.output import print_result, progress_steps, table

if TYPE_CHECKING:
    from trocar.robot.calibration.paper_robot import PaperTwin

SUMMARY = "fit a robot to the figures of the paper"
ORDER = 113


def add_arguments(parser: ArgumentParser) -> None:
    """Describe the arguments."""
    options(parser, """
        --arm ARM required   psm or ecm
        -o,--output OVERLAY  overlay file to write
    """)  # fmt: skip
    add_overwrite(parser)
    add_json(parser)


def run(args: Namespace) -> int:
    """Fit, write, print."""
    from trocar.descriptions import load_arm
    from trocar.descriptions.overlay import write_overlay
    from trocar.outputs import check_file
    from trocar.robot.calibration.paper_robot import paper_twin

    allow_overwrite(args, "output")
    if args.output:
        check_file(args.output, args.overwrite)
    with progress_steps() as watch:
        found = paper_twin(load_arm(args.arm), watch)
    if args.output:
        write_overlay(args.output, found.overlay, overwrite=args.overwrite)
    written = [f"written to {args.output}"] if args.output else []
    print_result(args, found.as_dict(), lambda: "\n\n".join([_twin(found), *written]))
    return 0


def _twin(found: PaperTwin) -> str:
    columns = (
        (found.hardware.position, found.hardware.rms),
        (found.nominal.position, found.nominal.rms_axes),
        (found.twin.position, found.twin.rms_axes),
    )
    rows = [
        [f"axes {label}", *(f"{1e3 * v:.2f}" for v in values)]
        for label, values in found.distances.items()
    ]
    rows += [
        [f"remote centre, {what} {axis}", *(f"{1e3 * column[part][i]:.2f}" for column in columns)]
        for part, what in enumerate(("position", "RMS"))
        for i, axis in enumerate("XYZ")
    ]
    both = [found.missed(found.nominal), found.missed(found.twin)]
    rows += [
        [f"remote centre, {what}", "", *(f"{1e3 * one[part]:.2f}" for one in both)]
        for part, what in enumerate(("distance from the hardware's", "spread missed"))
    ]
    head = ["[mm]", "hardware", "nominal", "calibrated"]
    return f"{found.overlay.arm}: the closed-loop paper's own robot\n{table(head, rows)}"
