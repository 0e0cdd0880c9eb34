"""Benchmark speed and accuracy, and compare each figure with its goal.

The real-time factor of PART speed depends on the machine: compare the ratio to bare MuJoCo. PART
calibration measures what `trocar calibrate` makes of robots that it has not seen: accuracy,
intervals, exchanged labels, broken loops, setup joints (half an hour). python -m benchmarks --help
lists more, in the repository. See docs/performance.md.
"""

from __future__ import annotations

from argparse import ArgumentParser, ArgumentTypeError, Namespace
from typing import TYPE_CHECKING, Any

from trocar.cli.arguments import add_json, allow, options
from trocar.cli.output import print_result, progress_steps, table
from trocar.errors import InputError
from trocar.robot.experiments import BENCHED, chosen, listed, names_of

if TYPE_CHECKING:
    from trocar.robot.verification.figures import Figure
    from trocar.robot.verification.speed import Table9Row

SUMMARY = "benchmark speed against bare MuJoCo, and accuracy"
ORDER = 200

#: Experiments that PART names; options choose the others.
PARTS = BENCHED[:4]


def add_arguments(parser: ArgumentParser) -> None:
    """Describe the arguments."""
    usual = ", ".join(names_of(chosen(PARTS, ())))
    options(parser, f"""
        part PART:part [...]       {listed(PARTS)} (default: {usual})
        --duration S:number = 10   simulated time per pass
        --passes N:int = 5         number of interleaved passes
        --poses N:int = 10000      number of inverse-kinematics poses
        --robots N:int = 40        number of calibrated robots of each kind
        --log FILE                 replay this PSM recording (docs/follow.md)
        --calibration OVERLAY [...]  measure speed with these calibrated robots
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
    from trocar.robot.verification.figures import figure_rows

    for word in args.calibration or ():
        if word in names_of(PARTS):
            raise InputError(
                f"--calibration: got the PART {word!r}; PART comes first, as in"
                f" `trocar bench {word} --calibration OVERLAY`"
            )
    if args.calibration == []:
        raise InputError("--calibration: got no OVERLAY; allowed: one or more")
    overlays = [read_overlay(file) for file in args.calibration or ()]
    if overlays and (set(args.part) - {"speed"} or args.log):
        raise InputError(
            "--calibration OVERLAY: allowed with PART speed only; to measure the accuracy of a"
            " calibrated robot, run `trocar verify --calibration`"
        )
    names = args.part or (("speed",) if overlays else names_of(chosen(PARTS, ())))
    for part in PARTS:
        if part.name not in names:
            allow(args, f"with PART {part.name}", *part.options)
    experiments = chosen(BENCHED, {*names, *(["replay"] if args.log else [])})
    given = {**vars(args), "overlays": overlays}
    rows: list[Table9Row] = []
    found: list[Figure] = []
    with progress_steps("measuring", sum(e.steps for e in experiments)) as watch:
        for experiment in experiments:
            measured: list[Any] = rows if experiment.name == "speed" else found
            measured += experiment.measure(given, watch)
    blocks = [_speeds(rows)] if rows else []
    blocks += [table(*figure_rows(found))] if found else []
    print_result(args, {"table9": rows, "figures": found}, lambda: "\n\n".join(blocks))
    return 0


def _part(name: str) -> str:
    if name not in names_of(PARTS):  # argparse's own choices reject an empty list
        raise ArgumentTypeError(f"got {name!r}; allowed: {', '.join(names_of(PARTS))}")
    return name


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
