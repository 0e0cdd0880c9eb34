"""The patient cart without its arms: base on castors, column with its slides, tower, cap, handle.

In the cart's frame: x to its left, y to the patient, z up from the floor. Footprint and height
after dvrk_env's base link; the column stands where the setup joints slide, the rest is our own
choice, after photographs.
"""

from __future__ import annotations

from build123d import Pos
from build123d.topology import Shape

from tools.cad.forms import (
    Corner,
    both,
    box,
    edges_at,
    fuse,
    mirrored,
    prism,
    rod,
    rounded,
)
from tools.cad.links import Link, Part

#: Half the width of the column, and where it begins and ends along y. [mm]
HALF_WIDTH, REAR, FRONT = 54.0, -180.0, -50.0
#: Top of the base, of the tower, of the column. [mm]
BASE, TOWER, COLUMN = 176.0, 1150.0, 1770.0
#: Where the castors' forks turn (x, y), and the radius of the wheels. [mm]
CASTORS, WHEEL = ((290, 110), (-290, 110), (300, -490), (-300, -490)), 55.0


def links() -> tuple[Link, ...]:
    """Return the cart as one link that stands in the world."""
    parts = (
        Part("cover", base()),
        Part("cover", tower()),
        Part("cover", cap()),
        Part("joint", column()),
        Part("steel", slides()),
        Part("casting", castor_forks()),
        Part("black", wheels()),
        Part("black", handle()),
        Part("accent", badge()),
    )
    convex = (
        box((-350, -570, 60), (350, 190, BASE)),
        box((-HALF_WIDTH, REAR, BASE), (HALF_WIDTH, FRONT, COLUMN)),
        prism(_tower_plan(1.0), "z", BASE, TOWER),
        prism(_tower_plan(0.7), "z", TOWER, COLUMN),
    )
    return (Link("cart", "cart", parts, convex),)


def base() -> Shape:
    """Return the low hull over the castors: broad behind, two rounded feet in front."""
    half: list[Corner] = [(60, 60, 50), (130, 190, 90), (340, 190, 110), (350, -420, 160)]
    half += [(280, -570, 130)]
    plan = both(half, 0)
    low = prism(plan, "z", 66, 140)
    return fuse(rounded(edges_at(low, "z", 140), 40.0), _step())


def _step() -> Shape:
    """Return the raised middle of the base, from which the column rises."""
    half: list[Corner] = [(150, -10, 60), (200, -500, 120)]
    step = prism(both(half, 0), "z", 100, BASE)
    return rounded(edges_at(step, "z", BASE), 30.0)


def column() -> Shape:
    """Return the dark column with a groove on each side where an arm slides."""
    plan: list[Corner] = [(HALF_WIDTH, REAR), (HALF_WIDTH, -114), (HALF_WIDTH - 10, -114)]
    plan += [(HALF_WIDTH - 10, -90), (HALF_WIDTH, -90), (HALF_WIDTH, FRONT), (12, FRONT)]
    plan += [(12, FRONT - 10)]
    return prism(both(plan, 0), "z", BASE, COLUMN)


def slides() -> Shape:
    """Return the steel rails in the column's grooves."""
    side = box((HALF_WIDTH - 12, -111, BASE), (HALF_WIDTH - 3, -93, COLUMN - 20))
    front = box((-9, FRONT - 12, BASE), (9, FRONT - 3, COLUMN - 20))
    return fuse(side, mirrored(side, "x"), front)


def _tower_plan(scale: float) -> list[Corner]:
    """Return the tower's outline: flat against the column, round behind."""
    half: list[Corner] = [(90, REAR - 2, 20), (178 * scale, REAR - 70 * scale, 60 * scale)]
    half += [(150 * scale, REAR - 276 * scale, 90 * scale)]
    return both(half, 0)


def tower() -> Shape:
    """Return the covers behind the column: the counterweights' below, a slimmer one above."""
    lower = prism(_tower_plan(1.0), "z", BASE, TOWER)
    lower = rounded(edges_at(lower, "z", TOWER), 45.0)
    upper = prism(_tower_plan(0.7), "z", TOWER - 60, COLUMN)
    return fuse(lower, upper)


def cap() -> Shape:
    """Return the rounded head that closes column and tower."""
    half: list[Corner] = [(100, -22, 60), (142, -400, 110)]
    head = prism(both(half, 0), "z", COLUMN, COLUMN + 72)
    return rounded(edges_at(head, "z", COLUMN + 72), 34.0)


def badge() -> Shape:
    """Return a coloured band about the head's foot."""
    half: list[Corner] = [(92, -30, 54), (134, -392, 104)]
    return prism(both(half, 0), "z", COLUMN - 16, COLUMN)


def castor_forks() -> Shape:
    """Return what holds the wheels under the base."""
    each = [Pos(x, y, 0) * box((-36, -44, 34), (36, 44, 66), 26.0, "z") for x, y in CASTORS]
    return fuse(*each)


def wheels() -> Shape:
    """Return two wheels at each castor."""
    pairs = [
        rod((x + s * 38, y, WHEEL), (x + s * 62, y, WHEEL), WHEEL)
        for x, y in CASTORS
        for s in (1, -1)
    ]
    return fuse(*pairs)


def handle() -> Shape:
    """Return the bar that pushes the cart, behind the tower."""
    x, y, z, r = 210.0, -540.0, 980.0, 16.0
    posts = [rod((s * 120, REAR - 240, z), (s * x, y, z), r) for s in (1, -1)]
    return fuse(rod((-x - r, y, z), (x + r, y, z), r), *posts)
