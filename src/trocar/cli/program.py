"""The program `trocar`: table of subcommands, error messages, exit status.

Exit status: 0 success; 1 the run failed; 2 bad input, nothing was done; 130 interrupted.
"""

from __future__ import annotations

import contextlib
import logging
import os
import re
import sys
from collections.abc import Collection, Sequence
from importlib import import_module
from pathlib import Path

from trocar import __version__
from trocar.cli.arguments import Parser, keep_negative_numbers
from trocar.errors import InputError, TrocarError, UnknownNameError


def _commands() -> dict[str, str]:
    """Return {subcommand: its summary}, from the sources: importing them all would take too long.

    The module `trocar.cli.<name>`, hyphens as _, has `SUMMARY`, its line in `trocar --help`, and
    `ORDER`, its place there; `add_arguments(parser)` and `run(args) -> exit status`, which imports
    heavy libraries.
    """
    found: list[tuple[int, str, str]] = []
    for path in Path(__file__).parent.glob("*.py"):
        text = path.read_text(encoding="utf-8")
        if summary := re.search(r'^SUMMARY = "(.*)"$', text, re.MULTILINE):
            order = re.search(r"^ORDER = (\d+)$", text, re.MULTILINE)
            name = path.stem.replace("_", "-")
            found.append((int(order[1]) if order else sys.maxsize, name, summary[1]))
    return {name: summary for _, name, summary in sorted(found)}


#: {subcommand: its line in `trocar --help`}.
COMMANDS = _commands()

DONE, FAILED, BAD_INPUT, INTERRUPTED = 0, 1, 2, 130


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command.

    Args:
        arguments: words after the program name; None: those of `sys.argv`

    Returns:
        exit status, see above
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
    """Return the parser of all subcommands; only those in `described` get their arguments."""
    parser = Parser(
        prog="trocar",
        description="Simulate the da Vinci Research Kit: mechanism, dynamics, CRTK interface.",
        epilog="Run `trocar COMMAND --help` for the options of a command. Units: metres, radians.",
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
    """Redirect buffered output to devnull, so that the interpreter's flush at exit succeeds."""
    with contextlib.suppress(OSError, ValueError):
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, sys.stdout.fileno())
        os.close(nowhere)
