"""Live simulation: its options, and one loop for the web viewer and all transports.

Transports are the modules of `trocar.ros.transports` with `OPTIONS`; what has a
`greeting` prints it when the simulation runs.
"""

from __future__ import annotations

import gc
import os
import re
import secrets
import sys
from argparse import ArgumentParser, Namespace
from collections.abc import Mapping, Sequence
from contextlib import ExitStack, closing, suppress
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Literal
from urllib.parse import urlsplit

from trocar.cli.arguments import Arguments, add_origin, add_port, allow, names_of, options
from trocar.cli.gallery import controls, gallery, load
from trocar.cli.worlds import (
    add_cameras,
    add_look,
    add_record_images,
    open_pictures,
    record_images,
    recording,
)
from trocar.errors import InputError

if TYPE_CHECKING:
    from trocar.live.access import PageAccess
    from trocar.ros import Component, Transport
    from trocar.simulation import World
    from trocar.tasks.served import ServedTask
    from trocar.teleoperation.session import Session
    from trocar.teleoperation.virtual_fixtures import Fixtures
    from trocar.viewer import Choice

PACKAGE = "trocar.ros.transports"
TRANSPORTS = Path(__file__).parents[1] / "ros" / "transports"
#: Generation-0 threshold of the garbage collector: messages contain no cycles.
#: Source: our own choice; with Python's default of 700, every tenth step was 0.4 ms late.
GC_THRESHOLD = 5_000
#: Python's thread switch interval [s]. Source: our own choice, half a tick.
SWITCH_S = 0.0001


def add_serving(parser: ArgumentParser) -> None:
    """Add the options of the web viewer, the transports and the cameras."""
    viewer = parser.add_argument_group("web viewer")
    add_port(viewer)
    options(viewer, """
        --no-page  do not serve the web viewer
    """)  # fmt: skip
    add_origin(viewer)
    clients = parser.add_argument_group("clients (docs/sockets.md, docs/ros.md)")
    for module in transport_modules():
        options(clients, module.options)
    options(clients, """
        --rate HZ:number                 publication rate of states (default: 220, at most 1000)
        --clock wall|sim = wall          message stamps: wall, start time plus simulated time; sim,
                                         simulated time
        --exclusive                      one client per arm: reject commands of others until it
                                         disconnects or is silent for 5 s
        --setpoint-timeout S:number      simulated time after which an arm holds when a client sends
                                         no further effort, wrench or velocity (default: 0.1; 0 =
                                         never, as on the dVRK)
    """)  # fmt: skip
    assistance = parser.add_argument_group("assistance (docs/assistance.md)")
    options(assistance, """
        --fixture FILE  virtual fixtures, TOML file: forces at masters, and a filter of servo_cp
    """)  # fmt: skip
    cameras = parser.add_argument_group("cameras (docs/endoscope.md)")
    add_cameras(cameras)
    add_record_images(cameras)


def add_host(parser: Arguments) -> None:
    """Add the options that open a web viewer without a WebSocket to other machines."""
    options(parser, """
        --host HOST = 127.0.0.1  address of the web viewer (default: 127.0.0.1); 0.0.0.0: other
                                 machines watch, and drive if the viewer here lets them
        --token TOKEN            token required by the web viewer (default: $TROCAR_TOKEN)
    """)  # fmt: skip


def allow_headless(args: Namespace) -> None:
    """Reject options of `add_serving`, but for the look of images, that do nothing with --headless.

    Raises:
        InputError: one of them was given
    """
    clients = names_of(*(partial(options, table=module.options) for module in transport_modules()))
    allow(args, "with --no-page in place of --headless", *clients)
    kept = {"record_images", "camera_rate", "image_format", *names_of(add_look)}
    allow(args, "without --headless", *(n for n in names_of(add_serving) if n not in kept))
    if not args.record_images:
        allow(args, "without --headless, or with --record-images", "camera_rate", "image_format")


def _allow_served(args: Namespace, shared: bool) -> None:
    """Reject options of servers that are not started."""
    if args.no_page:
        allow(args, "without --no-page", "port")
    if args.no_websocket:
        allow(args, "without --no-websocket", "websocket_port")
    if args.no_page and args.no_websocket:
        allow(args, "with the web viewer or the WebSocket", "origin", "token", "host")
    if args.foxglove_record is None and not args.foxglove:
        allow(args, "with --foxglove", "foxglove_port")
    if not shared:
        names = ("rate", "clock", "exclusive", "setpoint_timeout")
        allow(args, "with a client's interface, e.g. without --no-websocket", *names)


