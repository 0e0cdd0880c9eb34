"""The closed-loop paper's Tables 1 to 5 as printed, Tables 6 and 7; errata of sources as data."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from trocar.descriptions.arms import read_arm
from trocar.descriptions.catalogue import DATA, find, names
from trocar.descriptions.keys import key as toml_key
from trocar.descriptions.records import ArmDescription
from trocar.descriptions.table import read_table
from trocar.errors import UnknownNameError

PRINTED = DATA / "paper"


Vector = tuple[float, float, float]

#: {type of arm: {axes: distance}}, of the hardware [m]. Source: closed-loop paper, Table 6.
TABLE6: dict[str, dict[str, float]] = {
    "PSM": {
        "3-4": 0.0958,
        "3-6": 0.1487,
        "4-c1": 0.1500,
        "6-c1": 0.0961,
        "3-7": 0.1842,
        "6-8": 0.5152,
        "7-c2": 0.5166,
        "6-7": 0.0365,
    },
    "ECM": {
        "3-4": 0.0373,
        "3-6": 0.3047,
        "4-c1": 0.3038,
        "6-c1": 0.0380,
        "3-7": 0.3416,
        "6-8": 0.3392,
        "7-c2": 0.3409,
        "6-7": 0.0374,
    },
}
#: Difference of the lengths of the paper's own models from its measurements: 3-6 of the PSM,
#: 0.150 m against 0.1487 m, the hundredth for rounding. Source: closed-loop paper, Tables 4 and 6.
TABLE6_SPREAD_M = 1.31e-3


@dataclass(frozen=True)
class PaperRcm:
    """A row of Table 7: where the remote centre is, and the RMS of where it was seen [m]."""

    position: Vector
    rms: Vector


#: {type of arm: (hardware, the paper's simulation)}. The positions are printed in mm, and so are
#: the RMS errors, whatever the garbled head of the table says. Source: closed-loop paper, Table 7.
TABLE7: dict[str, tuple[PaperRcm, PaperRcm]] = {
    "PSM": (
        PaperRcm((-1.49e-3, -516.11e-3, 2.19e-3), (0.62e-3, 0.62e-3, 0.31e-3)),
        PaperRcm((0.56e-3, -518.60e-3, 0.93e-3), (0.85e-3, 1.91e-3, 1.08e-3)),
    ),
    "ECM": (
        PaperRcm((341.11e-3, -0.08e-3, -3.39e-3), (3.72e-3, 2.45e-3, 1.33e-3)),
        PaperRcm((338.44e-3, -0.05e-3, -0.54e-3), (2.17e-3, 1.14e-3, 0.85e-3)),
    ),
}
#: Distance of the paper's simulation from its hardware [m]. Source: closed-loop paper, 4.2.
TABLE7_ERROR_M = {"PSM": 3.46e-3, "ECM": 3.91e-3}


@dataclass(frozen=True)
class Erratum:
    """One entry of a source that is wrong.

    Attributes:
        frame, key: the entry, of a frame or of the joint of that name
        printed, mended: the value in print, the right one
        effect: of the printed value
        source: of the right value
    """

    frame: str = field(metadata=toml_key())
    key: str = field(metadata=toml_key())
    printed: float | str = field(metadata=toml_key(form="any"))
    mended: float | str = field(metadata=toml_key(form="any"))
    effect: str = field(metadata=toml_key())
    source: str = field(metadata=toml_key())


def printed_tables() -> tuple[str, ...]:
    """Return the names of the printed tables."""
    return tuple(sorted(path.stem for path in PRINTED.glob("*.toml")))


def load_printed(table: str) -> ArmDescription:
    """Load a table as it is printed; kinematics only.

    Raises:
        UnknownNameError: no such table; the known ones are listed
    """
    return read_arm(read_table(_path(table)), None)


def errata(name: str) -> tuple[Erratum, ...]:
    """Return the errata of a printed table, or of the source of a built-in arm.

    Raises:
        UnknownNameError: neither; the known ones are listed
    """
    path = find("arms", name) if name in names("arms") else _path(name)
    rows = read_table(path).tables("erratum")
    return tuple(row.record(Erratum) for row in rows)


def _path(table: str) -> Path:
    if table not in printed_tables():
        raise UnknownNameError("printed table", table, printed_tables())
    return PRINTED / f"{table}.toml"
