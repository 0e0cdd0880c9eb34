"""Check an arm of CRTK: a dVRK, another simulator, or this one.

Topics, types, frames, rates, states, latched events and services are read and compared with CRTK's
and the dVRK's documents, and with recordings of the dVRK's own software. With --move the arm makes
small, slow moves (2 deg, 2 mm) and returns; whatever was not commanded stops them. Exit status 1: a
check failed. See docs/conform.md.
"""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from contextlib import closing
from typing import TYPE_CHECKING

from trocar.cli.arguments import add_json, add_overwrite, allow, allow_overwrite, options
from trocar.cli.output import print_result, progress_steps, table
from trocar.errors import InputError

if TYPE_CHECKING:
    from trocar.conformance import ConformanceReport
    from trocar.ros.client import RosClient

SUMMARY = "check a robot's or simulator's CRTK interface"
ORDER = 62


def add_arguments(parser: ArgumentParser) -> None:
    """Describe the arguments."""
    options(parser, """
        address ADDRESS ?  rosbridge of the arm, such as ws://127.0.0.1:9090
        --ros1             arm on ROS 1 (rospy), master at ROS_MASTER_URI
        --ros2             arm on ROS 2 (extra ros2); services with rmw_cyclonedds_cpp only
        --arm ARM = PSM1   prefix of its topics
        --seconds S:number = 3   time for which streams are observed
        --rate HZ:number = 80    lowest rate of streams
    """)  # fmt: skip
    moves = parser.add_argument_group("moves")
    options(moves, """
        --move  command small, slow moves; keep a hand at the emergency stop of a real arm
        --home  enable and home the arm first
        --nan   send a set-point that is not a number, too, as the last command: a dVRK disables
                itself
    """)  # fmt: skip
    report = parser.add_argument_group("report")
    options(report, """
        --html FILE  write the report as a page
    """)  # fmt: skip
    add_overwrite(report, "an existing report")
    add_json(parser)


def run(args: Namespace) -> int:
    """Check, print, and return 1 if a check failed."""
    from trocar.conformance import ConformanceSettings, conform, page
    from trocar.outputs import check_file, write_text

    if not args.move:
        allow(args, "with --move", "home", "nan")
    allow_overwrite(args, "html")
    if args.html is not None:
        check_file(args.html, args.overwrite)
    client = _client(args)
    settings = ConformanceSettings(args.seconds, args.rate, args.move, args.home, args.nan)
    with closing(client), progress_steps() as watch:
        client.start()
        report = conform(client, args.arm.strip("/"), settings, watch)
    if args.html is not None:
        write_text(args.html, page(report), args.overwrite)
    print_result(args, report, lambda: _text(report))
    return 0 if report.conforms else 1


def _client(args: Namespace) -> RosClient:
    chosen = [bool(args.address), args.ros1, args.ros2]
    if sum(chosen) != 1:
        raise InputError(
            f"conform: got {sum(chosen)} of ADDRESS, --ros1 and --ros2; allowed: one of them"
        )
    if args.ros1:
        from trocar.ros.transports.ros1 import Ros1Client

        return Ros1Client("trocar_conform")
    if args.ros2:
        from trocar.ros.transports.ros2 import Ros2Client

        return Ros2Client()
    from trocar.ros.transports.websocket.client import WebSocketClient

    return WebSocketClient(args.address, "conform")


def _text(report: ConformanceReport) -> str:
    from trocar.conformance import groups

    marks = {"pass": "pass", "fail": "FAIL", "skip": "skip"}
    parts: list[str] = []
    for name, rows in groups(report.results):
        cells = [(marks[row.verdict], row.name, row.found, row.allowed) for row in rows]
        parts.append(f"{name}\n{table(('', 'check', 'found', 'allowed'), cells)}")
    failed = report.having("fail")
    sources = [f"  {row.name}\n    source: {row.source}" for row in failed]
    if failed:
        parts.append("\n".join(["Failed", *sources]))
    return "\n\n".join([*parts, report.summary])
