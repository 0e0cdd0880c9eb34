"""Which solids are drawn together, of which arms, and how finely."""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module

from trocar.apps.cad.link import Link
from trocar.apps.cad.tessellate import Fineness
from trocar.descriptions import names
from trocar.descriptions.catalogue import load_mechanism
from trocar.descriptions.overlay_records import Overlay
from trocar.errors import InputError


@dataclass(frozen=True)
class SolidSet:
    """Solids whose files lie in one folder.

    Attributes:
        name: of the folder, and of the module that draws them
        fineness: of what is looked at
        arms: (arm, tool) that are drawn, each of which may have links that another has too; empty
            where the solids stand in the world
    """

    name: str
    fineness: Fineness
    arms: tuple[tuple[str, str], ...] = ()

    def links(self, overlay: Overlay | None = None) -> tuple[Link, ...]:
        """Return every link, drawn once, on the axes of the nominal or of a calibrated arm.

        Raises:
            InputError: the overlay is for none of the arms
        """
        draw = import_module(f"trocar.apps.cad.{self.name}").links
        if not self.arms:
            return tuple(draw())
        found: dict[str, Link] = {}
        for arm, tool in self.arms:
            if overlay is None or overlay.arm == arm:
                for link in draw(load_mechanism(arm, tool, overlay)):
                    found.setdefault(link.name, link)
        return tuple(found.values())


def solid_sets() -> dict[str, SolidSet]:
    """Return the sets by name.

    The fineness is our own choice: the full cart stays under 120,000 triangles.
    """
    each = (
        SolidSet("psm", Fineness(0.3, 1.0), (("psm", "none"),)),
        SolidSet("ecm", Fineness(0.3, 1.0), (("ecm", "none"),)),
        SolidSet(
            "suj",
            Fineness(0.5, 2.0),
            tuple((f"suj_{arm}", "none") for arm in ("psm1", "psm2", "psm3", "ecm")),
        ),
        SolidSet("mtm", Fineness(0.3, 1.0), (("mtmr", "none"), ("mtml", "none"))),
        SolidSet("tools", Fineness(0.03, 0.1), tuple(("psm", t) for t in names("tools"))),
        SolidSet("cart", Fineness(1.0, 4.0)),
        SolidSet("table", Fineness(1.0, 4.0)),
    )
    return {one.name: one for one in each}


def sets_of(overlay: Overlay) -> tuple[str, ...]:
    """Return the sets that a calibrated arm has its own of.

    Raises:
        InputError: of this arm nothing is drawn
    """
    sets = solid_sets()
    found = [name for name, one in sets.items() if (overlay.arm, "none") in one.arms]
    if not found:
        known = ", ".join(arm for one in sets.values() for arm, _ in one.arms)
        raise InputError(f"{overlay.file}: a calibration of {overlay.arm!r}; allowed: {known}")
    return tuple(found)
