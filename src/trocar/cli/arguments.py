"""Arguments that several subcommands take, and a parser that reports errors as trocar does."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import NoReturn

from trocar.errors import InputError


class Parser(argparse.ArgumentParser):
    """A parser whose errors are InputErrors: one line, no usage before it."""

    def __init__(self, **options: object) -> None:
        options.setdefault("formatter_class", argparse.RawDescriptionHelpFormatter)
        super().__init__(**options)  # type: ignore[arg-type]

    def error(self, message: str) -> NoReturn:
        """Refuse the command line."""
        command = self.prog.partition(" ")[2]
        where = f"{command}: " if command else ""
        raise InputError(f"{where}{message} (see {self.prog} --help)")


def keep_negative_numbers(words: Sequence[str]) -> list[str]:
    """Return a command line in which argparse takes no number for an option.

    It knows -1 and -0.5, but would take -1.2e-05 and -inf for options. A word that starts with a
    space is none.
    """
    return [f" {word}" if word.startswith("-") and _is_number(word) else word for word in words]


def number(text: str) -> float:
    """Read a number of the command line."""
    if not _is_number(text):
        raise argparse.ArgumentTypeError(f"got {text.strip()!r}; allowed: a number")
    return float(text)


def add_arm(parser: argparse.ArgumentParser) -> None:
    """Let the user choose an arm and its tool."""
    parser.add_argument("arm", metavar="ARM", help="a built-in arm (trocar list), or a TOML file")
    parser.add_argument(
        "--tool", metavar="TOOL", help='another tool, its TOML file, or "none"; default: the arm\'s'
    )


def add_calibration(parser: argparse.ArgumentParser) -> None:
    """Let the user lay a calibration over the arm."""
    parser.add_argument(
        "--calibration", metavar="OVERLAY", help="a calibrated robot in place of the nominal one"
    )


def add_calibrations(parser: argparse.ArgumentParser) -> None:
    """Let the user lay calibrations over the arms of a rig."""
    parser.add_argument(
        "--calibration",
        action="append",
        metavar="[ARM=]OVERLAY",
        help="a calibrated robot: for this arm, or for all of its kind; may be repeated",
    )


def add_json(parser: argparse.ArgumentParser) -> None:
    """Let the user ask for JSON."""
    parser.add_argument("--json", action="store_true", help="print one JSON document, for programs")


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
