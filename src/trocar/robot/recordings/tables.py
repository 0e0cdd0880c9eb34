"""Files of numbers: CSV of any separator and header, plain or gzip, and arrays of NumPy's."""

from __future__ import annotations

import gzip
import io
import math
import re
import zlib
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import TextIO

import numpy as np
from numpy.typing import NDArray

from trocar.errors import LogError
from trocar.recording.bags import FORMATS

Array = NDArray[np.float64]

#: Formats of recordings that are read.
READABLE = (
    "a recording of trocar's own (MCAP), a text file of numbers (plain or gzip), an array (.npy),"
    f" {FORMATS}, a dataset of LeRobot's or one of its Parquet files"
)
#: {first bytes of a file that is no text: kind, way to a table}. Source: the formats' documents.
OTHER_KINDS = {
    b"\xd0\xcf\x11\xe0": ("a spreadsheet (.xls)", "save it as CSV"),
    b"PK\x03\x04": ("a spreadsheet (.xlsx) or another archive", "save it as CSV"),
    b"MATLAB 5.0": ("a MAT-file", "write its table with writematrix, as CSV"),
    b"\x89HDF": ("an HDF5 file", "write its tables as CSV"),
    b"\x80\x04\x95": ("a pickle", "write its table as CSV"),
    b"\x80\x03": ("a pickle", "write its table as CSV"),
}
#: Longest row [characters]. Source: our own choice; 76 columns take some 1000.
LONGEST_LINE = 1 << 16
#: Lines before the header of a table that are left out. Source: our own choice.
MOST_BEFORE = 20
#: Words for a number that was not recorded. Source: pandas, MATLAB and spreadsheets.
MISSING = frozenset({"", "nan", "na", "n/a", "null", "none", "-", "#n/a"})
COMMENT = "#%/"
#: Times as dates, beside those of ISO 8601; a time of day alone is on one and the same day. Source:
#: rosbag to CSV converters, MATLAB's datetime, spreadsheets.
DATES = (
    "%Y/%m/%d/%H:%M:%S.%f", "%Y/%m/%d %H:%M:%S.%f", "%d-%b-%Y %H:%M:%S.%f", "%d-%b-%Y %H:%M:%S",
    "%m/%d/%Y %H:%M:%S.%f", "%d/%m/%Y %H:%M:%S.%f", "%d.%m.%Y %H:%M:%S.%f", "%Y-%m-%d-%H-%M-%S.%f",
    "%Y%m%d_%H%M%S_%f", "%H:%M:%S.%f",
)  # fmt: skip
#: Several numbers in one field: "[0.1, 0.2]". Source: rosbag to CSV converters.
LIST = re.compile(r"\"?[\[(]\s*([-+.\d][^\])]*)[\])]\"?")
QUOTED = re.compile(r"\"([^\"]*)\"")
#: Stands for a comma inside quotes while a row is split.
INNER = "\x01"


@dataclass(frozen=True, eq=False)
class NumberTable:
    """Numbers by rows and columns.

    Attributes:
        file: its path, as given
        names: of the columns, empty without a header
        values: (k, c); NaN where a field is no number
        rows: numbers of the rows in the file, from 1, (k,)
        texts: {column: row and text of its first field that is neither a number nor empty}
        dates: columns of dates, in s
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
    dates: frozenset[int] = frozenset()


def read_table(path: str | Path, most_rows: int | None = None) -> NumberTable:
    """Read a text file of numbers.

    Commas, semicolons (then with decimal commas), tabs or spaces separate fields. Lines that begin
    with #, % or // are comments; one of them with as many fields as the rows is the header, and so
    are the rows of words before the numbers: group, name, unit. Up to `MOST_BEFORE` shorter lines
    before the header, and a row that breaks off at the end of the file, are left out.

    Args:
        path: the file
        most_rows: rows to read; all of them when omitted

    Raises:
        LogError: no such file, truncated, no text, or rows of different lengths; the row is named
    """
    file = str(path)
    if Path(file).suffix.lower() == ".npy":
        return _read_array(file, most_rows)
    read = _Rows(file)
    for number, line in _lines(path):
        read.line(number, line)
        if len(read.rows) == most_rows:
            break
    return read.table()


def _read_array(file: str, most_rows: int | None) -> NumberTable:
    """Read an array of NumPy's, a sample a row."""
    try:
        values = np.load(Path(file).expanduser(), allow_pickle=False)
        values = np.asarray(values, np.float64)
    except (OSError, ValueError, EOFError, TypeError) as error:
        raise LogError(file, f"cannot be read: {error}") from None
    if values.ndim != 2:
        raise LogError(file, f"has {values.ndim} dimensions; allowed: 2, a sample a row")
    values = values[:most_rows]
    holes = {int(k): (int(np.flatnonzero(~np.isfinite(values[:, k]))[0]) + 1, "nan")
             for k in np.flatnonzero(~np.isfinite(values).all(axis=0))}  # fmt: skip
    values = np.where(np.isfinite(values), values, np.nan)
    return NumberTable(file, (), values, np.arange(1, len(values) + 1), {}, holes)


