"""The program `trocar`: table of subcommands, error messages, exit status.

Exit status: 0 success; 1 the run failed; 2 bad input, nothing was done; 130 interrupted; 141 the
reader of standard output closed it; 143 terminated.
"""

from __future__ import annotations

import contextlib
import errno
import logging
import os
import re
import signal
import sys
import threading
import time
from argparse import SUPPRESS
from collections.abc import Collection, Generator, Sequence
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
#: Exit status after SIGTERM. Source: shells report 128 + signal.
TERMINATED = 128 + signal.SIGTERM
#: Time within which several SIGTERMs count as one [s]. Source: our own choice; `timeout` sends two.
AT_ONCE_S = 1.0
#: Exit status after a closed pipe. Source: shells report `yes | head` as 128 + SIGPIPE.
CLOSED_PIPE = 128 + 13
#: Longest error [characters]. Source: our own choice; the longest without quoted input has 600.
LONGEST = 4000
#: Errors of a print on a full disk; other errors of the system keep their traceback.
FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO)


class Terminated(KeyboardInterrupt):
    """SIGTERM was received: what Ctrl-C ends ends in the same way."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command.

    Args:
        arguments: words after the program name; None: those of `sys.argv`

    Returns:
        exit status, see above
    """
    words = list(sys.argv[1:] if arguments is None else arguments)
    status, leaving = FAILED, None
    try:
        try:
            with _terminable():
                status = _run(words)
        except SystemExit as end:  # of --help and --version
            leaving = end
        problem = _output_problem()
    except TrocarError as error:
        _complain(f"error: {_line(str(error))}")
        return BAD_INPUT if isinstance(error, InputError) else FAILED
    except BrokenPipeError:  # nobody reads on, as in `trocar show psm | head`
        _discard_output()
        return CLOSED_PIPE
    except OSError as error:
        if error.errno not in FULL:
            raise
        problem = str(error.strerror)
    except KeyboardInterrupt as reason:
        terminated = isinstance(reason, Terminated)
        _complain("terminated" if terminated else "interrupted")
        return TERMINATED if terminated else INTERRUPTED
    if problem:
        _discard_output()
        _complain(f"error: output cannot be written: {problem}")
        return FAILED
    if leaving is not None:
        raise leaving
    return status


def _run(words: list[str]) -> int:
    if "-".join(words[:2]) in COMMANDS:  # `trocar calibrate camera`
        words = ["-".join(words[:2]), *words[2:]]
    command = next((word for word in words if not word.startswith("-")), None)
    if command is not None and command not in COMMANDS:
        pairs = [name.replace("-", " ", 1) for name in COMMANDS if name.startswith(f"{command}-")]
        typed = " ".join(words[:2]) if pairs else command  # "learn trian"
        raise UnknownNameError("command", typed, pairs or COMMANDS)
    parser = build_parser((command or "",))
    if not words:
        parser.print_help()
        return DONE
    words = keep_negative_numbers(words)
    args = parser.parse_args(words)
    given = vars(build_parser((command or "",), defaults=False).parse_args(words))
    called: dict[str, str] = given.pop("called")
    args.given = {name: called[name] for name in given if name in called}
    logging.basicConfig(format="trocar: warning: %(message)s", level=logging.WARNING)
    status: int = args.run(args)
    return status


@contextlib.contextmanager
def _terminable() -> Generator[None]:
    """Raise Terminated in the main thread at SIGTERM, unless the process ignores or handles it."""
    received = float("-inf")

    def terminate(*_: object) -> None:
        nonlocal received
        if (now := time.monotonic()) - received > AT_ONCE_S:
            received = now
            raise Terminated

    in_main = threading.current_thread() is threading.main_thread()
    if not in_main or signal.getsignal(signal.SIGTERM) is not signal.SIG_DFL:
        yield
        return
    signal.signal(signal.SIGTERM, terminate)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, signal.SIG_DFL)


def build_parser(described: Collection[str] = tuple(COMMANDS), defaults: bool = True) -> Parser:
    """Return the parser of all subcommands.

    Args:
        described: the subcommands that get their arguments
        defaults: False: options that are not given are absent; `called` has what each is called
    """
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
        if defaults:
            command.set_defaults(run=module.run)
            continue
        command._defaults.clear()  # argparse has no public way
        called: dict[str, str] = {}
        for action in command.arguments:
            if action.option_strings:
                action.default = SUPPRESS
                before = f"{called[action.dest]} or " if action.dest in called else ""
                called[action.dest] = before + action.option_strings[-1]
        command.set_defaults(called=called)
    return parser


def _output_problem() -> str:
    """Write what is buffered; return why standard output cannot be written, "" if it can.

    Raises:
        BrokenPipeError: the reader of the pipe has closed it
    """
    if sys.stdout is None:
        return "it is closed"
    try:
        sys.stdout.flush()
    except BrokenPipeError:
        raise
    except OSError as error:
        return error.strerror or str(error)
    return ""


def _line(text: str) -> str:
    """Return an error on one line; one that quotes a long input is cut in its middle."""
    line = " ".join(text.split())
    return line if len(line) <= LONGEST else f"{line[: LONGEST // 2]} ... {line[-LONGEST // 2 :]}"


def _complain(text: str) -> None:
    if sys.stderr is not None:
        with contextlib.suppress(OSError):
            print(f"trocar: {text}", file=sys.stderr)


def _discard_output() -> None:
    """Redirect buffered output to devnull, so that the interpreter's flush at exit succeeds."""
    if sys.stdout is None:
        return
    with contextlib.suppress(OSError, ValueError):
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, sys.stdout.fileno())
        os.close(nowhere)
