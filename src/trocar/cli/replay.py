"""Repeat a recording of a simulation, or drive an arm along one of a real arm, and compare.

A recording of trocar's own (trocar sim --record) is repeated command by command, and every physics
period is compared to the last bit; of the options only --rig and --json matter then.

Otherwise FILE is a recording of a real PSM, ECM or MTM: comma-separated text without a header,
plain or gzip, a row per sample: the positions of all joints, then their velocities, then their
efforts (SI); or a rosbag 1, a rosbag 2 or an MCAP file with the topic /<ARM>/measured_js. See
docs/replay.md.
"""

from __future__ import annotations

import sys
from argparse import ArgumentParser, Namespace
from typing import TYPE_CHECKING

from trocar.cli.arguments import add_calibration, add_json, number
from trocar.cli.output import print_json, progress_bar, table

if TYPE_CHECKING:
    from trocar.apps.follow import RepeatReport, ReplayReport


def add_arguments(parser: ArgumentParser) -> None:
    """Describe the arguments."""
    parser.add_argument("log", metavar="FILE", help="the recording")
    parser.add_argument("--rig", help="path of the rig of a recording of trocar's own, if it moved")
    parser.add_argument(
        "--arm", default="psm", help="a built-in arm (trocar list), or a TOML file; default: psm"
    )
    parser.add_argument("--tool", help="another tool, or its TOML file; default: the arm's")
    add_calibration(parser)
    parser.add_argument(
        "--mode",
        choices=("position", "effort"),
        default="position",
        help="follow the recorded motion, or apply the recorded efforts open loop",
    )
    parser.add_argument(
        "--window",
        type=number,
        default=0.5,
        metavar="S",
        help="in mode effort, restart from the recorded state this often; default: 0.5 s",
    )
    parser.add_argument(
        "--rate",
        type=number,
        default=200.0,
        metavar="HZ",
        help="rows a second; a bag is resampled to it; default: 200",
    )
    parser.add_argument(
        "--wrist",
        choices=("motor", "joint"),
        default="motor",
        help="side of the coupling on which a PSM's wrist and jaw, or an MTM's joints 2 to 4, were"
        " recorded in a text file; default: motor",
    )
    parser.add_argument(
        "--topic", help="joint states in a bag; default: the only topic that fits the arm"
    )
    parser.add_argument(
        "--control", choices=("dvrk", "paper"), default="dvrk", help="gains; default: dvrk"
    )
    parser.add_argument(
        "--friction",
        choices=("identified", "paper"),
        default="identified",
        help="of the joints; default: identified",
    )
    add_json(parser)


def run(args: Namespace) -> int:
    """Replay and print what was found."""
    from trocar.recording import is_recording

    return _repeat(args) if is_recording(args.log) else _replay(args)


def _repeat(args: Namespace) -> int:
    from trocar.apps.follow import repeat

    with progress_bar("periods", not args.json) as watch:
        report = repeat(args.log, args.rig, watch)
    for text in (*report.warnings, *filter(None, [report.problem])):
        print(f"trocar: warning: {args.log}: {text}", file=sys.stderr)
    if args.json:
        print_json(report.as_dict())
    else:
        print(_repeated(report))
    return 0 if report.identical else 1


def _replay(args: Namespace) -> int:
    from trocar.apps.follow import ReplaySettings, replay

    settings = ReplaySettings(
        mode=args.mode,
        window_s=args.window,
        rate_hz=args.rate,
        control=args.control,
        friction=args.friction,
        wrist=args.wrist,
        tool=args.tool,
        topic=args.topic,
        calibration=args.calibration,
    )
    with progress_bar("rows", not args.json) as watch:
        report = replay(args.log, args.arm, settings, watch)
    if args.json:
        print_json(report.as_dict())
    else:
        print(_tables(report, settings.rate_hz))
    return 0


def _repeated(report: RepeatReport) -> str:
    head = (
        f"{report.file}: rig {report.rig}, {report.commands} commands,"
        f" {report.periods} periods ({report.simulated_s:.3f} s)\n"
    )
    if report.difference is None:
        return f"{head}the motion is identical to the last bit (digest {report.digest})"
    d = report.difference
    return (
        f"{head}the motion DIFFERS from {d.time:.3f} s on; largest difference:"
        f" {d.largest:.3g} in the {d.quantity} of {d.joint}"
    )


def _tables(report: ReplayReport, rate_hz: float) -> str:
    rows: list[list[str]] = []
    for joint, tracking in report.tracking_rms.items():
        slides = joint == "insertion"
        share = report.effort_relative_rms[joint]
        rows.append(
            [
                joint,
                f"{1e3 * tracking:.3f}",
                "mm" if slides else "mrad",
                f"{report.effort_rms[joint]:.4f}",
                "N" if slides else "N m",
                "-" if share is None else f"{100.0 * share:.1f}",
            ]
        )
    head = ["joint", "tracking RMS", "", "effort RMS", "", "% of recorded"]
    return (
        f"{report.arm} along {report.log}, mode {report.mode}: {report.samples} samples"
        f" ({report.samples / rate_hz:.2f} s), {report.clipped} beyond a limit and clipped\n\n"
        f"{table(head, rows)}"
    )
