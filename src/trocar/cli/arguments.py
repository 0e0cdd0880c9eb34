"""The command-line parser, and arguments shared by several subcommands."""

from __future__ import annotations

import argparse
import re
import textwrap
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NoReturn, Protocol, cast

from trocar.errors import InputError

if TYPE_CHECKING:
    from _typeshed import SupportsWrite

#: Port of the web viewer.
PORT = 8080


class Arguments(Protocol):
    """A parser or a group of its arguments."""

    def add_argument(self, *names: str, **keywords: Any) -> argparse.Action:
        """Add an argument, as `argparse.ArgumentParser.add_argument`."""
        ...


class Parser(argparse.ArgumentParser):
    """An argument parser that raises InputError, one line without usage."""

    def __init__(self, **options: object) -> None:
        options.setdefault("formatter_class", argparse.RawDescriptionHelpFormatter)
        super().__init__(**options)  # type: ignore[arg-type]

    @property
    def arguments(self) -> list[argparse.Action]:
        """Its arguments, in their order."""
        return self._actions  # argparse has no public way

    @property
    def commands(self) -> Mapping[str, Parser]:
        """{name: its subcommand}, in their order; empty where it has none."""
        for action in self.arguments:
            if action.nargs == argparse.PARSER:
                return cast("Mapping[str, Parser]", action.choices)
        return {}

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


def speed(text: str) -> float | str:
    """Parse a speed of simulated time: "realtime", "max", or a positive factor of real time."""
    if text in ("realtime", "max"):
        return text
    value = float(text) if _is_number(text) else 0.0
    if not 0.0 < value < float("inf"):
        allowed = "realtime, max, or a factor of real time above 0, e.g. 0.2 for slow motion"
        raise argparse.ArgumentTypeError(f"got {text!r}; allowed: {allowed}")
    return value


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


#: Names, METAVAR:type, how often, its attribute, whether required, and the default.
ROW = re.compile(
    r"(\S+)(?: (?!required$|= |\.\.\.|\?)(\S+?)(?::([a-z]+))?(?= |$))?"
    r"(?: (\.\.\.|\[\.\.\.\]|\?))?(?: as (\w+))?(?: (required))?(?: = (.*))?"
)


def options(parser: Arguments, table: str, **types: Callable[[str], Any]) -> None:
    """Add arguments from a table that reads like --help.

    A row is `-o,--output FILE:type = default  help`; its help may go on in indented lines. Rows
    without a FILE are flags, `a|b` are choices. After the type, `...` repeats an option, or takes
    one or more positional arguments, `[...]` any number, `?` one or none (of choices, the
    first when the option stands alone); `as NAME` is the attribute that keeps the value.

    Args:
        parser: parser or argument group
        table: the rows, parted from their help by two spaces
        types: converters by name, beside int, number, duration and speed
    """
    types = {"int": int, "number": number, "duration": duration, "speed": speed, **types}
    for row in re.split(r"\n(?=\S)", textwrap.dedent(table).strip()):
        spec, text = re.split(r"\s{2,}", row, maxsplit=1)
        found = ROW.fullmatch(spec)
        if found is None:
            raise ValueError(f"no row of options: {spec!r}")
        names, metavar, kind, many, dest, required, default = found.groups()
        help_text = " ".join(text.split())
        keywords: dict[str, Any] = {"type": types[kind]} if kind else {}
        if default is not None and "(default" not in help_text:
            help_text += f" (default: {default})"
        if metavar is None:
            keywords["action"] = "store_true"
        elif "|" in metavar and metavar.islower():
            keywords["choices"] = tuple(metavar.split("|"))
        else:
            keywords["metavar"] = metavar
        if many == "..." and names.startswith("-"):
            keywords |= {"action": "append", "default": []}
        elif many:
            keywords["nargs"] = {"...": "+", "[...]": "*"}.get(many, "?")
        if many == "?" and "choices" in keywords:
            keywords |= {"const": keywords["choices"][0], "metavar": metavar}
        given = {"dest": dest, "required": bool(required), "default": default}
        keywords |= {key: value for key, value in given.items() if value}
        parser.add_argument(*names.split(","), help=help_text, **keywords)


