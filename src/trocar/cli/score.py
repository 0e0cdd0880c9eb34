"""Score the motion of a recording: path length, economy of motion, smoothness, events.

FILE is a recording of a simulation (trocar sim --record, trocar teleop --record), or of real arms
with their joints or the poses of their tips (docs/recordings.md). Each arm whose tip moved is
scored. See docs/scores.md for definitions and sources.
"""

from __future__ import annotations

import sys
from argparse import ArgumentParser, Namespace
from typing import TYPE_CHECKING

from trocar.cli.arguments import add_json, allow, names_of, options
from trocar.cli.output import fixed, print_result, progress_steps, table, warn
from trocar.cli.reading import add_reading, allow_reading, read_settings

if TYPE_CHECKING:
    from trocar.tasks.scoring import RecordingScore

SUMMARY = "score a recording: path length, economy, smoothness"
ORDER = 105


def add_arguments(parser: ArgumentParser) -> None:
    """Describe the arguments."""
    options(parser, """
        file FILE         recording of a simulation or of real arms
        --arm ARM         score this arm only (default: every arm that moved)
        --start S:number  start of the interval (default: of FILE)
        --end S:number    end of the interval (default: of FILE)
        --rig RIG         recorded rig, if it is no longer at its recorded path
        --tool TOOL       of a real PSM: built-in tool or TOML file (default: that of the
                          description)
    """)  # fmt: skip
    add_reading(parser)
    add_json(parser)


def run(args: Namespace) -> int:
    """Print the scores."""
    from trocar.robot.recordings import recording_kind
    from trocar.tasks.scoring import score_recording

    kind = recording_kind(args.file)
    allow_reading(args, {kind})
    if kind != "recording":
        return _score_real(args)
    allow(args, "with a recording of a real arm", "tool", *names_of(add_reading))
    with progress_steps() as watch:
        watch(f"scoring {args.file}")
        report = score_recording(args.file, args.arm, args.start, args.end, args.rig)
    if report.problem:
        warn(f"{args.file}: {report.problem}")
    print_result(args, report, lambda: _report(report))
    return 0


def _score_real(args: Namespace) -> int:
    """Score the tips in the recording of a real robot."""
    from trocar.robot.recordings import tip_motions
    from trocar.tasks.scoring import RESTS_M, RecordingScore, score_tip

    allow(args, "with a recording of a simulation", "rig")
    with progress_steps() as watch:
        watch(f"scoring {args.file}")
        tips = tip_motions(args.file, args.arm or args.of, read_settings(args), args.tool)
        kept = [tip for tip in tips if args.arm or tip.extent_m > RESTS_M]
        arms = {tip.label: score_tip(tip.times, tip.positions, args.start, args.end)
                for tip in kept}  # fmt: skip
    for tip in tips:
        print(tip.understood, file=sys.stderr)
    ends = [(tip.times[0], tip.times[-1]) for tip in tips]
    start = min(first for first, _ in ends) if args.start is None else args.start
    end = max(last for _, last in ends) if args.end is None else args.end
    report = RecordingScore(args.file, float(start), float(end), arms, "")
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
