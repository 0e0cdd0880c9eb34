"""The inside of a body about a scene: seen to all edges, and it hides and touches nothing."""

from __future__ import annotations

from contextlib import closing

import numpy as np
import pytest

from trocar.errors import DescriptionError
from trocar.rendering import Endoscope, Look
from trocar.simulation import World
from trocar.tasks import Task, make_task, run_episode, scene_with

PLACED = ("needle-pick", "suturing", "visual-servoing")


def begun(name: str, surroundings: str, seed: int = 0) -> Task:
    """Return a task at the beginning of an episode."""
    task = make_task(scene_with(name, {"surroundings": surroundings}))
    task.reset(seed)
    return task


@pytest.mark.usefixtures("opengl")
@pytest.mark.parametrize(("name", "seed"), [*((name, 0) for name in PLACED), ("suturing", 4)])
def test_tissue_reaches_all_edges_and_hides_nothing_that_is_used(name: str, seed: int) -> None:
    shares = []
    for surroundings in ("table", "cavity"):
        task = begun(name, surroundings, seed)
        used = [prop.name for prop in task.world.rig.objects]
        with closing(Endoscope(task.world, preset="dvrk_sd_640x480", ids=True, visible=used)) as s:
            frame = s.capture()
        shares.append(np.array([frame.visible[one] for one in used]))
        assert frame.ids is not None
        shown = {"" if k == 0 else frame.names[int(k)] for k in np.unique(frame.ids)}
        task.close()
    assert shown.isdisjoint({"", "table", "floor"}) and "cavity" in shown
    assert (shares[1] >= shares[0] - 0.02).all()
    assert frame.left.mean(axis=(0, 1)).argmax() == 0  # red


def test_a_cavity_changes_no_motion_and_no_physics() -> None:
    ends = []
    for surroundings in ("table", "cavity"):
        task = begun("needle-pick", surroundings)
        result = run_episode(task, 0)
        assert result.success
        ends.append((task.world.model.mj.ngeom, task.world.save().row.tobytes()))
    assert ends[0] == ends[1]


def test_a_cavity_is_one_closed_surface_seen_from_inside_and_the_same_in_every_run() -> None:
    worlds = [World(begun("needle-pick", "cavity").scene.rig) for _ in range(2)]
    first, again = ([s for s in w.shapes() if s.name.startswith("cavity")] for w in worlds)
    for a, b in zip(first, again, strict=True):
        assert a.triangles is not None and b.triangles is not None and a.normals is not None
        assert (a.triangles[0] == b.triangles[0]).all() and not a.collide
    points, faces = first[0].triangles  # type: ignore[misc]
    edges = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    _, count = np.unique(edges, axis=0, return_counts=True)
    assert (count == 2).mean() > 0.98  # but for the ring at the top
    inwards = np.array([0.0, 0.0, 0.08]) - points
    assert first[0].normals is not None
    facing = np.einsum("ij,ij->i", inwards, first[0].normals)
    assert (facing > 0.0).mean() > 0.98
    for organ in first[1:]:
        points, faces = organ.triangles  # type: ignore[misc]
        a, b, c = np.moveaxis((points - points.mean(axis=0))[faces], 1, 0)
        assert np.einsum("ij,ij->i", a, np.cross(b, c)).sum() > 0.0  # the volume inside


@pytest.mark.usefixtures("opengl")
def test_a_cavity_is_darker_at_the_edges_unless_another_vignette_is_chosen() -> None:
    task = begun("needle-pick", "cavity")

    def edge(look: Look | None) -> float:
        with closing(Endoscope(task.world, preset="dvrk_sd_640x480", look=look)) as scope:
            left = scope.capture().left.astype(float)
        return float(left[:, -20:].mean() / left[200:280, 280:360].mean())

    assert edge(None) < 0.95 * edge(Look("surgical"))


def test_a_scene_without_tissue_has_no_cavity() -> None:
    with pytest.raises(DescriptionError, match='surroundings: got "cavity"; allowed: "table"'):
        scene_with("peg-board", {"surroundings": "cavity"})
    with pytest.raises(DescriptionError, match="surroundings"):
        scene_with("needle-pick", {"surroundings": "kitchen"})


def test_gauze_lies_in_a_cavity_as_cloth_that_stays_below_and_within_the_pad() -> None:
    worlds = [World(scene_with("suturing", {"surroundings": at}).rig) for at in ("table", "cavity")]
    box, cloth = (next(s for s in world.shapes() if s.name == "foam/0") for world in worlds)
    assert box.kind == "box" and cloth.kind == "mesh" and cloth.material == "gauze"
    assert cloth.triangles is not None and cloth.normals is not None
    points, faces = cloth.triangles
    assert points[:, 2].max() <= box.size[2] and points[:, 2].min() >= -box.size[2] - 1e-3
    inner = np.abs(points[:, :2]).max(axis=1) < 0.7 * box.size[1]
    assert points[inner, 2].min() > box.size[2] - 1e-3  # the needle lies on it
    assert (cloth.normals[inner, 2] > 0.9).all() and faces.max() < len(points)
    assert np.ptp(points[:, :2], axis=0) == pytest.approx(2.0 * box.size[:2], abs=5e-3)
