"""Benchmark speed and accuracy, and compare each figure with its goal.

PART speed measures the configurations of the paper's Table 9 against bare MuJoCo in the same run:
compare the ratio, because the real-time factor depends on the machine. PART fidelity measures
accuracy; with --calibration, also what `trocar calibrate` makes of robots that it has not seen:
accuracy, intervals, exchanged labels, broken loops, setup joints (half an hour). PART core, only if
named, measures the cost of API calls in physics steps. --log adds the replay of a recording.
python -m benchmarks --help lists more, in the repository. See docs/performance.md.
"""

from __future__ import annotations

from argparse import ArgumentParser, ArgumentTypeError, Namespace
from typing import TYPE_CHECKING

from trocar.cli.arguments import add_json, allow, options
from trocar.cli.output import print_result, progress_steps, table
from trocar.errors import InputError

if TYPE_CHECKING:
    from trocar.robot.verification.figures import Figure
    from trocar.robot.verification.speed import Table9Row

SUMMARY = "benchmark speed against bare MuJoCo, and accuracy"
ORDER = 200

#: The parts that are measured by default, and all parts.
PARTS = ("speed", "fidelity")
ALL_PARTS = (*PARTS, "core")
#: Progress steps that each part reports, for the time estimate of the progress bar.
STEPS = {"speed": 6, "fidelity": 11, "core": 10}
#: The same of --calibration.
CALIBRATION_STEPS = 6


def add_arguments(parser: ArgumentParser) -> None:
    """Describe the arguments."""
    options(parser, f"""
        part PART:part [...]       benchmark: {', '.join(ALL_PARTS)} (default: {', '.join(PARTS)})
        --duration S:number = 10   simulated time per pass
        --passes N:int = 5         number of interleaved passes
        --poses N:int = 10000      number of inverse-kinematics poses
        --robots N:int = 40        number of calibrated robots of each kind
        --log FILE                 replay this PSM recording (docs/follow.md)
        --calibration OVERLAY [...]
            measure speed with these calibrated robots; with PART fidelity and no OVERLAY, calibrate
            robots and compare them with the truth
    """, part=_part)  # fmt: skip
    add_json(parser)


def run(args: Namespace) -> int:
    """Measure and print."""
    counts = (args.passes, args.poses, args.robots)
    if not 0.0 < args.duration < float("inf") or min(counts) < 1:
        raise InputError(
            f"got --duration {args.duration:g}, --passes {args.passes}, --poses {args.poses},"
            f" --robots {args.robots}; allowed: above 0"
        )
    from trocar.descriptions.overlay import read_overlay
    from trocar.robot.verification.fidelity import fidelity
    from trocar.robot.verification.figures import figure_rows
    from trocar.robot.verification.speed import table9
    from trocar.robot.verification.unseen_robots import unseen_robots
    from trocar.robot.verification.verb_costs import core

    for word in args.calibration or ():
        if word in ALL_PARTS:
            raise InputError(
                f"--calibration: got the PART {word!r}; PART comes first, as in"
                f" `trocar bench {word} --calibration OVERLAY`"
            )
    overlays = [read_overlay(file) for file in args.calibration or ()]
    if overlays and (set(args.part) - {"speed"} or args.log):
        raise InputError(
            "--calibration OVERLAY: allowed with PART speed only; to measure the accuracy of a"
            " calibrated robot, run `trocar verify --calibration`"
        )
    calibrating = args.calibration == []
    if calibrating and "fidelity" not in args.part:
        raise InputError("--calibration without an OVERLAY: allowed with PART fidelity only")
    parts = args.part or (("speed",) if overlays else PARTS)
    if "speed" not in parts:
        allow(args, "with PART speed", "duration", "passes")
    if "fidelity" not in parts:
        allow(args, "with PART fidelity", "poses")
    if not calibrating:
        allow(args, "with --calibration without an OVERLAY", "robots")
    rows: list[Table9Row] = []
    found: list[Figure] = []
    steps = sum(STEPS[part] for part in parts) + bool(args.log)
    steps += CALIBRATION_STEPS if calibrating else 0
    with progress_steps("measuring", steps) as watch:
        if "speed" in parts:
            rows = table9(args.duration, args.passes, watch, overlays)
        if "fidelity" in parts:
            found += fidelity(watch, args.poses)
        if "core" in parts:
            found += core(watch)
        if calibrating:
            found += unseen_robots(args.robots, watch)
        if args.log:
            watch("replay")
            found += _replayed(args.log)
    document = {"table9": rows, "figures": found}
    blocks = [_speeds(rows)] if rows else []
    blocks += [table(*figure_rows(found))] if found else []
    print_result(args, document, lambda: "\n\n".join(blocks))
    return 0


def _part(name: str) -> str:
    if name not in ALL_PARTS:  # argparse's own choices reject an empty list
        raise ArgumentTypeError(f"got {name!r}; allowed: {', '.join(ALL_PARTS)}")
    return name


def _replayed(log: str) -> list[Figure]:
    from trocar.robot.follow import ReplaySettings, replay
    from trocar.robot.verification.figures import Figure

    report = replay(log, "psm", ReplaySettings())
    found: list[Figure] = []
    for joint, rms in report.tracking_rms.items():
        unit, limit = ("mm", 1.0) if joint == "insertion" else ("mrad", 10.0)
        found.append(Figure(f"replay: tracking of {joint}", 1e3 * rms, unit, limit))
    for joint, rms in report.effort_rms.items():
        limit = 0.5 if joint in ("yaw", "pitch") else None
        unit = "N" if joint == "insertion" else "N m"
        found.append(Figure(f"replay: effort of {joint}, simulated - recorded", rms, unit, limit))
    return found


def _speeds(rows: list[Table9Row]) -> str:
    head = ["configuration", "real-time factor", "goal", "bare MuJoCo", "overhead", "at rest",
            "collision cost", "paper (Gazebo)"]  # fmt: skip
    lines = [
        [row.configuration, f"{row.real_time_factor:.1f}", f"{row.goal:g}",
         f"{row.bare_real_time_factor:.1f}", f"{row.overhead:.3f}",
         f"{row.overhead_at_rest:.3f}", f"{row.collision_cost:.3f}",
         f"{row.paper:g}"]
        for row in rows
    ]  # fmt: skip
    return (
        "Speed at 1 kHz on one core (medians). Bare MuJoCo: mj_step alone, same motion.\n"
        "Overhead: time of trocar's own code / time of mj_step; at rest: the same, arms at rest.\n"
        "Collision cost: mj_step with bodies / without bodies, at rest.\n\n" + table(head, lines)
    )
