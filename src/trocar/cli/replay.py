"""Replay the recording of a simulation, or drive an arm along the log of a real arm, and compare.

A recording of a simulation (trocar sim --record) is repeated, and every physics step is compared
bit by bit. Only --rig and --json apply.

A log of a real PSM, ECM or MTM is a CSV file, plain or gzip, one row per sample with the positions,
then velocities, then efforts of all joints (SI units), or a rosbag 1, rosbag 2 or MCAP file with
topic /<ARM>/measured_js. See docs/follow.md.
"""

from __future__ import annotations

import sys
from argparse import ArgumentParser, Namespace
from typing import TYPE_CHECKING

from trocar.cli.arguments import add_calibration, add_gains, add_json, allow, options
from trocar.cli.identify import add_base_rpy
from trocar.cli.output import print_result, progress_bar, table

if TYPE_CHECKING:
    from trocar.robot.follow import RepeatReport, ReplayReport

SUMMARY = "replay a simulation, or a real arm's log on an arm"
ORDER = 70


def add_arguments(parser: ArgumentParser) -> None:
    """Describe the arguments."""
    options(parser, """
        log FILE  recording of a simulation or log of an arm
    """)  # fmt: skip
    add_json(parser)
    own = parser.add_argument_group("recording of a simulation")
    options(own, """
        --rig RIG  rig of the recording, if its path has changed; of a log of a real arm, the rig in
                   which it stands
    """)  # fmt: skip
    real = parser.add_argument_group("log of a real arm")
    options(real, """
        --arm ARM        built-in arm (see trocar list arms) or TOML file; with --rig, an arm of
                         that rig (default: psm; with --rig its only one)
        --tool TOOL      built-in tool or TOML file (default: the tool of the arm's description)
    """)  # fmt: skip
    add_base_rpy(real)
    add_calibration(real)
    options(real, """
        --mode position|effort = position  position: track the recorded positions (default); effort:
                                           apply the recorded efforts open loop
        --window S:number = 0.5            mode effort: reset to the recorded state every S seconds
        --rate HZ:number = 200             sample rate of a CSV log; bags are resampled to it
        --wrist motor|joint = motor        CSV log: side of the coupling on which a PSM's wrist and
                                           jaw, or an MTM's joints 2 to 4, were recorded
        --topic TOPIC                      bag: topic of joint states (default: the only one that
                                           fits the arm)
    """)  # fmt: skip
    add_gains(real)


def run(args: Namespace) -> int:
    """Replay and print the report."""
    from trocar.recording import is_recording
    from trocar.recording.bags import is_bag

    if is_recording(args.log):
        real = (
            "arm",
            "tool",
            "base_rpy",
            "calibration",
            "dynamics",
            "mode",
            "window",
            "rate",
            "wrist",
        )
        allow(args, "with the log of a real arm", *real, "topic", "control", "friction")
        return _repeat(args)
    if args.mode == "position":
        allow(args, "with --mode effort", "window")
    if is_bag(args.log):
        allow(args, "with a CSV log", "wrist")
    else:
        allow(args, "with a bag", "topic")
    return _replay(args)


def _repeat(args: Namespace) -> int:
    from trocar.robot.follow import repeat

    with progress_bar("steps") as watch:
        report = repeat(args.log, args.rig, watch)
    for text in (*report.warnings, *filter(None, [report.problem])):
        print(f"trocar: warning: {args.log}: {text}", file=sys.stderr)
    print_result(args, report, lambda: _repeated(report))
    return 0 if report.identical else 1


def _replay(args: Namespace) -> int:
    from trocar.robot.follow import ReplaySettings, replay

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
        rig=args.rig,
        base_rpy=args.base_rpy,
    )
    with progress_bar("rows") as watch:
        report = replay(args.log, args.arm, settings, watch)
    print_result(args, report, lambda: _tables(report, settings.rate_hz))
    return 0


def _repeated(report: RepeatReport) -> str:
    head = (
        f"{report.file}: rig {report.rig}, {report.commands} commands,"
        f" {report.periods} steps ({report.simulated_s:.3f} s)\n"
    )
    if report.difference is None:
        return f"{head}motion is identical to the last bit (digest {report.digest})"
    d = report.difference
    return (
        f"{head}motion DIFFERS from {d.time:.3f} s on; largest difference:"
        f" {d.largest:.3g} in the {d.quantity} of {d.joint}"
    )


def _tables(report: ReplayReport, rate_hz: float) -> str:
    rows: list[list[str]] = []
    for joint, tracking in report.tracking_rms.items():
        slides = joint == "insertion"
        ratio = report.effort_relative_rms[joint]
        rows.append(
            [
                joint,
                f"{1e3 * tracking:.3f}",
                "mm" if slides else "mrad",
                f"{report.effort_rms[joint]:.4f}",
                "N" if slides else "N m",
                "-" if ratio is None else f"{100.0 * ratio:.1f}",
            ]
        )
    head = ["joint", "tracking RMS", "", "effort RMS", "", "% of recorded"]
    return (
        f"{report.arm} along {report.log}, mode {report.mode}: {report.samples} samples"
        f" ({report.samples / rate_hz:.2f} s), {report.clipped} clipped to a joint limit\n\n"
        f"{table(head, rows)}"
    )
