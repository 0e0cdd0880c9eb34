"""The parser of the command line, and the arguments that several subcommands share."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import NoReturn

from trocar.errors import InputError

#: Port of the web viewer.
PORT = 8080


class Parser(argparse.ArgumentParser):
    """An argument parser that raises InputError, one line without usage."""

    def __init__(self, **options: object) -> None:
        options.setdefault("formatter_class", argparse.RawDescriptionHelpFormatter)
        super().__init__(**options)  # type: ignore[arg-type]

    def error(self, message: str) -> NoReturn:
        """Reject the command line."""
        command = self.prog.partition(" ")[2]
        where = f"{command}: " if command else ""
        raise InputError(f"{where}{message} (see {self.prog} --help)")


def keep_negative_numbers(words: Sequence[str]) -> list[str]:
    """Return a command line in which argparse takes no negative number for an option.

    argparse recognises -1 and -0.5 as numbers, but not -1.2e-05 and -inf. A leading space keeps a
    word from being parsed as an option.
    """
    return [f" {word}" if word.startswith("-") and _is_number(word) else word for word in words]


def number(text: str) -> float:
    """Read a number of the command line."""
    if not _is_number(text):
        raise argparse.ArgumentTypeError(f"got {text.strip()!r}; allowed: a number")
    return float(text)


def duration(text: str) -> float:
    """Read a positive, finite time [s]."""
    value = number(text)
    if not 0.0 < value < float("inf"):
        raise argparse.ArgumentTypeError(f"got {value:g}; allowed: above 0 s")
    return value


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def add_arm(parser: argparse.ArgumentParser) -> None:
    """Add an arm and its tool."""
    parser.add_argument("arm", metavar="ARM", help="built-in arm (trocar list) or TOML file")
    parser.add_argument(
        "--tool", metavar="TOOL", help='tool, its TOML file, or "none" (default: the arm\'s own)'
    )


def add_calibration(parser: argparse.ArgumentParser) -> None:
    """Add the calibration of one arm."""
    parser.add_argument(
        "--calibration", metavar="OVERLAY", help="calibrated geometry in place of the nominal one"
    )


def add_calibrations(parser: argparse.ArgumentParser) -> None:
    """Add the calibrations of a rig's arms."""
    parser.add_argument(
        "--calibration",
        action="append",
        metavar="[ARM=]OVERLAY",
        help="calibrated geometry of this arm, or of all arms of its kind; may be repeated",
    )


def add_gains(parser: argparse.ArgumentParser) -> None:
    """Add the presets of servo gains and of joint friction."""
    parser.add_argument(
        "--control", choices=("dvrk", "paper"), default="dvrk", help="servo gains (default: dvrk)"
    )
    parser.add_argument(
        "--friction",
        choices=("identified", "paper"),
        default="identified",
        help="joint friction (default: identified)",
    )


def add_rig(parser: argparse.ArgumentParser, rig: str | None = "full_cart") -> None:
    """Add the rig; None: the command chooses one."""
    parser.add_argument(
        "--rig",
        default=rig,
        help=f"built-in rig (trocar list) or TOML file; default: {rig or 'the smallest that fits'}",
    )


def add_port(parser: argparse._ActionsContainer) -> None:
    """Add the port of the web viewer."""
    parser.add_argument(
        "--port",
        type=int,
        default=PORT,
        metavar="N",
        help=f"web viewer port (default {PORT}, 0 = any free port)",
    )


def add_origin(parser: argparse._ActionsContainer) -> None:
    """Add the origins of web pages that may connect."""
    parser.add_argument(
        "--origin",
        action="append",
        default=[],
        metavar="URL",
        help="accept pages of this origin, as http://localhost:3000; may be repeated",
    )


def add_json(parser: argparse.ArgumentParser) -> None:
    """Add JSON output."""
    parser.add_argument("--json", action="store_true", help="print one JSON document, for programs")
