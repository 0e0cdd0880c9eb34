"""Default classes: what many elements of a file share is said once."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from trocar.modeling.contacts import ContactMask
from trocar.modeling.markup import child, element
from trocar.modeling.menagerie.text import exact, row
from trocar.modeling.menagerie.variants import MJX, Variant
from trocar.modeling.options import (
    CONTACT_FRICTION,
    CONTACT_IMPEDANCE,
    CONTACT_PERIODS,
    STIFF_IMPEDANCE,
    STOP_PERIODS,
)

#: A family's elements and their attributes: {"joint": {...}, "position": {...}}.
Family = Mapping[str, Mapping[str, str]]
#: Groups of geoms and sites that a viewer switches together. Source: MuJoCo Menagerie.
VISUAL_GROUP, COLLISION_GROUP, FRAME_GROUP = 2, 3, 4
#: Corners of a convex piece in MJX. Source: MuJoCo's page on MJX, 64 or less.
MOST_HULL_CORNERS = 64


class Classes:
    """The default classes of one file, collected while its elements are written."""

    def __init__(self, root: str, variant: Variant, timestep: float) -> None:
        self.root = root
        self._variant, self._timestep = variant, timestep
        self._families: dict[str, Family] = {}
        self._masks: dict[str, ContactMask] = {}

    def family(self, name: str, family: Family) -> str:
        """Return the class of hinges and servos that are alike, called `name` if it is new."""
        for known, shared in self._families.items():
            if shared == family and known.partition(".")[0] == name:
                return known
        count = sum(known.partition(".")[0] == name for known in self._families)
        made = f"{name}.{count + 1}" if count else name
        self._families[made] = family
        return made

    def collision(self, owner: str, mask: ContactMask) -> str:
        """Return the class of an owner's collision geoms, "collision" of a lone arm."""
        name = f"{owner}_collision" if owner else "collision"
        self._masks[name] = mask
        return name

    def document(self) -> Any:
        """Return the element `default` with all that was asked for."""
        whole = element("default")
        top = child(whole, "default", {"class": self.root})
        self._shared(top)
        for name, family in self._families.items():
            made = child(top, "default", {"class": name})
            for tag, attributes in family.items():
                child(made, tag, attributes)
        return whole

    def _shared(self, top: Any) -> None:
        period, variant = self._timestep, self._variant
        child(
            top,
            "joint",
            {
                "axis": "0 0 1",
                "solreflimit": row([STOP_PERIODS * period, 1.0]),
                "solimplimit": row(STIFF_IMPEDANCE),
            },
        )
        child(top, "material", {"specular": "0.4", "shininess": "0.4"})
        # Thin or open shapes have no volume; masses come from `inertial` alone.
        mesh = {"inertia": "shell"}
        if variant is MJX:
            mesh["maxhullvert"] = str(MOST_HULL_CORNERS)
        child(top, "mesh", mesh)
        stiff = {"solref": row([variant.loop_periods * period, 1.0])}
        child(top, "equality", {**stiff, "solimp": row(STIFF_IMPEDANCE)})
        seen = child(top, "default", {"class": "visual"})
        none = {"contype": "0", "conaffinity": "0"}
        child(seen, "geom", {"type": "mesh", "group": str(VISUAL_GROUP), "mass": "0", **none})
        touched = child(top, "default", {"class": "collision"})
        child(touched, "geom", self._contact())
        for name, mask in self._masks.items():
            said = {"contype": str(mask.contype), "conaffinity": str(mask.conaffinity)}
            if name == "collision":
                for key, value in said.items():
                    touched[0].set(key, value)
            else:
                child(child(touched, "default", {"class": name}), "geom", said)
        frames = child(top, "default", {"class": "frame"})
        child(frames, "site", {"group": str(FRAME_GROUP), "size": exact(0.002)})

    def _contact(self) -> dict[str, str]:
        return {
            "type": "capsule",
            "group": str(COLLISION_GROUP),
            "mass": "0",
            "condim": "4",
            "friction": row(CONTACT_FRICTION),
            "solref": row([CONTACT_PERIODS * self._timestep, 1.0]),
            "solimp": row(CONTACT_IMPEDANCE),
        }
