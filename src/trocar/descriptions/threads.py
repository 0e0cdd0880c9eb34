"""Thread as a chain of rigid links, which jaws can grasp: its dimensions from TOML."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from trocar.descriptions.keys import key
from trocar.descriptions.materials import MATERIALS
from trocar.descriptions.table import Table, read_table

DATA = Path(__file__).parent / "data" / "threads.toml"
#: Length of a link. Source: measured: with 3 mm a thread that is dragged takes twice as long. [m]
LINK_M = 4e-3
#: Most links of a thread. Source: our own choice; 60 that lie on the table take 2 ms a step.
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
#: Mass of a thread per length, some two hundred times that of a real one: tension is delayed by a
#: step, which makes lighter links unstable. Source: our own choice. [kg/m]
HEAVY_KG_M = 0.01


@dataclass(frozen=True)
class ThreadKeys:
    """Keys of a thread that jaws can grasp, besides its diameter.

    Attributes:
        length: of the thread [m]
        link: length of a link, about; 2 to 60 of them [m]
        modulus: of bending [Pa]
        friction: coefficient against everything
        tension: largest one that it bears steadily [N]
        mass: of the thread; default: 10 g per metre [kg]
        knots: whether it touches itself
        material: of its drawing
    """

    length: float = field(metadata=key("length", above=0.0))
    link: float = field(metadata=key("length", above=0.0, default=LINK_M))
    modulus: float = field(metadata=key("pressure", above=0.0, default=MODULUS_PA))
    friction: float = field(metadata=key(least=0.0, default=FRICTION))
    tension: float = field(metadata=key("force", above=0.0, default=TENSION_N))
    mass: float | None = field(default=None, metadata=key("mass", above=0.0))
    knots: bool = field(default=False, metadata=key())
    material: str = field(default="accent", metadata=key(choices=tuple(MATERIALS)))


@dataclass(frozen=True)
class ThreadSize:
    """Keys of a thread's diameter.

    Attributes:
        size: a surgical size
        diameter: instead of `size` [m]
    """

    size: str = field(default="", metadata=key())
    diameter: float = field(metadata=key("length", above=0.0), kw_only=True)


@dataclass(frozen=True)
class ChainThread:
    """Thread that bends and does not stretch; it lies along its prop's x axis from the origin.

    Attributes:
        length, diameter: [m]
        links: number of links
        rigidity: of bending: modulus times second moment of area [N m^2]
        friction: coefficient against everything
        tension: largest one that it bears steadily [N]
        mass: of the thread [kg]
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


def read_thread(row: Table) -> ChainThread:
    """Read the thread of a prop.

    Raises:
        DescriptionError: an unknown size, or dimensions that make no thread
    """
    sizes = read_table(DATA)
    sized = "size" in row
    given = sizes.table(row.text("size", allowed=tuple(sizes.entries()))) if sized else row
    if sized and row.has("diameter", "length"):
        raise row.fail("diameter", "contradicts the size; give one of them")
    diameter, keys = given.record(ThreadSize).diameter, row.record(ThreadKeys)
    links = round(keys.length / keys.link)
    if not 2 <= links <= MOST_LINKS:
        raise row.fail(
            "link",
            f"got {1e3 * keys.link:g} mm, which makes {links} links; allowed: 2 to {MOST_LINKS}",
        )
    if not 2.0 * diameter < keys.length / links:
        raise row.fail(
            "link",
            f"got {1e3 * keys.link:g} mm; allowed: above twice the diameter, {2e3 * diameter:g} mm",
        )
    return ChainThread(
        keys.length,
        diameter,
        links,
        keys.modulus * np.pi * diameter**4 / 64.0,
        keys.friction,
        keys.tension,
        HEAVY_KG_M * keys.length if keys.mass is None else keys.mass,
        keys.knots,
        keys.material,
    )