class _Rows:
    """Lines of a table, read one after the other.

    Args:
        file: for errors
    """

    def __init__(self, file: str) -> None:
        self.file = file
        self.rows: list[list[float]] = []
        self._numbers: list[int] = []
        self._heads: list[list[str]] = []  # rows of words
        self._comments: list[str] = []
        self._split: _Splitter | None = None
        self._texts: dict[int, tuple[int, str]] = {}
        self._holes: dict[int, tuple[int, str]] = {}
        self._dates: dict[int, str] = {}  # formats by column, "" for ISO 8601
        self._short: tuple[int, int] | None = None
        self._blank = self._before = self._again = 0
        self._indexed = False

    def line(self, number: int, line: str) -> None:
        """Read a line."""
        if not line.strip():
            self._blank = self._blank or (number if self.rows else 0)
            return
        if line.lstrip()[:1] in COMMENT:
            self._comments.append(line.strip().lstrip(COMMENT).strip())
            return
        split = _Splitter.of(line) if self._split is None or not self.rows else self._split
        fields = split(line)
        if 0 < len(self.rows) <= MOST_BEFORE and self._begins(line, len(fields)):
            split = _Splitter.of(line)
            fields = split(line)
            self._before += len(self.rows) + len(self._heads)
            self.rows, self._numbers, self._heads = [], [], []
            self._texts, self._holes, self._short, self._blank = {}, {}, None, 0
            self._dates = {}
        if self._blank:
            raise LogError(
                self.file, "row is blank; allowed: at the end of the file only", self._blank
            )
        self._split = split
        if not self.rows and (not any(fields) or self._counts(fields)):
            return
        if not self.rows and (not _numeric(fields) or self._numbered(fields)):
            if self._heads and not 0 <= len(fields) - len(self._heads[-1]) <= 1:
                self._before += len(self._heads)
                self._heads = []
            self._heads.append(fields)
            return
        if self.rows and fields in self._heads:
            self._again += 1
            return
        if self._indexed:
            fields = fields[1:]
        if len(self._heads) == 1:
            fields, self._heads[0] = _spread(fields, self._heads[0])
        else:
            fields, _ = _spread(fields, [])
        if self._short is not None or (self.rows and len(fields) != len(self.rows[0])):
            if self._short is not None or len(fields) > len(self.rows[0]):
                bad, count = self._short or (number, len(fields))
                raise LogError(self.file, f"got {count} columns; allowed: {len(self.rows[0])}", bad)
            self._short = number, len(fields)
            return
        self._add(number, fields)

    def _begins(self, line: str, count: int) -> bool:
        """Return whether the table begins at this line; rows before it are then a preamble.

        Args:
            line: the line
            count: of its fields, cut as those before
        """
        own, width = _Splitter.of(line)(line), len(self.rows[0])
        return (len(own) > width and not _numeric(own)) or width <= 2 < count

    def _counts(self, fields: list[str]) -> bool:
        """Return whether fields are the numbers of columns, as pandas writes them."""
        counted = [str(k) for k in range(len(fields))]
        if self._heads or len(fields) < 3 or self._indexed:
            return False
        self._indexed = fields == ["", *counted[:-1]]
        return self._indexed or fields == counted

    def _numbered(self, fields: list[str]) -> bool:
        """Return whether fields are a header's numbers of joints: "time", "1", "2", "3"."""
        first, rest = fields[0], fields[1:]
        counts = ([str(k + start) for k in range(len(rest))] for start in (0, 1))
        return bool(self._heads) and not _is_number(first) and len(rest) > 1 and rest in counts

    def _add(self, number: int, fields: list[str]) -> None:
        values: list[float] = []
        for column, text in enumerate(fields):
            try:
                value = float(text)
            except ValueError:
                value = self._date(column, text)
                if math.isnan(value) and text.lower() not in MISSING:
                    self._texts.setdefault(column, (number, text[:40]))
            if not math.isfinite(value):
                self._holes.setdefault(column, (number, text[:40]))
                value = math.nan
            values.append(value)
        self.rows.append(values)
        self._numbers.append(number)

    def _date(self, column: int, text: str) -> float:
        """Return a date in s, NaN of other text; a column has the format of its first date."""
        if text.count(":") < 2 and "_" not in text and text.count("-") < 5:
            return math.nan
        known = self._dates.get(column)
        for form in ("", *DATES) if known is None else (known,):
            try:
                if form:
                    when = datetime.strptime(text, form).replace(tzinfo=UTC)
                else:
                    when = datetime.fromisoformat(text)
            except ValueError:
                continue
            self._dates[column] = form
            return (when if when.tzinfo else when.replace(tzinfo=UTC)).timestamp()
        return math.nan

    def table(self) -> NumberTable:
        """Return the lines as a table.

        Raises:
            LogError: the header has more columns than the rows
        """
        rows, split = self.rows, self._split
        header = _joined(self._heads)
        if rows and not header and split is not None:
            fitting = [c for c in self._comments if len(split(c)) == len(rows[0]) > 1]
            header = tuple(split(fitting[-1])) if fitting else ()
        if header and rows:
            if len(header) > len(rows[0]):
                raise LogError(
                    self.file,
                    f"the header has {len(header)} columns; its first row has {len(rows[0])}",
                    1,
                )
            header = _grouped([*header, *[""] * (len(rows[0]) - len(header))])
        notes: list[str] = []
        if self._before and rows:
            notes.append(f"{self._before} lines before the table left out")
        if self._again:
            notes.append(f"the header written again {self._again} times left out")
        if self._short:
            notes.append(f"row {self._short[0]} breaks off and was left out")
        values = np.array(rows, np.float64) if rows else np.zeros((0, len(header)))
        numbers = np.array(self._numbers, np.int64)
        return NumberTable(
            self.file, header, values, numbers, self._texts, self._holes, tuple(notes),
            frozenset(self._dates),
        )  # fmt: skip


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


