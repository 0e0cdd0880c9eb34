"""Curved suturing needles: their centre line, what they touch with, and what they look like."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from trocar.descriptions.keys import key
from trocar.descriptions.materials import MATERIALS
from trocar.descriptions.meshes import Mesh
from trocar.descriptions.table import Table, read_table
from trocar.errors import InputError
from trocar.inputs import check_numbers

Array = NDArray[np.float64]

DATA = Path(__file__).parent / "data" / "needles.toml"
#: Steel of needles (AISI 302, 420). Source: its data sheets, 7.7 to 7.9. [kg/m^3]
DENSITY = 7800.0
#: Radius of the very tip over that of the wire. Source: our own choice.
TIP = 0.05
#: Rings of the drawn surface along the arc and the point, and corners of a ring. Source: our own
#: choice; chords miss an arc of 10 mm radius by 4 um.
RINGS, POINT_RINGS, AROUND = 60, 16, 20


@dataclass(frozen=True)
class Needle:
    """Wire bent to an arc of a circle, with a point at its end.

    Its frame lies in the circle's centre: the swage on the x axis, the tip at the angle `arc`
    about z. Angles below are those about z, from 0 at the swage.

    Attributes:
        radius: of the circle [m]
        arc: angle from swage to tip [rad]
        wire: diameter [m]
        taper: length of the point along the arc [m]
    """

    radius: float
    arc: float
    wire: float
    taper: float

    def __post_init__(self) -> None:
        """Check the dimensions."""
        sizes = self.radius, self.arc, self.wire, self.taper
        for size, name in zip(sizes, ("radius", "arc", "wire", "taper"), strict=True):
            check_numbers(size, (), f"needle: {name}")
        for name, problem in _faults(*sizes):
            raise InputError(f"needle: {name}: {problem}")

    @property
    def length(self) -> float:
        """Length along the arc [m]."""
        return self.radius * self.arc

    @property
    def mass(self) -> float:
        """Mass of a needle of steel [kg]."""
        point = (1.0 + TIP + TIP**2) / 3.0 * self.taper
        return DENSITY * np.pi * (0.5 * self.wire) ** 2 * (self.length - self.taper + point)

    def points(self, angles: ArrayLike) -> Array:
        """Return the centre line at angles (n,), (n, 3) [m]."""
        a = np.asarray(angles, dtype=np.float64)
        return self.radius * np.stack([np.cos(a), np.sin(a), np.zeros_like(a)], axis=-1)

    def tangents(self, angles: ArrayLike) -> Array:
        """Return directions towards the tip at angles (n,), (n, 3)."""
        a = np.asarray(angles, dtype=np.float64)
        return np.stack([-np.sin(a), np.cos(a), np.zeros_like(a)], axis=-1)

    def half_width(self, angles: ArrayLike) -> Array:
        """Return half the thickness at angles (n,), (n,) [m]."""
        ahead = self.radius * (self.arc - np.asarray(angles, dtype=np.float64))
        return 0.5 * self.wire * np.clip(ahead / self.taper, TIP, 1.0)

    def pose(self, angle: float) -> Array:
        """Return a frame on the centre line in the needle's, (4, 4).

        Its x axis points away from the circle's centre, y towards the tip, z out of the plane.
        """
        c, s = np.cos(angle), np.sin(angle)
        found = np.eye(4)
        found[:2, :2] = [[c, -s], [s, c]]
        found[:2, 3] = self.radius * c, self.radius * s
        return found

    @property
    def swage(self) -> Array:
        """The frame where the thread begins, (4, 4); see `pose`."""
        return self.pose(0.0)

    @property
    def tip(self) -> Array:
        """The frame at the tip, (4, 4); see `pose`."""
        return self.pose(self.arc)

    def mesh(self) -> Mesh:
        """Return its surface, with normals."""
        blunt = max(0.0, self.arc - self.taper / self.radius)
        angles = np.concatenate(
            [np.linspace(0.0, blunt, RINGS)[:-1], np.linspace(blunt, self.arc, POINT_RINGS)]
        )
        around = np.linspace(0.0, 2.0 * np.pi, AROUND, endpoint=False)
        radial = self.points(angles)[:, None] / self.radius
        out = np.cos(around)[:, None] * radial + np.sin(around)[:, None] * [0.0, 0.0, 1.0]
        thick = self.half_width(angles)[:, None, None]
        vertices = self.points(angles)[:, None] + thick * out
        slope = np.where(angles >= blunt, 0.5 * self.wire / self.taper, 0.0)[:, None, None]
        normals = out + slope * self.tangents(angles)[:, None]
        normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
        ring, corner = np.meshgrid(np.arange(len(angles) - 1), np.arange(AROUND), indexing="ij")
        here, right = ring * AROUND + corner, ring * AROUND + (corner + 1) % AROUND
        sides = [(here, here + AROUND, right), (right, here + AROUND, right + AROUND)]
        faces = np.concatenate([np.stack(side, axis=-1).reshape(-1, 3) for side in sides])
        # Lids have corners of their own, with normals along the wire.
        fan = np.stack([np.zeros(AROUND - 2, int), np.arange(1, AROUND - 1), np.arange(2, AROUND)])
        first = vertices[0].shape[0] * len(angles)
        along = self.tangents([0.0, self.arc])
        lids = [fan.T + first, fan.T[:, ::-1] + first + AROUND]
        return Mesh(
            np.concatenate([vertices.reshape(-1, 3), vertices[0], vertices[-1]]),
            np.concatenate([faces, *lids]),
            "needle",
            np.concatenate(
                [
                    normals.reshape(-1, 3),
                    np.tile(-along[0], (AROUND, 1)),
                    np.tile(along[1], (AROUND, 1)),
                ]
            ),
        )


@dataclass(frozen=True)
class NeedleSize:
    """Key of a needle's size.

    Attributes:
        size: a usual needle: half a circle or 3/8 of one, with its length along the arc in mm;
            `half_training`: radius 10 mm, wire of 1 mm
    """

    size: str = field(metadata=key())


@dataclass(frozen=True)
class NeedleLook:
    """Key of a needle's surface.

    Attributes:
        material: of its drawing
    """

    material: str = field(default="steel", metadata=key(choices=tuple(MATERIALS)))


@dataclass(frozen=True)
class NeedleKeys:
    """Keys of a needle's dimensions, in place of its size.

    Attributes:
        arc: angle from swage to tip [rad]
        radius: of the circle [m]
        length: along the arc, instead of `radius` [m]
        wire: diameter [m]
        taper: length of the point [m]
    """

    arc: float = field(metadata=key("angle"))
    radius: float | None = field(default=None, metadata=key("length"))
    length: float | None = field(default=None, metadata=key("length"))
    wire: float = field(kw_only=True, metadata=key("length"))
    taper: float = field(kw_only=True, metadata=key("length"))


def read_needle(table: Table) -> Needle:
    """Read a needle: the name of a size, or its dimensions.

    Raises:
        DescriptionError: an unknown size, or dimensions that make no needle
    """
    if "size" in table:
        sizes = read_table(DATA)
        size = table.record(NeedleSize, choices={"size": sizes.entries()}).size
        return _read_dimensions(sizes.table(size))
    return _read_dimensions(table)


def needle_named(text: str) -> Needle:
    """Return a needle by its size or by "ARC_DEG,RADIUS_MM,WIRE_MM,TAPER_MM".

    Raises:
        InputError: an unknown size, or numbers that make no needle
    """
    keys = ("arc_deg", "radius_mm", "wire_mm", "taper_mm")
    words = text.split(",")
    if len(words) == 1:
        return read_needle(Table({"size": text}, "needle"))
    try:
        values: dict[str, Any] = dict(zip(keys, map(float, words), strict=True))
    except ValueError:
        raise InputError(
            f"needle: got {text!r}; allowed: a size or ARC_DEG,RADIUS_MM,WIRE_MM,TAPER_MM"
        ) from None
    return read_needle(Table(values, "needle"))


def _read_dimensions(row: Table) -> Needle:
    keys = row.record(NeedleKeys)
    if keys.length is not None and keys.radius is not None:
        raise row.fail("length", "contradicts the radius; give one of them")
    if keys.length is not None:
        radius = keys.length / (keys.arc if keys.arc > 0.0 else 1.0)
    else:
        radius = row.quantity("radius", "length")
    found = radius, keys.arc, keys.wire, keys.taper
    for name, problem in _faults(*found):
        raise row.fail(name, problem)
    return Needle(*found)


def _faults(radius: float, arc: float, wire: float, taper: float) -> Iterator[tuple[str, str]]:
    """Yield the names of impossible dimensions, each with what was got and what is allowed."""
    for name, value, most, scale, unit in (
        ("arc", arc, 2.0 * np.pi, 180.0 / np.pi, "deg"),
        ("radius", radius, 0.1, 1e3, "mm"),
        ("wire", wire, 0.5 * radius, 1e3, "mm"),
        ("taper", taper, radius * arc, 1e3, "mm"),
    ):
        if not 0.0 < value <= most:
            yield (
                name,
                f"got {scale * value:g} {unit}; allowed: above 0, up to {scale * most:g} {unit}",
            )


def needle_sizes() -> dict[str, Needle]:
    """Return the needles of known sizes by name."""
    sizes = read_table(DATA)
    return {name: _read_dimensions(sizes.table(name)) for name in sizes.entries()}
