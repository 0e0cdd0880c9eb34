"""Mirror a real robot with the simulated arms, live or from a recording.

Subscribes to /<ARM>/measured_js (and jaw, gripper, setup joints) and sets the joint positions of
the simulated arms, or commands them as servo set-points. With --no-page, a bag is played without
viewer and the lag of each arm reported. See docs/follow.md.
"""

from __future__ import annotations

import sys
from argparse import ArgumentParser, ArgumentTypeError, Namespace
from contextlib import ExitStack, closing, suppress
from pathlib import Path
from typing import TYPE_CHECKING

from trocar.cli.arguments import (
    add_calibrations,
    add_json,
    add_origin,
    add_port,
    add_rig,
    allow,
    allow_overwrite,
    names_of,
    options,
)
from trocar.cli.output import print_json, table
from trocar.cli.serving import add_host, greeting, page_access
from trocar.cli.worlds import add_cameras, add_record, open_pictures, recording
from trocar.errors import InputError

if TYPE_CHECKING:
    from trocar.live import Loop
    from trocar.live.access import PageAccess
    from trocar.live.images import Pictures
    from trocar.robot.follow import BagSource, LiveSource, Mirror, MirrorReport
    from trocar.ros.transports.websocket import WebSocketTransport
    from trocar.simulation import World

SUMMARY = "mirror a real robot, live or from a recording"
ORDER = 60


def add_arguments(parser: ArgumentParser) -> None:
    """Describe the arguments."""
    group = parser.add_argument_group("source (one is required)")
    source = group.add_mutually_exclusive_group(required=True)
    options(source, """
        --ros1           robot on ROS 1 (rospy)
        --ros2           robot on ROS 2 (extra ros2)
        --websocket URL  robot behind rosbridge, e.g. ws://127.0.0.1:9090
        --bag FILE       recording: rosbag 1, rosbag 2 or MCAP file, or a table of numbers with the
                         names of its arms (docs/recordings.md)
    """)  # fmt: skip
    add_rig(parser)
    add_calibrations(parser)
    options(parser, """
        --arms ARM,...        arms to mirror (default: all with topics in the source)
        --topic ARM=TOPIC:topic ...  topic of the joint states of ARM (repeatable; default: by its
                              name)
        --jaw ARM=TOPIC:topic ...  topic of the jaw or gripper of ARM (repeatable; default: by its
                              name)
        --rate HZ:number      rate of a table without times
        --by set|servo = set  set joint positions, or command them as servo set-points
        --duration S:number   stop after S seconds
        --speed realtime|max  playback speed of a bag (default: realtime with the web viewer, else
                              max)
    """, topic=arm_topic)  # fmt: skip
    add_json(parser)
    add_record(parser)
    viewer = parser.add_argument_group("web viewer and clients")
    add_port(viewer)
    options(viewer, """
        --no-page      do not serve the web viewer, print a report
        --serve N:int  serve the simulated arms' topics and images over rosbridge WebSocket on port
                       N (0 = any free port)
    """)  # fmt: skip
    add_host(viewer)
    add_origin(viewer)
    cameras = parser.add_argument_group("cameras")
    add_cameras(cameras)


def arm_topic(text: str) -> tuple[str, str]:
    """Return an arm and its topic."""
    arm, _, topic = text.partition("=")
    if not arm or not topic.strip("/"):
        raise ArgumentTypeError(f"got {text!r}; allowed: ARM=TOPIC, e.g. PSM1=/left/measured_js")
    return arm, topic


def run(args: Namespace) -> int:
    """Mirror."""
    if args.duration is not None and not 0.0 < args.duration < float("inf"):
        raise InputError(f"--duration: got {args.duration:g}; allowed: above 0 s")
    if args.json and not args.no_page:
        raise InputError("--json: allowed with --no-page only, which prints a report")
    if args.speed == "max" and not args.bag:
        raise InputError("--speed max: allowed with --bag only; a live robot runs in real time")
    allow_overwrite(args, "record")
    if args.no_page:
        allow(args, "without --no-page", "port", "host")
        if args.serve is None:
            served = ("origin", "token", *names_of(add_cameras))
            allow(args, "without --no-page, or with --serve", *served)
    from trocar.live import Loop
    from trocar.live.loop import SERVER_TICK_S
    from trocar.robot.follow import Mirror
    from trocar.simulation import World

    access = page_access(args)
    world = World(args.rig, calibration=args.calibration)
    source = _source(args, world)
    speed = args.speed or ("max" if args.bag and args.no_page else "realtime")
    loop = Loop(world, speed=speed, tick_s=SERVER_TICK_S)
    loop.while_running = recording(world, args)
    arms = [name.strip() for name in args.arms.split(",") if name.strip()] if args.arms else None
    mirror = Mirror(loop, source, arms, args.by, topics=dict(args.topic), jaws=dict(args.jaw))
    if mirror.missing and args.bag:
        print(f"no topics in {args.bag}: {', '.join(mirror.missing)}", file=sys.stderr)
    with ExitStack() as stack:
        stack.enter_context(closing(mirror))
        pictures = _pictures(loop, args, stack)
        socket = _served(loop, args, (pictures, access), stack)
        mirror.start()
        if args.no_page:
            if socket is not None:
                print(socket.greeting, file=sys.stderr if args.json else sys.stdout, flush=True)
            _follow(loop, mirror, args.duration)
        else:
            _show(world, loop, mirror, args, (pictures, access, socket))
    report = mirror.report()
    if args.json:
        print_json(report)
    elif args.no_page:
        print(_text(report))
    return 0


