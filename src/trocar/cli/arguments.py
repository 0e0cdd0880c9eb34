"""The command-line parser, and arguments shared by several subcommands."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import TYPE_CHECKING, NoReturn

from trocar.errors import InputError

if TYPE_CHECKING:
    from argparse import _ActionsContainer

    from _typeshed import SupportsWrite

#: Port of the web viewer.
PORT = 8080


class Parser(argparse.ArgumentParser):
    """An argument parser that raises InputError, one line without usage."""

    def __init__(self, **options: object) -> None:
        options.setdefault("formatter_class", argparse.RawDescriptionHelpFormatter)
        super().__init__(**options)  # type: ignore[arg-type]

    def _print_message(self, message: str, file: SupportsWrite[str] | None = None) -> None:
        print(message, end="", file=file)  # argparse's own ignores a full disk

    def error(self, message: str) -> NoReturn:
        """Raise InputError with argparse's message."""
        command = self.prog.partition(" ")[2]
        where = f"{command}: " if command else ""
        raise InputError(f"{where}{message} (see {self.prog} --help)")


def keep_negative_numbers(words: Sequence[str]) -> list[str]:
    """Escape negative numbers so that argparse does not parse them as options.

    argparse recognises -1 and -0.5 as numbers, but not -1.2e-05 and -inf. A leading space keeps a
    word from being parsed as an option.
    """
    return [f" {word}" if word.startswith("-") and _is_number(word) else word for word in words]


def number(text: str) -> float:
    """Parse a number."""
    if not _is_number(text):
        raise argparse.ArgumentTypeError(f"got {text.strip()!r}; allowed: a number")
    return float(text)


def duration(text: str) -> float:
    """Parse a positive, finite time [s]."""
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
    """Add the arm and its tool."""
    parser.add_argument(
        "arm", metavar="ARM", help="built-in arm (see trocar list arms) or TOML file"
    )
    parser.add_argument(
        "--tool",
        metavar="TOOL",
        help='built-in tool, TOML file, or "none" (default: the tool of the arm\'s description)',
    )


def add_calibration(parser: _ActionsContainer) -> None:
    """Add the calibration overlay of one arm."""
    parser.add_argument(
        "--calibration",
        metavar="OVERLAY",
        help="calibration overlay, replaces nominal geometry (trocar calibrate)",
    )


def add_calibrations(parser: _ActionsContainer) -> None:
    """Add the calibration overlays of a rig's arms."""
    parser.add_argument(
        "--calibration",
        action="append",
        metavar="[ARM=]OVERLAY",
        help="calibration overlay of ARM, or of every arm of its type (repeatable)",
    )


def add_gains(parser: _ActionsContainer) -> None:
    """Add the presets of servo gains and joint friction."""
    parser.add_argument(
        "--control",
        choices=("dvrk", "paper"),
        default="dvrk",
        help="servo gain preset (default: dvrk)",
    )
    parser.add_argument(
        "--friction",
        choices=("identified", "paper"),
        default="identified",
        help="joint friction preset (default: identified)",
    )


def add_rig(
    parser: _ActionsContainer, rig: str | None = "full_cart", chosen: str = "chosen by command"
) -> None:
    """Add the rig.

    Args:
        parser: parser or argument group
        rig: default rig; None: the command chooses one
        chosen: help text for the default, if `rig` is None
    """
    parser.add_argument(
        "--rig",
        default=rig,
        help=f"built-in rig (see trocar list rigs) or TOML file (default: {rig or chosen})",
    )


def add_port(parser: _ActionsContainer) -> None:
    """Add the port of the web viewer."""
    parser.add_argument(
        "--port",
        type=int,
        default=PORT,
        metavar="N",
        help=f"web viewer port (default: {PORT}, 0 = any free port)",
    )


def add_origin(parser: _ActionsContainer) -> None:
    """Add the origins of web pages that are allowed to connect."""
    parser.add_argument(
        "--origin",
        action="append",
        default=[],
        metavar="URL",
        help="allow web pages of this origin, e.g. http://localhost:3000 (repeatable)",
    )


def add_overwrite(parser: _ActionsContainer, what: str = "an existing output file") -> None:
    """Add the permission to replace output files."""
    parser.add_argument("--overwrite", action="store_true", help=f"replace {what}")


def add_json(parser: argparse.ArgumentParser) -> None:
    """Add JSON output."""
    parser.add_argument("--json", action="store_true", help="print the result as one JSON document")
