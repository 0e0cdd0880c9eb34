"""Text files of numbers: CSV of any separator, plain or gzip, with or without a header."""

from __future__ import annotations

import gzip
import io
import math
import re
import zlib
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import TextIO

import numpy as np
from numpy.typing import NDArray

from trocar.errors import LogError
from trocar.recording.bags import FORMATS

Array = NDArray[np.float64]

#: Formats of recordings that are read.
READABLE = (
    f"a recording of trocar's own (MCAP), a text file of numbers (plain or gzip), {FORMATS}, a"
    " dataset of LeRobot's or one of its Parquet files"
)
#: Longest row [characters]. Source: our own choice; 76 columns take some 1000.
LONGEST_LINE = 1 << 16
#: Words for a number that was not recorded. Source: pandas, MATLAB and spreadsheets.
MISSING = frozenset({"", "nan", "na", "n/a", "null", "none", "-", "#n/a"})
COMMENT = "#%/"
#: Several numbers in one field: "[0.1, 0.2]". Source: rosbag to CSV converters.
LIST = re.compile(r"\"?[\[(]\s*([-+.\d][^\])]*)[\])]\"?")
QUOTED = re.compile(r"\"([^\"]*)\"")
#: Stands for a comma inside quotes while a row is split.
INNER = "\x1f"


@dataclass(frozen=True, eq=False)
class NumberTable:
    """Numbers by rows and columns.

    Attributes:
        file: its path, as given
        names: of the columns, empty without a header
        values: (k, c); NaN where a field is no number
        rows: numbers of the rows in the file, from 1, (k,)
        texts: {column: row and text of its first field that is neither a number nor empty}
        holes: {column: row and text of its first field that is empty or not finite}
        notes: rows that were left out
    """

    file: str
    names: tuple[str, ...]
    values: Array
    rows: NDArray[np.int64]
    texts: dict[int, tuple[int, str]] = field(default_factory=dict[int, tuple[int, str]])
    holes: dict[int, tuple[int, str]] = field(default_factory=dict[int, tuple[int, str]])
    notes: tuple[str, ...] = ()


def read_table(path: str | Path, most_rows: int | None = None) -> NumberTable:
    """Read a text file of numbers.

    Commas, semicolons (then with decimal commas), tabs or spaces separate fields. Lines that begin
    with #, % or // are comments; one of them with as many fields as the rows is the header, and so
    is a first row with words. A row that breaks off at the end of the file is left out.

    Args:
        path: the file
        most_rows: rows to read; all of them when omitted

    Raises:
        LogError: no such file, truncated, no text, or rows of different lengths; the row is named
    """
    file = str(path)
    header: tuple[str, ...] = ()
    comments: list[str] = []
    split: _Splitter | None = None
    rows: list[list[float]] = []
    numbers: list[int] = []
    texts: dict[int, tuple[int, str]] = {}
    holes: dict[int, tuple[int, str]] = {}
    short: tuple[int, int] | None = None
    for number, line in _lines(path):
        if line.lstrip()[:1] in COMMENT:
            comments.append(line.strip().lstrip(COMMENT).strip())
            continue
        if split is None:
            split = _Splitter.of(line)
        fields = split(line)
        if not rows and not _numeric(fields):
            units = len(fields) == len(header)  # a second row of words
            header = tuple(f"{n} {u}" for n, u in zip(header, fields, strict=True)) if units else (
                tuple(fields)
            )  # fmt: skip
            continue
        fields, header = _spread(fields, header)
        if short is not None or (rows and len(fields) != len(rows[0])):
            if short is not None or len(fields) > len(rows[0]):
                bad, count = short or (number, len(fields))
                raise LogError(file, f"got {count} columns; allowed: {len(rows[0])}", bad)
            short = number, len(fields)
            continue
        values: list[float] = []
        for column, text in enumerate(fields):
            try:
                value = float(text)
            except ValueError:
                value = math.nan
                if text.lower() not in MISSING:
                    texts.setdefault(column, (number, text[:40]))
            if not math.isfinite(value):
                holes.setdefault(column, (number, text[:40]))
                value = math.nan
            values.append(value)
        rows.append(values)
        numbers.append(number)
        if len(rows) == most_rows:
            break
    if rows and not header and split is not None:
        fitting = [c for c in comments if len(split(c)) == len(rows[0]) > 1]
        header = tuple(split(fitting[-1])) if fitting else ()
    if header and rows:
        if len(header) > len(rows[0]):
            raise LogError(
                file, f"the header has {len(header)} columns; its first row has {len(rows[0])}", 1
            )
        header = _grouped([*header, *[""] * (len(rows[0]) - len(header))])
    notes = (f"row {short[0]} breaks off and was left out",) if short else ()
    values_of = np.array(rows, np.float64) if rows else np.zeros((0, len(header)))
    return NumberTable(file, header, values_of, np.array(numbers, np.int64), texts, holes, notes)


