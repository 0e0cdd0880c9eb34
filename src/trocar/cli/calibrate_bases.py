"""Register arms' bases and joint offsets from their own joint readings, without motion capture.

TOUCHES is a TOML file of arms that touch known points of a block, or hold a board in front of a
camera (trocar touches simulates one). With --from, the joints of each touch are read from a
recording of the arms at the times of the touches. See docs/calibration.md.
"""

from __future__ import annotations

import math
import sys
from argparse import ArgumentParser, Namespace
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from trocar.cli.arguments import add_json, add_overwrite, allow, allow_overwrite, names_of, options
from trocar.cli.output import print_result, progress_steps, table, warn
from trocar.cli.reading import add_reading, allow_reading, read_settings

if TYPE_CHECKING:
    from trocar.robot.calibration.registration import Base

SUMMARY = "register arms' bases by touching known points"
ORDER = 111


def add_arguments(parser: ArgumentParser) -> None:
    """Describe the arguments."""
    options(parser, """
        touches TOUCHES   TOML file of touches
        -o,--output FILE  registration to write, as TOML
        --from FILE as recording  recording of the arms while they touched (see recordings.md): the
                          readings have times in place of joints
    """)  # fmt: skip
    add_reading(parser)
    add_overwrite(parser)
    add_json(parser)


def run(args: Namespace) -> int:
    """Register, write, print."""
    from trocar.descriptions.table import toml_text
    from trocar.outputs import check_file, write_text
    from trocar.robot.calibration.registration import register, registration_dict
    from trocar.robot.calibration.touches import read_touches
    from trocar.robot.recordings import recording_kind

    allow_overwrite(args, "output")
    if args.recording is None:
        allow(args, "with --from", *names_of(add_reading))
        how = None
    else:
        allow_reading(args, {recording_kind(args.recording)})
        how = read_settings(args)
    if args.output:
        check_file(args.output, args.overwrite)
    with progress_steps() as watch:
        watch(f"reading {args.touches}")
        readings = read_touches(args.touches, args.recording, how)
        found = register(readings, watch)
    for one in readings.values():
        if one.understood:
            print(one.understood, file=sys.stderr)
    boards = next(iter(readings.values())).boards is not None
    document = registration_dict(found, "camera" if boards else "block")
    if args.output:
        write_text(args.output, toml_text({"schema": 1, **document}), args.overwrite)
    for text in document["warnings"]:
        warn(text)
    written = [f"written to {args.output}"] if args.output else []
    print_result(args, document, lambda: "\n\n".join([_registration(found, document), *written]))
    return 0


def _registration(found: Mapping[str, Base], document: dict[str, Any]) -> str:
    placed = {
        f"{name} in the {document['reference']}": one for name, one in document["arms"].items()
    }
    placed |= document["bases"]
    rows = [
        [what, *(f"{1e3 * v:.3f}" for v in one["xyz_m"]),
         *(f"{1e3 * v:.3f}" for v in one["xyz_sigma_m"]),
         *(f"{math.degrees(v):.4f}" for v in one["rpy_rad"]),
         *(f"{math.degrees(v):.4f}" for v in one["turn_sigma_rad"])]
        for what, one in placed.items()
    ]  # fmt: skip
    head = ["base", "x [mm]", "y", "z", "sigma x", "y", "z", "roll [deg]", "pitch", "yaw",
            "sigma about x", "y", "z"]  # fmt: skip
    offsets = [
        [name, joint, f"{1e3 * v.value:.3f}", f"{1e3 * v.sigma:.3f}",
         "not determined" if joint in base.undetermined else ""]
        for name, base in found.items()
        for joint, v in base.offsets.items()
    ]  # fmt: skip
    left = "; ".join(
        f"{name}: {base.readings} readings, {1e3 * base.position_rms:.3f} mm RMS residual per axis"
        for name, base in found.items()
    )
    return "\n\n".join(
        [
            left,
            table(head, rows),
            table(["arm", "joint", "offset [mrad; mm]", "sigma", ""], offsets),
        ]
    )
