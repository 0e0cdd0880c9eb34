"""Run a dVRK Python script (import crtk, dvrk) without ROS.

Words after the script name that are not options of this command are passed to the script, as is
everything after `--`. With --speed max or a factor, the script's sleeps, rates and waits run in
simulated time, reproducible bit by bit. The exit status is the script's, 1 if it raises.
See docs/scripts.md.
"""

from __future__ import annotations

import re
import sys
import threading
from argparse import ArgumentParser, Namespace
from collections.abc import Sequence
from concurrent.futures import Future
from contextlib import ExitStack, nullcontext, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from trocar.cli.arguments import Parser, add_port, allow, allow_overwrite, options
from trocar.cli.serving import add_host, greeting, page_access
from trocar.cli.worlds import (
    add_cameras,
    add_record,
    add_world,
    make_world,
    open_pictures,
    recording,
)
from trocar.errors import InputError, TrocarError

if TYPE_CHECKING:
    from trocar.live import Loop
    from trocar.live.images import Pictures
    from trocar.scripts import Flow
    from trocar.simulation import World

SUMMARY = "run a dVRK Python script without ROS"
ORDER = 30

#: Publication rate of states [Hz]. Source: dVRK 2.4, system_ROS publishes every 10 ms.
RATE_HZ = 100.0
#: Options without a value.
FLAGS = (
    "-h", "--help", "--page", "--overwrite", "--no-cameras", "--distortion", "--no-shadows"
)  # fmt: skip


def add_arguments(parser: ArgumentParser) -> None:
    """Describe the arguments."""
    _add_options(parser)
    options(parser, """
        script SCRIPT.py  script to run
    """)  # fmt: skip
    parser.add_argument(
        "arguments", metavar="...", nargs="*", help="arguments passed to the script"
    )
    whole = parser.parse_known_args

    def parse(words: Sequence[str], namespace: Any = None) -> Any:
        """Parse the options of this command only, and leave the script's arguments unchanged."""
        own, rest = _sorted_out(words)
        found, unknown = whole(own, namespace)
        found.arguments = rest
        return found, unknown

    parser.parse_known_args = parse  # type: ignore[method-assign]


def _add_options(parser: ArgumentParser) -> None:
    options(parser, f"""
        --speed SPEED:speed = realtime   realtime; max, simulated time as fast as possible; or a
                                         factor of real time: 0.2 is slow motion
        --timeout S:number               abort after S seconds of simulated time, or S seconds of
                                         wall time without progress
        --rate HZ:number = {RATE_HZ}     publication rate of states (default: {RATE_HZ:g}, as on the
                                         dVRK; at most 1000)
        --ros-version 1|2                edition of ROS that the script is written for: rospy or
                                         rclpy (default: by its imports, else ROS_VERSION, else 1)
    """)  # fmt: skip
    add_world(parser, None, "the smallest with the script's arms")
    add_record(parser)
    add_cameras(parser.add_argument_group("cameras"))
    viewer = parser.add_argument_group("web viewer")
    options(viewer, """
        --page  serve the web viewer
    """)  # fmt: skip
    add_port(viewer)
    add_host(viewer)


def run(args: Namespace) -> int:
    """Run the script."""
    from trocar.scripts import Live, rig_for, run_script

    if args.timeout is not None and not 0.0 < args.timeout < float("inf"):
        raise InputError(f"--timeout: got {args.timeout:g}; allowed: above 0 s")
    script = Path(args.script)
    if not script.is_file():
        raise InputError(f"{script}: no such file")
    if args.rig is None:
        args.rig = rig_for(script.read_bytes(), args.arguments)
    if args.page and args.speed != "realtime":
        raise InputError(f"--page: got --speed {args.speed}; allowed: --speed realtime")
    if not args.page:
        allow(args, "with --page", "port", "host", "token")
    allow_overwrite(args, "record")
    world = make_world(args)
    page = ScriptPage(world, args) if args.page else None
    flow, linger = _flow(world, args, page), page and page.linger
    edition = None if args.ros_version is None else 2 if args.ros_version == "2" else 1
    with nullcontext() if isinstance(flow, Live) else recording(world, args)():
        outcome = run_script(script.absolute(), args.arguments, flow, args.timeout, linger, edition)
    if isinstance(flow, Live):
        flow.loop.wait()  # raises what went wrong at its end, as with the recording's last chunk
    sys.stdout.flush()
    print(
        f"trocar: {script.name}: rig {args.rig}, {outcome.simulated_s:.1f} s simulated in"
        f" {outcome.wall_s:.1f} s",
        file=sys.stderr,
    )
    return outcome.status


