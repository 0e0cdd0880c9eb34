"""Surfaces and curves that bend are seen where they are, and leave everything else alone."""

from __future__ import annotations

import numpy as np
import pytest

from tests.rendering.scenes import camera, mesh, plate, snapshot, stereo
from trocar.cameras.lens import plane_from_pixels
from trocar.errors import InputError
from trocar.geometry.se3 import transform
from trocar.rendering import Channels, Look, Renderer, Series, StereoFrame
from trocar.rendering.primitives import tube, vertex_normals
from trocar.simulation import World
from trocar.simulation.records import Drawing, DrawnCurve, DrawnSurface

EYES = {"eye": camera(stereo())}
BACK = [mesh("back", plate(transform(np.eye(3), [0.0, 0.0, 0.12]), 0.4, 0.4))]
CENTRE, RADIUS = np.array([0.004, -0.003, 0.09]), 0.02


def dome(centre: np.ndarray = CENTRE, name: str = "dome", rows: int = 120) -> DrawnSurface:
    """Return the half of a sphere that faces the camera."""
    polar = np.linspace(0.0, 0.5 * np.pi, rows)[:, None]
    around = np.linspace(0.0, 2.0 * np.pi, 2 * rows)
    ring = np.sin(polar)
    vertices = centre + RADIUS * np.stack(
        [ring * np.cos(around), ring * np.sin(around), -np.cos(polar) + 0.0 * around], axis=-1
    ).reshape(-1, 3)
    row, column = np.meshgrid(np.arange(rows - 1), np.arange(2 * rows - 1), indexing="ij")
    a = (2 * rows * row + column).ravel()
    faces = np.concatenate(
        [
            np.stack([a, a + 2 * rows + 1, a + 2 * rows], 1),
            np.stack([a, a + 1, a + 2 * rows + 1], 1),
        ]
    )
    return DrawnSurface(name, vertices, faces)


def thread(radius: float = 0.001, name: str = "thread") -> DrawnCurve:
    """Return a helix ahead of the camera."""
    t = np.linspace(0.0, 4.0 * np.pi, 200)
    points = np.stack([0.01 * np.cos(t), 0.01 * np.sin(t), 0.09 + 0.002 * t], axis=1)
    return DrawnCurve(name, points, radius)


def drawn(*drawings: Drawing, look: Look | None = None) -> StereoFrame:
    renderer = Renderer(lambda: (1, BACK), Channels(True, True, True), look)
    frame = renderer.render(snapshot()._replace(drawings=drawings), EYES, "eye")
    renderer.close()
    return frame


@pytest.mark.usefixtures("opengl")
def test_depth_and_normals_of_a_drawn_dome_are_a_spheres() -> None:
    frame = drawn(dome())
    assert frame.depth is not None and frame.ids is not None and frame.normals is not None
    inside = frame.ids[0] == {name: k for k, name in frame.names.items()}["dome"]
    assert inside.sum() > 10_000
    v, u = np.nonzero(inside)
    rays = plane_from_pixels(np.stack([u, v], axis=1).astype(float), frame.K[0])
    rays = np.concatenate([rays, np.ones((len(rays), 1))], axis=1)
    a, b = (rays**2).sum(axis=1), rays @ CENTRE  # |t r - c| = radius
    gap = b**2 - a * (CENTRE @ CENTRE - RADIUS**2)
    steep = np.sqrt(np.maximum(gap, 0.0) / a) < 0.3 * RADIUS
    depth = (b - np.sqrt(np.maximum(gap, 0.0))) / a
    off = np.abs(frame.depth[0][inside] - depth)[~steep]
    assert off.max() < 2e-5  # between two rows of vertices a chord lies 4 um below the sphere
    normal = (depth[:, None] * rays - CENTRE) / RADIUS
    assert (
        np.abs(frame.normals[0][inside] - normal)[~steep].max() < 0.5 * np.pi / 119
    )  # a row's angle


@pytest.mark.usefixtures("opengl")
def test_a_drawn_curve_is_as_wide_as_its_radius_says_and_throws_a_shadow() -> None:
    line = DrawnCurve("line", np.array([[-0.02, 0, 0.1], [0.0, 0, 0.1], [0.02, 0, 0.1]]), 0.002)
    frame = drawn(line)
    assert frame.ids is not None
    column = frame.ids[0][:, 327] == {name: k for k, name in frame.names.items()}["line"]
    assert column.sum() == pytest.approx(2 * 0.002 * frame.K[0, 1, 1] / 0.1, abs=1.5)
    plain = drawn(line, look=Look(shadows=False, exposure=0.0)).left.astype(int)
    shaded = drawn(line, look=Look(exposure=0.0)).left.astype(int)
    assert (plain - shaded).max() > 30