def _spread(fields: list[str], header: list[str]) -> tuple[list[str], list[str]]:
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
    return spread, names if same else header


def _joined(heads: Sequence[Sequence[str]]) -> tuple[str, ...]:
    """Join the rows of a header; a name of all but the last holds for the blank fields after it."""
    width = max(map(len, heads), default=0)
    names = [""] * width
    for place, head in enumerate(heads):
        name = ""
        for column, text in enumerate([*head, *[""] * (width - len(head))]):
            name = text if text or place + 1 == len(heads) else name
            names[column] = f"{names[column]} {name}".strip()
    return tuple(names)


def _grouped(names: Sequence[str]) -> tuple[str, ...]:
    """Number neighbours of one name, and blank ones after it: "q", "" become "q[0]", "q[1]"."""
    found: list[str] = []
    name, count = "", 0
    for place, text in enumerate(names):
        same = not text or text == name
        name, count = (name, count + 1) if same else (text, 0)
        group = same or (place + 1 < len(names) and names[place + 1] in ("", text))
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
    """Give (row from 1, text) of a plain or gzip file."""
    file, number = str(path), 0
    try:
        with ExitStack() as stack:
            stream = _open(path, stack)
            while line := stream.readline(LONGEST_LINE):
                number += 1
                if "\0" in line:
                    raise LogError(file, "is not text; allowed: rows of numbers", number)
                if len(line) >= LONGEST_LINE:
                    raise LogError(file, "is not a table of numbers: row too long", number)
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
    head = raw.read(10)
    raw.seek(0)
    for start, (what, way) in OTHER_KINDS.items():
        if head.startswith(start):
            raise LogError(str(path), f"is {what}: {way}")
    head = head[:2]
    if head in (b"\xff\xfe", b"\xfe\xff"):
        return stack.enter_context(io.TextIOWrapper(raw, encoding="utf-16", errors="replace"))
    plain = stack.enter_context(gzip.GzipFile(fileobj=raw)) if head == b"\x1f\x8b" else raw
    return stack.enter_context(io.TextIOWrapper(plain, encoding="utf-8-sig", errors="replace"))
