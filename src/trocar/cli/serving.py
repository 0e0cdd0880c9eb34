"""A live simulation: its options, and one loop for the web viewer and every transport.

A new transport takes its option in `add_serving` and a line in `_transports`; its `greeting` is
printed when the simulation runs.
"""

from __future__ import annotations

import gc
import logging
import os
import sys
from argparse import ArgumentParser, Namespace
from contextlib import ExitStack, closing, suppress
from typing import TYPE_CHECKING
from urllib.parse import urlencode

from trocar.cli.arguments import add_origin, add_port, number
from trocar.cli.worlds import (
    add_cameras,
    add_record_images,
    open_pictures,
    record_images,
    recording,
)
from trocar.errors import InputError

if TYPE_CHECKING:
    from trocar.apps.teleoperation.session import Session
    from trocar.interfaces.crtk import Transport
    from trocar.interfaces.origins import PageAccess
    from trocar.simulation import World

_log = logging.getLogger("trocar")

WEBSOCKET_PORT = 9090
FOXGLOVE_PORT = 8765
TOKEN_VARIABLE = "TROCAR_TOKEN"
#: Generation-0 threshold of the garbage collector: messages contain no cycles.
#: Source: our own choice; with Python's 700 every tenth period was 0.4 ms late.
GC_THRESHOLD = 5_000
#: Python's thread switch interval [s]. Source: our own choice, half a tick.
SWITCH_S = 0.0001


def add_serving(parser: ArgumentParser) -> None:
    """Add the options of the web viewer, the transports and the cameras."""
    viewer = parser.add_argument_group("web viewer")
    add_port(viewer)
    viewer.add_argument("--no-page", action="store_true", help="do not serve the web viewer")
    clients = parser.add_argument_group("clients (docs/ros.md)")
    clients.add_argument(
        "--no-websocket", action="store_true", help="do not serve rosbridge's WebSocket"
    )
    clients.add_argument(
        "--websocket-port",
        type=int,
        default=WEBSOCKET_PORT,
        metavar="N",
        help=f"WebSocket port (default {WEBSOCKET_PORT}, 0 = any free port)",
    )
    clients.add_argument(
        "--host",
        default="127.0.0.1",
        help="WebSocket address (default 127.0.0.1); beyond this machine only with --token",
    )
    clients.add_argument(
        "--token", help=f"token that WebSocket clients must present (default: ${TOKEN_VARIABLE})"
    )
    add_origin(clients)
    clients.add_argument(
        "--ros1", action="store_true", help="join the ROS 1 master at ROS_MASTER_URI (rospy)"
    )
    clients.add_argument(
        "--ros2",
        nargs="?",
        const="auto",
        choices=("auto", "rclpy", "dds"),
        metavar="auto|rclpy|dds",
        help="ROS 2 by rclpy where it can be imported, else by DDS without ROS (extra ros2);"
        " without token",
    )
    clients.add_argument(
        "--foxglove", action="store_true", help="live view in Foxglove (extra foxglove)"
    )
    clients.add_argument(
        "--foxglove-port",
        type=int,
        default=FOXGLOVE_PORT,
        metavar="N",
        help=f"Foxglove port (default {FOXGLOVE_PORT}, 0 = any free port)",
    )
    clients.add_argument(
        "--foxglove-record",
        metavar="FILE",
        help="--foxglove, and write every topic to a new MCAP file",
    )
    clients.add_argument(
        "--rate", type=number, metavar="HZ", help="rate of states (default 220, at most 1000)"
    )
    clients.add_argument(
        "--clock",
        choices=("wall", "sim"),
        default="wall",
        help="stamps: wall time at the start plus simulated time (default), or simulated time",
    )
    clients.add_argument(
        "--compat",
        action="append",
        default=[],
        choices=("dvrk_env", "dvrk_vrep"),
        help="serve the topics of an older simulator as well; may be repeated",
    )
    cameras = parser.add_argument_group("cameras (docs/endoscope.md)")
    add_cameras(cameras)
    add_record_images(cameras)


