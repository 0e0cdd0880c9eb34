"""Write docs/command-line.md: every command with its options, between the text of a template."""

from __future__ import annotations

import argparse
import re
from collections import Counter
from collections.abc import Collection, Iterable
from pathlib import Path

from trocar.cli.arguments import Parser
from trocar.cli.program import build_parser

ROOT = Path(__file__).parents[2]
TEMPLATE = Path(__file__).with_name("command-line.in.md")
PAGE = ROOT / "docs" / "command-line.md"
#: Options of so many commands, with the same words, stand in one table.
SHARED = 3


def page() -> str:
    """Return the page as Markdown."""
    head, _, rest = TEMPLATE.read_text(encoding="utf-8").partition("<!-- commands -->\n")
    pieces = re.split(r"^<!-- after (\S+) -->\n", rest, flags=re.MULTILINE)[1:]
    after = dict(zip(pieces[::2], (text.strip() for text in pieces[1::2]), strict=True))
    found = build_parser().commands
    unknown = after.keys() - found.keys()
    if unknown:
        raise ValueError(f"{TEMPLATE.name}: no command {', '.join(sorted(unknown))}")
    every = [row for parser in found.values() for row in _rows(parser)]
    shared: dict[str, tuple[str, str]] = {}
    for row, count in Counter(every).most_common():
        if count >= SHARED and row[0].startswith("-"):
            shared.setdefault(row[0].split()[0], row)
    parts = [head.strip(), "## Shared options", *_table(shared.values())]
    for name, parser in found.items():
        parts += [f"## {name}", *_command(f"trocar {name}", parser, shared.values())]
        parts += [after[name]] if name in after else []
    return "\n\n".join(parts) + "\n"


def _command(called: str, parser: Parser, shared: Collection[tuple[str, str]]) -> list[str]:
    """Return what a command does, how it is called, and a table of its options."""
    actions = _arguments(parser)
    options = ["[OPTIONS]"] if any(a.option_strings and not a.required for a in actions) else []
    words = [_usage(a) for a in actions if a.required or not a.option_strings]
    line = " ".join([called, *words, *options])
    parts = [*_description(parser.description or ""), f"```\n{line}\n```"]
    rows = _rows(parser)
    parts += _table(row for row in rows if row not in shared)
    if also := " ".join(name.split()[0] for name, text in rows if (name, text) in shared):
        parts.append(f"[Shared options](#shared-options): `{also}`")
    return [part for part in parts if part]


def _arguments(parser: Parser) -> list[argparse.Action]:
    return [a for a in parser.arguments if a.dest != "help"]


def _rows(parser: Parser) -> list[tuple[str, str]]:
    """Return the name and the help of each argument."""
    return [(_name(action), _help(parser, action)) for action in _arguments(parser)]


def _table(rows: Iterable[tuple[str, str]]) -> list[str]:
    table = [f"| `{name}` | {text} |" for name, text in rows]
    return ["\n".join(["| argument | |", "|---|---|", *table])] if table else []


def _description(text: str) -> list[str]:
    """Return a description as paragraphs, indented lines (a table of keys) as they are."""
    found: list[str] = []
    for block in re.split(r"((?:^ {2,}.*\n?)+)", text, flags=re.MULTILINE):
        if block.startswith("  "):
            found.append(f"```\n{block.rstrip()}\n```")
        elif block.strip():
            found.append(_linked(_escaped(block)))
    return found


def _usage(action: argparse.Action) -> str:
    if not action.option_strings:
        one = _value(action)
        return f"[{one}]" if action.nargs in ("?", "*") else one
    return f"{action.option_strings[-1]} {_value(action)}".strip()


def _name(action: argparse.Action) -> str:
    names = ", ".join(action.option_strings)
    return f"{names} {_value(action)}".strip().replace("|", "\\|")


def _value(action: argparse.Action) -> str:
    if action.nargs == 0:
        return ""
    one = action.metavar or (
        "|".join(map(str, action.choices)) if action.choices else action.dest.upper()
    )
    if isinstance(one, tuple):
        return " ".join(one)
    if isinstance(action.nargs, int):
        return " ".join([one] * action.nargs)
    return f"{one} ..." if action.nargs in ("+", "*") else one


def _help(parser: Parser, action: argparse.Action) -> str:
    text = parser._get_formatter()._expand_help(action) if action.help else ""
    return _linked(_escaped(text))


def _linked(text: str) -> str:
    """Return a text in which the names of pages are links."""
    return re.sub(r"docs/([\w-]+\.md)", r"[\1](\1)", text)


def _escaped(text: str) -> str:
    """Return text of --help as one line of Markdown."""
    return re.sub(r"([|*_<>])", r"\\\1", " ".join(text.split()))


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
