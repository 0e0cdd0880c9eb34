"""Measure how fast trocar runs and how true it is, each figure beside its goal.

Speeds are those of the paper's Table 9 configurations beside bare MuJoCo in the same run: the
ratio counts, the real-time factor depends on the machine. With --log a recording is replayed too.
Measured only when asked for: core, the cost of verbs and readings in physics steps; recording, the
cost of recording the full cart in motion; interface, what a program in another process sees of it
(--transport); scope, how many pictures of the endoscope a second, beside MuJoCo's own renderer; and
soak, an hour of it (some minutes of the machine's time).
"""

from __future__ import annotations

import sys
from argparse import ArgumentParser, ArgumentTypeError, Namespace
from dataclasses import asdict
from math import isfinite
from typing import TYPE_CHECKING

from trocar.cli.arguments import add_json, number
from trocar.cli.output import print_json, table
from trocar.errors import InputError

if TYPE_CHECKING:
    from trocar.apps.benchmarks import Figure, Table9Row

#: What is measured unless parts are asked for, and all that may be.
PARTS = ("speed", "figures", "startup")
ALL_PARTS = (*PARTS, "core", "recording", "interface", "scope", "soak")
#: As `trocar.apps.benchmarks.live_scope` has it [s].
LIVE_S = 60.0
TRANSPORTS = ("websocket", "ros1", "ros2")


def add_arguments(parser: ArgumentParser) -> None:
    """Describe the arguments."""
    parser.add_argument(
        "part",
        nargs="*",
        type=_part,
        metavar="PART",
        help=f"what to measure: {', '.join(ALL_PARTS)}; default: {', '.join(PARTS)}",
    )
    parser.add_argument(
        "--duration",
        type=number,
        metavar="S",
        help="simulated time of a pass (default: 10 s; recording: 4 s), of the soak (3600 s), or"
        " how long pictures of a size are drawn (4 s)",
    )
    parser.add_argument(
        "--live",
        type=number,
        metavar="S",
        help="of the part scope: how long the cart runs in real time while both eyes are drawn and"
        f" its page is shown in a headless browser, where there is one ({LIVE_S:g} s)",
    )
    parser.add_argument(
        "--no-browser", action="store_true", help="of it: a program looks at the page instead"
    )
    parser.add_argument(
        "--transport",
        action="append",
        default=[],
        choices=TRANSPORTS,
        help="of the part interface; default: websocket; may be repeated",
    )
    parser.add_argument(
        "--passes",
        type=int,
        metavar="N",
        help="interleaved passes (default: 5; of the recording: 31)",
    )
    parser.add_argument(
        "--poses", type=int, default=10_000, metavar="N", help="poses of the inverse kinematics"
    )
    parser.add_argument("--log", help="a PSM's recording to replay (docs/replay.md)")
    parser.add_argument(
        "--calibration",
        action="append",
        default=[],
        metavar="OVERLAY",
        help="speed of the configurations with this calibrated robot; may be repeated",
    )
    add_json(parser)


def run(args: Namespace) -> int:
    """Measure and print."""
    timed = args.duration is None or 0.0 < args.duration < float("inf")
    timed = timed and (args.live is None or 0.0 < args.live < float("inf"))
    if not timed or (args.passes is not None and args.passes < 1) or args.poses < 1:
        raise InputError("--duration, --live, --passes and --poses: allowed: above 0")
    from trocar.apps.benchmarks import (
        core,
        figures,
        interface,
        recording,
        scope,
        soak,
        startup,
        table9,
    )
    from trocar.descriptions.overlay import read_overlay

    overlays = [read_overlay(file) for file in args.calibration]
    if overlays and (set(args.part) - {"speed"} or args.log):
        raise InputError(
            "--calibration: allowed with the part speed alone; `trocar verify --calibration` says"
            " how true a calibrated robot is"
        )
    parts = args.part or (("speed",) if overlays else PARTS)
    each = () if args.duration is None else (args.duration,)
    passes = {} if args.passes is None else {"passes": args.passes}
    rows = table9(*each, **passes, watch=_watch, overlays=overlays) if "speed" in parts else []
    found = figures(_watch, args.poses) if "figures" in parts else []
    found += startup(_watch) if "startup" in parts else []
    found += core(_watch) if "core" in parts else []
    found += recording(*each, **passes, watch=_watch) if "recording" in parts else []
    if "interface" in parts:
        found += interface(tuple(args.transport) or ("websocket",), *each, watch=_watch)
    if "scope" in parts:
        live_s = LIVE_S if args.live is None else args.live
        onlooker = "" if args.no_browser else None
        found += scope(*each, watch=_watch, live_s=live_s, onlooker=onlooker)
    found += soak(*each, watch=_watch) if "soak" in parts else []
    found += _replayed(args.log) if args.log else []
    if args.json:
        measured = [{**asdict(f), "met": f.met} for f in found]
        print_json({"table9": [asdict(row) for row in rows], "figures": measured})
    else:
        print("\n\n".join(filter(None, [_speeds(rows), _figures(found)])))
    return 0


def _part(name: str) -> str:
    if name not in ALL_PARTS:  # argparse's own choices refuse that none is named
        raise ArgumentTypeError(f"got {name!r}; allowed: {', '.join(ALL_PARTS)}")
    return name


def _watch(what: str) -> None:
    print(f"trocar: measuring {what} ...", file=sys.stderr, flush=True)


def _replayed(log: str) -> list[Figure]:
    from trocar.apps.benchmarks import Figure
    from trocar.apps.replay import ReplaySettings, replay

    _watch("replay")
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
    if not rows:
        return ""
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
        "Speed at 1 kHz on one core (medians; bare = mj_step alone in the same motion;\n"
        "overhead = own time / its; at rest = own time / that of mj_step while the arms rest;\n"
        "collision cost = mj_step with bodies / without, at rest):\n\n" + table(head, lines)
    )


def _figures(found: list[Figure]) -> str:
    if not found:
        return ""
    rows: list[list[str]] = []
    for figure in found:
        limit = (
            "" if figure.limit is None else f"{'>=' if figure.at_least else '<='} {figure.limit:g}"
        )
        verdict = {None: "", True: "met", False: "MISSED"}[figure.met]
        value = f"{figure.value:.4g}" if isfinite(figure.value) else "-"
        rows.append([figure.name, value, figure.unit, limit, verdict])
    return table(["figure", "measured", "unit", "goal", ""], rows)