def serve(world: World, args: Namespace, session: Session | None = None) -> None:
    """Run a world and serve it as the options say, until Ctrl-C or the end of --duration.

    Args:
        world: what runs
        args: the options of `add_serving`
        session: teleoperation by this machine's devices; None: the rig's masters wait for clients

    Raises:
        InputError: a port, host or token that cannot be used, or nothing to serve
        DivergedError: the simulation left the finite numbers
    """
    from trocar.interfaces import Loop
    from trocar.interfaces.loop import SERVER_TICK_S
    from trocar.interfaces.origins import PageAccess

    access = PageAccess(args.origin)
    transports = _transports(args, access)
    if args.no_page and not transports:
        raise InputError(
            "nothing would be served: leave out --no-page or --no-websocket, or use --headless"
        )
    shared = bool(transports) or session is not None
    if session is None and shared and not args.no_page:
        from trocar.apps.teleoperation.session import Session

        session = Session()  # pedals in the page
    # Clients need an answer sooner than the web viewer does.
    tick_s = max(1, round(SERVER_TICK_S / world.timestep)) * world.timestep if shared else None
    loop = Loop(world, speed=args.speed or "realtime", tick_s=tick_s)
    loop.while_running = recording(world, args)

    def greet(*addresses: str) -> None:
        first, *others = (*addresses, *(str(getattr(t, "greeting", t.name)) for t in transports))
        print(f"{first}  (Ctrl-C stops)", *others, sep="\n", flush=True)

    with ExitStack() as stack:
        pictures = open_pictures(loop, args)
        if pictures is not None:
            stack.enter_context(closing(pictures))
            pictures.start()
        record_images(world, pictures, args)
        if shared:
            from trocar.apps.teleoperation import components
            from trocar.interfaces.crtk import Core

            sys.setswitchinterval(SWITCH_S)
            rates = {"rate_hz": args.rate, "camera_rate_hz": args.camera_rate}
            core = Core(
                loop,
                clock=args.clock,
                compat=args.compat,
                pictures=pictures,
                components=components(loop) if session is None else session.components(loop),
                **{name: rate for name, rate in rates.items() if rate is not None},
            )
            stack.enter_context(closing(core))
            for transport in transports:
                core.attach(transport)
            core.start()
        gc.collect()
        stack.callback(gc.unfreeze)
        stack.callback(gc.set_threshold, *gc.get_threshold())
        gc.freeze()  # a collection of everything set up so far takes as long as thirty ticks
        gc.set_threshold(GC_THRESHOLD)
        if args.no_page:
            with closing(loop), suppress(KeyboardInterrupt):
                loop.start(args.duration)
                greet()
                loop.wait()
            return
        from trocar.interfaces.viewer import serve as serve_page

        serve_page(
            world,
            port=args.port,
            duration_s=args.duration,
            on_ready=greet,
            loop=loop,
            pictures=pictures,
            driving=session and session.driving(_socket(transports, args, access)),
            access=access,
        )


def _transports(args: Namespace, access: PageAccess) -> list[Transport]:
    """Return the transports of the options, not started yet."""
    found: list[Transport] = []
    if not args.no_websocket:
        from trocar.interfaces.crtk.transports.websocket import WebSocketTransport

        found.append(WebSocketTransport(args.host, args.websocket_port, _token(args), access))
    if args.ros2 is not None:
        found.append(_ros2(args.ros2))
    if args.ros1:
        from trocar.interfaces.crtk.transports.ros1 import Ros1Transport

        found.append(Ros1Transport())
    if args.foxglove or args.foxglove_record is not None:
        from trocar.interfaces.crtk.transports.foxglove import FoxgloveTransport

        record = args.foxglove_record
        found.append(FoxgloveTransport(args.foxglove_port, record, images=args.record_images))
    return found


def _token(args: Namespace) -> str | None:
    return args.token if args.token is not None else os.environ.get(TOKEN_VARIABLE) or None


def _ros2(kind: str) -> Transport:
    """Return ROS 2 by rclpy, or by Cyclone DDS without ROS; "auto": by rclpy if there is one."""
    if kind != "dds":
        from trocar.interfaces.crtk.transports.rclpy_node import MissingRclpyError, RclpyTransport

        try:
            return RclpyTransport()
        except MissingRclpyError as error:
            if kind == "rclpy":
                raise
            if error.there:
                reason = f"{error.python} cannot import it ({error.reason})"
                _log.warning("ROS 2: there is an rclpy, but %s; using DDS without ROS", reason)
    from trocar.interfaces.crtk.transports.ros2 import Ros2Transport

    return Ros2Transport()


def _socket(transports: list[Transport], args: Namespace, access: PageAccess) -> str | None:
    """Return the WebSocket's address with the web viewer's credentials, None without one."""
    address = next((str(t.address) for t in transports if hasattr(t, "address")), None)  # type: ignore[attr-defined]
    if address is None:
        return None
    token = _token(args)
    return f"{address}/?{access.query}" + (f"&{urlencode({'token': token})}" if token else "")
