"""What `trocar sim` serves beside the page: its options, and one loop for everybody.

A transport is added in three places here: its option, `_transports`, and nothing else; what its
`greeting` says is printed when time flows.
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

from trocar.cli.arguments import number
from trocar.cli.cameras import add_cameras, open_pictures, record_images
from trocar.cli.worlds import recording
from trocar.errors import InputError

if TYPE_CHECKING:
    from argparse import _ArgumentGroup

    from trocar.apps.teleoperation.session import Session
    from trocar.interfaces import Loop
    from trocar.interfaces.crtk import Core, Transport
    from trocar.interfaces.origins import PageAccess
    from trocar.interfaces.pictures import Pictures
    from trocar.simulation import World

    Adds = _ArgumentGroup

_log = logging.getLogger("trocar")

PORT = 8080
WEBSOCKET_PORT = 9090
FOXGLOVE_PORT = 8765
TOKEN_VARIABLE = "TROCAR_TOKEN"
YOUNG = 5_000
"""Objects that are made before garbage is looked for: messages of many periods, which are none.

Source: our own choice; with Python's 700, looking delays every tenth period by 0.4 ms."""
SWITCH_S = 0.0001
"""How long one thread may keep the others waiting [s]. Source: our own choice, half a tick."""


def add_serving(parser: ArgumentParser) -> None:
    """Add the options of the page and of everything else that is served."""
    page = parser.add_argument_group("the page")
    page.add_argument(
        "--port", type=int, default=PORT, metavar="N", help=f"of the page; default: {PORT}; 0: any"
    )
    page.add_argument("--no-page", action="store_true", help="serve no page")
    sockets = parser.add_argument_group("clients (docs/ros.md)")
    sockets.add_argument(
        "--no-websocket", action="store_true", help="do without rosbridge's WebSocket"
    )
    sockets.add_argument(
        "--websocket-port",
        type=int,
        default=WEBSOCKET_PORT,
        metavar="N",
        help=f"default: {WEBSOCKET_PORT}; 0: any",
    )
    sockets.add_argument(
        "--host",
        default="127.0.0.1",
        help="where the WebSocket listens; beyond this machine only with --token",
    )
    sockets.add_argument(
        "--token", help=f"what WebSocket clients have to show; default: ${TOKEN_VARIABLE}, if set"
    )
    add_origin(sockets)
    sockets.add_argument(
        "--ros1", action="store_true", help="join the ROS 1 master at ROS_MASTER_URI (rospy)"
    )
    sockets.add_argument(
        "--ros2",
        nargs="?",
        const="auto",
        choices=("auto", "rclpy", "dds"),
        metavar="auto|rclpy|dds",
        help="speak ROS 2: by rclpy where it can be imported, else without ROS (extra ros2); no"
        " token there",
    )
    _add_foxglove(sockets)
    _add_rates(sockets)
    add_cameras(parser.add_argument_group("cameras (docs/endoscope.md)"))


def add_origin(parser: ArgumentParser | Adds) -> None:
    """Add the option that lets web pages of the user's own connect."""
    parser.add_argument(
        "--origin",
        action="append",
        default=[],
        metavar="URL",
        help="let pages of this origin connect, such as http://localhost:3000; may be repeated",
    )


def _add_foxglove(sockets: Adds) -> None:
    sockets.add_argument(
        "--foxglove", action="store_true", help="a live view in Foxglove (extra foxglove)"
    )
    sockets.add_argument(
        "--foxglove-port",
        type=int,
        default=FOXGLOVE_PORT,
        metavar="N",
        help=f"default: {FOXGLOVE_PORT}; 0: any",
    )
    sockets.add_argument(
        "--foxglove-record",
        metavar="FILE",
        help="--foxglove, and every topic written to a new MCAP file",
    )


def _add_rates(sockets: Adds) -> None:
    sockets.add_argument(
        "--rate", type=number, metavar="HZ", help="of states; default: 220, up to 1000"
    )
    sockets.add_argument(
        "--clock",
        choices=("wall", "sim"),
        default="wall",
        help="stamps: the wall clock at the start plus simulated time, or simulated time alone",
    )
    sockets.add_argument(
        "--compat",
        action="append",
        default=[],
        choices=("dvrk_env", "dvrk_vrep"),
        help="serve an older simulator's topics, too; may be repeated",
    )


