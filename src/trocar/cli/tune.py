"""Step each joint of a lone arm, tell how it answers, and tune its gains from that.

The other joints are held meanwhile. P and D are searched for the soonest settled step with little
overshoot and effort to spare; I stays. docs/tuning.md says how. Nothing is written to a file:
the lines to put into one are printed.
"""

from __future__ import annotations

import sys
from argparse import ArgumentParser, Namespace
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from trocar.cli.arguments import add_arm, add_calibration, add_json
from trocar.cli.output import print_json, short, table

if TYPE_CHECKING:
    from trocar.apps.tuning import Tried, TuningReport


def add_arguments(parser: ArgumentParser) -> None:
    """Describe the arguments."""
    add_arm(parser)
    add_calibration(parser)
    parser.add_argument(
        "--joint",
        metavar="J",
        action="append",
        default=[],
        help="this joint only; may be repeated; default: all",
    )
    parser.add_argument(
        "--control",
        choices=("dvrk", "paper"),
        default="dvrk",
        help="gains to begin with; default: dvrk",
    )
    parser.add_argument(
        "--friction",
        choices=("identified", "paper"),
        default="identified",
        help="of the joints; default: identified",
    )
    add_json(parser)


def run(args: Namespace) -> int:
    """Tune and print."""
    from trocar.apps.tuning import TuneSettings, tune
    from trocar.descriptions import load_arm

    settings = TuneSettings(tuple(args.joint), args.tool, args.control, args.friction)
    arm = load_arm(args.arm, args.tool, args.calibration)
    report = tune(arm, settings, _watch)
    if args.json:
        print_json(_document(report))
    else:
        print(_tables(report))
    return 0


def _watch(what: str) -> None:
    print(f"trocar: tuning {what} ...", file=sys.stderr, flush=True)


def _document(report: TuningReport) -> dict[str, Any]:
    document = asdict(report)
    document["tool"] = report.tool or None
    for joint in document["joints"]:
        for which in ("present", "tuned"):
            joint[which] = {**joint[which]["gains"], **joint[which]["response"]}
    return document


def _tables(report: TuningReport) -> str:
    rows: list[list[str]] = []
    for joint in report.joints:
        slides = joint.kind == "prismatic"
        step = f"{1e3 * joint.step:g} {'mm' if slides else 'mrad'}"
        rows.append([joint.joint, step, "present", *_row(joint.present)])
        rows.append(["", "", "tuned", *_row(joint.tuned)])
    head = ["joint", "step", "gains", "P", "I", "D", "rise [ms]", "overshoot [%]",
            "settled [ms]", "left [mrad, mm]", "effort [% of limit]"]  # fmt: skip
    mounted = f" with {report.tool}" if report.tool else ""
    lines = "\n\n".join(f"# {part}\n{text}" for part, text in report.toml.items())
    return (
        f"{report.arm}{mounted}: steps with the gains {report.control!r},"
        f" {report.friction} friction\n\n{table(head, rows)}\n\n"
        f"The tuned gains, for the file of each part:\n\n{lines}"
    )


def _row(tried: Tried) -> list[str]:
    gains, response = tried.gains, tried.response
    return [
        *(short(gain) for gain in (gains.p, gains.i, gains.d)),
        _digits(1e3 * response.rise_time_s, 1),
        _digits(1e2 * response.overshoot, 2),
        _digits(1e3 * response.settling_time_s, 1),
        _digits(1e3 * response.steady_error, 4),
        _digits(1e2 * response.peak_effort_share, 1),
    ]


def _digits(value: float, decimals: int) -> str:
    """Write a number with so many decimals, `-` for what there is not, 0 without a sign."""
    return "-" if value != value else f"{round(value, decimals) + 0.0:.{decimals}f}"
