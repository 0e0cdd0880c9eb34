"""Needles: sizes, centre line, surface and mass, and what a description of one may not be."""

from __future__ import annotations

import numpy as np
import pytest

from trocar.descriptions.meshes import open_edges
from trocar.descriptions.needles import DATA, DENSITY, Needle
from trocar.descriptions.props import read_props
from trocar.descriptions.records import Prop
from trocar.descriptions.table import parse_table, read_table
from trocar.errors import DescriptionError


def read(text: str) -> Prop:
    (prop,) = read_props(parse_table(f"[[prop]]\n{text}", "here.toml"), ())
    return prop


@pytest.fixture(scope="module")
def sizes() -> dict[str, Prop]:
    row = 'name = "n"\nkind = "needle"\nmovable = true\nsize = '
    return {name: read(f'{row}"{name}"') for name in read_table(DATA).entries()}


def test_the_arc_of_every_size_is_as_long_as_its_catalogue_says(sizes: dict[str, Prop]) -> None:
    for name, prop in sizes.items():
        assert prop.needle is not None
        line = prop.needle.points(np.linspace(0.0, prop.needle.arc, 2001))
        length = float(np.linalg.norm(np.diff(line, axis=0), axis=1).sum())
        number = name.rpartition("_")[2]
        assert length == pytest.approx(1e-3 * float(number) if number.isdigit() else 0.01 * np.pi,
                                       rel=1e-5)  # fmt: skip


def test_the_surface_is_closed_and_holds_the_needles_mass(sizes: dict[str, Prop]) -> None:
    for prop in sizes.values():
        assert prop.needle is not None and prop.movable is not None
        mesh = prop.needle.mesh()
        assert mesh.normals is not None and open_edges(mesh.vertices, mesh.faces) == 0
        a, b, c = mesh.vertices[mesh.faces].swapaxes(0, 1)
        volume = float((a * np.cross(b, c)).sum() / 6.0)
        # A ring of 20 corners has 1.6 % less area than its circle.
        assert DENSITY * volume == pytest.approx(prop.needle.mass, rel=0.025)
        assert prop.movable.mass == prop.needle.mass
        outside = np.cross(b - a, c - a)
        assert ((outside * mesh.normals[mesh.faces].mean(axis=1)).sum(axis=1) > 0.0).all()


def test_ends_are_frames_on_the_centre_line_with_y_along_the_wire() -> None:
    needle = Needle(0.01, 0.75 * np.pi, 0.0008, 0.004)
    for T, angle in ((needle.swage, 0.0), (needle.tip, needle.arc)):
        assert np.allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3)) and np.linalg.det(T) > 0.0
        ahead = (needle.points(angle + 1e-6) - needle.points(angle - 1e-6)) / 2e-8
        assert np.allclose(T[:3, 1], ahead, atol=1e-8)
        assert np.allclose(T[:3, 3], needle.points(angle))


def test_capsules_follow_the_wire_and_get_thin_towards_the_tip(sizes: dict[str, Prop]) -> None:
    seen, *touching = sizes["half_26"].shapes
    needle = sizes["half_26"].needle
    assert needle is not None and not seen.collide and len(touching) == 12
    for shape in touching:
        off = np.linalg.norm(shape.pose[:3, 3]) - needle.radius
        assert shape.collide and abs(off) < 1e-4
    assert touching[-1].size[0] < touching[-2].size[0] <= 0.5 * needle.wire


@pytest.mark.parametrize(
    ("given", "problem"),
    [
        ('size = "half_27"', r"prop\[0\]\.size: got 'half_27'; allowed: half_17, half_26"),
        ("radius_mm = 10\narc_deg = 400\nwire_mm = 1\ntaper_mm = 3", "got 400 deg; allowed"),
        (
            "radius_mm = 10\narc_deg = 180\nwire_mm = 6\ntaper_mm = 3",
            "wire.*got 6 mm; .*up to 5 mm",
        ),
        ("radius_mm = 10\narc_deg = 90\nwire_mm = 1\ntaper_mm = 30", "taper.*up to 15.708 mm"),
        ("radius_mm = 1\nlength_mm = 9\narc_deg = 90\nwire_mm = 1\ntaper_mm = 3", "contradicts"),
    ],
)
def test_impossible_needles_are_named(given: str, problem: str) -> None:
    with pytest.raises(DescriptionError, match=problem):
        read(f'name = "n"\nkind = "needle"\n{given}')