def names_of(*tables: Callable[[Parser], object]) -> list[str]:
    """Return the options that functions add to a parser, as attributes of parsed arguments."""
    parser = Parser(add_help=False)
    for add in tables:
        add(parser)
    return [action.dest for action in parser.arguments]


def allow(args: argparse.Namespace, when: str, *names: str) -> None:
    """Reject options that would do nothing.

    Args:
        args: parsed arguments; `given` maps those on the command line to what they are called there
        when: when the options are allowed
        names: the options, as attributes of `args`

    Raises:
        InputError: one of them was given
    """
    for name in names:
        if name in args.given:
            raise InputError(f"{args.given[name]}: has no effect here; allowed {when} only")


def allow_overwrite(args: argparse.Namespace, *outputs: str) -> None:
    """Reject --overwrite where no file is written.

    Args:
        args: parsed arguments
        outputs: options that name files to write, as attributes of `args`
    """
    if not any(name in args.given for name in outputs):
        options = " or ".join(f"--{name.replace('_', '-')}" for name in outputs)
        allow(args, f"with {options}", "overwrite")


def add_arm(parser: argparse.ArgumentParser) -> None:
    """Add the arm and its tool."""
    options(parser, """
        arm ARM      built-in arm (see trocar list arms) or TOML file
        --tool TOOL  built-in tool, TOML file, or "none" (default: the tool of the arm's
                     description)
    """)  # fmt: skip


def add_calibration(parser: Arguments) -> None:
    """Add the calibration overlay of one arm."""
    options(parser, """
        --calibration OVERLAY ...
            calibration overlay, replaces nominal geometry (trocar calibrate)
        --dynamics OVERLAY ... as calibration
            dynamics overlay, replaces masses and friction (trocar identify), or built-in: psm,
            mtmr, psm_si_cad, cad (default: identified in a simulation, else the description's, cad)
    """)  # fmt: skip


def add_calibrations(parser: Arguments) -> None:
    """Add the calibration overlays of a rig's arms."""
    options(parser, """
        --calibration [ARM=]OVERLAY ...
            calibration overlay of ARM, or of every arm of its type (repeatable)
        --dynamics [ARM=]OVERLAY ... as calibration
            dynamics overlay of ARM, or of every arm of its type (trocar identify), or built-in:
            psm, mtmr, psm_si_cad, cad (repeatable; default: identified in a simulation, else the
            descriptions', cad)
    """)  # fmt: skip


def add_gains(parser: Arguments) -> None:
    """Add the presets of servo gains and joint friction."""
    options(parser, """
        --control dvrk|paper = dvrk         servo gain preset
        --friction identified|paper = identified  joint friction preset
    """)  # fmt: skip


def add_rig(
    parser: Arguments, rig: str | None = "full_cart", chosen: str = "chosen by command"
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


def add_port(parser: Arguments) -> None:
    """Add the port of the web viewer."""
    options(parser, f"""
        --port N:int = {PORT}  web viewer port (default: {PORT}, 0 = any free port)
    """)  # fmt: skip


def add_origin(parser: Arguments) -> None:
    """Add the origins of web pages that are allowed to connect."""
    options(parser, """
        --origin URL ...  allow web pages of this origin, e.g. http://localhost:3000 (repeatable)
    """)  # fmt: skip


def add_overwrite(parser: Arguments, what: str = "an existing output file") -> None:
    """Add the permission to replace output files."""
    options(parser, f"""
        --overwrite  replace {what}
    """)  # fmt: skip


def add_json(parser: argparse.ArgumentParser) -> None:
    """Add JSON output."""
    options(parser, """
        --json  print the result as one JSON document
    """)  # fmt: skip