def _source(args: Namespace, world: World) -> BagSource | LiveSource:
    from trocar.recording.bags import is_bag
    from trocar.robot.follow import BagSource, LiveSource, open_bag
    from trocar.robot.recordings.parquet import is_parquet
    from trocar.robot.recordings.table_bag import bag_of_table

    if (
        args.bag
        and Path(args.bag).expanduser().exists()
        and (is_parquet(args.bag) or not is_bag(args.bag))
    ):
        wanted = args.arms.split(",") if args.arms else [arm.name for arm in world.rig.arms]
        arms = {name.strip(): world.rig.arm(name.strip()).arm for name in wanted if name.strip()}
        return BagSource(
            bag_of_table(args.bag, arms, args.rate, lambda text: print(text, file=sys.stderr))
        )
    allow(args, "with a table of numbers", "rate")
    if args.bag:
        return BagSource(open_bag(args.bag))
    if args.websocket:
        from trocar.ros.transports.websocket.client import WebSocketClient

        return LiveSource(WebSocketClient(args.websocket))
    if args.ros1:
        from trocar.ros.transports.ros1 import Ros1Client

        return LiveSource(Ros1Client("trocar_mirror"))
    from trocar.ros.transports.ros2 import Ros2Client

    return LiveSource(Ros2Client())


def _follow(loop: Loop, mirror: Mirror, duration_s: float | None) -> None:
    """Run until the bag ends, the duration has passed, or Ctrl-C."""
    with closing(loop), suppress(KeyboardInterrupt):
        loop.start(duration_s)
        while not mirror.over.wait(0.05):
            if loop.wait(0.0):
                break
    loop.stop()


def _pictures(loop: Loop, args: Namespace, stack: ExitStack) -> Pictures | None:
    """Start rendering the cameras, if a client can subscribe to them."""
    if args.no_page and args.serve is None:
        return None
    pictures = open_pictures(loop, args)
    if pictures is None:
        return None
    stack.enter_context(closing(pictures))
    pictures.start()
    return pictures


def _served(
    loop: Loop, args: Namespace, shared: tuple[Pictures | None, PageAccess], stack: ExitStack
) -> WebSocketTransport | None:
    """Serve the simulated arms' topics with --serve."""
    if args.serve is None:
        return None
    from trocar.ros import Core
    from trocar.ros.transports.websocket import WebSocketTransport

    pictures, access = shared
    rate = {} if args.camera_rate is None else {"camera_rate_hz": args.camera_rate}
    core = stack.enter_context(closing(Core(loop, pictures=pictures, **rate)))
    transport = WebSocketTransport("127.0.0.1", args.serve, access)
    core.attach(transport)
    core.start()
    return transport


def _show(
    world: World,
    loop: Loop,
    mirror: Mirror,
    args: Namespace,
    more: tuple[Pictures | None, PageAccess, WebSocketTransport | None],
) -> None:
    from trocar.viewer import serve

    pictures, access, socket = more
    stack = ExitStack()

    def greet(url: str) -> None:
        lines, found = [url], {"web_viewer": url}
        if socket is not None:
            lines.append(str(socket.greeting))
            found[socket.name] = socket.viewer_address
        print(*greeting(stack, access, lines, found), sep="\n", flush=True)

    with stack:
        serve(
            world,
            host=args.host,
            port=args.port,
            duration_s=args.duration,
            on_ready=greet,
            loop=loop,
            pictures=pictures,
            note=mirror.page,
            access=access,
        )
    loop.wait()


def _text(report: MirrorReport) -> str:
    rows = [
        [
            name,
            str(arm.heard),
            f"{arm.rate_hz:.1f}",
            f"{arm.lag_ms_median:.1f}",
            f"{arm.lag_ms_max:.1f}",
            str(arm.gaps),
            str(arm.clipped),
        ]
        for name, arm in report.arms.items()
    ]
    head = ["arm", "messages", "[Hz]", "lag [ms]", "max", "silences", "beyond limits"]
    return f"{report.source}: {report.duration_s:.2f} s\n" + table(head, rows)
