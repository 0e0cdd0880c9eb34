"""The patient's table: four cushions on a frame with side rails, a telescopic column, a base.

In the table's frame: y along the patient, z up from the floor. All sizes are our own choice: those
of a plain operating table.
"""

from __future__ import annotations

from itertools import pairwise

from build123d import Pos
from build123d.topology import Shape

from tools.cad import kit
from tools.cad.forms import box, fuse, prism
from tools.cad.links import Link, Part

#: Top of the cushions, their thickness; half of the table's width and length. [mm]
TOP, CUSHION, HALF_WIDTH, HALF_LENGTH = 800.0, 70.0, 280.0, 750.0
#: Where one cushion ends and the next begins, along y, and the gap between them. [mm]
SEAMS, GAP = (-750.0, -330.0, 180.0, 480.0, 750.0), 8.0


def links() -> tuple[Link, ...]:
    """Return the table as one link that stands in the world."""
    parts = (
        Part("drape", cushions()),
        Part("casting", frame()),
        Part("steel", rails()),
        Part("cover", column()),
        Part("joint", base()),
    )
    slab = box((-HALF_WIDTH, -HALF_LENGTH, TOP - CUSHION), (HALF_WIDTH, HALF_LENGTH, TOP))
    return (Link("table", "table", parts, (slab,)),)


def cushions() -> Shape:
    """Return the cushions, rounded, with a seam between each two."""
    found: list[Shape] = []
    for start, end in pairwise(SEAMS):
        low = start if start == SEAMS[0] else start + GAP / 2
        high = end if end == SEAMS[-1] else end - GAP / 2
        middle = (0.0, (low + high) / 2, TOP - CUSHION / 2)
        found.append(kit.rounded_box(middle, (2 * HALF_WIDTH, high - low, CUSHION), 20.0, 24.0))
    return kit.together(found)


def frame() -> Shape:
    """Return the plates under the cushions."""
    return box((-260, -730, TOP - CUSHION - 27), (260, 730, TOP - CUSHION - 1), 30.0, "z")


def rails() -> Shape:
    """Return the rails along both sides, on their posts."""
    found: list[Shape] = []
    z = TOP - CUSHION - 14
    for side in (1, -1):
        for start, end in ((-700, -350), (-310, 160), (200, 460)):
            x = side * 283
            found.append(box((x - 5, start, z - 14), (x + 5, end, z + 12)))
            near, far = sorted((side * 258, side * 280))
            found += [
                box((near, y - 8, z - 9), (far, y + 8, z + 7)) for y in (start + 40, end - 40)
            ]
    return kit.together(found)


def column() -> Shape:
    """Return the telescope that lifts the table."""
    steps = [(95.0, 175.0, 560.0, 704.0), (112.0, 195.0, 330.0, 570.0), (130.0, 215.0, 70.0, 340.0)]
    return fuse(
        *(
            prism(
                [(x, 150 - y, 40), (x, 150 + y, 40), (-x, 150 + y, 40), (-x, 150 - y, 40)],
                "z",
                a,
                b,
            )
            for x, y, a, b in steps
        )
    )


def base() -> Shape:
    """Return the foot on the floor."""
    return Pos(0, 150, 0) * kit.plate(
        kit.polygon(
            [(-230, -330), (-150, -450), (150, -450), (230, -330), (230, 450), (-230, 450)], 60.0
        ),
        8.0,
        78.0,
        16.0,
    )
