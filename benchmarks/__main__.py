"""Measure what is not a part of `trocar bench`, each figure beside its goal.

startup: time to the help and to the first motion. recording: cost of recording the full cart in
motion. interface: what a client in another process sees of a simulator. scope: pictures of the
endoscope a second, beside MuJoCo's own renderer and in real time. soak: hours of the cart in
motion (7 minutes each on one core). assistance: error and time of a modelled operator with and
without virtual fixtures. laws: momentum, friction, soft pads and elastic bands of props. grip:
slip of a held needle, and loads at which a jaw lets go. dynamics: efforts predicted along
recordings of real arms. errors: how far tips are from where the robots report them. vision:
calibrations of the endoscope from views of a board, an ECM that centres an object (10 s a seed),
a needle that is tracked in rendered images (40 s a seed).
drives: cost and drift of identified dynamics in the simulation. tasks: success, time, forces and
speed of the scripted policies of all scenes. random-actions: what diverges, flies off or sinks in
when actions are random. suturing: stitches through soft tissue (50 episodes: 30 minutes on one
core).

python -m benchmarks attack --help: attack a simulator and count what fails.
python -m benchmarks against --help: speed of an older commit and of this tree, in turn.
"""

from __future__ import annotations

import os
import sys
from argparse import ArgumentParser, RawDescriptionHelpFormatter
from collections.abc import Sequence
from pathlib import Path

from trocar.cli.output import print_json, table
from trocar.errors import InputError, TrocarError
from trocar.robot.verification.figures import Figure, figure_rows

NAMES = (
    "startup",
    "recording",
    "interface",
    "scope",
    "soak",
    "assistance",
    "laws",
    "grip",
    "dynamics",
    "errors",
    "vision",
    "drives",
    "tasks",
    "suturing",
    "random-actions",
)
TRANSPORTS = ("websocket", "ros1", "ros2")


