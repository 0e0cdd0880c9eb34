"""The closed-loop paper's Tables 1 to 5 as printed, with their errata as data."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from trocar.descriptions.arms import read_arm
from trocar.descriptions.catalogue import DATA
from trocar.descriptions.records import ArmDescription
from trocar.descriptions.table import read_table
from trocar.errors import UnknownNameError

PRINTED = DATA / "paper"


@dataclass(frozen=True)
class Erratum:
    """One entry of a printed table that is wrong.

    Attributes:
        frame, key: the entry
        printed, mended: what stands there and what should
        effect: what a reader who follows the print gets
        source: how it is known
    """

    frame: str
    key: str
    printed: float | str
    mended: float | str
    effect: str
    source: str


def printed_tables() -> tuple[str, ...]:
    """Return the names of the printed tables."""
    return tuple(sorted(path.stem for path in PRINTED.glob("*.toml")))


def load_printed(table: str) -> ArmDescription:
    """Load a table as it is printed; kinematics only.

    Raises:
        UnknownNameError: no such table; the known ones are listed
    """
    return read_arm(read_table(_path(table)), None)


def errata(table: str) -> tuple[Erratum, ...]:
    """Return what is wrong in a printed table."""
    rows = read_table(_path(table)).tables("erratum")
    return tuple(
        Erratum(
            row.text("frame"),
            row.text("key"),
            row.raw("printed"),
            row.raw("mended"),
            row.text("effect"),
            row.text("source"),
        )
        for row in rows
    )


def _path(table: str) -> Path:
    if table not in printed_tables():
        raise UnknownNameError("printed table", table, printed_tables())
    return PRINTED / f"{table}.toml"
