"""Measure the step response of each joint of an arm, and tune its PID gains.

The other joints hold their position. P and D are optimised for settling time with small overshoot
and without effort saturation; I is unchanged. The tuned gains are printed as TOML, no file is
modified. See docs/tuning.md for the method.
"""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from typing import TYPE_CHECKING

from trocar.cli.arguments import add_arm, add_calibration, add_gains, add_json, options
from trocar.cli.output import print_result, progress_steps, short, table

if TYPE_CHECKING:
    from trocar.robot.tuning import GainTrial, TuningReport

SUMMARY = "measure an arm's step responses and tune its gains"
ORDER = 50


def add_arguments(parser: ArgumentParser) -> None:
    """Describe the arguments."""
    add_arm(parser)
    add_calibration(parser)
    options(parser, """
        --joint J ...  tune this joint only (repeatable, default: all joints)
    """)  # fmt: skip
    add_gains(parser)
    add_json(parser)


def run(args: Namespace) -> int:
    """Tune and print."""
    from trocar.descriptions import load_arm
    from trocar.descriptions.calibrated import selects_cad
    from trocar.robot.tuning import TuneSettings, tune

    dynamics = "cad" if selects_cad(args.calibration) else None
    settings = TuneSettings(tuple(args.joint), args.tool, args.control, args.friction, dynamics)
    arm = load_arm(args.arm, args.tool, args.calibration)
    with progress_steps("tuning") as watch:
        report = tune(arm, settings, watch)
    print_result(args, report, lambda: _tables(report))
    return 0


def _tables(report: TuningReport) -> str:
    rows: list[list[str]] = []
    for joint in report.joints:
        slides = joint.kind == "prismatic"
        step = f"{1e3 * joint.step:g} {'mm' if slides else 'mrad'}"
        rows.append([joint.joint, step, "present", *_row(joint.present)])
        rows.append(["", "", "tuned", *_row(joint.tuned)])
    head = ["joint", "step", "gains", "P", "I", "D", "rise [ms]", "overshoot [%]",
            "settling [ms]", "error [mrad, mm]", "peak effort [%]"]  # fmt: skip
    mounted = f" with {report.tool}" if report.tool else ""
    lines = "\n\n".join(f"# {part}\n{text}" for part, text in report.toml.items())
    return (
        f"{report.arm}{mounted}: step responses with gains {report.control!r},"
        f" {report.friction} friction\n\n{table(head, rows)}\n\n"
        f"Tuned gains, for the TOML file of each part:\n\n{lines}"
    )


def _row(tried: GainTrial) -> list[str]:
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
    """Format a number with a fixed number of decimals; `-` for NaN, 0 without a sign."""
    return "-" if value != value else f"{round(value, decimals) + 0.0:.{decimals}f}"