def main(words: Sequence[str] | None = None) -> int:
    """Run benchmarks, print their figures, and return the exit status."""
    words = sys.argv[1:] if words is None else words
    if words[:1] == ["attack"]:
        from benchmarks.attack.__main__ import main as attack

        return attack(words[1:])
    if words[:1] == ["against"]:
        from benchmarks.against import main as against

        return against(words[1:])
    parser = ArgumentParser(
        "python -m benchmarks", description=__doc__, formatter_class=RawDescriptionHelpFormatter
    )
    parser.add_argument("name", nargs="+", choices=NAMES, metavar="NAME", help=", ".join(NAMES))
    parser.add_argument(
        "--duration",
        type=float,
        metavar="S",
        help="time of each pass, subscription or episode (recording, scope: 4; interface: 10; soak:"
        " 3600; random-actions: 2)",
    )
    parser.add_argument("--passes", type=int, default=31, metavar="N", help="of recording (31)")
    parser.add_argument(
        "--seeds",
        type=int,
        metavar="N",
        help="of assistance: trials of each (50); of vision: robots (20)",
    )
    parser.add_argument(
        "--only",
        choices=("hand-eye", "servoing", "needle", "held", "tips"),
        help="of vision: this part (default: all; held: of needle, the second in jaws alone)",
    )
    parser.add_argument(
        "--style",
        choices=("plain", "surgical", "light"),
        help="of vision, needle and held: on this ground (default: all)",
    )
    parser.add_argument(
        "--preset",
        choices=("hd_1280x720", "dvrk_sd_640x480"),
        help="of vision, needle and held: images of this camera (default: both)",
    )
    parser.add_argument(
        "--first", type=int, default=0, metavar="SEED", help="of vision, held: the first robot (0)"
    )
    parser.add_argument(
        "--workers", type=int, default=1, metavar="N", help="of vision, needle: processes (1)"
    )
    parser.add_argument(
        "--episodes",
        type=int,
        metavar="N",
        help="of each scene, of tasks and suturing (50) and of random-actions (1000)",
    )
    parser.add_argument(
        "--scene",
        action="append",
        default=[],
        metavar="NAME",
        help="of tasks and random-actions: this one (repeatable; default: all)",
    )
    parser.add_argument(
        "--case",
        action="append",
        default=[],
        metavar="NAME",
        help="of suturing: one, noisy, four, random, ... (repeatable; default: all)",
    )
    parser.add_argument(
        "--keep",
        metavar="FILE",
        help="of tasks, suturing and needle of vision: keep episodes or runs in FILE, and do not"
        " run again those that it has",
    )
    parser.add_argument(
        "--transport",
        action="append",
        choices=TRANSPORTS,
        help="of interface; default: websocket; may be repeated",
    )
    parser.add_argument(
        "--live",
        type=float,
        default=60.0,
        metavar="S",
        help="of scope: time of the cart in real time, its page in a headless browser (60)",
    )
    parser.add_argument(
        "--no-browser", action="store_true", help="of scope: a program loads the page instead"
    )
    parser.add_argument("-o", "--output", metavar="PNG", help="of soak, assistance: plot it")
    parser.add_argument(
        "--recordings",
        metavar="DIR",
        default=os.environ.get("TROCAR_HARDWARE_DATA"),
        help="of dynamics, drives: recordings of real arms (default: $TROCAR_HARDWARE_DATA)",
    )
    parser.add_argument("--json", action="store_true", help="print one JSON document")
    args = parser.parse_args(words)
    try:
        for value in (args.duration, args.passes, args.live):
            if value is not None and not 0.0 < value < float("inf"):
                raise InputError("--duration, --live and --passes: allowed: above 0")
        drawn = {"soak", "assistance"} & set(args.name)
        if args.output is not None and len(drawn) != 1:
            raise InputError("--output: allowed with soak or assistance only")
        if args.episodes is not None and args.episodes < 1:
            raise InputError(f"--episodes: got {args.episodes}; allowed: 1 or more")
        if args.workers < 1:
            raise InputError(f"--workers: got {args.workers}; allowed: 1 or more")
        if args.seeds is not None and args.seeds < 2:
            raise InputError(f"--seeds: got {args.seeds}; allowed: 2 or more")
        each = () if args.duration is None else (args.duration,)
        found: list[Figure] = []
        if "startup" in args.name:
            from benchmarks.startup import startup

            watch("start-up")
            found += startup()
        if "recording" in args.name:
            from benchmarks.recording import recording

            watch("recording")
            found += recording(*each or (4.0,), args.passes)
        if "interface" in args.name:
            from benchmarks.interface import interface

            found += interface(args.transport or ("websocket",), *each or (10.0,), watch)
        if "scope" in args.name:
            from benchmarks.scope import scope

            onlooker = "" if args.no_browser else None
            found += scope(*each or (4.0,), watch, args.live, onlooker)
        if "laws" in args.name:
            from benchmarks.laws import laws

            found += laws()
        if "grip" in args.name:
            from benchmarks.grip import grip

            watch("grip")
            found += grip()
        if "suturing" in args.name:
            from benchmarks.suturing import suturing

            kept = args.keep and Path(args.keep)
            found += suturing(args.episodes or 50, watch, args.case, kept)
        if "tasks" in args.name:
            from benchmarks.tasks import tasks

            kept = args.keep and Path(args.keep)
            found += tasks(args.scene, args.episodes or 50, watch, kept)
        if "random-actions" in args.name:
            from benchmarks.random_actions import EPISODE_S, random_actions

            time_s = args.duration or EPISODE_S
            found += random_actions(args.scene, args.episodes or 1000, time_s, watch)
        if "dynamics" in args.name:
            from benchmarks.dynamics import dynamics

            if args.recordings is None:
                print("dynamics: skipped, no folder of recordings is named", file=sys.stderr)
            else:
                watch("dynamics")
                found += dynamics(Path(args.recordings))
        if "drives" in args.name:
            from benchmarks.drives import drives

            watch("drives")
            found += drives(args.recordings and Path(args.recordings))
        if "errors" in args.name:
            from benchmarks.errors import errors

            watch("errors")
            found += errors()
        if "vision" in args.name:
            if args.only in (None, "hand-eye"):
                from benchmarks.vision import hand_eye

                found += hand_eye(args.seeds or 20, watch)
            if args.only in (None, "servoing"):
                from benchmarks.servoing import servoing

                found += servoing(args.seeds or 20, watch)
            if args.only in (None, "needle", "held"):
                from benchmarks.needle_tracking import GOALS, STYLES, held, needle_tracking

                count = args.seeds or 20
                styles = [args.style] if args.style else list(STYLES)
                presets = [args.preset] if args.preset else list(GOALS)
                if args.only == "held":
                    seeds = range(args.first, args.first + count)
                    found += held(seeds, styles, presets, watch)
                else:
                    kept = args.keep and Path(args.keep)
                    found += needle_tracking(count, args.workers, styles, presets, watch, kept)
            if args.only in (None, "tips"):
                from benchmarks.tips import tips

                found += tips(args.seeds or 20, watch)
        if "soak" in args.name:
            from benchmarks.soak import draw, soak

            soaked = soak(*each, watch=watch)
            found += soaked.figures
            if args.output is not None:
                Path(args.output).write_bytes(draw(soaked.windows))
        if "assistance" in args.name:
            from benchmarks import assistance as assisted

            results = assisted.assistance(args.seeds or 50, watch)
            found += assisted.figures(results)
            if args.output is not None:
                Path(args.output).write_bytes(assisted.draw(results))
    except TrocarError as error:
        print(f"benchmarks: error: {error}", file=sys.stderr)
        return 2 if isinstance(error, InputError) else 1
    if args.json:
        print_json({"figures": found})
    else:
        print(table(*figure_rows(found)))
    return 0


def watch(what: str) -> None:
    """Report progress on stderr."""
    print(f"measuring {what} ...", file=sys.stderr, flush=True)


if __name__ == "__main__":
    sys.exit(main())
