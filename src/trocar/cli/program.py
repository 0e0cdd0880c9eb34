"""The program `trocar`: which subcommands there are, and how an error ends it.

Exit status: 0 done; 1 the run failed; 2 bad input, nothing was done; 130 interrupted.
"""

from __future__ import annotations

import argparse
import contextlib
import logging
import os
import sys
from collections.abc import Sequence
from importlib import import_module
from importlib.util import find_spec

from trocar import __version__
from trocar.cli.arguments import Parser, keep_negative_numbers
from trocar.errors import InputError, TrocarError

#: Subcommand -> what `trocar --help` says of it. The module `trocar.cli.<name>`, hyphens as _, has
#: `add_arguments(parser)` and `run(args) -> exit status`; it imports heavy libraries in `run` only.
COMMANDS = {
    "sim": "simulate a rig: live in the browser, or headless",
    "render": "what a rig's camera sees, as a picture or a video",
    "run": "a script of the dVRK without ROS, as fast as it goes",
    "teleop": "drive a rig by hand: keyboard, gamepad, SpaceMouse, masters",
    "tune": "step response of an arm's joints, and gains tuned from it",
    "mirror": "the simulated arms follow a real robot, live or recorded",
    "replay": "repeat a recording, or drive an arm along one of a real arm",
    "mocap": "tracks of a simulated arm, as cameras would tell them",
    "rcm": "the remote centre of an arm from tracks of motion capture",
    "plot": "draw a recording: joints, errors, efforts",
    "calibrate": "a robot's own geometry, from motion capture",
    "fk": "poses of an arm's frames from joint positions",
    "ik": "all joint positions that bring an arm's tip to a pose",
    "list": "names of the built-in arms, tools and rigs",
    "show": "what is known of an arm: frames, limits, masses, sources",
    "export": "an arm or a rig for other simulators: URDF, SDF, MJCF",
    "import": "a robot or an object of another tool, as an arm or a prop",
    "import-dvrk": "a lab's own dVRK configuration, as a rig",
    "verify": "the paper's experiments repeated, its figures beside ours",
    "bench": "measure real-time factors beside bare MuJoCo",
}

DONE, FAILED, BAD_INPUT, INTERRUPTED = 0, 1, 2, 130


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command.

    Args:
        arguments: what follows the program's name; `sys.argv` when omitted

    Returns:
        the exit status, see above
    """
    words = sys.argv[1:] if arguments is None else arguments
    try:
        args = build_parser().parse_args(keep_negative_numbers(words))
        _log_to_stderr()
        status: int = args.run(args)
        sys.stdout.flush()
    except TrocarError as error:
        print(f"trocar: error: {' '.join(str(error).split())}", file=sys.stderr)
        return BAD_INPUT if isinstance(error, InputError) else FAILED
    except BrokenPipeError:  # nobody reads on, as in `trocar show psm | head`
        _close_output()
        return FAILED
    except KeyboardInterrupt:
        print("trocar: interrupted", file=sys.stderr)
        return INTERRUPTED
    return status


def build_parser() -> argparse.ArgumentParser:
    """Return the parser with every subcommand whose module is there."""
    parser = Parser(
        prog="trocar",
        description="The da Vinci Research Kit in Python: true mechanism, dynamics, interface.",
        epilog="trocar COMMAND --help says more. Lengths are in metres, angles in radians.",
    )
    parser.add_argument("--version", action="version", version=f"trocar {__version__}")
    commands = parser.add_subparsers(metavar="COMMAND", required=True, title="commands")
    for name, summary in COMMANDS.items():
        place = f"trocar.cli.{name.replace('-', '_')}"
        if find_spec(place) is None:
            continue
        module = import_module(place)
        command = commands.add_parser(
            name, help=summary, description=module.__doc__, formatter_class=parser.formatter_class
        )
        module.add_arguments(command)
        command.set_defaults(run=module.run)
    return parser


def _log_to_stderr() -> None:
    """Let warnings of the simulation look like those of the command line."""
    logging.basicConfig(format="trocar: warning: %(message)s", level=logging.WARNING)


def _close_output() -> None:
    """Send what is still buffered nowhere, so that the interpreter's own flush does not fail."""
    with contextlib.suppress(OSError, ValueError):
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, sys.stdout.fileno())
        os.close(nowhere)