def serve(
    world: World,
    args: Namespace,
    session: Session | None = None,
    components: Sequence[Component] = (),
    task: ServedTask | None = None,
    *,
    loads: bool = False,
    start: Literal["viewer", "now"] = "now",
) -> Choice | None:
    """Run and serve a world until Ctrl-C or the end of --duration.

    Args:
        world: world to simulate
        args: parsed options of `add_serving`
        session: teleoperation by devices of this machine; None: clients drive the rig's masters
        components: further topics
        task: a scene's count and policy, for its topic and the page
        loads: whether the web viewer offers other rigs and scenes
        start: "viewer" keeps time still until a browser shows the scene

    Returns:
        what was chosen in the web viewer, to be given to `serve_chosen`; None otherwise

    Raises:
        InputError: port, host, token or fixture is not usable, or nothing is served
        DivergedError: the simulation diverged
    """
    from trocar.live import Loop
    from trocar.live.loop import SERVER_TICK_S

    access = args.access = getattr(args, "access", None) or page_access(args)
    transports = _transports(args, access)
    if args.no_page and not transports:
        raise InputError(
            "got --no-page and --no-websocket, so nothing is served; leave out one of them, or use"
            " --headless"
        )
    fixtures = _fixtures(world, args)
    shared = bool(transports) or session is not None
    _allow_served(args, shared)
    if session is None and shared and not args.no_page:
        from trocar.teleoperation.session import Session

        session = Session()  # pedals in the web viewer
    # Clients need shorter ticks than the web viewer.
    tick_s = max(1, round(SERVER_TICK_S / world.timestep)) * world.timestep if shared else None
    loop = Loop(world, speed=args.speed or "realtime", tick_s=tick_s)
    loop.while_running = recording(world, args)
    if task is not None:
        task.watch(loop)
        components = (*components, task.component())
    if fixtures is not None:
        loop.filter_command = fixtures.filter_command
        if not shared:
            fixtures.check_masters(())

    def greet(*addresses: str) -> None:
        if addresses:
            args.port = urlsplit(addresses[0]).port
        lines = [*addresses, *(str(getattr(t, "greeting", t.name)) for t in transports)]
        found = dict(zip(("web_viewer",), addresses, strict=False))
        found |= {t.name: url for t in transports if (url := getattr(t, "viewer_address", ""))}
        greeted = greeting(stack, access, lines, found)
        print(*greeted, sep="\n", flush=True)

    with ExitStack() as stack:
        pictures = open_pictures(loop, args)
        if pictures is not None:
            stack.enter_context(closing(pictures))
            pictures.overlay = task and task.overlay
            pictures.start()
        record_images(world, pictures, args)
        if shared:
            from trocar.ros import Core
            from trocar.teleoperation import components as teleoperated

            sys.setswitchinterval(SWITCH_S)
            given = {"rate_hz": args.rate, "camera_rate_hz": args.camera_rate}
            given["setpoint_timeout_s"] = args.setpoint_timeout
            core = Core(
                loop,
                clock=args.clock,
                pictures=pictures,
                components=(
                    *(teleoperated if session is None else session.components)(loop, fixtures),
                    *components,
                ),
                exclusive=args.exclusive,
                **{name: value for name, value in given.items() if value is not None},
            )
            stack.enter_context(closing(core))
            for transport in transports:
                core.attach(transport)
            core.start()
        gc.collect()
        stack.callback(gc.unfreeze)
        stack.callback(gc.set_threshold, *gc.get_threshold())
        gc.freeze()  # collecting all objects of the setup takes thirty ticks
        gc.set_threshold(GC_THRESHOLD)
        if args.no_page:
            with closing(loop), suppress(KeyboardInterrupt):
                loop.start(args.duration)
                greet()
                loop.wait()
            loop.wait()  # raises what went wrong after Ctrl-C, as with the recording's last chunk
            return None
        from trocar.viewer import serve as serve_page

        addresses = (getattr(transport, "viewer_address", None) for transport in transports)
        socket = next(filter(None, addresses), None)
        chosen = serve_page(
            world,
            host=args.host,
            port=args.port,
            duration_s=args.duration,
            on_ready=greet,
            loop=loop,
            pictures=pictures,
            driving=session and session.driving(socket),
            access=access,
            scene=task and controls(task),
            gallery=gallery(task.task.scene.name if task else world.rig.name) if loads else None,
            start=start,
        )
        loop.wait()
        return chosen


