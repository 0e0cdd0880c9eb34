"""The program `trocar`: its subcommands, and how an error ends it.

Exit status: 0 done; 1 the run failed; 2 bad input, nothing was done; 130 interrupted.
"""

from __future__ import annotations

import contextlib
import logging
import os
import sys
from collections.abc import Collection, Sequence
from importlib import import_module

from trocar import __version__
from trocar.cli.arguments import Parser, keep_negative_numbers
from trocar.errors import InputError, TrocarError, UnknownNameError

#: Subcommand -> its line in `trocar --help`. The module `trocar.cli.<name>`, hyphens as _, has
#: `add_arguments(parser)` and `run(args) -> exit status`; it imports heavy libraries in `run` only.
COMMANDS = {
    "sim": "simulate a rig, live in the browser or headless",
    "render": "write a picture or a video of a rig's camera",
    "run": "run a dVRK script without ROS",
    "teleop": "drive a rig by keyboard, gamepad, SpaceMouse or masters",
    "tune": "measure an arm's step responses and tune its gains",
    "mirror": "follow a real robot with the simulated arms, live or recorded",
    "replay": "repeat a recording, or drive an arm along one of a real arm",
    "mocap": "simulate motion capture of an arm",
    "rcm": "find an arm's remote centre in motion capture",
    "plot": "plot a recording: joints, errors, efforts",
    "calibrate": "identify an arm's own geometry from motion capture",
    "fk": "forward kinematics: poses from joint positions",
    "ik": "inverse kinematics: all joint positions of a pose",
    "list": "list built-in arms, tools, rigs and cameras",
    "show": "show an arm: frames, limits, masses, sources",
    "export": "write an arm or a rig as URDF, SDF or MJCF",
    "import": "import an arm or a prop from URDF, SDF, MJCF or a mesh",
    "import-dvrk": "import a lab's dVRK configuration, as a rig",
    "verify": "repeat the closed-loop paper's experiments",
    "bench": "measure speed beside bare MuJoCo, and accuracy",
    "sample": "write small sample files for the other commands",
    "completion": "print the completion script of a shell",
}

DONE, FAILED, BAD_INPUT, INTERRUPTED = 0, 1, 2, 130


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command.

    Args:
        arguments: what follows the program's name; `sys.argv` when omitted

    Returns:
        the exit status, see above
    """
    words = list(sys.argv[1:] if arguments is None else arguments)
    try:
        command = next((word for word in words if not word.startswith("-")), None)
        if command is not None and command not in COMMANDS:
            raise UnknownNameError("command", command, COMMANDS)
        parser = build_parser((command or "",))
        if not words:
            parser.print_help()
            return DONE
        args = parser.parse_args(keep_negative_numbers(words))
        logging.basicConfig(format="trocar: warning: %(message)s", level=logging.WARNING)
        status: int = args.run(args)
        sys.stdout.flush()
    except TrocarError as error:
        print(f"trocar: error: {' '.join(str(error).split())}", file=sys.stderr)
        return BAD_INPUT if isinstance(error, InputError) else FAILED
    except BrokenPipeError:  # nobody reads on, as in `trocar show psm | head`
        _discard_output()
        return FAILED
    except KeyboardInterrupt:
        print("trocar: interrupted", file=sys.stderr)
        return INTERRUPTED
    return status


def build_parser(described: Collection[str] = tuple(COMMANDS)) -> Parser:
    """Return the parser of all subcommands, with the arguments of those that are `described`."""
    parser = Parser(
        prog="trocar",
        description="The da Vinci Research Kit in Python: true mechanism, dynamics, interface.",
        epilog="See trocar COMMAND --help for a command. Lengths are in metres, angles in radians.",
    )
    parser.add_argument("--version", action="version", version=f"trocar {__version__}")
    commands = parser.add_subparsers(metavar="COMMAND", required=True, title="commands")
    for name, summary in COMMANDS.items():
        if name not in described:
            commands.add_parser(name, help=summary)
            continue
        module = import_module(f"trocar.cli.{name.replace('-', '_')}")
        command = commands.add_parser(
            name, help=summary, description=module.__doc__, formatter_class=parser.formatter_class
        )
        module.add_arguments(command)
        command.set_defaults(run=module.run)
    return parser


def _discard_output() -> None:
    """Redirect buffered output to nowhere, so that the interpreter's own flush does not fail."""
    with contextlib.suppress(OSError, ValueError):
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, sys.stdout.fileno())
        os.close(nowhere)