def _flow(world: World, args: Namespace, page: ScriptPage | None) -> Flow:
    """Return the connection between script and simulation, live or stepped."""
    from trocar.live import Loop
    from trocar.scripts import Live, Stepped
    from trocar.teleoperation import components

    def draw(loop: Loop) -> Pictures | None:
        return open_pictures(loop, args, stepped=args.speed != "realtime")

    rates: dict[str, float] = {"rate_hz": args.rate}
    if args.camera_rate is not None:
        rates["camera_rate_hz"] = args.camera_rate
    if args.speed != "realtime":
        pace = None if args.speed == "max" else args.speed
        return Stepped(world, args.timeout, components, draw, pace, **rates)
    begin = Loop.start if page is None else page.begin
    live = Live(world, begin, components, draw, **rates)
    live.loop.while_running = recording(world, args)
    return live


class ScriptPage:
    """Web viewer of a running script, served in its own thread until Ctrl-C after the script."""

    def __init__(self, world: World, args: Namespace) -> None:
        self._world, self._args, self._access = world, args, page_access(args)
        self._stack = ExitStack()
        self._ready: Future[str] = Future()
        self._thread = threading.Thread(target=self._serve, name="trocar-page", daemon=True)

    def begin(self, loop: Loop) -> None:
        """Serve the web viewer, which starts the loop; return when the loop runs."""
        self._loop = loop
        self._thread.start()
        address = self._ready.result()
        lines = greeting(self._stack, self._access, [address], {"web_viewer": address})
        print(*lines, sep="\n", file=sys.stderr, flush=True)
        if sys.stdin is not None and sys.stdin.isatty():
            print("press Enter to start the script ", file=sys.stderr, end="", flush=True)
            sys.stdin.readline()

    def linger(self) -> None:
        """Keep serving until Ctrl-C."""
        with self._stack, suppress(KeyboardInterrupt):
            print("script finished; Ctrl-C stops the web viewer", file=sys.stderr, flush=True)
            while self._thread.is_alive():
                self._thread.join(1.0)

    def _serve(self) -> None:
        from trocar.viewer import serve

        try:
            serve(
                self._world,
                host=self._args.host,
                port=self._args.port,
                loop=self._loop,
                on_ready=self._ready.set_result,
                access=self._access,
            )
        except Exception as problem:
            if not self._ready.done():
                self._ready.set_exception(problem)
            elif not isinstance(problem, TrocarError):
                raise  # a TrocarError reaches the script through its simulation


def _sorted_out(words: Sequence[str]) -> tuple[list[str], list[str]]:
    """Split the words into those of this command (also after the script) and the script's."""
    before = _leading(words)
    script = words[before : before + 1]
    after = words[before + 1 :]
    count = _leading(after)
    rest = list(after[count:])
    if rest[:1] == ["--"]:
        rest = rest[1:]
    own = [*words[:before], *after[:count], *script]
    return own, [word[1:] if word.startswith(" -") else word for word in rest]


def _leading(words: Sequence[str]) -> int:
    """Count the leading words that are options of this command, or their values."""
    options = Parser(allow_abbrev=False)
    _add_options(options)
    names = set(re.findall(r"--[\w-]+|-h", options.format_usage()))
    count = 0
    while count < len(words):
        name, given, _ = words[count].partition("=")
        if name not in names:
            break
        count += 1 if given or name in FLAGS else 2
    return min(count, len(words))
