"""Score the motion of a recording: path length, economy of motion, smoothness, events.

FILE is a recording of a simulation (trocar sim --record, trocar teleop --record). Each arm whose
tip moved is scored. See docs/scores.md for definitions and sources.
"""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from typing import TYPE_CHECKING

from trocar.cli.arguments import add_json, options
from trocar.cli.output import fixed, print_result, progress_steps, table, warn

if TYPE_CHECKING:
    from trocar.tasks.scoring import RecordingScore

SUMMARY = "score a recording: path length, economy, smoothness"
ORDER = 105


def add_arguments(parser: ArgumentParser) -> None:
    """Describe the arguments."""
    options(parser, """
        file FILE         recording, MCAP file
        --arm ARM         score this arm only (default: every arm that moved)
        --start S:number  start of the interval (default: of FILE)
        --end S:number    end of the interval (default: of FILE)
        --rig RIG         recorded rig, if it is no longer at its recorded path
    """)  # fmt: skip
    add_json(parser)


def run(args: Namespace) -> int:
    """Print the scores."""
    from trocar.tasks.scoring import score_recording

    with progress_steps() as watch:
        watch(f"scoring {args.file}")
        report = score_recording(args.file, args.arm, args.start, args.end, args.rig)
    if report.problem:
        warn(f"{args.file}: {report.problem}")
    print_result(args, report, lambda: _report(report))
    return 0


def _report(report: RecordingScore) -> str:
    head = ["arm", "path [mm]", "economy", "smoothness", "peak [mm/s]", "jaw [mN m]"]
    rows = [
        [
            name,
            fixed(1e3 * one.motion.path_length_m, 2),
            fixed(one.motion.economy, 3),
            fixed(one.motion.smoothness, 2),
            fixed(1e3 * one.motion.speed_max_m_s, 1),
            "-" if one.jaw_effort_max is None else fixed(1e3 * one.jaw_effort_max, 1),
        ]
        for name, one in report.arms.items()
    ]
    events = [
        f"{name}: {count} {event}"
        for name, one in report.arms.items()
        for event, count in one.events.items()
    ]
    interval = f"{report.start_s:g} to {report.end_s:g} s"
    if not rows:
        return f"{report.file}: {interval}: no arm moved"
    return "\n".join([f"{report.file}: {interval}\n", table(head, rows), *events])
