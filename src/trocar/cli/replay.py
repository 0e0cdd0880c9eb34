"""trocar replay: drive an arm along a recording of a real one, and compare."""

from __future__ import annotations

import argparse
import json
import sys
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from trocar.apps.replay import ReplayReport

HELP = "drive an arm along a recording of a real one, and compare"
BAR_WIDTH = 32


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add what the subcommand takes."""
    parser.add_argument("log", metavar="LOG", help="recording: CSV without header, plain or gzip")
    parser.add_argument("--arm", default="psm", help="built-in arm or TOML file (default: psm)")
    parser.add_argument("--tool", help="mounted tool (default: the arm's own)")
    parser.add_argument(
        "--mode",
        choices=("position", "effort"),
        default="position",
        help="servo along the recorded motion, or apply the recorded efforts open loop",
    )
    parser.add_argument(
        "--window",
        type=float,
        default=0.5,
        metavar="S",
        help="with --mode effort: restart from the recorded state this often (default: 0.5 s)",
    )
    parser.add_argument(
        "--rate", type=float, default=200.0, metavar="HZ", help="rows per second (default: 200)"
    )
    parser.add_argument(
        "--wrist",
        choices=("motor", "joint"),
        default="motor",
        help="how a PSM's columns 5 to 7 were recorded (default: motor side)",
    )
    parser.add_argument("--control", choices=("dvrk", "paper"), default="dvrk", help="gains")
    parser.add_argument(
        "--friction", choices=("identified", "paper"), default="identified", help="joint friction"
    )
    parser.add_argument("--json", action="store_true", help="print one JSON document")


def run(args: argparse.Namespace) -> int:
    """Replay and print."""
    from trocar.apps.replay import ReplaySettings, replay

    settings = ReplaySettings(
        mode=args.mode,
        window_s=args.window,
        rate_hz=args.rate,
        control=args.control,
        friction=args.friction,
        wrist=args.wrist,
        tool=args.tool,
    )
    shown = sys.stderr.isatty() and not args.json
    try:
        report = replay(args.log, args.arm, settings, _draw_bar if shown else None)
    finally:
        if shown:
            sys.stderr.write("\r\x1b[K")
    if args.json:
        print(json.dumps(report.as_dict(), indent=2, allow_nan=False))
    else:
        _print_table(report, settings.rate_hz)
    return 0


def _draw_bar(done: int, total: int) -> None:
    filled = BAR_WIDTH * done // total
    bar = "#" * filled + "." * (BAR_WIDTH - filled)
    sys.stderr.write(f"\r[{bar}] {done} of {total} rows")
    sys.stderr.flush()


def _print_table(report: ReplayReport, rate_hz: float) -> None:
    seconds = report.samples / rate_hz
    print(
        f"{report.log}: {report.arm}, mode {report.mode}, {report.samples} samples"
        f" ({seconds:.2f} s), {report.clipped} beyond a limit and clipped"
    )
    print(f"{'joint':<12} {'tracking RMS':>14} {'effort RMS':>14} {'of recorded':>12}")
    for name, tracking in report.tracking_rms.items():
        slides = name == "insertion"
        motion = f"{1e3 * tracking:.3f} {'mm  ' if slides else 'mrad'}"
        effort = f"{report.effort_rms[name]:.4f} {'N  ' if slides else 'N m'}"
        share = report.effort_relative_rms[name]
        relative = "-" if share is None else f"{100.0 * share:.1f} %"
        print(f"{name:<12} {motion:>14} {effort:>14} {relative:>12}")