@pytest.mark.usefixtures("opengl")
def test_one_renderer_follows_drawings_that_come_grow_and_go() -> None:
    renderer = Renderer(lambda: (1, BACK), Channels(True, True, True))
    shots = [(), (dome(rows=20),), (dome(), thread()), (thread(),), ()]
    for drawings in shots:
        frame = renderer.render(snapshot()._replace(drawings=drawings), EYES, "eye")
        alone = drawn(*drawings)
        assert (frame.side_by_side == alone.side_by_side).all()
        assert (frame.ids == alone.ids).all() and frame.names == alone.names
    renderer.close()


@pytest.mark.usefixtures("opengl")
def test_a_series_draws_what_bends_although_no_body_moves() -> None:
    series = Series(Renderer(lambda: (1, BACK)))
    first, second = (
        series.render(
            snapshot(time=time)._replace(drawings=(dome(CENTRE + np.array([time, 0.0, 0.0])),)),
            EYES,
            "eye",
        )
        for time in (0.0, 0.01)
    )
    assert (first.left != second.left).any()
    series.close()


def test_normals_of_a_surface_are_the_spheres() -> None:
    ball = dome()
    normals = vertex_normals(ball.vertices, ball.faces.astype(np.int64))
    outwards = (normals * (ball.vertices - CENTRE)).sum(axis=1) / RADIUS
    rim = 1.5 * 0.5 * np.pi / 119  # there, all triangles are on one side
    assert outwards[240:].min() > np.cos(rim)


def test_a_tube_is_closed_faces_outwards_and_does_not_twist() -> None:
    points = thread().points
    vertices, normals, faces = tube(points, 0.001)
    a, b, c = vertices[faces.T]
    volume = np.einsum("ni,ni->", a, np.cross(b, c)) / 6.0
    length = np.linalg.norm(np.diff(points, axis=0), axis=1).sum()
    polygon = 0.5 * 12 * np.sin(2.0 * np.pi / 12)  # of radius 1
    assert volume == pytest.approx(polygon * 0.001**2 * length, rel=0.01)
    facing = (np.cross(b - a, c - a) * normals[faces].mean(axis=1)).sum(axis=1)
    assert (facing > 0.0).all()
    edges = np.sort(np.round(vertices[faces[:, [0, 1, 1, 2, 2, 0]]].reshape(-1, 2, 3), 9), axis=1)
    _, count = np.unique(edges.reshape(-1, 6), axis=0, return_counts=True)
    assert (count == 2).all()
    rings = normals[: 12 * len(points)].reshape(-1, 12, 3)
    step = np.linalg.norm(np.diff(points, axis=0), axis=1).max() / 0.01  # of a helix's tangent
    assert np.abs(np.diff(rings, axis=0)).max() < 1.5 * step


def test_drawings_leave_motion_bit_identical_and_are_asked_for_by_snapshots_only() -> None:
    asked = []

    def provider() -> DrawnCurve:
        asked.append(1)
        return thread()

    bare, world = World("psm"), World("psm")
    stop = world.draw("thread", provider)
    for each in (bare, world):
        each.arm("PSM1").move_jp(each.arm("PSM1").setpoint_js().position + 0.02)
        each.step(50)
    assert not asked and (world.save().row == bare.save().row).all()
    (own,) = world.snapshot().drawings
    assert own.name == "thread" and len(asked) == 1
    with pytest.raises(InputError, match="draw: got 'thread'"):
        world.draw("thread", provider)
    stop()
    assert world.snapshot().drawings == ()


@pytest.mark.parametrize(
    ("drawing", "message"),
    [
        (dome()._replace(faces=dome().faces + 1), "faces: got .* numbers from 0 up to 28799"),
        (dome()._replace(vertices=np.zeros((4, 2))), r"vertices \[m\]: .*allowed: n x 3 finite"),
        (dome()._replace(vertices=np.nan * dome().vertices), r"vertices \[m\]: got .*nan"),
        (dome()._replace(rest=np.zeros((3, 3))), r"rest \[m\]: got .*28800 x 3 finite"),
        (dome()._replace(rgba=(1.0, 0.0)), "rgba: got .*; allowed: 4 finite numbers from 0 up to"),
        (dome()._replace(gloss=np.nan), "gloss, metal: got .*; allowed: 2 finite numbers"),
        (thread()._replace(points=np.zeros((1, 3))), r"points \[m\]: got one; allowed: two or"),
        (thread()._replace(points=None), r"points \[m\]: got None"),
        (thread()._replace(radius=-0.001), r"radius \[m\]: got -0.001; allowed: a finite number"),
    ],
)
@pytest.mark.usefixtures("opengl")
def test_a_drawing_that_cannot_be_is_named(drawing: Drawing, message: str) -> None:
    with pytest.raises(InputError, match=f"drawing {drawing.name}: {message}"):
        drawn(drawing)