def page_access(args: Namespace) -> PageAccess:
    """Return the access of a run; beyond the loopback address the web viewer has a random token.

    Args:
        args: `host` and `token`; `origin` and `no_page` where the command has them
    """
    from trocar.live.access import PageAccess, is_loopback

    token = os.environ.get("TROCAR_TOKEN") or None if args.token is None else args.token
    if token is None and not getattr(args, "no_page", False) and not is_loopback(args.host):
        token = secrets.token_urlsafe()
    return PageAccess(getattr(args, "origin", ()), token)


def greeting(
    stack: ExitStack, access: PageAccess, lines: Sequence[str], addresses: Mapping[str, str]
) -> list[str]:
    """Return the lines to print once a run is served.

    Args:
        stack: ends with the run, and removes the file of addresses
        access: of the run
        lines: addresses and greetings, the web viewer's first
        addresses: {service: address with the secret}, for programs of the same user
    """
    from trocar.live.access import announced

    first, *others = lines
    if access.token is not None:
        path = stack.enter_context(announced(addresses))
        others.append(f"{path}  (addresses with the secret of this run)")
    if access.watch_address:
        others.insert(0, f"{access.watch_address}  (other machines: watch, request control)")
    return [f"{first}  (Ctrl-C stops)", *others]


def serve_chosen(chosen: Choice | None, args: Namespace) -> None:
    """Serve what was chosen in the web viewer, at the same port, and what is chosen after it.

    Recordings, fixtures and changes of the rig were of the world before.

    Args:
        chosen: by `serve`
        args: parsed options of `add_serving`
    """
    args = Namespace(**vars(args))
    for name in ("record", "record_images", "foxglove_record", "fixture"):
        if name in args:
            setattr(args, name, None)
    while chosen is not None:
        print(f"trocar: {chosen.name}: starting ...", file=sys.stderr, flush=True)
        world, task = load(chosen)
        waits = task is not None and bool(task.driver)
        start: Literal["viewer", "now"] = "viewer" if waits else "now"
        chosen = serve(world, args, task=task, loads=True, start=start)


def _fixtures(world: World, args: Namespace) -> Fixtures | None:
    """Return the virtual fixtures of --fixture."""
    if args.fixture is None:
        return None
    from trocar.descriptions.fixtures import read_fixtures
    from trocar.teleoperation.virtual_fixtures import Fixtures

    return Fixtures(world, read_fixtures(args.fixture))


@dataclass(frozen=True)
class TransportModule:
    """A module of `trocar.ros.transports`, not imported yet.

    Attributes:
        name: as imported
        order: its place among the options
        options: its table of options
    """

    name: str
    order: int
    options: str

    def requested(self, args: Namespace) -> bool:
        """Whether an option was given, or the transport is served by default."""
        parser = ArgumentParser()
        options(parser, self.options)
        usual = vars(parser.parse_args([]))
        return any(name.startswith("no_") for name in usual) or any(
            getattr(args, name) != value for name, value in usual.items()
        )


def transport_modules() -> list[TransportModule]:
    """Return the modules with `OPTIONS`, read from the sources: importing them takes too long."""
    found: list[TransportModule] = []
    for path in (*TRANSPORTS.glob("*.py"), *TRANSPORTS.glob("*/__init__.py")):
        text = path.read_text(encoding="utf-8")
        table = re.search(r'^OPTIONS = """(.*?)"""', text, re.MULTILINE | re.DOTALL)
        order = re.search(r"^ORDER = (\d+)$", text, re.MULTILINE)
        if table is not None:
            name = path.parent.name if path.stem == "__init__" else path.stem
            place = int(order[1]) if order else sys.maxsize
            found.append(TransportModule(f"{PACKAGE}.{name}", place, table[1]))
    return sorted(found, key=lambda module: (module.order, module.name))


def _transports(args: Namespace, pages: PageAccess) -> list[Transport]:
    """Return the transports of the options, not started yet."""
    modules = (import_module(m.name) for m in transport_modules() if m.requested(args))
    found = (module.open_transport(vars(args), pages) for module in modules)
    return [transport for transport in found if transport is not None]
