"""Soft tissue with a wound: a pad of two halves that a needle and its thread can pass."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.descriptions.keys import key
from trocar.descriptions.materials import MATERIALS
from trocar.descriptions.needles import Needle
from trocar.descriptions.table import Table

Array = NDArray[np.float64]

#: Most nodes of a mesh. Source: our own choice; 20,000 take 10 s to factor.
MOST_NODES = 20_000
#: Range of moduli of tissue. Source: fat 1 kPa, tendon and hard rubber 10 MPa. [Pa]
SOFTEST_PA, STIFFEST_PA = 1e3, 1e7
#: Most stitches of a tissue. Source: our own choice; four take 0.2 ms a step.
MOST_STITCHES = 8
#: Least arc of a needle that passes both halves. Source: our own choice, less than 3/8 of a circle,
#: 135 deg. [rad]
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

    length: float = field(metadata=key("length", above=0.0))
    knot: float = field(metadata=key("length", above=0.0))
    friction: float = field(metadata=key("force", above=0.0))
    radius: float = field(metadata=key("length", above=0.0))

    @property
    def free(self) -> float:
        """Length between swage and knot [m]."""
        return self.length - self.knot


@dataclass(frozen=True)
class Layer:
    """Keys of a layer of tissue, from the surface down.

    Attributes:
        thickness: of the layer [m]
        modulus: of elasticity [Pa]
    """

    thickness: float = field(metadata=key("length", above=0.0))
    modulus: float = field(
        metadata=key("pressure", least=SOFTEST_PA, most=STIFFEST_PA, shown="kPa")
    )


@dataclass(frozen=True, eq=False)
class Tissue:
    """A pad of two equal halves on both sides of a straight wound.

    Its frame: origin in the middle of the wound on the surface, x along the wound, z outwards.

    Attributes:
        length: along the wound [m]
        width: of each half, across the wound [m]
        depth: thickness of the pad [m]
        gap: width of the open wound [m]
        modulus: of elasticity, below all layers [Pa]
        poisson: Poisson's ratio
        layers: (thickness [m], modulus [Pa]) of each from the surface down
        element: edge of the mesh's cells, about [m]
        patch: radius of the places that stitches hold [m]
        stitches: most stitches at a time
        puncture: force at which a needle's tip enters [N]
        drag: of a needle at each point where it passes [N]
        tear: force at which a stitch tears out [N]
        needle: a needle prop before it, which passes it
        wire: dimensions of the needle
        thread: of this needle
        material: of the surface
    """

    length: float = field(metadata=key("length", above=0.0))
    width: float = field(metadata=key("length", above=0.0))
    depth: float = field(metadata=key("length", above=0.0))
    gap: float = field(metadata=key("length", above=0.0))
    modulus: float = field(
        metadata=key("pressure", least=SOFTEST_PA, most=STIFFEST_PA, shown="kPa")
    )
    poisson: float = field(metadata=key(least=0.0, most=0.49, default=0.4))
    layers: tuple[tuple[float, float], ...]
    element: float = field(metadata=key("length", above=0.0, default=1e-3))
    patch: float = field(metadata=key("length", above=0.0, default=1.5e-3))
    stitches: int = field(metadata=key(least=1, most=MOST_STITCHES, default=1))
    puncture: float = field(metadata=key("force", above=0.0))
    drag: float = field(metadata=key("force", above=0.0))
    tear: float = field(metadata=key("force", above=0.0))
    needle: str = field(metadata=key())
    wire: Needle
    thread: Thread
    material: str = field(metadata=key(choices=tuple(MATERIALS), default="accent"))

    def modulus_at(self, below: ArrayLike) -> Array:
        """Return the modulus at depths below the surface, (n,) [Pa, m]."""
        deep = np.asarray(below, dtype=np.float64)
        found, top = np.full(deep.shape, self.modulus), 0.0
        for thickness, modulus in self.layers:
            found[(deep >= top) & (deep < top + thickness)] = modulus
            top += thickness
        return found


def read_tissue(row: Table, needles: Mapping[str, Needle]) -> Tissue:
    """Read the tissue of a prop.

    Args:
        row: the table
        needles: that may pass it, {prop: needle}

    Raises:
        DescriptionError: naming file, key, what was got and what is allowed
    """
    layers = tuple(
        (layer.thickness, layer.modulus)
        for layer in row.each("layer", lambda layer: layer.record(Layer))
    )
    needle = row.text("needle", allowed=tuple(needles))
    thread = _read_thread(row.table("thread"))
    found = row.record(Tissue, layers=layers, needle=needle, wire=needles[needle], thread=thread)
    element, sizes = found.element, (found.length, found.width, found.depth)
    nodes = 2 * int(np.prod([round(size / element) + 1 for size in sizes]))
    if nodes > MOST_NODES:
        raise row.fail(
            "element_mm",
            f"got {1e3 * element:g} mm, which makes {nodes} nodes; allowed: up to {MOST_NODES}",
        )
    for name, size in (("width", found.width), ("depth", found.depth)):
        if size < 2.0 * element:
            raise row.fail(
                name, f"got {1e3 * size:g} mm; allowed: two elements, {2e3 * element:g} mm, or more"
            )
    if sum(thickness for thickness, _ in layers) > found.depth:
        raise row.fail("layer", f"got layers thicker than the tissue, {1e3 * found.depth:g} mm")
    if found.wire.arc < MIN_ARC:
        raise row.fail(
            "needle",
            f"got an arc of {np.degrees(found.wire.arc):.0f} deg; allowed: 120 deg or more",
        )
    return found


def _read_thread(row: Table) -> Thread:
    found = row.record(Thread)
    if found.knot >= found.length:
        raise row.fail(
            "knot", f"got {1e3 * found.knot:g} mm; allowed: less than the thread's length"
        )
    row.done()
    return found
