"""Thread as a chain of rigid links, which jaws can grasp: its dimensions from TOML."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from trocar.descriptions.table import Table, read_table

DATA = Path(__file__).parent / "data" / "threads.toml"
#: Length of a link. Source: measured: with 3 mm a thread that is dragged takes twice as long. [m]
LINK_M = 4e-3
#: Links of a thread at most. Source: our own choice; 60 that lie on the table take 2 ms a step.
MOST_LINKS = 60
#: Modulus of bending. Source: usual for monofilaments of nylon and polypropylene (1 to 4 GPa), from
#: no data sheet; braided thread bends more easily. [Pa]
MODULUS_PA = 2e9
#: Coefficient of friction. Source: our own choice, of the order that is usual for thread on steel;
#: it depends on load and material (Surg Gynecol Obstet 161:12, 1985).
FRICTION = 0.2
#: Largest tension that a thread bears steadily in steps of 1 ms. Source: our own choice; thread
#: slips out of jaws below 8 N, and closes wounds with 2 N. [N]
TENSION_N = 5.0
#: Mass of a thread, some two hundred times that of a real one: tension acts with the delay of a
#: step, which lighter links do not bear. Source: our own choice. [kg/m]
HEAVY_KG_M = 0.01


@dataclass(frozen=True)
class ChainThread:
    """Thread that bends and does not stretch; it lies along its prop's x axis from the origin.

    Attributes:
        length, diameter: [m]
        links: of which it is made
        rigidity: of bending: modulus times second moment of area [N m^2]
        friction: coefficient towards everything
        tension: largest one that it bears steadily [N]
        mass: of all [kg]
        knots: whether it touches itself
        material: name of a row in `materials`
    """

    length: float
    diameter: float
    links: int
    rigidity: float
    friction: float
    tension: float
    mass: float
    knots: bool
    material: str

    @property
    def link(self) -> float:
        """Length of a link [m]."""
        return self.length / self.links


def read_thread(row: Table, materials: tuple[str, ...]) -> ChainThread:
    """Return the thread of a prop's table.

    Args:
        row: the table
        materials: names that are allowed

    Raises:
        DescriptionError: an unknown size, or dimensions that make no thread
    """
    sizes = read_table(DATA)
    sized = "size" in row
    given = sizes.table(row.text("size", allowed=tuple(sizes.entries()))) if sized else row
    if sized and row.has("diameter", "length"):
        raise row.fail("diameter", "contradicts the size; give one of them")
    diameter, length = given.positive("diameter", "length"), row.positive("length", "length")
    link = row.positive("link", "length", default=LINK_M)
    links = round(length / link)
    if not 2 <= links <= MOST_LINKS:
        raise row.fail(
            "link",
            f"got {1e3 * link:g} mm, which makes {links} links; allowed: 2 to {MOST_LINKS}",
        )
    if not 2.0 * diameter < length / links:
        raise row.fail(
            "link",
            f"got {1e3 * link:g} mm; allowed: above twice the diameter, {2e3 * diameter:g} mm",
        )
    modulus = row.positive("modulus", "pressure", default=MODULUS_PA)
    friction = row.number("friction", FRICTION)
    if friction < 0.0:
        raise row.fail("friction", f"got {friction:g}; allowed: 0 or more")
    return ChainThread(
        length,
        diameter,
        links,
        modulus * np.pi * diameter**4 / 64.0,
        friction,
        row.positive("tension", "force", default=TENSION_N),
        row.positive("mass", "mass", default=HEAVY_KG_M * length),
        row.flag("knots", False),
        row.text("material", "accent", allowed=materials),
    )
