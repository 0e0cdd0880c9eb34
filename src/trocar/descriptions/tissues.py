"""Soft tissue with a wound: a pad of two halves that a needle and its thread can pass."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.descriptions.materials import MATERIALS
from trocar.descriptions.needles import Needle
from trocar.descriptions.table import Table

Array = NDArray[np.float64]

#: Nodes of a mesh at most. Source: our own choice; 20,000 take 10 s to factor.
MOST_NODES = 20_000
#: Stiffness of what counts as tissue. Source: fat 1 kPa, tendon and hard rubber 10 MPa. [Pa]
SOFTEST, STIFFEST = 1e3, 1e7
#: Stitches that one tissue can have. Source: our own choice; four take 0.2 ms a step.
MOST_STITCHES = 8
#: Arc of a needle that passes both halves. Source: our own choice; 3/8 of a circle is 135 deg.
#: [rad]
MIN_ARC = np.radians(120.0)


@dataclass(frozen=True)
class Thread:
    """The thread of a needle.

    Attributes:
        length: from the swage to its end [m]
        knot: from the knot that stops at the first puncture to its end [m]
        friction: at each point where it passes through tissue [N]
        radius: of its drawing and its volume [m]
    """

    length: float
    knot: float
    friction: float
    radius: float

    @property
    def free(self) -> float:
        """Length between swage and knot [m]."""
        return self.length - self.knot


@dataclass(frozen=True, eq=False)
class Tissue:
    """A pad of two equal halves on both sides of a straight wound.

    Its frame: origin in the middle of the wound on the surface, x along the wound, z outwards.

    Attributes:
        length: along the wound [m]
        width: of each half, across the wound [m]
        depth: [m]
        gap: width of the open wound [m]
        modulus: of elasticity, below all layers [Pa]
        poisson: Poisson's ratio
        layers: (thickness [m], modulus [Pa]) of each from the surface down
        element: edge of the mesh's cells, about [m]
        patch: radius of the places that are held, see `simulation.elastic` [m]
        stitches: how many there can be
        puncture: force at which a needle's tip enters [N]
        drag: of a needle at each point where it passes [N]
        tear: force at which a stitch tears out [N]
        needle, wire: name of the prop that passes, and its dimensions
        thread: of this needle
        material: name of a row in `materials`
    """

    length: float
    width: float
    depth: float
    gap: float
    modulus: float
    poisson: float
    layers: tuple[tuple[float, float], ...]
    element: float
    patch: float
    stitches: int
    puncture: float
    drag: float
    tear: float
    needle: str
    wire: Needle
    thread: Thread
    material: str

    def modulus_at(self, below: ArrayLike) -> Array:
        """Return the modulus at depths below the surface, (n,) [Pa, m]."""
        deep = np.asarray(below, dtype=np.float64)
        found, top = np.full(deep.shape, self.modulus), 0.0
        for thickness, modulus in self.layers:
            found[(deep >= top) & (deep < top + thickness)] = modulus
            top += thickness
        return found


def read_tissue(row: Table, needles: Mapping[str, Needle]) -> Tissue:
    """Return the tissue of a prop's table.

    Args:
        row: the table
        needles: that may pass it, {prop: needle}

    Raises:
        DescriptionError: naming file, key, what was got and what is allowed
    """
    length, width = row.positive("length", "length"), row.positive("width", "length")
    depth, gap = row.positive("depth", "length"), row.positive("gap", "length")
    element = row.positive("element", "length", default=1e-3)
    patch = row.positive("patch", "length", default=1.5e-3)
    nodes = 2 * int(np.prod([round(size / element) + 1 for size in (length, width, depth)]))
    if nodes > MOST_NODES:
        raise row.fail(
            "element_mm",
            f"got {1e3 * element:g} mm, which makes {nodes} nodes; allowed: up to {MOST_NODES}",
        )
    for key, size in (("width", width), ("depth", depth)):
        if size < 2.0 * element:
            raise row.fail(
                key, f"got {1e3 * size:g} mm; allowed: two elements, {2e3 * element:g} mm, or more"
            )
    poisson = row.number("poisson", 0.4)
    if not 0.0 <= poisson <= 0.49:
        raise row.fail("poisson", f"got {poisson:g}; allowed: 0 to 0.49")
    layers = row.each(
        "layer", lambda layer: (layer.positive("thickness", "length"), _modulus(layer))
    )
    if sum(thickness for thickness, _ in layers) > depth:
        raise row.fail("layer", f"got layers thicker than the tissue, {1e3 * depth:g} mm")
    stitches = row.number("stitches", 1)
    if stitches not in range(1, MOST_STITCHES + 1):
        raise row.fail("stitches", f"got {stitches:g}; allowed: 1 to {MOST_STITCHES}")
    needle = row.text("needle", allowed=tuple(needles))
    wire = needles[needle]
    if wire.arc < MIN_ARC:
        raise row.fail(
            "needle", f"got an arc of {np.degrees(wire.arc):.0f} deg; allowed: 120 deg or more"
        )
    return Tissue(
        length,
        width,
        depth,
        gap,
        _modulus(row),
        poisson,
        layers,
        element,
        patch,
        int(stitches),
        row.positive("puncture", "force"),
        row.positive("drag", "force"),
        row.positive("tear", "force"),
        needle,
        wire,
        _read_thread(row.table("thread")),
        row.text("material", "accent", allowed=tuple(MATERIALS)),
    )


def _read_thread(row: Table) -> Thread:
    length, knot = row.positive("length", "length"), row.positive("knot", "length")
    if knot >= length:
        raise row.fail("knot", f"got {1e3 * knot:g} mm; allowed: less than the thread's length")
    found = Thread(
        length, knot, row.positive("friction", "force"), row.positive("radius", "length")
    )
    row.done()
    return found


def _modulus(row: Table) -> float:
    value = row.quantity("modulus", "pressure")
    if not SOFTEST <= value <= STIFFEST:
        raise row.fail(
            "modulus",
            f"got {1e-3 * value:g} kPa; allowed: {1e-3 * SOFTEST:g} to {1e-3 * STIFFEST:g} kPa",
        )
    return value
