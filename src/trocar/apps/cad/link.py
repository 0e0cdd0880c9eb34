"""What an artist of solids gives: links, each of parts that look alike, in their frame."""

from __future__ import annotations

from dataclasses import dataclass

from build123d.topology import Shape


@dataclass(frozen=True, eq=False)
class Part:
    """A solid of one material.

    Attributes:
        material: name of a row in `descriptions.materials`
        solid: one or several closed solids in the link's frame, in millimetres
    """

    material: str
    solid: Shape


@dataclass(frozen=True, eq=False)
class Link:
    """What moves with one frame.

    Attributes:
        name: of its files and of its section in solids.toml
        frame: the description's frame that it is drawn in and moves with
        parts: what is seen, and together what weighs; they may overlap no more than a joint does
        convex: solids of which each one's convex hull touches; empty: the one hull of all parts
    """

    name: str
    frame: str
    parts: tuple[Part, ...]
    convex: tuple[Shape, ...] = ()
