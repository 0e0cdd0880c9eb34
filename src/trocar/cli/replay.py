"""Replay the recording of a simulation, or drive an arm along the log of a real arm, and compare.

A recording of a simulation (trocar sim --record) is repeated, and every physics step is compared
bit by bit. Only --rig and --json apply.

A log of a real PSM, ECM or MTM is a bag, a text file of numbers of any layout, or an episode of a
LeRobot dataset. See docs/recordings.md and docs/follow.md.
"""

from __future__ import annotations

import sys
from argparse import ArgumentParser, Namespace
from typing import TYPE_CHECKING

from trocar.cli.arguments import (
    add_calibration,
    add_gains,
    add_json,
    allow,
    names_of,
    options,
)
from trocar.cli.identify import add_base_rpy
from trocar.cli.output import leaning, print_result, progress_bar, table
from trocar.cli.reading import add_reading, allow_reading, read_settings

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
    """)  # fmt: skip
    add_reading(real)
    add_gains(real)


def run(args: Namespace) -> int:
    """Replay and print the report."""
    from trocar.robot.recordings import recording_kind

    kind = recording_kind(args.log)
    if kind == "recording":
        real = (
            "arm",
            "tool",
            "base_rpy",
            "calibration",
            "dynamics",
            "mode",
            "window",
            "control",
            "friction",
        )
        allow(args, "with the log of a real arm", *real, *names_of(add_reading))
        return _repeat(args)
    if args.mode == "position":
        allow(args, "with --mode effort", "window")
    allow_reading(args, {kind})
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
        control=args.control,
        friction=args.friction,
        reading=read_settings(args),
        tool=args.tool,
        calibration=args.calibration,
        rig=args.rig,
        base_rpy=args.base_rpy,
    )
    with progress_bar("rows") as watch:
        report = replay(args.log, args.arm, settings, watch)
    print(report.understood, file=sys.stderr)
    print_result(args, report, lambda: _tables(report))
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


def _tables(report: ReplayReport) -> str:
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
        f" ({report.samples / report.rate_hz:.2f} s{_pieces(report)}), {report.clipped} clipped to"
        f" a joint limit{leaning(report.up)}\n\n"
        f"{table(head, rows)}"
    )


def _pieces(report: ReplayReport) -> str:
    return f" in {report.pieces} pieces" if report.pieces > 1 else ""