def serve(world: World, args: Namespace, session: Session | None = None) -> None:
    """Run a world and serve what the options ask for, until Ctrl-C or the time is over.

    Args:
        world: what runs
        args: the options of `add_serving`
        session: somebody who drives; None: the rig's masters wait for clients

    Raises:
        InputError: a port, host or token that cannot be used, or nothing to serve
        DivergedError: the simulation left the finite numbers
    """
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
    loop = _loop(world, args, shared=shared)
    loop.while_running = recording(world, args)
    with ExitStack() as stack:
        pictures = open_pictures(loop, args)
        if pictures is not None:
            stack.enter_context(closing(pictures))
            pictures.start()
        record_images(world, pictures, args)
        if shared:
            sys.setswitchinterval(SWITCH_S)
            core = stack.enter_context(closing(_core(loop, args, pictures, session)))
            for transport in transports:
                core.attach(transport)
            core.start()
        gc.collect()
        stack.callback(gc.unfreeze)
        stack.callback(gc.set_threshold, *gc.get_threshold())
        gc.freeze()  # going through all that was set up takes as long as thirty ticks
        gc.set_threshold(YOUNG)
        _run(world, loop, args, (transports, pictures, session, access))


def _transports(args: Namespace, access: PageAccess) -> list[Transport]:
    """Return what the options ask for, not started yet."""
    found: list[Transport] = []
    if not args.no_websocket:
        from trocar.interfaces.crtk.transports.websocket import WebSocketTransport

        token = args.token if args.token is not None else os.environ.get(TOKEN_VARIABLE) or None
        found.append(WebSocketTransport(args.host, args.websocket_port, token, access))
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


def _ros2(way: str) -> Transport:
    """Return ROS 2 by rclpy, or by Cyclone DDS without ROS; "auto": by rclpy if there is one."""
    if way != "dds":
        from trocar.interfaces.crtk.transports.rclpy_node import MissingRclpyError, RclpyTransport

        try:
            return RclpyTransport()
        except MissingRclpyError as error:
            if way == "rclpy":
                raise
            if error.there:
                reason = f"{error.python} cannot import it ({error.reason})"
                _log.warning("ROS 2: there is an rclpy, but %s; so it goes without", reason)
    from trocar.interfaces.crtk.transports.ros2 import Ros2Transport

    return Ros2Transport()


def _loop(world: World, args: Namespace, *, shared: bool) -> Loop:
    """Make the loop; clients want an answer sooner than a page needs it."""
    from trocar.interfaces import Loop
    from trocar.interfaces.loop import SERVER_TICK_S

    steps = max(1, round(SERVER_TICK_S / world.timestep))
    tick_s = steps * world.timestep if shared else None
    return Loop(world, speed=args.speed or "realtime", tick_s=tick_s)


def _core(loop: Loop, args: Namespace, pictures: Pictures | None, session: Session | None) -> Core:
    from trocar.apps.teleoperation import components
    from trocar.interfaces.crtk import Core

    rates = {"rate_hz": args.rate, "camera_rate_hz": args.camera_rate}
    given = {name: rate for name, rate in rates.items() if rate is not None}
    return Core(
        loop,
        clock=args.clock,
        compat=args.compat,
        pictures=pictures,
        components=components(loop) if session is None else session.components(loop),
        **given,
    )


def _run(
    world: World,
    loop: Loop,
    args: Namespace,
    served: tuple[list[Transport], Pictures | None, Session | None, PageAccess],
) -> None:
    transports, pictures, session, access = served
    told = [str(getattr(transport, "greeting", transport.name)) for transport in transports]

    def tell(*addresses: str) -> None:
        first, *others = addresses
        print(f"{first}  (Ctrl-C stops)", *others, sep="\n", flush=True)

    if args.no_page:
        with closing(loop), suppress(KeyboardInterrupt):
            loop.start(args.duration)
            tell(*told)
            loop.wait()
        return
    from trocar.interfaces.viewer import serve as serve_page

    serve_page(
        world,
        port=args.port,
        duration_s=args.duration,
        on_ready=lambda url: tell(url, *told),
        loop=loop,
        pictures=pictures,
        driving=None if session is None else session.driving(_socket(transports, args, access)),
        access=access,
    )


def _socket(transports: list[Transport], args: Namespace, access: PageAccess) -> str | None:
    """Return where our page reaches the WebSocket and what it shows there, None without one."""
    address = next((str(t.address) for t in transports if hasattr(t, "address")), None)  # type: ignore[attr-defined]
    token = args.token if args.token is not None else os.environ.get(TOKEN_VARIABLE)
    if address is None:
        return None
    return f"{address}/?{access.query}" + (f"&{urlencode({'token': token})}" if token else "")
