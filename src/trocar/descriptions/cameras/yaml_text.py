"""Read the YAML that calibration files are written in, without a library.

What ROS's and OpenCV's tools write, and what people make of it by hand: maps and lists by
indentation or in brackets, over several lines, numbers, texts, comments, tags (which are passed
over). Anchors and texts over several lines are refused.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any, cast

from trocar.errors import DescriptionError

#: Source: YAML 1.1, and what OpenCV writes (".Nan", "1.").
NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?")
WORDS: dict[str, Any] = {
    "": None, "~": None, "null": None, "true": True, "false": False,
    ".nan": float("nan"), ".inf": float("inf"), "-.inf": float("-inf"),
}  # fmt: skip
KEY = re.compile(r"""("[^"]*"|'[^']*'|[^\s\[\]{}"',#&*][^\[\]{}:]*?)\s*:(?=\s|$)""")
TAG = re.compile(r"!\S*\s*")


@dataclass(frozen=True)
class _Line:
    """A line, or those that a pair of brackets joins: its number, indent and text."""

    number: int
    indent: int
    text: str


def parse_yaml(text: str, file: str) -> dict[str, Any]:
    """Return the map that a YAML file holds.

    Raises:
        DescriptionError: naming the line that cannot be understood
    """
    lines = _lines(text, file)
    if not lines:
        raise DescriptionError(file, "", "is empty; allowed: a camera's calibration in YAML")
    value, rest = _block(lines, 0, file)
    if rest < len(lines):
        raise _fail(file, lines[rest], "is indented less than what it stands in")
    if not isinstance(value, dict):
        raise _fail(file, lines[0], "is no key with a value")
    return cast(dict[str, Any], value)


def _lines(text: str, file: str) -> list[_Line]:
    found: list[_Line] = []
    for number, raw in enumerate(text.splitlines(), 1):
        bare = _without_comment(raw).rstrip()
        if found and _depth(found[-1].text) > 0:
            last = found.pop()
            found.append(_Line(last.number, last.indent, f"{last.text} {bare.strip()}".rstrip()))
        elif bare.strip() and not bare.startswith(("%", "---", "...")):
            indent = len(bare) - len(bare.lstrip(" "))
            if bare[indent] == "\t":
                raise DescriptionError(file, f"line {number}", "is indented by a tabulator")
            found.append(_Line(number, indent, bare.strip()))
    if found and _depth(found[-1].text) != 0:
        raise _fail(file, found[-1], "has a bracket that is never closed")
    return found


def _without_comment(line: str) -> str:
    quote = ""
    for at, sign in enumerate(line):
        if quote:
            quote = "" if sign == quote else quote
        elif sign in "\"'":
            quote = sign
        elif sign == "#" and (at == 0 or line[at - 1] in " \t"):
            return line[:at]
    return line


def _depth(text: str) -> int:
    bare = re.sub(r"\"[^\"]*\"|'[^']*'", "", text)
    return sum(bare.count(sign) for sign in "[{") - sum(bare.count(sign) for sign in "]}")


def _block(lines: list[_Line], at: int, file: str) -> tuple[Any, int]:
    """Return the map, list or value that begins at a line, and the line after it."""
    first = lines[at]
    if _is_item(first.text):
        return _items(lines, at, file)
    if KEY.match(first.text) is None:
        return _value(first.text, file, first), at + 1
    found: dict[str, Any] = {}
    while at < len(lines) and lines[at].indent == first.indent:
        line = lines[at]
        key = KEY.match(line.text)
        if key is None:
            raise _fail(file, line, "is no key with a value")
        name, rest = key.group(1).strip("\"'"), TAG.sub("", line.text[key.end() :].strip(), 1)
        if name in found:
            raise _fail(file, line, f"has {name!r} a second time")
        at += 1
        inside = at < len(lines) and (
            lines[at].indent > line.indent
            or (lines[at].indent == line.indent and _is_item(lines[at].text))
        )
        if not rest and inside:
            found[name], at = _block(lines, at, file)
        else:
            found[name] = _value(rest, file, line)
    if at < len(lines) and lines[at].indent > first.indent:
        raise _fail(file, lines[at], "is indented more than what it stands in")
    return found, at


def _items(lines: list[_Line], at: int, file: str) -> tuple[list[Any], int]:
    found: list[Any] = []
    first = lines[at]
    while at < len(lines) and lines[at].indent == first.indent and _is_item(lines[at].text):
        line = lines[at]
        found.append(_value(line.text[1:].strip(), file, line))
        at += 1
    return found, at


def _is_item(text: str) -> bool:
    return text == "-" or text.startswith("- ")


def _value(text: str, file: str, line: _Line) -> Any:
    value, rest = _flow(TAG.sub("", text.strip(), 1) if text.startswith("!") else text, file, line)
    if rest.strip():
        raise _fail(file, line, f"has {rest.strip()!r} after its value")
    return value


def _flow(text: str, file: str, line: _Line) -> tuple[Any, str]:
    """Return the value that a text begins with, and what follows it."""
    text = text.lstrip()
    if text[:1] in ("[", "{"):
        return _bracket(text, file, line)
    if text[:1] in ("&", "*", "|", ">"):
        raise _fail(file, line, f"has {text[:1]!r}, which a calibration needs not")
    if text[:1] in ('"', "'"):
        end = text.find(text[0], 1)
        if end < 0:
            raise _fail(file, line, "has a quote that is never closed")
        return text[1:end], text[end + 1 :]
    end = len(text)
    if _depth(line.text) == 0 and any(sign in line.text for sign in "[{"):
        end = next((i for i, sign in enumerate(text) if sign in ",]}"), end)
    return _scalar(text[:end].strip()), text[end:]


def _bracket(text: str, file: str, line: _Line) -> tuple[Any, str]:
    """Return a list or map in brackets, and what follows it."""
    close = "]" if text[0] == "[" else "}"
    items: list[Any] = []
    pairs: dict[str, Any] = {}
    rest = text[1:].lstrip()
    while not rest.startswith(close):
        if close == "}":
            key = KEY.match(rest)
            if key is None:
                raise _fail(file, line, "has braces without key and value")
            pairs[key.group(1).strip("\"'")], rest = _flow(rest[key.end() :], file, line)
        else:
            value, rest = _flow(rest, file, line)
            items.append(value)
        rest = rest.lstrip()
        if rest.startswith(","):
            rest = rest[1:].lstrip()
        elif not rest.startswith(close):
            raise _fail(file, line, f"has no {close!r} or ',' where one is needed")
    return (items if close == "]" else pairs), rest[1:]


def _scalar(text: str) -> Any:
    if text.lower() in WORDS:
        return WORDS[text.lower()]
    if NUMBER.fullmatch(text):
        return int(text) if re.fullmatch(r"[-+]?\d+", text) else float(text)
    return text


def _fail(file: str, line: _Line, problem: str) -> DescriptionError:
    return DescriptionError(file, f"line {line.number}", problem)
