"""The three-dimensional half of the page: the cart, the floor, the light and the camera."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import groupby
from typing import TYPE_CHECKING

import numpy as np
import viser
from numpy.typing import NDArray

from trocar.geometry.rotations import matrix_from_quaternion
from trocar.interfaces.viewer.finishes import finish
from trocar.interfaces.viewer.glb import Part, pack
from trocar.interfaces.viewer.meshes import half_extents, mesh

if TYPE_CHECKING:
    from trocar.simulation.records import ShapeRecord, Snapshot

Floats = NDArray[np.float64]

STILL = 1e-5
"""A pose whose numbers all changed less is not sent again: 10 um, 20 urad, far below a pixel."""

VIEW = np.array([0.85, 1.0, 0.38])
"""From the middle of the arms towards the camera. Source: chosen by eye: across the patient."""

SKY, HORIZON = (142, 160, 180), (232, 237, 242)
"""Colours of the backdrop's upper and lower edge. Source: chosen by eye."""

MARGIN = 0.95
"""Distance over the one at which a sphere around everything would just fit. Source: by eye."""

FIELD_OF_VIEW = np.deg2rad(38.0)
"""Vertical angle of the camera [rad]. Source: chosen by eye."""


class Bodies:
    """One node per body; only those that moved are sent."""

    def __init__(self, scene: viser.SceneApi, shapes: Iterable[ShapeRecord]) -> None:
        self._scene = scene
        self._looks: dict[int, bytes] = {}
        self._nodes: dict[int, viser.GlbHandle] = {}
        self.renew(shapes)

    def renew(self, shapes: Iterable[ShapeRecord]) -> int:
        """Show other shapes, as after an exchange of a tool; return how many bodies look new."""
        by_body = sorted(shapes, key=lambda shape: shape.body)
        looks = {
            body: pack(parts_of(tuple(group)))
            for body, group in groupby(by_body, key=lambda shape: shape.body)
        }
        for body in [b for b, look in self._looks.items() if looks.get(b) != look]:
            self._nodes.pop(body).remove()
        fresh = [body for body in looks if body not in self._nodes]
        for body in fresh:
            self._nodes[body] = self._scene.add_glb(f"/cart/body_{body}", looks[body])
        self._looks = looks
        self._index = np.array(list(self._nodes), dtype=int)
        self._sent: Floats | None = None
        return len(fresh)

    def show(self, snapshot: Snapshot) -> int:
        """Send the poses that changed; return how many."""
        positions, quaternions = snapshot.positions, snapshot.quaternions
        poses = np.concatenate([positions[self._index], quaternions[self._index]], axis=1)
        moved = self._moved(poses)
        for row in np.flatnonzero(moved):
            node = self._nodes[int(self._index[row])]
            node.position, node.wxyz = poses[row, :3], poses[row, 3:]
        if self._sent is None:
            self._sent = poses
        else:
            self._sent[moved] = poses[moved]
        return int(np.count_nonzero(moved))

    def _moved(self, poses: Floats) -> NDArray[np.bool_]:
        if self._sent is None:
            return np.ones(len(poses), dtype=bool)
        return np.any(np.abs(poses - self._sent) > STILL, axis=1)


def parts_of(shapes: Sequence[ShapeRecord]) -> list[Part]:
    """Join the shapes of one body into one set of triangles per finish, in the body's frame."""
    parts: list[Part] = []
    by_finish = sorted(shapes, key=lambda shape: (repr(finish(shape)), shape.normals is None))
    for (look, flat), group in groupby(by_finish, key=lambda s: (finish(s), s.normals is None)):
        vertices, normals, faces, count = [], [], [], 0
        for shape in group:
            points, triangles = shape.triangles or mesh(shape.kind, shape.size, shape.rounding)
            vertices.append(points @ shape.pose[:3, :3].T + shape.pose[:3, 3])
            if shape.normals is not None:
                normals.append(shape.normals @ shape.pose[:3, :3].T)
            faces.append(triangles + count)
            count += len(points)
        smooth = None if flat else np.concatenate(normals)
        parts.append(Part(np.concatenate(vertices), np.concatenate(faces), look, smooth))
    return parts


def light(scene: viser.SceneApi) -> None:
    """A key light from the upper left that throws shadows, a soft sky, a studio's reflections."""
    scene.configure_default_lights(enabled=False)
    scene.configure_environment_map("studio", environment_intensity=0.25)
    scene.add_light_directional(
        "/light/key", color=(255, 247, 235), intensity=2.3, cast_shadow=True, position=(3, 1.2, 4)
    )
    scene.add_light_directional(
        "/light/fill", color=(214, 228, 255), intensity=0.5, position=(-2, 4, 1.5)
    )
    scene.add_light_hemisphere(
        "/light/sky", sky_color=(236, 242, 255), ground_color=(120, 118, 115), intensity=0.3
    )


def backdrop(scene: viser.SceneApi) -> None:
    """A wall that grows darker upwards, so that the white arms stand out."""
    rise = np.linspace(0.0, 1.0, 256)[:, None, None]
    colours = (1 - rise) * np.array(SKY) + rise * np.array(HORIZON)
    scene.set_background_image(np.repeat(colours, 8, axis=1).astype(np.uint8), format="png")


def floor(scene: viser.SceneApi) -> None:
    """A floor that takes the shadows, with lines every 10 cm and every metre."""
    scene.add_grid(
        "/floor",
        width=12.0,
        height=12.0,
        cell_size=0.1,
        section_size=1.0,
        cell_color=(206, 211, 217),
        section_color=(176, 183, 192),
        cell_thickness=0.6,
        section_thickness=1.0,
        plane_color=(222, 227, 232),
        plane_opacity=1.0,
        shadow_opacity=0.35,
        fade_distance=9.0,
        fade_strength=1.6,
        fade_from="origin",
    )


def look_at_all(server: viser.ViserServer, shapes: Sequence[ShapeRecord], now: Snapshot) -> None:
    """Point the camera of every new browser so that all arms are in sight."""
    low, high = bounds([shape for shape in shapes if shape.arm] or shapes, now)
    middle = (low + high) / 2
    distance = 0.5 * float(np.linalg.norm(high - low)) / np.sin(FIELD_OF_VIEW / 2) * MARGIN
    camera = server.initial_camera
    camera.fov = FIELD_OF_VIEW
    camera.look_at = middle
    camera.position = middle + distance * VIEW / np.linalg.norm(VIEW)
    camera.near, camera.far = 0.02, 60.0


def bounds(shapes: Sequence[ShapeRecord], now: Snapshot) -> tuple[Floats, Floats]:
    """Bound the shapes in the world [m]: low (3,), high (3,)."""
    bodies = [shape.body for shape in shapes]
    turns = matrix_from_quaternion(now.quaternions[bodies])
    poses = np.array([shape.pose for shape in shapes])
    middles = now.positions[bodies] + (turns @ poses[:, :3, 3:])[..., 0]
    halves = np.array([half_extents(shape.kind, shape.size) for shape in shapes])
    reach = (np.abs(turns @ poses[:, :3, :3]) @ halves[..., None])[..., 0]
    return (middles - reach).min(axis=0), (middles + reach).max(axis=0)
