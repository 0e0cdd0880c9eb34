"""Write docs/command-line.md: every command with its options, between the text of a template."""

from __future__ import annotations

import argparse
import re
from pathlib import Path

from trocar.cli.program import build_parser

ROOT = Path(__file__).parents[2]
TEMPLATE = Path(__file__).with_name("command-line.in.md")
PAGE = ROOT / "docs" / "command-line.md"


def page() -> str:
    """Return the page as Markdown."""
    head, _, rest = TEMPLATE.read_text(encoding="utf-8").partition("<!-- commands -->\n")
    pieces = re.split(r"^<!-- after (\S+) -->\n", rest, flags=re.MULTILINE)[1:]
    after = dict(zip(pieces[::2], (text.strip() for text in pieces[1::2]), strict=True))
    found = _subparsers(build_parser())
    unknown = after.keys() - found.keys()
    if unknown:
        raise ValueError(f"{TEMPLATE.name}: no command {', '.join(sorted(unknown))}")
    parts = [head.strip()]
    for name, parser in found.items():
        parts += [f"## {name}", *_command(f"trocar {name}", parser)]
        parts += [after[name]] if name in after else []
    return "\n\n".join(parts) + "\n"


def _subparsers(parser: argparse.ArgumentParser) -> dict[str, argparse.ArgumentParser]:
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            return dict(action.choices)
    return {}


def _command(called: str, parser: argparse.ArgumentParser) -> list[str]:
    """Return what a command does, how it is called, and a table of its options."""
    inner = _subparsers(parser)
    rows = [a for a in parser._actions if a.help != argparse.SUPPRESS and a.dest != "help"]
    rows = [a for a in rows if not isinstance(a, argparse._SubParsersAction)]
    options = ["[OPTIONS]"] if any(a.option_strings and not a.required for a in rows) else []
    words = [_usage(a) for a in rows if a.required or not a.option_strings]
    line = " ".join([called, *words, *options, *(["COMMAND ..."] if inner else [])])
    parts = [*_description(parser.description or ""), f"```\n{line}\n```"]
    if rows:
        table = [f"| `{_name(a)}` | {_help(parser, a)} |" for a in rows]
        parts.append("\n".join(["| argument | |", "|---|---|", *table]))
    for name, one in inner.items():
        parts += [
            f"### {called.removeprefix('trocar ')} {name}",
            *_command(f"{called} {name}", one),
        ]
    return [part for part in parts if part]


def _description(text: str) -> list[str]:
    """Return a description as paragraphs, indented lines (a table of keys) as they are."""
    found: list[str] = []
    for block in re.split(r"((?:^ {2,}.*\n?)+)", text, flags=re.MULTILINE):
        if block.startswith("  "):
            found.append(f"```\n{block.rstrip()}\n```")
        elif block.strip():
            found.append(_escaped(block))
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


def _help(parser: argparse.ArgumentParser, action: argparse.Action) -> str:
    text = parser._get_formatter()._expand_help(action) if action.help else ""
    return _escaped(text)


def _escaped(text: str) -> str:
    """Return text of --help as one line of Markdown."""
    return re.sub(r"([|*_<>])", r"\\\1", " ".join(text.split()))


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
