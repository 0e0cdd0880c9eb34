"""Show a recording in the web viewer: play it, look at any moment, go on from there.

A recording of a simulation (trocar sim --record) is repeated in the world that was recorded, and
compared with the file on the way; any moment can become a simulation (Continue from here). A log of
a real arm is a bag, a text file of numbers of any layout, or an episode of a LeRobot dataset; its
joints are put where the log has them. See docs/viewer.md and docs/recordings.md.
"""

from __future__ import annotations

import sys
from argparse import ArgumentParser, Namespace
from contextlib import ExitStack, closing
from threading import Timer
from typing import TYPE_CHECKING

from trocar.cli.arguments import add_origin, add_port, allow, names_of, options
from trocar.cli.reading import add_reading, allow_reading, read_settings
from trocar.cli.serving import add_host, greeting, page_access
from trocar.cli.worlds import add_cameras, open_pictures

if TYPE_CHECKING:
    from trocar.robot.follow import PlayedLog, RepeatedRecording

SUMMARY = "play a recording in the web viewer"
ORDER = 71


def add_arguments(parser: ArgumentParser) -> None:
    """Describe the arguments."""
    options(parser, """
        file FILE  recording of a simulation, or log of arms
        --rig RIG  rig of the recording, if its path has changed; of a log, the rig with its arms
    """)  # fmt: skip
    real = parser.add_argument_group("log of a real arm")
    options(real, """
        --arm ARM    built-in arm (see trocar list arms) or TOML file; with --rig, an arm of that
                     rig (default: psm; with --rig all that the log has)
        --tool TOOL  built-in tool or TOML file (default: the tool of the arm's description)
    """)  # fmt: skip
    add_reading(real)
    options(parser, """
        --duration S:duration  stop after S seconds
    """)  # fmt: skip
    viewer = parser.add_argument_group("web viewer")
    add_port(viewer)
    add_host(viewer)
    add_origin(viewer)
    cameras = parser.add_argument_group("cameras")
    add_cameras(cameras)


def run(args: Namespace) -> int:
    """Show it until Ctrl-C."""
    from trocar.live import Loop
    from trocar.live.player import Player
    from trocar.viewer import serve

    access = page_access(args)
    played = _opened(args)
    for text in played.notes:
        print(f"{args.file}: {text}", file=sys.stderr)
    loop = Loop(played.world)
    player = Player(loop, played)
    loop.watch(player)

    def greet(url: str) -> None:
        print(*greeting(stack, access, [url], {"web_viewer": url}), sep="\n", flush=True)
        if args.duration is not None:
            end = Timer(args.duration, loop.close)
            end.daemon = True
            end.start()
            stack.callback(end.cancel)

    with ExitStack() as stack:
        pictures = open_pictures(loop, args)
        if pictures is not None:
            stack.enter_context(closing(pictures))
            pictures.start()
        serve(
            played.world,
            host=args.host,
            port=args.port,
            on_ready=greet,
            loop=loop,
            pictures=pictures,
            access=access,
            player=player,
        )
    return 0


def _opened(args: Namespace) -> RepeatedRecording | PlayedLog:
    from trocar.robot.follow import RepeatedRecording
    from trocar.robot.recordings import recording_kind

    kind = recording_kind(args.file)
    if kind == "recording":
        allow(args, "with the log of a real arm", "arm", "tool", *names_of(add_reading))
        print(f"trocar: {args.file}: building its world ...", file=sys.stderr, flush=True)
        return RepeatedRecording(args.file, args.rig)
    allow_reading(args, {kind})
    return _of_log(args)


def _of_log(args: Namespace) -> PlayedLog:
    """Open a log: of one arm alone, or of those of a rig."""
    from trocar.descriptions import load_arm, load_rig
    from trocar.descriptions.mounting import rig_with_tool
    from trocar.descriptions.rigs import lone_arm_rig
    from trocar.robot.follow import PlayedLog
    from trocar.robot.recordings import read_arm_motion
    from trocar.robot.recordings.table_bag import arm_motions
    from trocar.simulation import World

    settings = read_settings(args)
    if args.rig is None:
        rig = lone_arm_rig(load_arm(args.arm or "psm", args.tool))
        name = rig.arms[0].name
    else:
        rig, name = load_rig(args.rig), args.arm
        if name is not None:
            name = rig.arm(name).name
            rig = rig if args.tool is None else rig_with_tool(rig, name, args.tool)
        else:
            allow(args, "with --arm", "tool", "of", "topic", "jaw")
    if name is not None:
        motions = {name: read_arm_motion(args.file, rig.arm(name).arm, settings)}
    else:
        motions = arm_motions(args.file, {one.name: one.arm for one in rig.arms}, settings)
    return PlayedLog(World(rig), motions)