@dataclass(frozen=True)
class _Splitter:
    """Cuts rows into fields.

    Attributes:
        separator: between fields; None: spaces
    """

    separator: str | None

    @classmethod
    def of(cls, line: str) -> _Splitter:
        """Find the separator of a row."""
        bare = LIST.sub("0", line)
        return cls(next((c for c in ";,\t" if c in bare), None))

    def __call__(self, line: str) -> list[str]:
        if '"' in line or "[" in line or "(" in line:
            line = LIST.sub(lambda m: m[0].replace(",", INNER).replace(" ", INNER), line)
            line = QUOTED.sub(lambda m: m[1].replace(",", INNER), line)
        if self.separator == ";":
            line = line.replace(",", ".")
        fields = [part.strip() for part in line.split(self.separator)]
        if len(fields) > 1 and not fields[-1] and self.separator is not None:
            fields.pop()  # a separator at the end of the row
        return [part.replace(INNER, " ") for part in fields]


def _spread(fields: list[str], header: tuple[str, ...]) -> tuple[list[str], tuple[str, ...]]:
    """Spread fields of several numbers over as many columns: "q" becomes "q[0]", "q[1]", ..."""
    if not any("[" in part or "(" in part for part in fields):
        return fields, header
    spread: list[str] = []
    names: list[str] = []
    same = len(header) == len(fields)
    for place, part in enumerate(fields):
        found = LIST.fullmatch(part)
        inside = found[1].split() if found else [part]
        spread += inside
        if same:
            name = header[place]
            names += [f"{name}[{k}]" for k in range(len(inside))] if found else [name]
    return spread, tuple(names) if same else header


def _grouped(names: Sequence[str]) -> tuple[str, ...]:
    """Number the columns of a name that blank ones follow: "q", "" become "q[0]", "q[1]"."""
    found: list[str] = []
    name, count = "", 0
    for place, text in enumerate(names):
        name, count = (text, 0) if text else (name, count + 1)
        group = not text or (place + 1 < len(names) and not names[place + 1])
        found.append(f"{name}[{count}]" if name and group else text)
    return tuple(found)


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _numeric(fields: Sequence[str]) -> bool:
    """Return whether a row's fields are numbers, but for a few labels beside them."""
    plain = [part for part in fields if part.lower() not in MISSING]
    return any(_is_number(part) or LIST.fullmatch(part) for part in plain) or not plain


def _lines(path: str | Path) -> Iterator[tuple[int, str]]:
    """Give (row from 1, text) of a plain or gzip file; blank rows may only stand at its end."""
    file, number, blank = str(path), 0, 0
    try:
        with ExitStack() as stack:
            stream = _open(path, stack)
            while line := stream.readline(LONGEST_LINE):
                number += 1
                if "\0" in line:
                    raise LogError(file, "is not text; allowed: rows of numbers", number)
                if len(line) >= LONGEST_LINE:
                    raise LogError(file, "is not a table of numbers: row too long", number)
                if not line.strip():
                    blank = blank or number
                    continue
                if blank:
                    raise LogError(
                        file, "row is blank; allowed: at the end of the file only", blank
                    )
                yield number, line
    except (EOFError, zlib.error, gzip.BadGzipFile) as error:
        raise LogError(file, f"gzip data is truncated or damaged ({error})", number + 1) from error
    except OSError as error:
        raise LogError(file, f"cannot be read: {error.strerror or error}") from error


def _open(path: str | Path, stack: ExitStack) -> TextIO:
    """Open a file as text, unpacked when it is gzip whatever its name says."""
    where = Path(path).expanduser()
    if not where.is_file():
        what = "is a folder" if where.is_dir() else "no such file"
        raise LogError(str(path), f"{what}; allowed: {READABLE}")
    raw = stack.enter_context(where.open("rb"))
    head = raw.read(2)
    raw.seek(0)
    if head in (b"\xff\xfe", b"\xfe\xff"):
        return stack.enter_context(io.TextIOWrapper(raw, encoding="utf-16", errors="replace"))
    plain = stack.enter_context(gzip.GzipFile(fileobj=raw)) if head == b"\x1f\x8b" else raw
    return stack.enter_context(io.TextIOWrapper(plain, encoding="utf-8-sig", errors="replace"))
