"""The Si's patient cart without its arms: base on castors, a column with four slides, head, bar.

In the cart's frame: x to its left, y to the patient, z up from the floor; the slides stand where
the setup joints are. Base and castors are the Classic's, further forward. Sizes: our own choice,
after photographs.
"""

from __future__ import annotations

from build123d import Pos
from build123d.topology import Shape

from tools.cad import cart
from tools.cad.forms import Corner, both, box, edges_at, fuse, mirrored, prism, rod, rounded
from tools.cad.links import Link, Part

#: Half the width of the column, its ends along y; a slide's half width and depth. [mm]
HALF_WIDTH, REAR, FRONT, SLIDE, DEPTH = 106.0, -182.0, 30.0, 40.0, 12.0
#: Where the slides of PSM1 and PSM2 lie along y, and top of base and column. [mm]
SIDE, BASE, COLUMN = -75.7, cart.BASE, 1900.0
#: How far the base stands forward of the Classic's. [mm]
FORWARD = 100.0


def links() -> tuple[Link, ...]:
    """Return the cart as one link that stands in the world."""
    parts = (
        Part("cover", _forward(cart.base())),
        Part("cover", column()),
        Part("cover", head()),
        Part("joint", grooves()),
        Part("steel", slides()),
        Part("casting", _forward(cart.castor_forks())),
        Part("black", _forward(cart.wheels())),
        Part("black", handle()),
        Part("accent", badge()),
    )
    convex = (
        box((-350, -470, 60), (350, 290, BASE)),
        box((-HALF_WIDTH, REAR, BASE), (HALF_WIDTH, FRONT, COLUMN)),
    )
    return (Link("cart", "cart", parts, convex),)


def _forward(shape: Shape) -> Shape:
    return Pos(0, FORWARD, 0) * shape


def _plan(grown: float) -> list[Corner]:
    """Return the column's outline, rounded at its corners, larger by some millimetres."""
    half: list[Corner] = [(HALF_WIDTH + grown, FRONT + grown, 42)]
    half += [(HALF_WIDTH + grown, REAR - grown, 42)]
    return both(half, 0)


def column() -> Shape:
    """Return the column, with a foot over the base."""
    foot = prism(_plan(34.0), "z", BASE - 40, BASE + 150)
    return fuse(
        prism(_plan(0.0), "z", BASE, COLUMN), rounded(edges_at(foot, "z", BASE + 150), 30.0)
    )


def _slots(half: float, out: float, low: float, high: float) -> Shape:
    """Return a strip on each side of the column, `out` past its face."""
    left = box((HALF_WIDTH - 8, SIDE - half, low), (HALF_WIDTH + out, SIDE + half, high))
    front = box((-half, FRONT - 8, low), (half, FRONT + out, high))
    back = box((-half, REAR - out, low), (half, REAR + 8, high))
    return fuse(left, mirrored(left, "x"), front, back)


def grooves() -> Shape:
    """Return the dark strips that the carriages run along."""
    return _slots(SLIDE - 6, 1.0, BASE + 180, COLUMN - 30)


def slides() -> Shape:
    """Return a rail in each strip."""
    return _slots(8.0, DEPTH, BASE + 190, COLUMN - 40)


def head() -> Shape:
    """Return the rounded head that closes the column."""
    top = prism(_plan(36.0), "z", COLUMN, COLUMN + 90)
    return rounded(edges_at(top, "z", COLUMN + 90), 34.0)


def badge() -> Shape:
    """Return a coloured band under the head."""
    return prism(_plan(10.0), "z", COLUMN - 18, COLUMN)


def handle() -> Shape:
    """Return the bar that pushes the cart, on two posts at the base's end."""
    x, y, z, r = 230.0, -430.0, 1010.0, 15.0
    posts = [rod((s * x, y + 30, 100), (s * x, y - 50, z), r) for s in (1, -1)]
    return fuse(rod((-x - 60, y - 50, z), (x + 60, y - 50, z), r + 2), *posts)
