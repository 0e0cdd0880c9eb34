"""Drawn solids: closed, convex where they touch, as heavy as they say, on the frames they name."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import ConvexHull

from trocar.descriptions import load_arm, load_rig, names
from trocar.descriptions.meshes import Mesh, open_edges
from trocar.descriptions.records import Shape
from trocar.descriptions.shapes import impossible
from trocar.descriptions.solids import DATA, INDEX, Solid, read_solid, solid_names
from trocar.errors import DescriptionError
from trocar.kinematics.forward import pose

PACKAGE = DATA.parents[2]
ARMS = [(arm, "none") for arm in names("arms")] + [("psm", tool) for tool in names("tools")]


def enclosed(mesh: Mesh) -> tuple[float, np.ndarray, np.ndarray]:
    """Volume, its first moment and its second moments, by tetrahedra from the origin."""
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    volumes = np.einsum("ij,ij->i", a, np.cross(b, c)) / 6
    total = a + b + c
    first = volumes @ total / 4
    outer = np.zeros((3, 3))
    for p in (a, b, c, total):
        outer += np.einsum("i,ij,ik->jk", volumes, p, p)
    return float(volumes.sum()), first, outer / 20


@pytest.fixture(scope="module")
def solids() -> list[Solid]:
    return [read_solid(name) for name in solid_names()]


def test_a_solid_is_closed_and_seen_from_outside(solids: list[Solid]) -> None:
    for solid in solids:
        assert solid.visual
        for shape in solid.visual:
            mesh = shape.mesh
            assert mesh is not None and mesh.normals is not None
            assert open_edges(mesh.vertices, mesh.faces) == 0, mesh.name
            assert enclosed(mesh)[0] > 0.0, mesh.name
            a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
            flat = np.cross(b - a, c - a)
            agree = np.einsum("ij,ij->i", flat, mesh.normals[mesh.faces].sum(axis=1)) >= 0.0
            assert (
                np.linalg.norm(flat[~agree], axis=1).sum()
                <= 0.01 * np.linalg.norm(flat, axis=1).sum()
            )
            np.testing.assert_allclose(np.linalg.norm(mesh.normals, axis=1), 1.0, atol=1e-9)


def test_what_touches_is_convex_and_of_few_triangles(solids: list[Solid]) -> None:
    for solid in solids:
        assert solid.convex
        for piece in solid.convex:
            mesh = piece.mesh
            assert mesh is not None and not piece.visible
            assert len(mesh.faces) <= 64 and open_edges(mesh.vertices, mesh.faces) == 0, mesh.name
            # Coordinates are kept to 1 um.
            assert enclosed(mesh)[0] == pytest.approx(ConvexHull(mesh.vertices).volume, rel=1e-3)
            assert (mesh.vertices > solid.lower - 3e-3).all(), mesh.name
            assert (mesh.vertices < solid.upper + 3e-3).all(), mesh.name


def test_mass_properties_are_those_of_the_triangles(solids: list[Solid]) -> None:
    for solid in solids:
        sums = [enclosed(shape.mesh) for shape in solid.visual if shape.mesh is not None]
        volume = sum(s[0] for s in sums)
        com = sum((s[1] for s in sums), np.zeros(3)) / volume
        second = sum((s[2] for s in sums), np.zeros((3, 3))) / volume - np.outer(com, com)
        gyration = np.trace(second) * np.eye(3) - second
        size = float(np.linalg.norm(solid.upper - solid.lower))
        # Triangles cut the corners off what is round: a thin rod of eight sides lacks a tenth.
        assert volume == pytest.approx(solid.volume, rel=0.1)
        np.testing.assert_allclose(com, solid.com, atol=0.02 * size)
        np.testing.assert_allclose(gyration, solid.gyration, atol=0.06 * np.trace(solid.gyration))


def test_a_solid_fills_what_it_says(solids: list[Solid]) -> None:
    for solid in solids:
        corners = np.concatenate([s.mesh.vertices for s in solid.visual if s.mesh is not None])
        np.testing.assert_allclose(corners.min(axis=0), solid.lower, atol=1e-6)
        np.testing.assert_allclose(corners.max(axis=0), solid.upper, atol=1e-6)


@pytest.mark.parametrize(("arm", "tool"), ARMS)
def test_every_body_is_a_possible_one(arm: str, tool: str) -> None:
    for body in load_arm(arm, tool).bodies:
        assert body.mass > 0.0 and not impossible(body.inertia), f"{body.part}: {body.frame}"


def test_a_body_that_names_a_solid_has_its_inertia_at_the_body_s_mass() -> None:
    for body in load_arm("psm", "none").bodies:
        if body.inertia_from == "solid":
            np.testing.assert_allclose(body.inertia, body.mass * read_solid(body.solid).gyration)


def test_only_what_the_description_says_touches() -> None:
    bodies = {body.frame: body for body in load_arm("psm", "none").bodies}
    assert any(s.collide for s in bodies["pitch_end"].shapes)
    assert not any(s.collide and s.visible for b in bodies.values() for s in b.shapes)


def test_names_of_meshes_are_unique_in_a_rig() -> None:
    rig = load_rig("full_cart")
    shapes = [s for arm in rig.arms for body in arm.arm.bodies for s in body.shapes]
    shapes += [s for prop in rig.props for s in prop.shapes]
    meshes = {id(s.mesh): s.mesh.name for s in shapes if s.mesh is not None}
    assert len(set(meshes.values())) == len(meshes)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    shutil.copytree(DATA / "psm", tmp_path / "psm")
    return tmp_path


def test_a_folder_of_one_s_own_gives_the_same_solid(folder: Path) -> None:
    ours, theirs = read_solid("psm/yaw"), read_solid("psm/yaw", folder)
    assert theirs is not ours and theirs.volume == ours.volume


def test_a_file_that_lacks_triangles_is_rejected(folder: Path) -> None:
    file = folder / "psm" / "yaw.cover.obj"
    file.write_text("\n".join(file.read_text().splitlines()[:-1]))
    with pytest.raises(DescriptionError, match=r"yaw.visual\[0\].triangles: got \d+; .* holds \d+"):
        read_solid("psm/yaw", folder)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "is no OBJ file of make cad"),
        ("v 0 0 0\nv 1 0 0\nf 1 2 3\n", "corners are not there"),
        ("v 0 0 x\nf 1 2 3\n", "is no OBJ file of make cad: could not convert"),
    ],
)
def test_a_broken_file_is_named(folder: Path, text: str, message: str) -> None:
    (folder / "psm" / "yaw.cover.obj").write_text(text)
    with pytest.raises(DescriptionError, match=rf"yaw.cover.obj: .*{message}"):
        read_solid("psm/yaw", folder)


def test_an_unknown_key_of_the_index_is_rejected(folder: Path) -> None:
    file = folder / "psm" / INDEX
    file.write_text(file.read_text().replace("[yaw]\n", "[yaw]\ncolour = 3\n"))
    with pytest.raises(DescriptionError, match=r"yaw.colour: unknown key"):
        read_solid("psm/yaw", folder)


def test_the_package_stays_small() -> None:
    size = sum(file.stat().st_size for file in (PACKAGE / "data").rglob("*") if file.is_file())
    assert size <= 12e6


def meshes_of(name: str) -> list[tuple[Shape, np.ndarray]]:
    """Every mesh of a rig at its start, with its pose in the world."""
    rig = load_rig(name)
    found = [(s, prop.pose @ s.pose) for prop in rig.props for s in prop.shapes]
    roots: dict[str, dict[str, np.ndarray]] = {}
    for arm in rig.arms:
        at = roots[arm.on][arm.frame] @ arm.pose if arm.on else arm.pose
        mechanism, q = arm.arm.mechanism, rig.poses["start"][arm.name]
        roots[arm.name] = {
            f.name: at @ pose(mechanism, q, f.name, arm.arm.root) for f in mechanism.frames
        }
        found += [(s, roots[arm.name][b.frame] @ s.pose) for b in arm.arm.bodies for s in b.shapes]
    return [(s, at) for s, at in found if s.mesh is not None]


def triangles(shapes: list[tuple[Shape, np.ndarray]]) -> int:
    return sum(len(s.mesh.faces) for s, _ in shapes if s.mesh is not None)


def test_the_full_cart_has_no_more_triangles_than_a_page_can_show() -> None:
    meshes = meshes_of("full_cart")
    assert triangles([m for m in meshes if m[0].visible]) <= 120_000
    assert triangles([m for m in meshes if not m[0].visible]) <= 10_000


def test_the_endoscope_sees_no_more_than_20_000_triangles() -> None:
    """Those with a corner in a frustum of 80 deg across, the widest of the facts' cameras."""
    rig = load_rig("full_cart")
    scope = rig.arm("ECM")
    setup = rig.arm(scope.on)
    at = setup.pose @ pose(
        setup.arm.mechanism, rig.poses["start"][setup.name], scope.frame, setup.arm.root
    )
    at = (
        at
        @ scope.pose
        @ pose(scope.arm.mechanism, rig.poses["start"]["ECM"], "tip", scope.arm.root)
    )
    seen = 0
    for shape, place in meshes_of("full_cart"):
        if shape.mesh is None or not shape.visible:
            continue
        local = np.linalg.inv(at) @ place
        points = shape.mesh.vertices @ local[:3, :3].T + local[:3, 3]
        ahead = points[:, 2]
        wide = np.abs(points[:, :2]) <= np.tan(np.deg2rad(40.0)) * ahead[:, None]
        inside = (ahead > 0.01) & wide.all(axis=1)
        seen += int(inside[shape.mesh.faces].any(axis=1).sum())
    assert 0 < seen <= 20_000


@pytest.mark.parametrize(
    ("rig", "arms", "most"),
    [("psm", "PSM1", 20_000), ("ecm", "ECM", 12_000), ("full_cart", "SUJ_PSM1", 6_000)],
)
def test_one_arm_keeps_to_its_share(rig: str, arms: str, most: int) -> None:
    bodies = load_rig(rig).arm(arms).arm.bodies
    shapes = [(s, s.pose) for b in bodies for s in b.shapes if s.visible and s.mesh is not None]
    assert triangles(shapes) <= most
